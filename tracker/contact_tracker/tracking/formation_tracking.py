"""Contacts beside the label, online, as the leading hypothesis has it (docs/theory.md, section 18)."""

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
from contact_tracker.tracking.state import TrackerState, scales_of

ESTABLISHED: Final = 0.8
"""Contacts are looked for beside a label of such a probability..."""
ESTABLISHED_TICKS: Final = 20
"""... that has lasted for so many ticks..."""
STILL_ESTABLISHED: Final = 0.5
"""... and those that were found are reported as long as it has this probability."""


def follow_formation(state: TrackerState, belief: Belief, tick: Tick) -> tuple[TrackerState, Belief]:
    """What touches beside the label after a tick that was weighed, and the belief with that."""
    label = belief.contact
    least = STILL_ESTABLISHED if any(one.holds for one in state.beside.held) else ESTABLISHED
    if label is Contact.FREE or belief.probability[label.column] < least:
        return state._replace(beside=online.interrupted(state.beside)), belief
    bank, row = state.banks[label.column], int(state.best_rows[label.column])
    onset, window = int(bank.onset[row]), state.window
    first_row = int(window.index.searchsorted(onset))
    if len(window) - first_row < ESTABLISHED_TICKS:
        return state._replace(beside=online.interrupted(state.beside)), belief
    assert state.averaging is not None
    some = window.cut(max(first_row, len(window) - online.LONGEST_TICKS), None)
    some = some.with_error(state.model.noise.extra_contact_variance[label.column])
    leave_per_s, origin_m = state.model.transitions.leave_per_s, state.averaging.origin_m
    ticks = FormationTicks(some, scales_of(state.model), leave_per_s, origin_m, state.knowledge)
    first = KnownContact(CONTACT_MODELS[label.column], bank.x[row])
    beside = online.advance(state.beside, ticks, first)
    state = state._replace(beside=beside)
    if beside.is_open:
        capped = ambiguity.at_most(belief.probability, label)
        belief = replace(belief, probability=capped, is_open=True)
    return state, replace(belief, further=_told(state, belief, tick))


def pause_formation(state: TrackerState) -> TrackerState:
    """After a tick in which nobody asks what touches beside the label."""
    if state.beside is online.NOTHING_BESIDE:
        return state
    return state._replace(beside=online.interrupted(state.beside))


def _told(state: TrackerState, belief: Belief, tick: Tick) -> tuple[FurtherContact, ...]:
    """The further contacts that hold now; ticks are as far apart as the model says."""
    power, now = state.model.certainty.posterior_power, state.ticks - 1
    return tuple(
        FurtherContact(
            one.elements.contact,
            float(expit(power * one.log_odds)),
            max(tick.start_ns - (now - one.since) * state.model.tick_ns, belief.onset_ns),
            None,
            one.geometry,
            tuple(kind for kind in one.inseparable if state.knowledge.allows(kind)),
            state.beside.constraints,
        )
        for one in state.beside.held
        if one.holds
    )
