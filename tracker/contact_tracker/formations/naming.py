"""Association of a further contact's elements with those of the map."""

from collections.abc import Sequence
from dataclasses import replace

from contact_tracker.geometry.elements import ContactGeometry, Element, Plane, canonical
from contact_tracker.map.map import Map, NamedElement
from contact_tracker.map.same_element import is_same_element


def named_by(known_map: Map, geometry: ContactGeometry) -> ContactGeometry:
    """The geometry with the names of elements of the map that agree with it within their uncertainty."""
    return ContactGeometry(
        _named(geometry.object, known_map.object), _named(geometry.environment, known_map.environment)
    )


def _named(element: Element, known: Sequence[NamedElement]) -> Element:
    for one in (one for one in known if not one.is_covered):
        for side in (element, _other_way(element)):
            if type(one.element) is type(side) and is_same_element(side, one.element):
                return replace(side, name=one.name)
    return canonical(element)


def _other_way(element: Element) -> Element:
    """A plane with its normal reversed: the solid side is unknown."""
    if not isinstance(element, Plane):
        return element
    return replace(element, normal=-element.normal, offset_m=-element.offset_m)
