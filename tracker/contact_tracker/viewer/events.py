"""A change of contact in words."""

from collections.abc import Sequence

from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.outputs.text import describe
from contact_tracker.states import Contact


def event(
    since_ns: int, probability: float, geometry: ContactGeometry | None, inseparable: Sequence[Contact] = ()
) -> str:
    """When (``since_ns`` after the first pose), how sure, where it touches, what else it may be.

    Of what it tells is the row's level.
    """
    return f"{since_ns * 1e-9:7.2f} s  p {probability:.2f}  {describe(geometry, inseparable)}".rstrip()
