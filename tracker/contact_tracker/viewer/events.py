"""A change of contact in words."""

from contact_tracker.geometry import ContactGeometry
from contact_tracker.outputs.words import describe


def event(probability: float, geometry: ContactGeometry | None) -> str:
    """How sure it is, and where it touches."""
    return f"p {probability:.2f}  {describe(geometry)}".rstrip()
