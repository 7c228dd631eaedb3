"""A map of what the object and its surroundings touch each other with (docs/map.md).

A file lists elements with names and accuracies; those that contacts have touched are learned, without.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from contact_tracker.geometry.elements import Array, Element, Line, Plane, Point
from contact_tracker.geometry.polyhedron import Feature, Polyhedron
from contact_tracker.map.elements import (
    KINDS,
    NOTHING_LEARNED,
    PARALLEL,
    LearnedElements,
    kind_of,
    plane_covariance,
)
from contact_tracker.states import CONTACTS, Contact

MOST_IN_MAP: Final = 60
"""Most listed elements with which the map of a recording begins: with 65, a stream takes as long as with a
fixed list, with 200 twice as long (measured once)."""


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of a known element: standard deviations per axis of its place (m) and direction (rad)."""

    position_m: float = 1e-3
    rotation_rad: float = float(np.radians(0.5))


@dataclass(frozen=True, eq=False)
class NamedElement:
    """An element with a name. A plane's normal points out of the body that it bounds.

    ``solid`` numbers the known bodies of a side; None for an element that is listed by itself. ``is_hull``
    says that the body is not convex, and this an element of its hull; ``is_covered`` that it lies on a known
    face, so that nothing can touch it; ``corners_m`` (C, 3) are its corners, none if it is listed by itself.
    """

    name: str
    element: Element
    solid: int | None = None
    is_hull: bool = False
    is_covered: bool = False
    corners_m: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def kind(self) -> str:
        """``f``, ``e`` or ``v``."""
        return kind_of(self.element)


@dataclass(frozen=True, eq=False)
class Up:
    """Faces of the surroundings have normals near the unit vector ``direction`` (3,), world frame."""

    direction: Array
    spread_rad: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Map:
    """Elements that are listed with names, of the object in the body frame and of the environment in the
    world frame, and those that were ``learned`` from another recording, with which the map of a recording
    begins.

    Where a side is complete, hypotheses assume no element of it that is not listed. ``states`` are the
    contacts that can occur, None for all; free motion always can.
    """

    listed_environment: tuple[NamedElement, ...] = ()
    listed_object: tuple[NamedElement, ...] = ()
    up: Up | None = None
    environment_complete: bool = False
    object_complete: bool = False
    learned: LearnedElements = NOTHING_LEARNED
    states: tuple[Contact, ...] | None = None

    @property
    def object(self) -> tuple[Element, ...]:
        """Faces, edges and vertices of the object, in the body frame, with covariances."""
        return self._elements(self.listed_object, 0)

    @property
    def environment(self) -> tuple[Element, ...]:
        """Faces, edges and vertices of the surroundings, in the world frame, with covariances."""
        return self._elements(self.listed_environment, 1)

    def _elements(self, listed: tuple[NamedElement, ...], side: int) -> tuple[Element, ...]:
        learned = (element for key, element in self.learned.known.items() if key[0] == side)
        return *(replace(element.element, name=element.name) for element in listed), *learned

    def __len__(self) -> int:
        return len(self.listed_object) + len(self.listed_environment) + len(self.learned.elements)

    def __repr__(self) -> str:
        return (
            f"<Map of {len(self.object)} elements of the object, {len(self.environment)} of the surroundings>"
        )

    @cached_property
    def lists_elements(self) -> bool:
        """Whether it says anything of elements by name; what is learned, and ``states``, do not count."""
        listed = bool(self.listed_object or self.listed_environment) or self.up is not None
        return listed or self.environment_complete or self.object_complete

    @cached_property
    def fixes_elements(self) -> bool:
        """Whether a side is complete, a single pose shows if listed elements touch, or these are many;
        otherwise the map of a recording begins with them."""
        count = len(self.listed_object) + len(self.listed_environment)
        is_complete = self.environment_complete or self.object_complete
        return self.shows_touch or is_complete or count > MOST_IN_MAP

    @cached_property
    def prior(self) -> LearnedElements:
        """The elements with which the map of a recording begins: those learned, and those listed unless they
        are fixed."""
        if self.fixes_elements:
            return self.learned
        sides = self.listed_object, self.listed_environment
        prior = self.learned
        for side, listed in enumerate(sides):
            prior = prior.with_listed(side, [named.element for named in listed if not named.is_covered])
        return prior

    @property
    def shows_touch(self) -> bool:
        """Whether a single pose shows if listed elements touch: there are some on both sides."""
        return bool(self.listed_object and self.listed_environment)

    def allows(self, contact: Contact) -> bool:
        """Whether ``contact`` can occur, and there may be elements of the kinds that it needs."""
        return contact is Contact.FREE or contact in self.allowed

    @property
    def possible(self) -> tuple[Contact, ...]:
        """The contacts that can occur, also with elements that are not listed."""
        return CONTACTS if self.states is None else self.states

    @cached_property
    def allowed(self) -> tuple[Contact, ...]:
        """The contacts that can occur, if no elements are missing where a side is complete."""
        sides = (
            (self.listed_object, self.object_complete),
            (self.listed_environment, self.environment_complete),
        )
        kinds = [
            {element.kind for element in listed} if complete else set(KINDS) for listed, complete in sides
        ]
        return tuple(
            contact
            for contact in CONTACTS
            if contact in self.possible and contact.value[0] in kinds[0] and contact.value[2] in kinds[1]
        )


