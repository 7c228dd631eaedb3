"""Start and change of the states: the hidden Markov model's arrays from the containment lattice."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.labels import CONTACTS, STATES, Contact
from contact_tracker.model import Model

Array = NDArray[np.float64]

AT_REST: Final = 0.02
"""Share of the changes that happen in a tick without visible motion."""


def log_initial(model: Model) -> Array:
    """Log probability (7,) of the state in which a recording begins."""
    first = model.transitions.initial_f_f
    others = (1.0 - first) / (len(STATES) - 1)
    return np.log([first if state is Contact.FF else others for state in STATES])


def log_stay(model: Model, activity: float) -> float:
    """Log probability that a state lasts through a tick of this ``activity`` (0 at rest, 1 in motion).

    Contacts change by moving: at rest what was believed hardly loosens.
    """
    return -model.transitions.leave_per_s * model.tick_s * max(activity, AT_REST)


def log_transition(model: Model, activity: float) -> Array:
    """Log weight (7, 7), row to column, of a change at the boundary before a tick of this ``activity``.

    Gaining or losing one step of the containment lattice, and leaving the surface or meeting it, are likely;
    what skips a step is rarer by ``skip``; the same contact with other elements is rarer still. Free motion
    has no onset to remember: it stays free by this matrix, contacts stay by ``log_stay``.
    """
    split = np.full((len(STATES), len(STATES)), model.transitions.skip)
    for i, a in enumerate(STATES):
        for j, b in enumerate(STATES):
            if a is b:
                split[i, j] = model.transitions.skip**2
            elif Contact.FREE in (a, b) or _adjacent(a, b):
                split[i, j] = 1.0
    split[Contact.FREE.column, Contact.FREE.column] = 0.0
    with np.errstate(divide="ignore"):
        leave = np.log(-np.expm1(log_stay(model, activity))) + np.log(
            split / split.sum(axis=1, keepdims=True)
        )
    leave[Contact.FREE.column, Contact.FREE.column] = log_stay(model, activity)
    return np.asarray(leave)


def _adjacent(a: Contact, b: Contact) -> bool:
    """Whether one of the two contains the other, and no third contact lies between."""
    upper, lower = (a, b) if a.contains(b) else (b, a)
    between = [c for c in CONTACTS if c not in (a, b) and upper.contains(c) and c.contains(lower)]
    return upper.contains(lower) and not between
