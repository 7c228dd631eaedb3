"""The belief after a tick: the label, what the motion leaves open, its geometry, and further contacts."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.explanations import online_contacts
from contact_tracker.explanations.further_contacts import FormationTicks, KnownContact
from contact_tracker.hypotheses.births import touching_evidence
from contact_tracker.hypotheses.observability import FittedContact, element_estimate, fitted_contact
from contact_tracker.map.association import MAP_INSERTION_PROBABILITY, Sighting
from contact_tracker.map.pairs import named_pairs
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.ambiguity import NO_CURVED_MOTION, update_curved_motion
from contact_tracker.tracking.belief import Belief, Detail, FurtherContact
from contact_tracker.tracking.state import FilterState

Array = NDArray[np.float64]

ESTABLISHED: Final = 0.8
"""Further contacts are searched beside a label of at least this probability..."""
ESTABLISHED_TICKS: Final = 20
"""... that has lasted this many ticks..."""
STILL_ESTABLISHED: Final = 0.5
"""... and are reported while the label has at least this probability."""


def read_posterior(
    state: FilterState, tick: Tick, detail: Detail, tests_curvature: bool
) -> tuple[FilterState, Belief]:
    """The belief after a tick, whose evidence is in ``state``; certain elements are added to the map.

    One filter of a bank ``tests_curvature``: whether free motion is on a curved surface.
    """
    probability = label_posterior(state)
    label = STATES[int(probability.argmax())]
    onset_ns = state.free_since_ns if label is Contact.FREE else int(state.best[label.column, 2])
    fit = label_fit(state, label) if detail >= Detail.GEOMETRY else None
    shared = belief = Belief(tick.stamp_ns, label, probability, onset_ns, fit, state.residual)
    state = state._replace(label=label)
    if detail >= Detail.SHARED or _should_update_map(state, belief):
        if label is not Contact.FREE:
            state = state._replace(curved=NO_CURVED_MOTION)
        elif tests_curvature:  # at intervals
            motion = state.curved, state.window, state.free_since, state.scales, state.known_map
            state = state._replace(curved=update_curved_motion(*motion))
        shared = share_among_indistinguishable(state, belief)
    if not shared.inseparable and _should_update_map(state, shared):  # sharing never raises its probability
        state = state._replace(map=state.map.insert(label_sighting(state, label, tick.stamp_ns)))
    if detail >= Detail.SHARED:
        belief = shared
    if detail >= Detail.FORMATION:
        state, belief = follow_formation(state, belief, tick)
    elif state.formation is not online_contacts.EMPTY_FORMATION:
        state = state._replace(formation=online_contacts.suspend(state.formation))
    return state, belief


def _should_update_map(state: FilterState, belief: Belief) -> bool:
    """Whether the labelled contact is certain enough for the map, and due."""
    if (
        state.uses_later_contacts
        or belief.contact is Contact.FREE
        or belief.probability.max() < MAP_INSERTION_PROBABILITY
    ):
        return False
    return belief.stamp_ns >= state.map.due_ns.get(belief.onset_ns, belief.stamp_ns)


def lagged_belief(state: FilterState, row: int) -> Belief:
    """The belief about the tick of ``recent[row]``, given all data until now."""
    past, stamp_ns, lag = state.recent[row], state.recent[row].stamp_ns, row - len(state.recent)
    probability = np.einsum("j,js->s", state_shares(state), state.lag_history[:, lag])
    probability = ambiguity.tempered(probability / probability.sum(), state.model.certainty.posterior_power)
    contact = STATES[int(np.argmax(probability))]
    # the geometry of that contact is in its belief of that time, or in one soon after
    agreeing = [belief for belief in state.recent[row:] if belief.contact is contact]
    without_geometry = Belief(stamp_ns, contact, probability, stamp_ns, None, past.residual)
    source = agreeing[0] if agreeing else without_geometry
    # further contacts of the latest belief in which all of them had begun: their constraints are counted
    complete = (b.further for b in agreeing if all(contact.start_ns <= stamp_ns for contact in b.further))
    further = max(complete, key=len, default=())
    args = source.inseparable, state.known_map, source.p_restricted, source.is_open
    probability = ambiguity.reported(probability, contact, *args)
    return replace(
        source,
        stamp_ns=stamp_ns,
        probability=probability,
        onset_ns=min(source.onset_ns, stamp_ns),
        residual=past.residual,
        further=further,
    )


def label_posterior(state: FilterState) -> Array:
    """The posterior (7,) of the states, the most probable of which is the label."""
    return ambiguity.tempered(state_shares(state), state.model.certainty.posterior_power)


def state_shares(state: FilterState) -> Array:
    """Shares (7,) of the states in their total weight. If the most probable states may agree with the motion
    by chance, they divide their weight with the first state that does not."""
    weight = np.exp(state.log_state_weight - state.log_state_weight.max())
    by_chance = list[Contact]()
    for column in (-weight).argsort().tolist():
        label = STATES[column]
        if not may_agree_by_chance(state, label):
            break
        by_chance.append(label)
    if by_chance:
        weight = ambiguity.shared_with(weight, label, by_chance)
    return np.asarray(weight / weight.sum())


def may_agree_by_chance(state: FilterState, label: Contact) -> bool:
    """Whether ``label`` is a contact of one constraint between new elements, and the motion has not used the
    five directions that it leaves: a new vertex and a new plane can be chosen such that they agree with any
    smooth motion in few directions (T24). False for a contact that is older than the window."""
    if label.codimension != 1:
        return False
    row, onset, _ = state.best[label.column].tolist()
    if state.banks[label.column].rows["prior_index"][row] or onset < state.window.index[0]:
        return False
    return ambiguity.freedom_of(label, state.window, onset).underused


def share_among_indistinguishable(state: FilterState, belief: Belief) -> Belief:
    """The belief in which states that the motion does not distinguish from the label share its
    probability."""
    label = belief.contact
    onset = state.onset_of(label)
    rivals = ambiguity.competing_evidence(state.banks, label, onset, state.ticks - 1)
    freedom = ambiguity.freedom_of(label, state.window, onset)
    touching: Array | float = 0.0
    if label is not Contact.FREE and state.known_map.lists_elements:
        bank = state.banks[label.column].single(int(state.best[label.column, 0]))
        touching = touching_evidence(CONTACT_MODELS[label.column], bank, state.window, state.scales)
    alternatives = ambiguity.indistinguishable(label, rivals, freedom, touching)
    p_restricted = ambiguity.p_restricted(freedom.underused, state.model.tick_s * freedom.moved_ticks)
    if label is Contact.FREE and state.curved.probability > 0.5:
        alternatives, p_restricted = CONTACTS, max(p_restricted, state.curved.probability)
    if label is Contact.FREE and state.map.untested_sides:
        alternatives = CONTACTS
    inseparable, possible = tuple(filter(state.known_map.allows, alternatives)), state.known_map.allowed
    if not inseparable and not p_restricted:
        return belief
    probability = ambiguity.redistribute(belief.probability, label, inseparable, p_restricted, possible)
    return replace(belief, probability=probability, inseparable=inseparable, p_restricted=p_restricted)


def open_beside(state: FilterState, belief: Belief) -> Belief:
    """The belief in which other contacts that fit as well are indistinguishable from the label, if there are
    further contacts beside it."""
    label, known_map = belief.contact, state.known_map
    if not belief.further:
        return belief
    onset = state.onset_of(label)
    rivals = ambiguity.competing_evidence(state.banks, label, onset, state.ticks - 1)
    alike = set(filter(known_map.allows, ambiguity.alike_in_formation(label, rivals)))
    if not alike:
        return belief
    inseparable = tuple(kind for kind in STATES if kind in alike | {*belief.inseparable})
    moved_s = state.model.tick_s * ambiguity.motion_since(state.window, onset)[1]
    p_restricted = ambiguity.p_restricted(True, moved_s)
    return replace(belief, inseparable=inseparable, p_restricted=p_restricted)


def with_rest(state: FilterState, belief: Belief, is_in_rest: bool) -> tuple[FilterState, Belief]:
    """The state and the belief to report after a tick: a rest does not distinguish the label from
    other states, and beside indistinguishable states the label is not certain."""
    open_at_rest = ambiguity.others_at_rest(belief.contact, state.known_map) if is_in_rest else ()
    if open_at_rest and belief.inseparable != open_at_rest:
        belief = replace(belief, inseparable=open_at_rest, p_restricted=ambiguity.CHANGED_AT_REST)
    if belief.inseparable or belief.is_open:
        args = belief.inseparable, state.known_map, belief.p_restricted, belief.is_open
        probability = ambiguity.reported(label_posterior(state), belief.contact, *args)
        belief = replace(belief, probability=probability)
    length = state.lag_history.shape[1]
    recent = (*state.recent, belief)[-length:] if length else ()
    return state._replace(recent=recent, belief=belief), belief


def label_fit(state: FilterState, label: Contact) -> FittedContact | None:
    """The best hypothesis of ``label``."""
    if label is Contact.FREE:
        return None
    bank, contact = state.banks[label.column], CONTACT_MODELS[label.column]
    row = int(state.best[label.column, 0])
    pair = named_pairs(state.known_map, contact)[bank.rows["known_pair_index"][row]]
    window = state.window.with_error(state.model.noise.extra_contact_variance[label.column])
    errors, origins = state.model.systematic, state.origins
    return fitted_contact(bank, row, contact, state.scales, window, origins, errors, pair=pair)


def label_sighting(state: FilterState, label: Contact, stamp_ns: int) -> Sighting:
    """The estimate of the elements by the best hypothesis of ``label``, a contact."""
    bank, contact = state.banks[label.column], CONTACT_MODELS[label.column]
    row, onset, _ = state.best[label.column].tolist()
    hypothesis = bank.single(row)
    since = state.window.since(onset).with_error(state.model.noise.extra_contact_variance[label.column])
    estimate = element_estimate(hypothesis, contact, state.scales, since)
    return Sighting(onset, state.ticks, estimate, int(hypothesis.onsets.onset_ns[0]), stamp_ns)


def follow_formation(state: FilterState, belief: Belief, tick: Tick) -> tuple[FilterState, Belief]:
    """Update the further contacts after an informative tick; returns the state and the belief with them."""
    label = belief.contact
    tracked = state.formation.tracked
    least = STILL_ESTABLISHED if tracked and any(contact.is_present for contact in tracked) else ESTABLISHED
    if label is Contact.FREE or belief.probability[label.column] < least:
        return state._replace(formation=online_contacts.suspend(state.formation)), belief
    window, (row, onset, _) = state.window, state.best[label.column].tolist()
    first_row, length = int(window.index.searchsorted(onset)), window.index.size
    if length - first_row < ESTABLISHED_TICKS:
        return state._replace(formation=online_contacts.suspend(state.formation)), belief
    labelled = KnownContact(label, state.banks[label.column].rows["x"][row].copy())
    beyond, excess = state.model.noise.extra_contact_variance[label.column], window.innovation_excess[-1]
    moved_ticks = float((excess / (excess + window.variance[-1] + beyond)).max(initial=0.0))
    formation = online_contacts.with_first(state.formation, labelled, window, moved_ticks)
    if formation.tracked or formation.queue or formation.ticks_since_search >= formation.search_interval:
        latest = window.cut(max(first_row, length - online_contacts.WINDOW_TICKS), None).with_error(beyond)
        rate, known_map = state.model.transitions.leave_per_s, state.known_map
        errors = state.model.systematic
        ticks = FormationTicks(latest, state.scales, rate, state.origins, known_map, errors)
        formation = online_contacts.advance(formation, ticks, labelled)
    state = state._replace(formation=formation)
    if formation.tracked:
        belief = open_beside(state, replace(belief, further=_reported(state, belief, tick)))
    if formation.is_open:
        belief = replace(belief, is_open=True)
    return state, belief


def _reported(state: FilterState, belief: Belief, tick: Tick) -> tuple[FurtherContact, ...]:
    """The further contacts present now; ticks are ``tick_ns`` of the model apart."""
    power, newest = state.model.certainty.posterior_power, state.ticks - 1
    return tuple(
        FurtherContact(
            contact.elements.contact,
            float(expit(power * contact.log_odds)) * ambiguity.most_beside(len(contact.inseparable)),
            max(tick.start_ns - (newest - contact.since) * state.model.tick_ns, belief.onset_ns),
            None,
            contact.geometry,
            contact.inseparable,
            state.formation.constraints,
        )
        for contact in state.formation.tracked
        if contact.is_present
    )
