"""The forward pass over a whole recording, and a record of it."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker import hmm
from contact_tracker.config.parameters import Model
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.tick_update import LiveHypotheses
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion import tick_averaging
from contact_tracker.motion.poses import Pose, batches
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.window import Window
from contact_tracker.tracking import tracker
from contact_tracker.tracking.batch_update import TickResult, update_in_batches
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.measurement_update import FREE
from contact_tracker.tracking.state import TrackerState

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class FilteredTick(NamedTuple):
    """One tick of the pass: the ``state`` after it, the ``tick``, and the ``belief``."""

    state: TrackerState
    tick: Tick
    belief: Belief

    @property
    def tick_result(self) -> TickResult:
        """The weights of the hypotheses."""
        return TickResult.of(self.state, self.tick)

    @property
    def numbers(self) -> Index:
        """Numbers (A,) that identify the active hypotheses in the whole recording."""
        return np.append(Bank.of_all(self.state.banks, "number"), self.state.next_hypothesis_id - 1)


def forward(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    known_map: Map = EMPTY_MAP,
    detail: Detail = Detail.GEOMETRY,
) -> Iterator[FilteredTick]:
    """The ticks of a recording, each as soon as it is over.

    Parameters
    ----------
    poses : validated poses in order of time.
    progress : called after each batch of poses with the number of those read so far.
    known_map : elements of the object and its surroundings that are known before.
    detail : of the beliefs.
    """
    state, count = tracker.start(model, known_map=known_map), 0
    for batch in batches(poses):
        state, closed = tracker.accumulate_poses(state, batch)
        for tick, (after, belief) in zip(closed, tracker.update_each(state, closed, detail), strict=True):
            yield FilteredTick(after, tick, belief)
            state = after
        count += len(batch)
        if progress is not None:
            progress(count)
    state, closed = tracker.close_tick(state)
    for tick, (after, belief) in zip(closed, tracker.update_each(state, closed, detail), strict=True):
        yield FilteredTick(after, tick, belief)
        state = after


def filter_batches(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    known_map: Map = EMPTY_MAP,
) -> Iterator[tuple[TrackerState, list[TickResult]]]:
    """``forward`` without beliefs: several ticks at a time, with the state after them.

    Parameters as there.
    """
    state, count = tracker.start(model, known_map=known_map), 0
    for batch in batches(poses):
        state, closed = tracker.accumulate_poses(state, batch)
        for then, result in update_in_batches(state, closed):
            yield then, result
            state = then
        count += len(batch)
        if progress is not None:
            progress(count)
    state, rest = tracker.close_tick(state)
    yield from update_in_batches(state, rest)


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

    @property
    def exposure(self) -> Array:
        """Exposure to change at the boundary before each tick (T,), see ``transition_model.hazard_exposure``.

        Exposure that is deferred at the end of the recording is missing. It has no effect, since no data
        follow.
        """
        return np.array(self.exposures)

    def window(self, state: TrackerState) -> Window:
        """All ticks, with variances from the final noise estimate."""
        assert state.averaging is not None
        counts, noise = np.array(self.frames, float), state.averaging.stream.noise
        variance = tick_averaging.tick_variances(noise, counts, state.model)
        uneven = tick_averaging.tick_anisotropy(noise, counts, state.model)
        return replace(Window.join(self.newest), variance=variance, position_anisotropy=uneven)

    @property
    def trellis(self) -> hmm.Trellis:
        """All hypotheses of the pass."""
        count = 1 + int(self.numbers[-1].max())
        states, onsets = np.full(count, FREE), np.zeros(count, np.int64)
        for number, alive in zip(self.numbers, self.alive, strict=True):
            states[number], onsets[number] = alive.state, alive.onset
        return hmm.Trellis(states, onsets, self.numbers, [alive.log_likelihood for alive in self.alive])
