"""A change of contact in words."""

from collections.abc import Sequence

from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.outputs.text import describe
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import FurtherContact


def event(
    since_ns: int, probability: float, geometry: ContactGeometry | None, inseparable: Sequence[Contact] = ()
) -> str:
    """When (``since_ns`` after the first pose), how sure, where it touches, what else it may be.

    Of what it tells is the row's level.
    """
    return f"{since_ns * 1e-9:7.2f} s  p {probability:.2f}  {describe(geometry, inseparable)}".rstrip()


def further_event(since_ns: int, further: FurtherContact, joins: bool) -> str:
    """A contact that joins those that there are, or leaves them."""
    how = "joins " if joins else "leaves"
    where = describe(further.geometry, further.inseparable) if joins else ""
    return f"{since_ns * 1e-9:7.2f} s  p {further.probability:.2f}  {how}  {where}".rstrip()
