"""The seven contact states, their order in arrays, and their containment."""

import reprlib
from collections.abc import Iterable
from enum import StrEnum
from typing import Final


class Contact(StrEnum):
    """A principal contact, object first: ``f`` face, ``e`` edge, ``v`` vertex; or free motion."""

    FF = "f-f"
    EF = "e-f"
    FE = "f-e"
    VF = "v-f"
    FV = "f-v"
    EE = "e-e"
    FREE = "free"

    codimension: int
    """Number of constraints on each pose: 3, 2, 2, 1, 1, 1 and 0."""
    column: int
    """Index of this state in all seven-column arrays."""

    def contains(self, other: "Contact") -> bool:
        """Whether every motion that is possible in this contact is possible in ``other``."""
        return other in _CONTAINS[self]


STATES: Final = tuple(Contact)
CONTACTS: Final = STATES[:-1]

for _column, (_state, _codimension) in enumerate(zip(STATES, (3, 2, 2, 1, 1, 1, 0), strict=True)):
    _state.column, _state.codimension = _column, _codimension
_CONTAINS: Final[dict[Contact, frozenset[Contact]]] = {
    Contact.FF: frozenset(STATES),
    Contact.EF: frozenset({Contact.EF, Contact.VF, Contact.EE, Contact.FREE}),
    Contact.FE: frozenset({Contact.FE, Contact.FV, Contact.EE, Contact.FREE}),
    Contact.VF: frozenset({Contact.VF, Contact.FREE}),
    Contact.FV: frozenset({Contact.FV, Contact.FREE}),
    Contact.EE: frozenset({Contact.EE, Contact.FREE}),
    Contact.FREE: frozenset({Contact.FREE}),
}


def united(*groups: Iterable[Contact]) -> tuple[Contact, ...]:
    """The states of all ``groups``, each once, in the order of ``STATES``."""
    members = {state for group in groups for state in group}
    return tuple(state for state in STATES if state in members)


def states_from(names: str | Iterable[str]) -> tuple[Contact, ...]:
    """The states of names (a list, or a text with commas) in the order of ``STATES``; raises ValueError."""
    if isinstance(names, str):
        names = filter(None, map(str.strip, names.split(",")))
    elif isinstance(names, bytes) or not isinstance(names, Iterable):
        raise ValueError(f"names of contacts, such as 'f-f,e-f', and not {reprlib.repr(names)}")
    names = [*names]
    for name in names:
        if name not in STATES:
            raise ValueError(f"{name!r} is no contact: choose from {', '.join(CONTACTS)}")
    if not names:
        raise ValueError(f"no contact is named: choose from {', '.join(CONTACTS)}")
    return tuple(state for state in STATES if state in names)
