"""Further contacts online, conditioned on the leading hypothesis (docs/theory.md, section 18)."""

from dataclasses import replace
from typing import Final

from scipy.special import expit

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.formations import online
from contact_tracker.formations.further import FormationTicks, KnownContact
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.states import Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.belief import Belief, FurtherContact
from contact_tracker.tracking.posterior import open_beside
from contact_tracker.tracking.state import TrackerState, scales_of

ESTABLISHED: Final = 0.8
"""Further contacts are searched beside a label of at least this probability..."""
ESTABLISHED_TICKS: Final = 20
"""... that has lasted this many ticks..."""
STILL_ESTABLISHED: Final = 0.5
"""... and are reported while the label has at least this probability."""


def follow_formation(state: TrackerState, belief: Belief, tick: Tick) -> tuple[TrackerState, Belief]:
    """Update the further contacts after an informative tick; returns the state and the belief with them."""
    label = belief.contact
    least = STILL_ESTABLISHED if any(one.is_present for one in state.formation.tracked) else ESTABLISHED
    if label is Contact.FREE or belief.probability[label.column] < least:
        return state._replace(formation=online.suspend(state.formation)), belief
    bank, row = state.banks[label.column], int(state.best_rows[label.column])
    onset, window = int(bank.onset[row]), state.window
    first_row = int(window.index.searchsorted(onset))
    if len(window) - first_row < ESTABLISHED_TICKS:
        return state._replace(formation=online.suspend(state.formation)), belief
    assert state.averaging is not None
    some = window.cut(max(first_row, len(window) - online.WINDOW_TICKS), None)
    some = some.with_error(state.model.noise.extra_contact_variance[label.column])
    leave_per_s, origin_m = state.model.transitions.leave_per_s, state.averaging.origin_m
    ticks = FormationTicks(
        some, scales_of(state.model), leave_per_s, origin_m, state.knowledge, state.model.systematic
    )
    first = KnownContact(CONTACT_MODELS[label.column], bank.x[row])
    formation = online.advance(state.formation, ticks, first)
    state = state._replace(formation=formation)
    belief = open_beside(state, replace(belief, further=_reported(state, belief, tick)))
    if formation.is_open:
        capped = ambiguity.at_most(belief.probability, label, possible=state.knowledge.allowed)
        belief = replace(belief, probability=capped, is_open=True)
    return state, belief


def pause_formation(state: TrackerState) -> TrackerState:
    """The state after a tick without an update of the further contacts."""
    if state.formation is online.EMPTY_FORMATION:
        return state
    return state._replace(formation=online.suspend(state.formation))


def _reported(state: TrackerState, belief: Belief, tick: Tick) -> tuple[FurtherContact, ...]:
    """The further contacts present now; ticks are ``tick_ns`` of the model apart."""
    power, now = state.model.certainty.posterior_power, state.ticks - 1
    return tuple(
        FurtherContact(
            one.elements.contact,
            float(expit(power * one.log_odds)) * ambiguity.most_beside(len(others)),
            max(tick.start_ns - (now - one.since) * state.model.tick_ns, belief.onset_ns),
            None,
            one.geometry,
            others,
            state.formation.constraints,
        )
        for one in state.formation.tracked
        for others in [tuple(filter(state.knowledge.allows, one.inseparable))]
        if one.is_present
    )
