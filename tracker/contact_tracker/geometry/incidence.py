"""Priors of elements that are incident with a known one of another kind (docs/theory.md, T28).

A contact that gains or loses a constraint keeps its elements, or changes to incident ones: from a face to an
edge of it, from an edge to a vertex on it, and back. An unknown direction is zero, with the covariance of the
distribution of directions.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from contact_tracker.geometry.elements import Array, Element, Line, Plane, Point, nearest

_FLAT: Final = 1e-12
LENGTH_M: Final = 0.2
"""Distance of the ends of an edge from its point nearest to the body."""
ANYWHERE_M: Final = 10.0
"""Standard deviation of an unknown position."""


def incident(element: Element, kind: str, near_m: Array) -> Element:
    """Prior of an element of another ``kind`` (f, e or v) that is incident with ``element`` near ``near_m``
    (3,)."""
    assert element.covariance is not None
    return _INCIDENT[type(element), kind](element, element.covariance, near_m)


def _vertex_on(edge: Line, covariance: Array, _: Array) -> Point:
    along = np.outer(edge.direction, edge.direction)
    return Point(edge.point_m, covariance[3:, 3:] + LENGTH_M**2 * (along + covariance[:3, :3]))


def _edge_through(vertex: Point, covariance: Array, _: Array) -> Line:
    """The direction is unknown, see ``known_entries`` of ``map.pairs``."""
    whole = np.zeros((6, 6))
    whole[3:, 3:] = covariance
    return Line(np.zeros(3), vertex.point_m, whole)


def _edge_in(face: Plane, covariance: Array, near_m: Array) -> Line:
    across, tilt, height = _face_covariances(face, covariance)
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = across + tilt, ANYWHERE_M**2 * across + height
    return Line(np.zeros(3), nearest(face, near_m), whole)


def _vertex_in(face: Plane, covariance: Array, near_m: Array) -> Point:
    across, _, height = _face_covariances(face, covariance)
    return Point(nearest(face, near_m), ANYWHERE_M**2 * across + height)


def _face_covariances(face: Plane, covariance: Array) -> tuple[Array, Array, Array]:
    """The projection onto a face, and the covariances along its normal of directions in the face and of
    positions on it near the contact, each (3, 3)."""
    out = np.outer(face.normal, face.normal)
    turns, both = covariance[:3, :3], covariance[:3, 3]
    tilt = 0.5 * float(turns.trace())
    across, explained = np.eye(3) - out, 0.0
    if tilt > 0.0:  # the added terms are in directions in which the normal cannot change, and have no effect
        explained = float(both @ np.linalg.solve(turns + tilt * (out + _FLAT * across), both))
    residual = covariance[3, 3] - explained
    return across, tilt * out, (max(float(residual), 0.0) + tilt * (0.5 * LENGTH_M) ** 2) * out


def _face_through_edge(edge: Line, covariance: Array, _: Array) -> Plane:
    along = np.outer(edge.direction, edge.direction)
    turn, shift = (0.5 * float(part.trace()) for part in (covariance[:3, :3], covariance[3:, 3:]))
    return _face_through(edge.point_m, np.eye(3) - along + turn * along, shift)


def _face_through_vertex(vertex: Point, covariance: Array, _: Array) -> Plane:
    return _face_through(vertex.point_m, np.eye(3), float(covariance.trace()) / 3.0)


def _face_through(place_m: Array, normal: Array, shift: float) -> Plane:
    """A face with an unknown normal of covariance ``normal`` (3, 3), through ``place_m`` up to the variance
    ``shift``."""
    jacobian = np.concatenate([np.eye(3), place_m[None]])
    whole = jacobian @ normal @ jacobian.T
    whole[3, 3] += shift
    return Plane(np.zeros(3), 0.0, whole)


_INCIDENT: Final[dict[tuple[type[Element], str], Callable[..., Element]]] = {
    (Line, "v"): _vertex_on,
    (Point, "e"): _edge_through,
    (Plane, "e"): _edge_in,
    (Plane, "v"): _vertex_in,
    (Line, "f"): _face_through_edge,
    (Point, "f"): _face_through_vertex,
}
