"""The seven contact states, their order in arrays, and their containment."""

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

    @property
    def codimension(self) -> int:
        """Number of constraints on each pose: 3, 2, 2, 1, 1, 1 and 0."""
        return _CODIMENSION[self]

    @property
    def column(self) -> int:
        """Index of this state in all seven-column arrays."""
        return _COLUMN[self]

    def contains(self, other: "Contact") -> bool:
        """Whether every motion that keeps this contact also keeps ``other``."""
        return other in _CONTAINS[self]


STATES: Final = tuple(Contact)
CONTACTS: Final = STATES[:-1]

_COLUMN: Final = {state: column for column, state in enumerate(STATES)}
_CODIMENSION: Final = dict(zip(STATES, (3, 2, 2, 1, 1, 1, 0), strict=True))
_CONTAINS: Final[dict[Contact, frozenset[Contact]]] = {
    Contact.FF: frozenset(STATES),
    Contact.EF: frozenset({Contact.EF, Contact.VF, Contact.EE, Contact.FREE}),
    Contact.FE: frozenset({Contact.FE, Contact.FV, Contact.EE, Contact.FREE}),
    Contact.VF: frozenset({Contact.VF, Contact.FREE}),
    Contact.FV: frozenset({Contact.FV, Contact.FREE}),
    Contact.EE: frozenset({Contact.EE, Contact.FREE}),
    Contact.FREE: frozenset({Contact.FREE}),
}
