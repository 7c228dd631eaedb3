"""Which beliefs of a stream are worth a line: where a contact is new, has become settled, joins or leaves."""

from typing import Final

from contact_tracker.outputs.text import is_settled
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Belief, FurtherContact

SAME_NS: Final = 1_000_000_000
"""The estimated onset of a further contact may change by less than that from belief to belief."""


class Changes:
    """What was reported last: ``label``, and whether as ``settled``."""

    def __init__(self) -> None:
        self.label: Contact | None = None
        self.settled = False

    def takes(self, belief: Belief) -> bool:
        """Whether the next belief is worth a line; it is the last one from then on."""
        changed, settles = belief.contact is not self.label, is_settled(belief)
        is_news = changed or (settles and not self.settled)
        self.label, self.settled = belief.contact, settles or (self.settled and not changed)
        return is_news


class FormationChanges:
    """Notices which further contacts join and leave from belief to belief: those ``before`` were shown."""

    def __init__(self) -> None:
        self.before: tuple[FurtherContact, ...] = ()

    def update(self, belief: Belief) -> tuple[list[FurtherContact], list[FurtherContact]]:
        """Those that join with a belief, and those that leave."""
        before, self.before = self.before, belief.further
        joins = [one for one in belief.further if not any(_is_same(one, other) for other in before)]
        leaves = [one for one in before if not any(_is_same(one, other) for other in belief.further)]
        return joins, leaves


def _is_same(one: FurtherContact, other: FurtherContact) -> bool:
    return one.contact is other.contact and abs(one.start_ns - other.start_ns) < SAME_NS
