"""The update of the tracker by a tick: window, births, and weights of the hypotheses."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker import hmm
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hmm import fixed_lag
from contact_tracker.hypotheses import bank_update
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.pruning import Births
from contact_tracker.hypotheses.tick_update import TickInput, TickWeights
from contact_tracker.motion.free_motion import NO_EXCESS
from contact_tracker.motion.lifted_pose import R
from contact_tracker.motion.rests import completes_rest, rest_ticks, rests_now
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.window import SlidingWindow, advance_window
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.prediction import TransitionPrediction, predict_transitions
from contact_tracker.tracking.state import TrackerState, scales_of
from contact_tracker.tracking.transition_model import hazard_exposure, tick_transitions

Array = NDArray[np.float64]

FREE: Final = Contact.FREE.column


class Prediction(NamedTuple):
    """The prediction for a tick, before its evidence is evaluated."""

    sliding_window: SlidingWindow
    """The window including the tick."""
    transitions: TransitionPrediction
    tick_input: TickInput
    """Input of the update of the hypothesis banks."""


def is_uninformative(state: TrackerState, tick: Tick, sliding: SlidingWindow) -> bool:
    """Whether neither this tick nor the one before carries information: at rest, in a gap, or before the
    strength of motion is known. Births at such a tick can wait for the next informative one without changing
    the posterior. With known elements every tick is informative, since it shows whether they touch, and with
    those of the map each up to the one that completes a rest, except after a gap."""
    before, tick_s = state.window.innovation_excess[-1:], state.model.tick_s
    if state.known_map or not len(before) or before.any() or tick.innovation_excess != NO_EXCESS:
        return False
    if state.knows_elements and sliding.frames[-rest_ticks(tick_s) :].all():
        return rests_now(sliding, tick_s) and not completes_rest(sliding, tick_s)
    return not completes_rest(sliding, tick_s)


def propagate_without_update(
    state: TrackerState, sliding: SlidingWindow, outliers: int, count: int = 1
) -> TrackerState:
    """Append an uninformative tick to the window only, or without a lag ``count`` of them; their exposure to
    change is deferred to the next informative tick."""
    assert count == 1 or not state.lag_history.size
    oldest, banks = state.window.expired_by(sliding.window, count), state.banks
    if oldest.innovation_excess.any():  # of other ticks each term is zero, as no element is known
        scales, errors = scales_of(state.model), state.model.noise.extra_contact_variance
        banks = tuple(
            bank_update.marginalise_expired_ticks(bank, contact, oldest.with_error(beyond), scales)
            for bank, contact, beyond in zip(banks, CONTACT_MODELS, errors, strict=True)
        )
    change, birth_weight = state.log_transition, state.log_birth_weight
    if state.hazard_exposure:  # the tick before was informative
        change = tick_transitions(state.model, 0.0).log_transition
        birth_weight = hmm.birth_log_weights(state.log_state_weight, change)
    return state._replace(
        sliding_window=sliding,
        banks=tuple(map(_with_longer_history, banks, range(len(banks)))) if state.lag_history.size else banks,
        live_hypotheses=state.live_hypotheses.held(state.ticks + count - 1),
        ticks=state.ticks + count,
        next_hypothesis_id=state.next_hypothesis_id + count,
        outliers=state.outliers + outliers,
        hazard_exposure=0.0,
        log_transition=change,
        log_birth_weight=birth_weight,
        deferred_exposure=state.deferred_exposure + count * hazard_exposure(0.0),
        lag_history=_longer_histories(state.lag_history),
    )


def update_hypotheses(state: TrackerState, tick: Tick, sliding: SlidingWindow) -> TrackerState:
    """Update by an informative tick: window, births, and weights of the hypotheses."""
    model, ahead = state.model, predict(state, tick, sliding)
    beyond, margin = model.noise.extra_contact_variance, model.search.margin_nats
    updated = bank_update.update(state.banks, [ahead.tick_input], beyond, scales_of(model), margin)
    return with_weights(state, tick, ahead, updated.banks, updated.tick_weights[0])


def predict(state: TrackerState, tick: Tick, sliding: SlidingWindow) -> Prediction:
    """The prediction for the newest tick of the window ``sliding``."""
    window = sliding.window
    ahead = predict_transitions(state, sliding)
    past = fixed_lag.inherited(state.lag_history, state.log_state_weight, ahead.log_transition)
    turn = tick.zeta[R].reshape(3, 3)
    births = Births(
        ahead.proposals,
        state.ticks,
        tick.start_ns,
        state.next_hypothesis_id,
        ahead.log_birth_weight,
        past,
        turn,
    )
    tick_input = TickInput(
        births, tick.stamp_ns, window, state.window, ahead.log_transition, ahead.log_survival
    )
    return Prediction(sliding, ahead, tick_input)


def with_weights(
    state: TrackerState, tick: Tick, ahead: Prediction, banks: Sequence[Bank], weighed: TickWeights
) -> TrackerState:
    """The state after a tick, with the updated banks and weights."""
    births = ahead.tick_input.births
    kept = tuple(_with_longer_history(bank, column) for column, bank in enumerate(banks))
    was_free = state.label is Contact.FREE
    return advanced(state, ahead)._replace(
        banks=kept,
        log_state_weight=weighed.log_state_weight,
        residual=weighed.residual,
        best_rows=weighed.best_rows,
        live_hypotheses=weighed.live_hypotheses,
        outliers=state.outliers + tick.outliers,
        label=STATES[int(np.argmax(weighed.log_state_weight))],
        free_since=state.free_since if was_free else state.ticks,
        free_since_ns=state.free_since_ns if was_free else tick.start_ns,
        hazard_exposure=ahead.transitions.hazard_exposure,
        log_transition=ahead.transitions.log_transition,
        log_birth_weight=weighed.log_birth_weight,
        log_normaliser=state.log_normaliser
        + float(weighed.log_birth_weight[FREE] - weighed.log_state_weight[FREE]),
        lag_history=_lag_histories(kept, births.lag_history[FREE]),
    )


def advanced(state: TrackerState, ahead: Prediction) -> TrackerState:
    """The state after a tick without the update of the hypotheses: enough for predicting the next tick."""
    return state._replace(
        sliding_window=ahead.sliding_window,
        cached_proposals=ahead.transitions.cached_proposals,
        ticks=state.ticks + 1,
        next_hypothesis_id=state.next_hypothesis_id + ahead.tick_input.births.total + 1,
        deferred_exposure=0.0,
    )


def advanced_window(state: TrackerState, tick: Tick) -> SlidingWindow:
    """The window including the tick."""
    return advance_window(state.sliding_window, state.ticks, tick, state.model)


def _with_longer_history(bank: Bank, column: int) -> Bank:
    """The bank with its lag histories extended by a tick in the state of ``column``."""
    return (
        replace(bank, lag_history=fixed_lag.grown(bank.lag_history, column))
        if bank.lag_history.shape[1]
        else bank
    )


def _longer_histories(histories: Array) -> Array:
    """The lag histories (7, L, 7) of the states, each extended by a tick in it."""
    if not histories.size:  # no lag
        return histories
    return np.array([fixed_lag.grown(past, column) for column, past in enumerate(histories)])


def _lag_histories(banks: Sequence[Bank], free: Array) -> Array:
    """Lag history (7, L, 7) of each state: the weighted mean over its hypotheses, and that of ``free`` (L,
    7)."""
    if not free.size:  # no lag
        return np.zeros((len(STATES), *free.shape))
    return np.array(
        [*(fixed_lag.mixed(b.lag_history, b.log_weight) for b in banks), fixed_lag.grown(free, FREE)]
    )
