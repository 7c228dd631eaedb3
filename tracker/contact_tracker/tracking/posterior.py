"""The posterior of the states after a tick, and the beliefs that are read from it, also of earlier ticks."""

from dataclasses import replace

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hypotheses.observability import FittedContact, fitted_contact
from contact_tracker.states import CONTACTS, STATES, Contact, united
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.state import FilterState


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
    """Whether the best hypothesis of ``label`` may agree with free motion by chance; not with known elements,
    nor if it is older than the window."""
    if label.codimension != 1:  # nothing is looked up for other states, of which there may be no hypothesis
        return False
    row, onset, _ = state.best[label.column].tolist()
    if state.banks[label.column].rows["prior_index"][row] or onset < state.window.index[0]:
        return False
    return ambiguity.agrees_by_chance(label, state.window, onset)


def beside_indistinguishable(state: FilterState, belief: Belief) -> Belief:
    """The belief with the states that the motion does not distinguish from its label."""
    label = belief.contact
    onset = state.onset_of(label)
    rivals = ambiguity.competing_evidence(state.banks, label, onset, state.ticks - 1)
    freedom = ambiguity.freedom_of(label, state.window, onset)
    if label is Contact.FF:
        freedom = ambiguity.freedom_by_moves(freedom, state.window.since(onset), state.model.tick_s)
    alternatives = ambiguity.indistinguishable(label, rivals, freedom)
    before = state.belief
    if freedom.is_unknown and before is not None and before.contact is label:
        alternatives = united(alternatives, before.inseparable)
    if label is Contact.FREE and (state.curved.probability > 0.5 or state.map.untested_sides):
        alternatives = CONTACTS
    elif label not in (Contact.FREE, Contact.FF) and (others := _open_by_elements(state, belief, onset)):
        alternatives = united(alternatives, others)
    inseparable = tuple(filter(state.known_map.allows, alternatives))
    return replace(belief, inseparable=inseparable) if inseparable else belief


def _open_by_elements(state: FilterState, belief: Belief, onset: int) -> list[Contact]:
    """The states that are as possible as the label, other than f-f, by the elements that touch."""
    label, window, others = belief.contact, state.window, list[Contact]()
    contact, row = CONTACT_MODELS[label.column], state.best[label.column, 0]
    form, x = contact.family.FORM, state.banks[label.column].rows["x"][row]
    if form.h >= 0:  # the second element is a face
        normal = x[form.d2 : form.d2 + 3]
        if ambiguity.is_flush_now(normal, contact.body_in_1, window, onset, state.model.tick_s):
            others.append(Contact.FF)
    if label.codimension == 1 or label is Contact.FE:
        fit = belief if belief.where is not None else label_fit(state, label)
        geometry = None if fit is None else fit.geometry
        if geometry is not None and ambiguity.may_be_free(label, geometry, window):
            others.append(Contact.FREE)
    return others


def label_fit(state: FilterState, label: Contact) -> FittedContact | None:
    """The best hypothesis of ``label``."""
    if label is Contact.FREE:
        return None
    bank, contact = state.banks[label.column], CONTACT_MODELS[label.column]
    row = int(state.best[label.column, 0])
    window = state.window.with_error(state.model.noise.extra_contact_variance[label.column])
    errors, origins = state.model.systematic, state.origins
    return fitted_contact(
        bank, row, contact, state.scales, window, origins, errors, known_map=state.known_map
    )


def lagged_belief(state: FilterState, row: int) -> Belief:
    """The belief about the tick of ``recent[row]``, given all data until now."""
    past, stamp_ns, lag = state.recent[row], state.recent[row].stamp_ns, row - len(state.recent)
    probability = np.einsum("j,js->s", state_shares(state), state.lag_history[:, lag])
    probability = ambiguity.tempered(probability / probability.sum(), state.model.certainty.posterior_power)
    contact = STATES[int(np.argmax(probability))]
    # the geometry of that contact is in its belief of that time, in one soon after, or in its hypothesis now
    agreeing = [belief for belief in state.recent[row:] if belief.contact is contact]
    source = agreeing[0] if agreeing else _not_yet_labelled(state, contact, probability, past)
    # further contacts of the latest belief in which all of them had begun: their constraints are counted
    complete = (b.further for b in agreeing if all(contact.start_ns <= stamp_ns for contact in b.further))
    further = max(complete, key=len, default=())
    probability = ambiguity.reported(
        probability, contact, source.inseparable, state.known_map, source.is_open
    )
    return replace(
        source,
        stamp_ns=stamp_ns,
        probability=probability,
        onset_ns=min(source.onset_ns, stamp_ns),
        residual=past.residual,
        further=further,
    )


def _not_yet_labelled(state: FilterState, contact: Contact, probability: Array, past: Belief) -> Belief:
    """A belief that ``contact`` held at an earlier tick, of which no belief since then has been: by the best
    of its hypotheses now that had begun; without elements if there is none."""
    belief = Belief(past.stamp_ns, contact, probability, past.stamp_ns, None, past.residual)
    if contact is Contact.FREE:
        return belief
    bank, best = state.banks[contact.column], state.best.copy()
    onset_ns = bank.onsets.onset_ns[bank.onset_index]
    begun = np.flatnonzero(onset_ns <= past.stamp_ns)
    if not len(begun):
        return belief
    row = int(begun[bank.log_weight[begun].argmax()])
    best[contact.column] = row, bank.onset[row], onset_ns[row]
    state = state._replace(best=best)
    belief = replace(belief, onset_ns=int(onset_ns[row]), where=label_fit(state, contact))
    return beside_indistinguishable(state, belief)
