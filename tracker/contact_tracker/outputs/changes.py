"""Changes between beliefs that are reported: new or settled labels, further contacts that begin or end."""

from typing import Final

from contact_tracker.outputs.text import is_open, is_settled
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Belief, FurtherContact

SAME_NS: Final = 1_000_000_000
"""Largest change of a further contact's estimated onset from belief to belief (ns)."""


class Changes:
    """What was reported last: the ``label``, whether it was ``settled``, or ``open`` among all states, and
    the ``further`` contacts."""

    def __init__(self) -> None:
        self.label: Contact | None = None
        self.settled = False
        self.open = False
        self.further: tuple[FurtherContact, ...] = ()

    def update(self, belief: Belief) -> tuple[bool, list[FurtherContact], list[FurtherContact]]:
        """Whether the next belief is reported, the further contacts that begin with it, and those that end.

        A new label is reported, one that settles, and free motion that is open among all states, as at rest.
        While all states are open, any label is as good as the last.
        """
        opened, settles = is_open(belief), is_settled(belief)
        changed = belief.contact is not self.label and not (self.open and opened)
        opens = belief.contact is Contact.FREE and opened and not self.open
        is_news = changed or opens or (settles and not self.settled)
        if is_news:
            self.label, self.open = belief.contact, opened
        self.settled = settles or (self.settled and not changed and not opens)
        before, self.further = self.further, belief.further
        joins = [one for one in belief.further if not any(_is_same(one, other) for other in before)]
        leaves = [one for one in before if not any(_is_same(one, other) for other in belief.further)]
        return is_news, joins, leaves


def _is_same(one: FurtherContact, other: FurtherContact) -> bool:
    return one.contact is other.contact and abs(one.start_ns - other.start_ns) < SAME_NS
