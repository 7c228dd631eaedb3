"""A record of a forward pass over a whole recording: its ticks, hypotheses and weights."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.hypotheses.bank_update import LiveHypotheses
from contact_tracker.motion import tick_averaging
from contact_tracker.motion.sensor_noise import NoiseEstimate
from contact_tracker.motion.window import Window
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.contact_filter import FilteredTick
from contact_tracker.tracking.transition_model import FREE
from contact_tracker_lab.calibration.trellis import Trellis

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass
class RecordedPass:
    """The ticks, hypotheses and weights of a forward pass, for recordings that are evaluated as a whole."""

    beliefs: list[Belief] = field(default_factory=list)
    start_ns: list[int] = field(default_factory=list)
    newest: list[Window] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    exposures: list[float] = field(default_factory=list)
    change: list[Array] = field(default_factory=list)
    entry: list[Array] = field(default_factory=list)
    alive: list[LiveHypotheses] = field(default_factory=list)
    numbers: list[Index] = field(default_factory=list)
    noise: NoiseEstimate | None = None

    @classmethod
    def over(cls, results: Iterable[FilteredTick]) -> "RecordedPass":
        """The record of all these ticks."""
        whole = cls()
        for result in results:
            whole.note(result)
        return whole

    def note(self, result: FilteredTick) -> None:
        """Append a tick."""
        self.beliefs.append(result.belief)
        self.start_ns.append(result.tick.start_ns)
        self.newest.append(result.state.window.cut(-1))
        self.frames.append(result.tick.count)
        self.exposures.append(result.state.hazard_exposure)
        self.change.append(result.state.log_transition)
        self.entry.append(result.state.log_birth_weight)
        self.alive.append(result.state.live_hypotheses)
        self.numbers.append(result.numbers)
        self.noise = result.tick.noise

    @property
    def exposure(self) -> Array:
        """Exposure to change at the boundary before each tick (T,), in ticks of motion.

        Exposure that is deferred at the end of the recording is missing. It has no effect, since no data
        follow.
        """
        return np.array(self.exposures)

    def window(self, model: Model) -> Window:
        """All ticks, with variances from the final noise estimate."""
        assert self.noise is not None
        counts = np.array(self.frames, float)
        variance = tick_averaging.tick_variances(self.noise, counts, model)
        uneven = tick_averaging.tick_anisotropy(self.noise, counts, model)
        return replace(Window.join(self.newest), variance=variance, position_anisotropy=uneven)

    @property
    def trellis(self) -> Trellis:
        """All hypotheses of the pass."""
        count = 1 + int(self.numbers[-1].max())
        states, onsets = np.full(count, FREE), np.zeros(count, np.int64)
        for number, alive in zip(self.numbers, self.alive, strict=True):
            states[number], onsets[number] = alive.state, alive.onset
        return Trellis(states, onsets, self.numbers, [alive.log_likelihood for alive in self.alive])
