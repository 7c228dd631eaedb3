"""Which of the elements that the user knows touch in a further contact."""

from collections.abc import Sequence
from dataclasses import replace

from contact_tracker.geometry.elements import ContactGeometry, Element, Plane, canonical
from contact_tracker.landmarks.association import is_same_element
from contact_tracker.landmarks.prior_map import NamedElement, PriorMap


def named_by(knowledge: PriorMap, geometry: ContactGeometry) -> ContactGeometry:
    """The geometry with the names of known elements from which it does not differ by more than is known."""
    return ContactGeometry(
        _named(geometry.object, knowledge.object), _named(geometry.environment, knowledge.environment)
    )


def _named(element: Element, known: Sequence[NamedElement]) -> Element:
    for one in known:
        for side in (element, _other_way(element)):
            if type(one.element) is type(side) and is_same_element(side, one.element):
                return replace(side, name=one.name)
    return canonical(element)


def _other_way(element: Element) -> Element:
    """A plane with the opposite normal: which side of it is solid was not found."""
    if not isinstance(element, Plane):
        return element
    return replace(element, normal=-element.normal, offset_m=-element.offset_m)
