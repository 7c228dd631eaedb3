"""A change of contact in words."""

from contact_tracker.geometry import ContactGeometry
from contact_tracker.outputs.words import describe


def event(since_ns: int, probability: float, geometry: ContactGeometry | None) -> str:
    """When (``since_ns`` after the first pose), how sure, where it touches; of what is the row's level."""
    return f"{since_ns * 1e-9:7.2f} s  p {probability:.2f}  {describe(geometry)}".rstrip()
