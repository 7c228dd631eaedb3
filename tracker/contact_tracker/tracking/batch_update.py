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
from contact_tracker.hypotheses.tick_update import LiveHypotheses, StopCondition
from contact_tracker.landmarks.landmark_memory import MAP_INSERTION_PROBABILITY
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.window import SlidingWindow, advance_windows
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.measurement_update import (
    Prediction,
    advanced,
    is_uninformative,
    predict,
    with_weights,
)
from contact_tracker.tracking.state import TrackerState, scales_of
from contact_tracker.tracking.tracker import read_posterior, skip_update

Array = NDArray[np.float64]


class TickResult(NamedTuple):
    """What the hypotheses weighed in one tick, as in ``TrackerState``."""

    tick: Tick
    log_birth_weight: Array
    log_transition: Array
    live_hypotheses: LiveHypotheses
    residual: Array
    outliers: int
    is_skipped: bool
    """Whether the hypotheses were not weighed, since nothing can change in it."""

    @classmethod
    def of(cls, state: TrackerState, tick: Tick) -> "TickResult":
        """The tick that has led to a state."""
        return cls(
            tick,
            state.log_birth_weight,
            state.log_transition,
            state.live_hypotheses,
            state.residual,
            state.outliers,
            not state.hazard_exposure,
        )


def update_in_batches(
    state: TrackerState, ticks: Sequence[Tick]
) -> Iterator[tuple[TrackerState, list[TickResult]]]:
    """Take in ticks that have been averaged; some at a time, each time with the state that they lead to."""
    slidings, first = list[SlidingWindow](), 0
    while first < len(ticks):
        some = ticks[first : first + bank_update.ticks_at_once(state.banks)]
        slidings = _windows(state, some, slidings)
        state, results = _update_batch(state, some, slidings)
        slidings = slidings[len(results) :]
        first += len(results)
        yield state, results


def _windows(
    state: TrackerState, ticks: Sequence[Tick], known: Sequence[SlidingWindow]
) -> list[SlidingWindow]:
    """The windows of some ticks, of which the first are known."""
    before = known[-1] if known else state.sliding_window
    return [*known, *advance_windows(before, state.ticks + len(known), ticks[len(known) :], state.model)]


def _update_batch(
    state: TrackerState, ticks: Sequence[Tick], slidings: Sequence[SlidingWindow]
) -> tuple[TrackerState, list[TickResult]]:
    """As far as nothing is to be looked at: a tick at least."""
    tick = ticks[0]
    if is_uninformative(state, tick):
        state, _ = skip_update(state, tick, slidings[0])
        return state, [TickResult.of(state, tick)]
    model, ahead = state.model, _predict_batch(state, ticks, slidings)
    until = StopCondition(MAP_INSERTION_PROBABILITY, model.certainty.posterior_power, state.memory.due_ns)
    moments, beyond = [one.tick_input for one in ahead], model.noise.extra_contact_variance
    banks, weighed = bank_update.update(
        state.banks, moments, beyond, scales_of(model), model.search.margin_nats, until
    )
    results = []
    for tick, one, weights in zip(ticks, ahead, weighed, strict=False):  # all that were weighed
        state = with_weights(state, tick, one, banks, weights)
        results.append(TickResult.of(state, tick))
    return read_posterior(state, tick, Detail.WEIGHTS)[0], results


def _predict_batch(
    state: TrackerState, ticks: Sequence[Tick], slidings: Sequence[SlidingWindow]
) -> list[Prediction]:
    """What is known before hypotheses are weighed, up to a tick that is mute or to where what is believed now
    may teach more."""
    ahead = list[Prediction]()
    due_ns = math.inf if state.belief is None else state.memory.due_ns.get(state.belief.onset_ns, math.inf)
    for tick, sliding in zip(ticks, slidings, strict=True):
        if ahead and (is_uninformative(state, tick) or ahead[-1].tick_input.stamp_ns >= due_ns):
            break
        one = predict(state, tick, sliding)
        ahead.append(one)
        state = advanced(state, one)
    return ahead
