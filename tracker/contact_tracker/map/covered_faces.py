"""Faces of known bodies that lie on another known face, as the underside of a block on a table."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from contact_tracker.geometry.elements import Array, Element, Line, Plane, Point
from contact_tracker.map.map import NamedElement

GAP_M: Final = 0.005
"""Largest gap between faces that lie on each other, too small for an object to touch one of them."""
OPPOSITE: Final = -0.99
"""Greatest cosine between the normals of faces that lie on each other."""
_SAME_M: Final = 5e-4
_SAME_DIRECTION: Final = 0.01
"""Distance from the plane of a face, and cosine to its normal, of what lies in it: meshes are rounded."""


def mark_covered(elements: Sequence[NamedElement]) -> tuple[NamedElement, ...]:
    """The elements of one side, with those marked that cannot be touched: faces of convex bodies that lie on
    another known face, their edges and their vertices.

    The plane of such a face is that of the other, with the opposite normal: motion would show either. A face
    that is listed by itself counts as endless.
    """
    sound = [one for one in elements if not one.is_hull]
    covered = [
        (one.solid, one.element)
        for one in sound
        if one.solid is not None and isinstance(one.element, Plane) and _is_covered(one, sound)
    ]
    return tuple(
        replace(one, is_covered=True)
        if any(one.solid == solid and _lies_in(one.element, face) for solid, face in covered)
        else one
        for one in elements
    )


def _is_covered(face: NamedElement, elements: Sequence[NamedElement]) -> bool:
    assert isinstance(face.element, Plane)
    corners_m = np.array([p.point_m for p in _points_of(face.solid, elements) if _lies_in(p, face.element)])
    return any(
        _covers(other, face.element, corners_m, elements)
        for other in elements
        if other.solid is None or other.solid != face.solid
    )


def _covers(other: NamedElement, face: Plane, corners_m: Array, elements: Sequence[NamedElement]) -> bool:
    """Whether the ``corners_m`` (C, 3) of a face lie on another, and within it, where its body is known."""
    if not isinstance(other.element, Plane) or other.element.normal @ face.normal > OPPOSITE:
        return False
    if np.abs(_in_front_m(other.element, corners_m)).max() > GAP_M:
        return False
    if other.solid is None:
        return True
    sides = [one.element for one in elements if one.solid == other.solid and isinstance(one.element, Plane)]
    return all(_in_front_m(side, corners_m).max() <= GAP_M for side in sides)


def _points_of(solid: int | None, elements: Sequence[NamedElement]) -> list[Point]:
    return [one.element for one in elements if one.solid == solid and isinstance(one.element, Point)]


def _lies_in(element: Element, face: Plane) -> bool:
    """Whether an element of a body lies in the plane of one of its faces."""
    match element:
        case Plane(normal, offset_m):
            return bool(normal @ face.normal > -OPPOSITE and abs(offset_m - face.offset_m) < _SAME_M)
        case Line(direction, point_m):
            is_parallel = abs(direction @ face.normal) < _SAME_DIRECTION
            return bool(is_parallel and abs(_in_front_m(face, point_m[None])[0]) < _SAME_M)
        case Point(point_m):
            return bool(abs(_in_front_m(face, point_m[None])[0]) < _SAME_M)


def _in_front_m(face: Plane, points_m: Array) -> Array:
    """Distances (N,) of points (N, 3) in front of a face."""
    return np.asarray(points_m @ face.normal - face.offset_m)
