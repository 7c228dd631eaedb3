"""The prediction for a tick: birth proposals, and probabilities of changing and staying."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from contact_tracker import hmm
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import Array
from contact_tracker.hypotheses.births import (
    BirthProposals,
    CachedProposals,
    Frame,
    propose_births,
)
from contact_tracker.hypotheses.proximity_prior import reweight_transitions, weigh_births
from contact_tracker.motion.lifted_pose import T
from contact_tracker.motion.window import Window
from contact_tracker.states import STATES
from contact_tracker.tracking.state import FilterState
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


def predict_transitions(
    state: FilterState, window: Window, completes_rest: bool = False
) -> TransitionPrediction:
    """The prediction for the newest tick of ``window``, by which ``state`` has not been updated.

    If it completes a rest, the object has rested until now in the state: that counts once.
    """
    model = state.model
    cached = _proposals(state, Frame.around(state.origins, window.zeta[-1, T]))
    proposals, log_odds = tuple([one.proposals for one in cached]), np.zeros(len(STATES))
    exposed = hazard_exposure(window.latest_motion_ratio) + state.deferred_exposure
    if state.known_map:  # known elements come into contact by any displacement, however smooth
        exposed = max(exposed, window.displacement_ratio)
    transition, survival = tick_transitions(model, exposed)
    if state.knows_elements:
        beyond = model.noise.extra_contact_variance
        proposals, log_odds[:-1], gain = weigh_births(proposals, window, beyond, state.scales)
        transition, survival = reweight_transitions(transition, survival, log_odds[:-1], gain)
    if completes_rest:
        transition, survival = transition + REST_LOG_LIKELIHOOD[:, None], survival + REST_LOG_LIKELIHOOD
    if state.ticks:
        birth_weight = hmm.birth_log_weights(state.log_state_weight, transition)
    else:
        birth_weight = state.log_state_weight + log_odds
        birth_weight = birth_weight - hmm.log_sum_exp(birth_weight) if state.knows_elements else birth_weight
    return TransitionPrediction(proposals, cached, exposed, transition, survival, birth_weight)


def _proposals(state: FilterState, frame: Frame) -> tuple[CachedProposals, ...]:
    """Birth proposals of each contact by the map as it is."""
    left_out = state.map.near(state.ticks, state.model.tick_s) if state.uses_later_contacts else ()
    current = None if state.uses_later_contacts else state.current_pair
    before = state.cached_proposals
    if before[0].map is state.map and before[0][1:-1] == (left_out, current, frame):
        return before
    view = state.map.without(left_out) if left_out else state.map.whole
    view = replace(view, current=current)
    share = 0.0 if state.uses_later_contacts else state.model.geometry.revisit_prior
    proposals = [propose_births(contact, state.known_map, view, share, frame) for contact in CONTACT_MODELS]
    return tuple(CachedProposals(state.map, left_out, current, frame, begins) for begins in proposals)
