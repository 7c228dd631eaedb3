"""Log lines for changes of contact."""

from collections.abc import Sequence

from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.outputs.text import describe
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import FurtherContact


def event(
    since_ns: int, probability: float, geometry: ContactGeometry | None, inseparable: Sequence[Contact] = ()
) -> str:
    """Time (``since_ns`` after the first pose), probability, geometry and alternatives of a contact.

    The contact itself is the row's level.
    """
    return f"{since_ns * 1e-9:7.2f} s  p {probability:.2f}  {describe(geometry, inseparable)}".rstrip()


def further_event(since_ns: int, further: FurtherContact, joins: bool) -> str:
    """The begin (``joins``) or end of a further contact."""
    how = "joins " if joins else "leaves"
    where = describe(further.geometry, further.inseparable) if joins else ""
    return f"{since_ns * 1e-9:7.2f} s  p {further.probability:.2f}  {how}  {where}".rstrip()
