"""The belief after a tick: of that tick, or with a lag of an earlier one."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.hypotheses.birth_proposals import named
from contact_tracker.hypotheses.contact_geometry import contact_geometry, element_estimate
from contact_tracker.landmarks.element_pairs import element_pairs
from contact_tracker.map.sighting import Sighting
from contact_tracker.motion.rests import rests_now
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.curved_motion import NO_CURVED_MOTION, update_curved_motion
from contact_tracker.tracking.state import TrackerState, scales_of

Array = NDArray[np.float64]


def answer(state: TrackerState, online: Belief) -> Belief | None:
    """The belief to report after a tick: the latest, or with a lag the earlier one, once there is one."""
    length = state.lag_history.shape[1]
    if not length:
        return online
    return lagged_belief(state, 0) if len(state.recent) == length else None


def flush_lag(state: TrackerState) -> list[Belief]:
    """The beliefs that the lag has withheld at the end of the stream."""
    first = 1 if len(state.recent) == state.lag_history.shape[1] else 0
    return [lagged_belief(state, row) for row in range(first, len(state.recent))]


def _had_begun(belief: Belief, stamp_ns: int) -> bool:
    return all(one.start_ns <= stamp_ns for one in belief.further)


def lagged_belief(state: TrackerState, row: int) -> Belief:
    """The belief about the tick of ``recent[row]``, given all data until now."""
    then = state.recent[row]
    weight = np.exp(state.log_state_weight - state.log_state_weight.max())
    back = row - len(state.recent)
    probability = np.einsum("j,js->s", weight, state.lag_history[:, back])
    probability = ambiguity.tempered(probability / probability.sum(), state.model.certainty.posterior_power)
    contact = STATES[int(np.argmax(probability))]
    # the geometry of that contact is in its belief of that time, or soon after
    telling = next((b for b in state.recent[row:] if b.contact is contact), then)
    onset_ns = telling.onset_ns if telling.contact is contact else then.stamp_ns
    geometry = telling.geometry if telling.contact is contact else None
    inseparable = telling.inseparable if telling.contact is contact else ()
    p_restricted = telling.p_restricted if telling.contact is contact else 0.0
    # from the latest belief whose further contacts had all begun: their constraints are counted
    begun = (b.further for b in state.recent[row:] if b.contact is contact and _had_begun(b, then.stamp_ns))
    further = max(begun, key=len, default=())
    is_open = telling.contact is contact and telling.is_open
    possible = state.knowledge.allowed
    probability = ambiguity.redistribute(probability, contact, inseparable, p_restricted, possible)
    probability = ambiguity.with_rivals(probability, contact, inseparable)
    if is_open:
        probability = ambiguity.at_most(probability, contact, possible=possible)
    onset_ns = min(onset_ns, then.stamp_ns)
    return Belief(
        then.stamp_ns,
        contact,
        probability,
        onset_ns,
        geometry,
        then.residual,
        inseparable,
        p_restricted,
        further,
        is_open=is_open,
    )


def state_posterior(state: TrackerState, stamp_ns: int) -> Belief:
    """The posterior of the states by the weights, and the best hypothesis of the most probable one.

    ``label_geometry`` adds the geometry, ``share_among_indistinguishable`` the ambiguity.
    """
    weight = np.exp(state.log_state_weight - state.log_state_weight.max())
    probability = ambiguity.tempered(weight, state.model.certainty.posterior_power)
    label = STATES[int(np.argmax(probability))]
    onset_ns = state.free_since_ns
    if label is not Contact.FREE:
        best = state.banks[label.column].single(int(state.best_rows[label.column]))
        onset_ns = int(best.onsets.onset_ns[0])
    return Belief(stamp_ns, label, probability, onset_ns, None, state.residual)


def share_among_indistinguishable(state: TrackerState, belief: Belief) -> Belief:
    """The belief in which states that the motion does not distinguish from the label share its
    probability."""
    label, possible = belief.contact, state.knowledge.allowed
    rivals, since, older = _compared_since_onset(state, label)
    freedom = ambiguity.freedom_of(label, since, older)
    others = ambiguity.indistinguishable(label, rivals, freedom)
    p_restricted = ambiguity.p_restricted(freedom.underused, since, state.model.tick_s)
    if label is Contact.FREE and state.curved.probability > 0.5:
        others, p_restricted = CONTACTS, max(p_restricted, state.curved.probability)
    inseparable = tuple(other for other in others if state.knowledge.allows(other))
    probability = ambiguity.redistribute(belief.probability, label, inseparable, p_restricted, possible)
    return replace(belief, probability=probability, inseparable=inseparable, p_restricted=p_restricted)


def open_beside(state: TrackerState, belief: Belief) -> Belief:
    """The belief in which other contacts that fit as well share the label's probability, if there are further
    contacts beside it."""
    label, knowledge = belief.contact, state.knowledge
    if not belief.further:
        return belief
    rivals, since, _ = _compared_since_onset(state, label)
    alike = set(filter(knowledge.allows, ambiguity.alike_in_formation(label, rivals)))
    if not alike:
        return belief
    others = tuple(one for one in STATES if one in alike | {*belief.inseparable})
    p_restricted = ambiguity.p_restricted(True, since, state.model.tick_s)
    given = state_posterior(state, belief.stamp_ns).probability
    probability = ambiguity.redistribute(given, label, others, p_restricted, knowledge.allowed)
    return replace(belief, probability=probability, inseparable=others, p_restricted=p_restricted)


def _compared_since_onset(
    state: TrackerState, label: Contact
) -> tuple[ambiguity.CompetingEvidence, Window, bool]:
    """How well each state explains the ticks since the onset of the label; those of the window, and whether
    there were others."""
    onset = state.free_since
    if label is not Contact.FREE:
        onset = int(state.banks[label.column].onset[state.best_rows[label.column]])
    rivals = ambiguity.competing_evidence(state.banks, label, onset, state.ticks - 1)
    since = state.window.pick(slice(state.window.index.searchsorted(onset), None))
    return rivals, since, onset < state.window.index[0]


def open_at_rest(state: TrackerState, belief: Belief) -> Belief:
    """The belief after a tick with frames: if the object rests, it does not tell the label from others."""
    others = ambiguity.others_at_rest(belief.contact, state.knowledge)
    if not others or belief.inseparable == others or not rests_now(state.sliding_window, state.model.tick_s):
        return belief
    given, p_restricted = state_posterior(state, belief.stamp_ns).probability, ambiguity.CHANGED_AT_REST
    possible = state.knowledge.allowed
    probability = ambiguity.redistribute(given, belief.contact, others, p_restricted, possible)
    if belief.is_open:
        probability = ambiguity.at_most(probability, belief.contact, possible=possible)
    return replace(belief, probability=probability, inseparable=others, p_restricted=p_restricted)


def with_curved_motion(state: TrackerState, label: Contact, tests_curvature: bool) -> TrackerState:
    """Test free motion for a curved surface at intervals, unless another tracker does that."""
    if label is not Contact.FREE:
        return state._replace(curved=NO_CURVED_MOTION)
    if not tests_curvature:
        return state
    known = state.curved, state.window, state.free_since
    return state._replace(curved=update_curved_motion(*known, scales_of(state.model), state.knowledge))


def label_geometry(state: TrackerState, label: Contact) -> ContactGeometry | None:
    """The geometry of the best hypothesis of ``label``."""
    if label is Contact.FREE:
        return None
    bank, contact = state.banks[label.column], CONTACT_MODELS[label.column]
    row = int(state.best_rows[label.column])
    assert state.averaging is not None
    scales, origin_m = scales_of(state.model), state.averaging.origin_m
    pair = element_pairs(state.knowledge, contact)[bank.known_pair_index[row]]
    window = state.window.with_error(state.model.noise.extra_contact_variance[label.column])
    where = contact_geometry(bank, row, contact, scales, window, origin_m, state.model.systematic)
    return named(where, pair)


def label_sighting(state: TrackerState, label: Contact, stamp_ns: int) -> Sighting:
    """What the best hypothesis of ``label``, a contact, says about its elements."""
    bank, contact = state.banks[label.column], CONTACT_MODELS[label.column]
    one = bank.single(int(state.best_rows[label.column]))
    first, window = int(one.onset[0]), state.window
    since = window.pick(slice(window.index.searchsorted(first), None))
    since = since.with_error(state.model.noise.extra_contact_variance[label.column])
    estimate = element_estimate(one, contact, scales_of(state.model), since)
    return Sighting(first, state.ticks, estimate, int(one.onsets.onset_ns[0]), stamp_ns)
