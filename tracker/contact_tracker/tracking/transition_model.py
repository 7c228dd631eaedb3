"""Initial and transition probabilities of the HMM, from the containment lattice and from counts.

The lattice is a prior with the weight ``prior_changes``, to which the counts of calibration add
(docs/models.md). So no change is impossible, and few counts change little.
"""

from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import expm

from contact_tracker.arrays import Array
from contact_tracker.config.parameters import Model, Transitions
from contact_tracker.states import CONTACTS, STATES, Contact

REST_EXPOSURE: Final = 0.02
"""Exposure to change of a tick without visible motion, in ticks of motion: contacts change by moving."""
LIFTED_AFTER_REST: Final = 0.65
"""Probability that an object which stands in f-f is lifted at the end of its rest, beyond the ordinary
transitions: in recordings with truth 15 of 22 such rests of a second or more ended in free motion and 7 went
on in f-f; 15 rests in other contacts, which were held, all went on in these. On 15 recordings of everyday
handling 0 and 0.65 give 0.863 and 0.867 offline, 0.750 and 0.760 online; divided as by the ordinary
transitions, they give 0.006 less online."""
PACE_SHAPE: Final = 1.3
"""Shape of the gamma prior, with mean one, on the pace of a recording: how much more often states end in it
than by the model. Most likely given the true changes of 47 recordings, whose paces are 0.34 to 11; their log
likelihood is 97 nats higher than with one pace for all. On 14 simulated everyday recordings 1.2 % of the time
is sure and wrong offline with it, with half and with double, and 2.7 % with one pace for all."""
FREE: Final = Contact.FREE.column
FACES: Final = Contact.FF.column
REST_LOG_LIKELIHOOD: Final = np.array([0.0, *[-6.0] * 5, -12.0])
"""Log likelihood (7,) of the first ``REST_S`` of a rest in each state, relative to that of f-f, once a rest:
an object that stands by itself does so on a face, and no hand holds one still in the air. Of 72 rests in 35
recordings 59 were f-f, 8 several contacts, 5 others and none free. On 15 recordings of everyday handling
0, -3 and -12 give 0.65, 0.68 and, with -6 for the others, 0.70 without an online map. A label is never
certain by it alone (``ambiguity.others_at_rest``)."""


def initial(transitions: Transitions) -> Array:
    """Probability (7,) of the state in which a recording begins: mean of the Dirichlet posterior."""
    p_faces = transitions.initial_f_f
    p_other = (1.0 - p_faces) / (len(STATES) - 1)
    prior = np.array([p_faces if state is Contact.FF else p_other for state in STATES])
    return _posterior_mean(prior, np.array(transitions.counts.begins), transitions.prior_changes)


def leave_per_s(transitions: Transitions) -> Array:
    """Rate (7,) at which each state is left while the object moves: mean of the gamma posterior."""
    weight, counts = transitions.prior_changes, transitions.counts
    departures = weight + np.array(counts.changes).sum(axis=1)
    return np.asarray(departures / (weight / transitions.leave_per_s + np.array(counts.moving_s)))


def destinations(transitions: Transitions) -> Array:
    """Distribution (7, 7) of the next state (column) given the state that is left: means of Dirichlet
    posteriors.

    The prior follows the lattice: steps to a neighbour, and between free and contact, are likely; changes
    that skip a step are rarer by ``skip``; the same contact with other elements is rarer still.
    """
    lattice = np.full((len(STATES), len(STATES)), transitions.skip)
    for i, a in enumerate(STATES):
        for j, b in enumerate(STATES):
            if a is b:
                lattice[i, j] = 0.0 if a is Contact.FREE else transitions.skip**2
            elif Contact.FREE in (a, b) or _adjacent(a, b):
                lattice[i, j] = 1.0
    prior = lattice / lattice.sum(axis=1, keepdims=True)
    return _posterior_mean(prior, np.array(transitions.counts.changes), transitions.prior_changes)


def log_initial(model: Model) -> Array:
    """Log probability (7,) of the state in which a recording begins."""
    return np.log(initial(model.transitions))


class TickTransitions(NamedTuple):
    """Log probabilities of one tick.

    Free motion needs no onset, so its stay is in ``log_transition``.
    """

    log_transition: Array
    """(7, 7) of a change at the boundary before it, from row to column."""
    log_survival: Array
    """(7,) of staying through it."""


def tick_transitions(model: Model, exposure: float) -> TickTransitions:
    """The log probabilities of a tick with this ``exposure`` (ticks of motion).

    A state changes at most once, unless the exposure is that of many ticks.
    """
    rate, log_split = _rates(model.transitions)
    stay = -rate * (model.tick_s * exposure)
    if exposure > 1.0:
        return TickTransitions(_after_changes(model, exposure, np.exp(stay)), stay)
    # without any exposure nothing changes
    change = np.log(-np.expm1(stay))[:, None] + log_split if exposure else np.full_like(log_split, -np.inf)
    change[FREE, FREE] = stay[FREE]
    return TickTransitions(change, stay)


def lift_after_rest(tick: TickTransitions) -> TickTransitions:
    """The log probabilities of a tick at the end of a rest: what stands on a face is mostly lifted."""
    change, stay = tick.log_transition.copy(), tick.log_survival.copy()
    change[FACES] += np.log1p(-LIFTED_AFTER_REST)
    stay[FACES] += np.log1p(-LIFTED_AFTER_REST)
    change[FACES, FREE] = np.logaddexp(change[FACES, FREE], np.log(LIFTED_AFTER_REST))
    return TickTransitions(change, stay)


def _after_changes(model: Model, exposure: float, stay: Array) -> Array:
    """Log probabilities (7, 7) of the state after any number of changes."""
    rate, log_split = _rates(model.transitions)
    generator = (rate * exposure * model.tick_s)[:, None] * (np.exp(log_split) - np.eye(len(STATES)))
    chance = expm(generator)
    lasted = np.where(np.arange(len(STATES)) == FREE, 0.0, stay)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.maximum(chance - np.diag(lasted), 0.0)))


@lru_cache(maxsize=8)
def _rates(transitions: Transitions) -> tuple[Array, Array]:
    """Rates of leaving (7,) and log distribution of the next state (7, 7), read-only."""
    with np.errstate(divide="ignore"):
        rate, log_split = leave_per_s(transitions), np.log(destinations(transitions))
    for values in (rate, log_split):
        values.flags.writeable = False
    return rate, log_split


def _posterior_mean(prior: Array, counts: Array, weight: float) -> Array:
    """Probabilities along the last axis from ``counts`` and a ``prior`` with the ``weight`` of this many
    counts."""
    return np.asarray((weight * prior + counts) / (weight + counts.sum(axis=-1, keepdims=True)))


def _adjacent(a: Contact, b: Contact) -> bool:
    """Whether one of the two contains the other, and no third contact lies between."""
    upper, lower = (a, b) if a.contains(b) else (b, a)
    between = [c for c in CONTACTS if c not in (a, b) and upper.contains(c) and c.contains(lower)]
    return upper.contains(lower) and not between
