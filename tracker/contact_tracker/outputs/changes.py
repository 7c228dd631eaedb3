"""Changes between beliefs that are reported: new or settled labels, further contacts that begin or end."""

from typing import Final

from contact_tracker.outputs.text import is_open, is_settled
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Belief, FurtherContact

SAME_NS: Final = 1_000_000_000
"""Largest change of a further contact's estimated onset from belief to belief (ns)."""


class Changes:
    """The last reported ``label``, and whether it was ``settled``, or ``open`` among all states."""

    def __init__(self) -> None:
        self.label: Contact | None = None
        self.settled = False
        self.open = False

    def takes(self, belief: Belief) -> bool:
        """Whether the next belief is reported: a new label, one that settles, and free motion that is open
        among all states, as at rest; updates the last one. While all states are open, any label is as good as
        the last."""
        opened, settles = is_open(belief), is_settled(belief)
        changed = belief.contact is not self.label and not (self.open and opened)
        opens = belief.contact is Contact.FREE and opened and not self.open
        is_news = changed or opens or (settles and not self.settled)
        if is_news:
            self.label, self.open = belief.contact, opened
        self.settled = settles or (self.settled and not changed and not opens)
        return is_news


class FormationChanges:
    """Finds further contacts that begin or end from belief to belief; ``before`` are the last ones."""

    def __init__(self) -> None:
        self.before: tuple[FurtherContact, ...] = ()

    def update(self, belief: Belief) -> tuple[list[FurtherContact], list[FurtherContact]]:
        """The further contacts that begin with a belief, and those that end."""
        before, self.before = self.before, belief.further
        joins = [one for one in belief.further if not any(_is_same(one, other) for other in before)]
        leaves = [one for one in before if not any(_is_same(one, other) for other in belief.further)]
        return joins, leaves


def _is_same(one: FurtherContact, other: FurtherContact) -> bool:
    return one.contact is other.contact and abs(one.start_ns - other.start_ns) < SAME_NS
