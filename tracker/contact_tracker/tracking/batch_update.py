"""Several ticks at once, where nobody asks what is believed of each: the same as one by one, in less time.

What is known before hypotheses are weighed is worked out for all of them first. Then hypotheses go on from
tick to tick, until one teaches something.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hypotheses import bank_update
from contact_tracker.hypotheses.bank_update import Alive, Until
from contact_tracker.landmarks.landmark_memory import SURE
from contact_tracker.motion.sliding import Sliding, slid
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.measurement_update import Coming, after, coming, is_mute, passed
from contact_tracker.tracking.state import TrackerState, scales_of
from contact_tracker.tracking.tracker import hold, look

Array = NDArray[np.float64]


class Glimpse(NamedTuple):
    """Of one ``tick`` what hypotheses weighed in it, and the outliers so far, as in ``TrackerState``."""

    tick: Tick
    entry: Array
    change: Array
    alive: Alive
    residual: Array
    outliers: int

    @classmethod
    def of(cls, state: TrackerState, tick: Tick) -> "Glimpse":
        """The tick that has led to a state."""
        return cls(tick, state.entry, state.change, state.alive, state.residual, state.outliers)


def strides(state: TrackerState, ticks: Sequence[Tick]) -> Iterator[tuple[TrackerState, list[Glimpse]]]:
    """Take in ticks that have been averaged; some at a time, each time with the state that they lead to."""
    slidings, first = list[Sliding](), 0
    while first < len(ticks):
        some = ticks[first : first + bank_update.ticks_at_once(state.banks)]
        slidings = _slidings(state, some, slidings)
        state, seen = _stride(state, some, slidings)
        slidings = slidings[len(seen) :]
        first += len(seen)
        yield state, seen


def _slidings(state: TrackerState, ticks: Sequence[Tick], known: Sequence[Sliding]) -> list[Sliding]:
    """The windows of some ticks, of which the first are known."""
    slidings = [*known]
    for tick in ticks[len(known) :]:
        before = slidings[-1] if slidings else state.sliding
        slidings.append(slid(before, state.ticks + len(slidings), tick, state.model))
    return slidings


def _stride(
    state: TrackerState, ticks: Sequence[Tick], slidings: Sequence[Sliding]
) -> tuple[TrackerState, list[Glimpse]]:
    """As far as nothing is to be looked at: a tick at least."""
    tick = ticks[0]
    if is_mute(state, tick):
        state, _ = hold(state, tick, slidings[0])
        return state, [Glimpse.of(state, tick)]
    model, ahead = state.model, _ahead(state, ticks, slidings)
    until = Until(SURE, model.certainty.sureness, state.memory.due_ns)
    moments, beyond = [one.moment for one in ahead], model.noise.beyond_floor
    banks, weighed = bank_update.update(
        state.banks, moments, beyond, scales_of(model), model.search.margin_nats, until
    )
    seen = []
    for tick, one, told in zip(ticks, ahead, weighed, strict=False):  # all that were weighed
        state = after(state, tick, one, banks, told)
        seen.append(Glimpse.of(state, tick))
    return look(state, tick, Detail.WEIGHTS)[0], seen


def _ahead(state: TrackerState, ticks: Sequence[Tick], slidings: Sequence[Sliding]) -> list[Coming]:
    """What is known before hypotheses are weighed, up to a tick that is mute or to where what is believed now
    may teach more."""
    ahead = list[Coming]()
    due_ns = math.inf if state.belief is None else state.memory.due_ns.get(state.belief.onset_ns, math.inf)
    for tick, sliding in zip(ticks, slidings, strict=True):
        if ahead and (is_mute(state, tick) or ahead[-1].moment.stamp_ns >= due_ns):
            break
        one = coming(state, tick, sliding)
        ahead.append(one)
        state = passed(state, one)
    return ahead
