"""What is kept of a whole recording: its ticks as one window, and the hypotheses of a forward pass."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.config.parameters import Model
from contact_tracker.hypotheses.bank_update import LiveHypotheses
from contact_tracker.motion.tick_averaging import Tick, tick_anisotropy, tick_variances
from contact_tracker.motion.window import Window
from contact_tracker.tracking.contact_filter import FilteredTick
from contact_tracker.tracking.transition_model import FREE
from contact_tracker_lab.calibration.trellis import Trellis


def window_of(ticks: Sequence[Tick], model: Model) -> Window:
    """All ticks of a recording, at least one, with the noise that is known at its end."""
    noise, count = ticks[-1].noise, np.array([float(tick.count) for tick in ticks])
    return Window(
        np.arange(len(ticks)),
        np.array([tick.zeta for tick in ticks]),
        tick_variances(noise, count, model),
        np.array([tick.innovation_excess for tick in ticks]),
        tick_anisotropy(noise, count, model),
        frames=count,
    )


@dataclass
class RecordedPass:
    """The hypotheses of a forward pass, for recordings that are evaluated as a whole."""

    exposures: list[float] = field(default_factory=list)
    alive: list[LiveHypotheses] = field(default_factory=list)
    numbers: list[Ints] = field(default_factory=list)

    def note(self, result: FilteredTick) -> None:
        """Append a tick."""
        self.exposures.append(result.state.hazard_exposure)
        self.alive.append(result.state.live_hypotheses)
        self.numbers.append(result.numbers)

    @property
    def exposure(self) -> Array:
        """Exposure to change at the boundary before each tick (T,), in ticks of motion.

        Exposure that is deferred at the end of the recording is missing. It has no effect, since no data
        follow.
        """
        return np.array(self.exposures)

    @property
    def trellis(self) -> Trellis:
        """All hypotheses of the pass."""
        count = 1 + int(self.numbers[-1].max())
        states, onsets = np.full(count, FREE), np.zeros(count, np.int64)
        for number, alive in zip(self.numbers, self.alive, strict=True):
            states[number], onsets[number] = alive.state, alive.onset
        return Trellis(states, onsets, self.numbers, [alive.log_likelihood for alive in self.alive])
