"""Update by several ticks in one call, without a posterior for each: same result as tick by tick, but faster.

First the predictions for all ticks are computed, then the hypothesis banks are updated tick by tick, up to
the first tick after which an element may be added to the map.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hypotheses import bank_update
from contact_tracker.hypotheses.tick_update import LiveHypotheses, StopCondition
from contact_tracker.map.sighting import MAP_INSERTION_PROBABILITY
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
    """Weights of the hypotheses after one tick, as in ``TrackerState``."""

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
        """The result of ``tick``, after which the tracker has ``state``."""
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
    """Update by averaged ticks in batches; yields the state after each batch and the results of its ticks."""
    windows, first = list[SlidingWindow](), 0
    while first < len(ticks):
        batch = ticks[first : first + bank_update.ticks_at_once(state.banks)]
        windows = _windows(state, batch, windows)
        state, results = _update_batch(state, batch, windows)
        windows = windows[len(results) :]
        first += len(results)
        yield state, results


def _windows(
    state: TrackerState, ticks: Sequence[Tick], known: Sequence[SlidingWindow]
) -> list[SlidingWindow]:
    """The windows of ``ticks``; those of the first ones are ``known``."""
    before = known[-1] if known else state.sliding_window
    return [*known, *advance_windows(before, state.ticks + len(known), ticks[len(known) :], state.model)]


def _update_batch(
    state: TrackerState, ticks: Sequence[Tick], windows: Sequence[SlidingWindow]
) -> tuple[TrackerState, list[TickResult]]:
    """Update by at least one tick, up to the first that stops the batch."""
    tick = ticks[0]
    if is_uninformative(state, tick, windows[0]):
        state, _ = skip_update(state, tick, windows[0])
        return state, [TickResult.of(state, tick)]
    model, predictions = state.model, _predict_batch(state, ticks, windows)
    stop = None
    if not state.uses_later_contacts:  # else nothing is added to the map
        power, due_ns = model.certainty.posterior_power, state.map.due_ns
        onset_ns = -1 if state.belief is None or state.current_pair is None else state.belief.onset_ns
        stop = StopCondition(MAP_INSERTION_PROBABILITY, power, due_ns, onset_ns)
    inputs, extra_variance = [one.tick_input for one in predictions], model.noise.extra_contact_variance
    banks, updated = bank_update.update(
        state.banks, inputs, extra_variance, scales_of(model), model.search.margin_nats, stop
    )
    results = []
    for tick, prediction, weights in zip(ticks, predictions, updated, strict=False):  # fewer if stopped
        state = with_weights(state, tick, prediction, banks, weights)
        results.append(TickResult.of(state, tick))
    return read_posterior(state, tick, Detail.WEIGHTS)[0], results


def _predict_batch(
    state: TrackerState, ticks: Sequence[Tick], windows: Sequence[SlidingWindow]
) -> list[Prediction]:
    """Predictions for the first of the ticks: up to an uninformative one, or to that in which the elements of
    the present contact are due again for the map."""
    predictions = list[Prediction]()
    due_ns = math.inf if state.belief is None else state.map.due_ns.get(state.belief.onset_ns, math.inf)
    for tick, window in zip(ticks, windows, strict=True):
        if predictions and (
            is_uninformative(state, tick, window) or predictions[-1].tick_input.stamp_ns >= due_ns
        ):
            break
        prediction = predict(state, tick, window)
        predictions.append(prediction)
        state = advanced(state, prediction)
    return predictions
