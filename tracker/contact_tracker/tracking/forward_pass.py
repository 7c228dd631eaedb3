"""The forward pass over a whole recording, and a record of it."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker import hmm
from contact_tracker.config.parameters import Model
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.bank_update import LiveHypotheses
from contact_tracker.motion import tick_averaging
from contact_tracker.motion.poses import Pose, batches
from contact_tracker.motion.sensor_noise import NoiseEstimate
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.tick_grid import ORIGIN_M, TickGrid
from contact_tracker.motion.window import Window
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker.tracking.state import FilterState
from contact_tracker.tracking.transition_model import FREE

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class FilteredTick(NamedTuple):
    """One tick of the pass: the ``state`` after it, the ``tick``, and the ``belief``."""

    state: FilterState
    tick: Tick
    belief: Belief

    @property
    def numbers(self) -> Index:
        """Numbers (A,) that identify the active hypotheses in the whole recording."""
        return np.append(Bank.of_all(self.state.banks, "number"), self.state.next_hypothesis_id - 1)


def ticks_of(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    body_m: Array = ORIGIN_M,
) -> Iterator[Tick]:
    """The ticks of a recording, each as soon as it is over.

    Parameters
    ----------
    poses : validated poses in order of time.
    progress : called after each batch of poses with the number of those read so far.
    body_m : (3,) point of the body that is tracked, see ``sensor_noise.independent_point``.
    """
    grid, count = TickGrid(model, body_m), 0
    for batch in batches(poses):
        yield from grid.add(batch) if len(batch) else ()
        count += len(batch)
        if progress is not None:
            progress(count)
    yield from grid.close()


def forward(
    ticks: Iterable[Tick], one: ContactFilter, detail: Detail = Detail.GEOMETRY
) -> Iterator[FilteredTick]:
    """Update a filter by ticks; the beliefs have this ``detail``."""
    for tick in ticks:
        belief = one.update(tick, detail)
        yield FilteredTick(one.state, tick, belief)


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
        self.newest.append(result.state.window.cut(-1, None))
        self.frames.append(result.tick.count)
        self.exposures.append(result.state.hazard_exposure)
        self.change.append(result.state.log_transition)
        self.entry.append(result.state.log_birth_weight)
        self.alive.append(result.state.live_hypotheses)
        self.numbers.append(result.numbers)
        self.noise = result.tick.noise

    @property
    def exposure(self) -> Array:
        """Exposure to change at the boundary before each tick (T,), see ``transition_model.hazard_exposure``.

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
    def trellis(self) -> hmm.Trellis:
        """All hypotheses of the pass."""
        count = 1 + int(self.numbers[-1].max())
        states, onsets = np.full(count, FREE), np.zeros(count, np.int64)
        for number, alive in zip(self.numbers, self.alive, strict=True):
            states[number], onsets[number] = alive.state, alive.onset
        return hmm.Trellis(states, onsets, self.numbers, [alive.log_likelihood for alive in self.alive])
