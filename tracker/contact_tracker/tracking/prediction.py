"""The prediction for a tick: birth proposals, and probabilities of changing and staying."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from contact_tracker import hmm
from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.geometry.elements import Array
from contact_tracker.hypotheses.birth import BirthProposals
from contact_tracker.hypotheses.birth_proposals import (
    CachedProposals,
    Frame,
    propose_births,
)
from contact_tracker.hypotheses.proximity_prior import proximity_evidence, reweight_transitions
from contact_tracker.motion.lifted_pose import T
from contact_tracker.motion.rests import completes_rest
from contact_tracker.motion.window import SlidingWindow
from contact_tracker.tracking.state import TrackerState, scales_of
from contact_tracker.tracking.transition_model import (
    REST_LOG_LIKELIHOOD,
    hazard_exposure,
    tick_transitions,
)


class TransitionPrediction(NamedTuple):
    """Prediction for a tick, before its evidence."""

    proposals: tuple[BirthProposals, ...]
    """Birth proposals of each contact."""
    cached_proposals: tuple[CachedProposals, ...]
    """The same with their keys, for reuse at the next tick."""
    hazard_exposure: float
    """Exposure to a change of state, in ticks of motion."""
    log_transition: Array
    """(7, 7) log probabilities of a change before the tick, from row to column."""
    log_survival: Array
    """(7,) log probabilities of staying through it."""
    log_birth_weight: Array
    """(7,) log birth weights."""


def predict_transitions(state: TrackerState, sliding: SlidingWindow) -> TransitionPrediction:
    """The prediction for the newest tick of ``window``, by which ``state`` has not been updated."""
    window = sliding.window
    assert state.averaging is not None
    model = state.model
    first, frame = state.ticks == 0, Frame.around(state.averaging.origin_m, window.zeta[-1, T])
    cached = tuple(
        _proposals_of(contact, earlier, state, frame)
        for contact, earlier in zip(CONTACT_MODELS, state.cached_proposals, strict=True)
    )
    proposals = tuple(now.proposals for now in cached)
    exposed = hazard_exposure(window.latest_motion_ratio) + state.deferred_exposure
    if not state.knows_elements:
        transition, survival = _with_rest(tick_transitions(model, exposed), sliding, model)
        birth_weight = (
            state.log_state_weight if first else hmm.birth_log_weights(state.log_state_weight, transition)
        )
        return TransitionPrediction(proposals, cached, exposed, transition, survival, birth_weight)
    if state.known_map:  # known elements come into contact by any displacement, however smooth
        exposed = max(exposed, window.displacement_ratio)
    scales, newest = scales_of(model), window.cut(-1, None)
    proximity = [
        proximity_evidence(
            contact, some, newest.with_error(model.noise.extra_contact_variance[column]), scales
        )
        for column, (contact, some) in enumerate(zip(CONTACT_MODELS, proposals, strict=True))
    ]
    proposals = tuple(m.of(b) for m, b in zip(proximity, proposals, strict=True))
    usual = tick_transitions(model, exposed)
    transition, survival = _with_rest(reweight_transitions(*usual, proximity), sliding, model)
    if not first:
        return TransitionPrediction(
            proposals,
            cached,
            exposed,
            transition,
            survival,
            hmm.birth_log_weights(state.log_state_weight, transition),
        )
    birth_weight = state.log_state_weight + np.array([*(m.log_odds for m in proximity), 0.0])
    return TransitionPrediction(
        proposals, cached, exposed, transition, survival, birth_weight - hmm.log_sum_exp(birth_weight)
    )


def _with_rest(transitions: tuple[Array, Array], sliding: SlidingWindow, model: Model) -> tuple[Array, Array]:
    """Log probabilities of changing and staying, times those that the object has rested until now in each
    state, if this tick completes a rest."""
    change, stay = transitions
    if not completes_rest(sliding, model.tick_s):
        return change, stay
    return change + REST_LOG_LIKELIHOOD[:, None], stay + REST_LOG_LIKELIHOOD


def _proposals_of(
    contact: ContactModel, earlier: CachedProposals, state: TrackerState, frame: Frame
) -> CachedProposals:
    """Birth proposals of a contact by the map as it is."""
    left_out = state.map.near(state.ticks, state.model.tick_s) if state.uses_later_contacts else ()
    current = None if state.uses_later_contacts else state.current_pair
    key = state.map, left_out, current, frame
    if earlier.map is state.map and earlier[1:-1] == key[1:]:
        return earlier
    view = state.map.without(left_out) if left_out else state.map.whole
    view = replace(view, current=current)
    share = 0.0 if state.uses_later_contacts else state.model.geometry.revisit_prior
    return CachedProposals(*key, propose_births(contact, state.known_map, view, share, frame))