EMPTY_MAP: Final = Map()


def known_to(element: Element, accuracy: Accuracy, place: Array | None = None) -> Element:
    """``element`` with the covariance that follows from ``accuracy`` at ``place`` (3,).

    Away from that place an error of direction is also an error of place. ``place`` is projected onto the
    element; by default it is the point of a plane nearest to the origin, and the given point of a line.
    """
    turn, shift = accuracy.rotation_rad**2, accuracy.position_m**2
    match element:
        case Plane(normal, offset_m):
            at = normal * offset_m if place is None else place - normal * (normal @ place - offset_m)
            across = turn * (np.eye(3) - np.outer(normal, normal))
            return Plane(normal, offset_m, plane_covariance(across, at, shift))
        case Line(direction, point_m):
            at = point_m if place is None else point_m + direction * (direction @ (place - point_m))
            across = np.eye(3) - np.outer(direction, direction)
            covariance = np.zeros((6, 6))
            covariance[:3, :3], covariance[3:, 3:] = turn * across, shift * across
            return Line(direction, at, covariance)
        case Point(point_m):
            return Point(point_m, shift * np.eye(3))


def elements_of(
    body: Polyhedron,
    face_name: Callable[[int, Array], str],
    accuracy: Accuracy,
    rotation: Array,
    position_m: Array,
    prefix: str = "",
    solid: int | None = None,
    is_hull: bool = False,
) -> tuple[NamedElement, ...]:
    """Faces, edges and vertices of a convex body, rotated by ``rotation`` (3, 3) and moved.

    ``face_name`` (number, outward normal before the rotation) names the faces. An edge is named after its two
    faces, a vertex after all of its faces. The other arguments are fields of ``NamedElement``.
    """
    faces = {face.indices: face_name(i, face.normals[0]) for i, face in enumerate(body.of_kind("f"), start=1)}

    def known(feature: Feature) -> NamedElement:
        middle = feature.points.mean(axis=0)
        named = [name for indices, name in faces.items() if feature.indices <= indices]
        name = f"{prefix}{KINDS[feature.kind]} {' '.join(sorted(named, key=_axis_order))}"
        element = feature.element(rotation, position_m, middle)
        placed = known_to(element, accuracy, rotation @ middle + position_m)
        return NamedElement(name, placed, solid, is_hull, corners_m=feature.points @ rotation.T + position_m)

    return tuple(known(feature) for feature in body.features)


def axis_name(_: int, normal: Array) -> str:
    """``+x``, ``-x`` ... for a face of a box, by the axis of its normal."""
    axis = int(np.argmax(np.abs(normal)))
    return f"{'+' if normal[axis] > 0 else '-'}{'xyz'[axis]}"


def number_name(number: int, _: Array) -> str:
    """``1``, ``2`` ... for a face of a mesh."""
    return str(number)


def _axis_order(name: str) -> tuple[int, str]:
    """x before y before z, 2 before 10."""
    return (int(name), "") if name.isdecimal() else (0, name[1:])


GAP_M: Final = 0.005
"""Largest gap between faces that lie on each other, too small for an object to touch one of them."""
_SAME_M: Final = 5e-4
"""Distance from the plane of a face of what lies in it: meshes are rounded."""


def mark_covered(elements: Sequence[NamedElement]) -> tuple[NamedElement, ...]:
    """The elements of one side, with those marked that cannot be touched: faces of convex bodies that lie on
    another known face, their edges and their vertices.

    The plane of such a face is that of the other, with the opposite normal: motion would show either. A face
    that is listed by itself counts as endless.
    """
    faces = [(e, e.element) for e in elements if isinstance(e.element, Plane) and not e.is_hull]

    def covers(other: NamedElement, plane: Plane, face: NamedElement, own: Plane) -> bool:
        """Whether the corners of a ``face`` lie on another, and within it, where its body is known."""
        off_m, is_opposite = _in_front_m(plane, face), plane.normal @ own.normal < -PARALLEL
        if not is_opposite or np.abs(off_m).max() > GAP_M:
            return False
        sides = [] if other.solid is None else [side for e, side in faces if e.solid == other.solid]
        return all(_in_front_m(side, face).max() <= GAP_M for side in sides)

    covered = [
        (face.solid, own)
        for face, own in faces
        if face.solid is not None
        and any(covers(other, plane, face, own) for other, plane in faces if other.solid != face.solid)
    ]
    return tuple(
        replace(element, is_covered=True)
        if any(
            element.solid == solid and np.abs(_in_front_m(face, element)).max() < _SAME_M
            for solid, face in covered
        )
        else element
        for element in elements
    )


def _in_front_m(face: Plane, element: NamedElement) -> Array:
    """Distances (C,) of the corners of an element in front of a face."""
    return np.asarray(element.corners_m @ face.normal - face.offset_m)
