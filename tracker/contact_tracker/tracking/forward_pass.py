"""The online pass over a whole recording, and what it met."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker import hmm
from contact_tracker.config.parameters import Model
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.bank_update import Alive
from contact_tracker.landmarks.prior_map import NOTHING, Knowledge
from contact_tracker.motion import tick_averaging
from contact_tracker.motion.poses import Pose, batches
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.window import Window
from contact_tracker.tracking import tracker
from contact_tracker.tracking.batch_update import Glimpse, strides
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.measurement_update import FREE
from contact_tracker.tracking.state import TrackerState

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Seen(NamedTuple):
    """One tick of the pass: the ``state`` that it led to, the ``tick``, and the ``belief`` right after it."""

    state: TrackerState
    tick: Tick
    belief: Belief

    @property
    def glimpse(self) -> Glimpse:
        """What hypotheses weighed."""
        return Glimpse.of(self.state, self.tick)

    @property
    def numbers(self) -> Index:
        """By which hypotheses are told apart over the whole recording (A,)."""
        return np.append(Bank.of_all(self.state.banks, "number"), self.state.numbers - 1)


def forward(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    knowledge: Knowledge = NOTHING,
    detail: Detail = Detail.GEOMETRY,
) -> Iterator[Seen]:
    """The ticks of a recording, each as soon as it is over.

    Parameters
    ----------
    poses : validated poses in order of time.
    progress : called after each batch of poses with the number of those read so far.
    knowledge : what is known of the object and its surroundings.
    detail : how much the beliefs tell.
    """
    state, count = tracker.start(model, knowledge=knowledge), 0
    for batch in batches(poses):
        state, closed = tracker.gather_some(state, batch)
        for tick in closed:
            state, belief = tracker.observe(state, tick, detail)
            yield Seen(state, tick, belief)
        count += len(batch)
        if progress is not None:
            progress(count)
    state, closed = tracker.gather_rest(state)
    for tick in closed:
        state, belief = tracker.observe(state, tick, detail)
        yield Seen(state, tick, belief)


def glimpses(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    knowledge: Knowledge = NOTHING,
) -> Iterator[tuple[TrackerState, list[Glimpse]]]:
    """``forward`` for who asks for no beliefs: some ticks at a time, and the state that they have led to.

    Parameters as there.
    """
    state, count = tracker.start(model, knowledge=knowledge), 0
    for batch in batches(poses):
        state, closed = tracker.gather_some(state, batch)
        for then, seen in strides(state, closed):
            yield then, seen
            state = then
        count += len(batch)
        if progress is not None:
            progress(count)
    state, rest = tracker.gather_rest(state)
    yield from strides(state, rest)


@dataclass
class Pass:
    """All that a forward pass met, tick by tick: for recordings that are looked at as a whole."""

    beliefs: list[Belief] = field(default_factory=list)
    start_ns: list[int] = field(default_factory=list)
    newest: list[Window] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    exposures: list[float] = field(default_factory=list)
    change: list[Array] = field(default_factory=list)
    entry: list[Array] = field(default_factory=list)
    alive: list[Alive] = field(default_factory=list)
    numbers: list[Index] = field(default_factory=list)

    @classmethod
    def over(cls, ticks_seen: Iterable[Seen]) -> "Pass":
        """Of all these ticks."""
        whole = cls()
        for seen in ticks_seen:
            whole.note(seen)
        return whole

    def note(self, seen: Seen) -> None:
        """Remember a tick."""
        self.beliefs.append(seen.belief)
        self.start_ns.append(seen.tick.start_ns)
        self.newest.append(seen.state.window.cut(-1, None))
        self.frames.append(seen.tick.count)
        self.exposures.append(seen.state.exposure)
        self.change.append(seen.state.change)
        self.entry.append(seen.state.entry)
        self.alive.append(seen.state.alive)
        self.numbers.append(seen.numbers)

    @property
    def exposure(self) -> Array:
        """To change at the boundary before each tick (T,), see ``transition_model.exposure``.

        What is withheld when the recording ends is in none of them. It would be without effect: no data come
        after it, so neither the evidence nor what is believed of the ticks before depends on it.
        """
        return np.array(self.exposures)

    def window(self, state: TrackerState) -> Window:
        """All ticks, with the variances that the final estimate of the noise gives them."""
        assert state.averaging is not None
        counts, noise = np.array(self.frames, float), state.averaging.learnt.noise
        variance = tick_averaging.tick_variances(noise, counts, state.model)
        uneven = tick_averaging.tick_unevenness(noise, counts)
        return replace(Window.join(self.newest), variance=variance, uneven=uneven)

    @property
    def trellis(self) -> hmm.Trellis:
        """All hypotheses that were met."""
        count = 1 + int(self.numbers[-1].max())
        states, onsets = np.full(count, FREE), np.zeros(count, np.int64)
        for number, alive in zip(self.numbers, self.alive, strict=True):
            states[number], onsets[number] = alive.state, alive.onset
        return hmm.Trellis(states, onsets, self.numbers, [alive.log_likelihood for alive in self.alive])
