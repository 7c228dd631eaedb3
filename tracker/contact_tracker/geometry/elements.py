"""Planes, lines and points with their uncertainty: the elements that touch.

The coordinates of an element are in the frame to which it is fixed: the body frame for the object, the world
frame for the environment (docs/conventions.md). Units are metres and radians. The covariance is None if it is
unknown, and the name if the element is not in the map.

``flat`` returns elements of all kinds in the same fields, so that tables have one schema; ``pack`` the
geometry of a tick as a row of numbers, in a tenth of the memory of objects.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from contact_tracker.geometry.linalg import Array as Array

ANYWHERE_M: Final = 1e3
"""Standard deviation of an unknown offset of a face."""


@dataclass(frozen=True, eq=False)
class Unobserved:
    """A free motion of an element that the data do not determine (docs/theory.md, T22).

    Parameters
    ----------
    how : a turn about ``direction``, or a shift along it.
    direction : (3,) unit vector.
    """

    how: Literal["turns_about", "shifts_along"]
    direction: Array

    def to_json(self) -> dict[str, Any]:
        return {self.how: _numbers(self.direction)}


@dataclass(frozen=True, eq=False)
class Plane:
    """All x with ``normal . x == offset_m``; ``covariance`` (4, 4) is of (normal, offset_m)."""

    normal: Array
    offset_m: float
    covariance: Array | None = None
    unobserved: tuple[Unobserved, ...] = ()
    name: str | None = None

    def to_json(self) -> dict[str, Any]:
        sd = _standard_deviations(self.covariance, 4)
        return {
            "plane": {
                "normal": _numbers(self.normal),
                "offset_m": float(self.offset_m),
                "normal_sd": _numbers(sd[:3]),
                "offset_sd_m": _number(sd[3]),
            },
            **_common(self),
        }


@dataclass(frozen=True, eq=False)
class Line:
    """All ``point_m + s direction``; ``covariance`` (6, 6) is of (direction, point_m).

    ``point_m`` of an estimated line is its point nearest to the body's origin (in the world, to the mean
    position of the body's origin), so that the covariance has no component along the line.
    """

    direction: Array
    point_m: Array
    covariance: Array | None = None
    unobserved: tuple[Unobserved, ...] = ()
    name: str | None = None

    def to_json(self) -> dict[str, Any]:
        sd = _standard_deviations(self.covariance, 6)
        return {
            "line": {
                "direction": _numbers(self.direction),
                "point_m": _numbers(self.point_m),
                "direction_sd": _numbers(sd[:3]),
                "point_sd_m": _numbers(sd[3:]),
            },
            **_common(self),
        }


@dataclass(frozen=True, eq=False)
class Point:
    """A point; ``covariance`` (3, 3) in m^2."""

    point_m: Array
    covariance: Array | None = None
    unobserved: tuple[Unobserved, ...] = ()
    name: str | None = None

    def to_json(self) -> dict[str, Any]:
        return {
            "point_m": _numbers(self.point_m),
            "point_sd_m": _numbers(_standard_deviations(self.covariance, 3)),
            **_common(self),
        }


Element = Plane | Line | Point
Pair = tuple[Element | None, Element | None]
"""Elements of the object and of the environment, None if unknown."""


def is_unobserved(element: Element) -> bool:
    """Whether the motion shows nothing of an element: it may have any direction, or be anywhere."""
    shifts = sum(way.how == "shifts_along" for way in element.unobserved)
    return len(element.unobserved) - shifts == 2 or shifts == 3


@dataclass(frozen=True, eq=False)
class ContactGeometry:
    """The touching pair: ``object`` in the body frame, ``environment`` in the world frame."""

    object: Element
    environment: Element

    @property
    def names(self) -> tuple[str | None, str | None]:
        """Names of both elements in the map, None for elements that are not in it."""
        return self.object.name, self.environment.name

    @property
    def is_unobserved(self) -> bool:
        """Whether the motion shows nothing of either element."""
        return is_unobserved(self.object) and is_unobserved(self.environment)

    @property
    def has_open_directions(self) -> bool:
        """Whether the motion leaves a direction of each element open: it is then so small, or in so few
        directions, that a constraint is a linear one on the motion, which free motion may keep by chance."""
        return bool(self.object.unobserved) and bool(self.environment.unobserved)

    @property
    def has_open_offset(self) -> tuple[bool, bool]:
        """Whether the offsets of the object's and of the environment's face are unknown (f-f only).

        The motion of f-f determines only their difference (docs/theory.md, T5). The object's face then goes
        through the body's origin, and the standard deviations of both offsets are those of the prior
        (``contacts/face_face.py``), unless the face is in the map.
        """
        body, world = self.object, self.environment
        if not (isinstance(body, Plane) and isinstance(world, Plane)):
            return False, False
        if body.covariance is None or world.covariance is None or body.name is not None:
            return False, False
        is_open = body.offset_m == 0.0 < body.covariance[3, 3]
        return bool(is_open), bool(is_open and world.covariance[3, 3] >= body.covariance[3, 3])

    def to_json(self) -> dict[str, Any]:
        return {"object": self.object.to_json(), "environment": self.environment.to_json()}


def _common(element: Element) -> dict[str, Any]:
    """The entries of all kinds of elements in JSON."""
    return {"unobserved": [way.to_json() for way in element.unobserved], "name": element.name}


def face_towards(normal: Array, spread_rad: float) -> Plane:
    """A face with an unknown offset and a unit ``normal`` (3,) of the standard deviation ``spread_rad``."""
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = spread_rad**2 * (np.eye(3) - np.outer(normal, normal))
    covariance[3, 3] = ANYWHERE_M**2
    return Plane(normal, 0.0, covariance)


def _standard_deviations(covariance: Array | None, size: int) -> Array:
    """Standard deviations (size,), NaN for an unknown covariance."""
    if covariance is None:
        return np.full(size, np.nan)
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _numbers(values: Array) -> list[float | None]:
    return [_number(v) for v in values]


def _number(value: float) -> float | None:
    """The number for JSON, which has no NaN: None for an unknown standard deviation."""
    return float(value) if np.isfinite(value) else None


def numbers(element: Element) -> Array:
    """The parameters of an element, in the order of its covariance."""
    match element:
        case Plane(normal, offset_m):
            return np.array([*normal, offset_m])
        case Line(direction, point_m):
            return np.concatenate([direction, point_m])
        case Point(point_m):
            return point_m


def of_numbers(
    kind: type[Element],
    values: Array,
    covariance: Array | None = None,
    unobserved: tuple[Unobserved, ...] = (),
    name: str | None = None,
) -> Element:
    """The element of a kind with these parameters, the inverse of ``numbers``."""
    common = covariance, unobserved, name
    if kind is Plane:
        return Plane(values[:3], float(values[3]), *common)
    return Line(values[:3], values[3:], *common) if kind is Line else Point(values, *common)


def nearest(element: Element, place_m: Array) -> Array:
    """The point (3,) of an element nearest to a place (3,)."""
    match element:
        case Plane(normal, offset_m):
            return np.asarray(place_m + (offset_m - normal @ place_m) * normal)
        case Line(direction, point_m):
            return np.asarray(point_m + direction * (direction @ (place_m - point_m)))
        case Point(point_m):
            return point_m


def by_foot(element: Element, near_m: Array) -> Element:
    """The same element; the point of a line is moved to the line's point nearest to ``near_m`` (3,)."""
    if not isinstance(element, Line) or element.covariance is None:
        return element
    d, arm = element.direction, near_m - element.point_m
    jacobian = np.eye(6)
    jacobian[3:] = np.hstack([d @ arm * np.eye(3) + np.outer(d, arm), np.eye(3) - np.outer(d, d)])
    covariance = jacobian @ element.covariance @ jacobian.T
    return replace(element, point_m=element.point_m + d * (d @ arm), covariance=covariance)


def canonical(element: Element) -> Element:
    """The element with the sign of its normal or direction for which the largest component is positive."""
    axis = numbers(element)[:3]
    return opposite(element) if axis[np.argmax(np.abs(axis))] < 0.0 else element


def opposite(element: Element) -> Element:
    """The same element with the opposite sense of its normal or direction; a point is unchanged."""
    match element:
        case Plane(normal, offset_m):
            return replace(element, normal=-normal, offset_m=-offset_m)  # the covariance is the same
        case Line(direction, _, covariance):
            flip = np.repeat([-1.0, 1.0], 3)
            moved = None if covariance is None else flip[:, None] * covariance * flip
            return replace(element, direction=-direction, covariance=moved)
        case Point():
            return element


class Origins(NamedTuple):
    """Origins of coordinates: ``world_m`` (3,) in the world frame, and ``body_m`` (3,) in the body frame."""

    world_m: Array
    body_m: Array

    @classmethod
    def zero(cls) -> "Origins":
        """The origins of the world and body frames themselves."""
        return cls(np.zeros(3), np.zeros(3))

    @property
    def reversed(self) -> "Origins":
        """The origins of the world and body frames in coordinates with these origins."""
        return Origins(-self.world_m, -self.body_m)


def shifted(element: Element, origin_m: Array) -> Element:
    """The element in a frame in which its present origin has the coordinates ``origin_m`` (3,)."""
    match element:
        case Plane(normal, offset_m, covariance):
            jacobian = np.eye(4)
            jacobian[3, :3] = origin_m
            moved = None if covariance is None else jacobian @ covariance @ jacobian.T
            offset_m = float(offset_m + normal @ origin_m)
            return Plane(normal, offset_m, moved, element.unobserved, element.name)
        case Line() | Point():
            return replace(element, point_m=element.point_m + origin_m)


def flat(element: Element | None) -> dict[str, Any]:
    """``type``, ``name``, ``axis``, ``point_m``, their standard deviations and ``unobserved`` of an element.

    ``axis`` (3,) is the normal of a face, the direction of an edge, and zero for a vertex. ``point_m`` (3,)
    is on the element: for a face, its point nearest to the origin of the frame. ``unobserved`` is JSON text.
    All keys are always present, with values of one type, except unknown standard deviations (None).
    """
    axis, point_m, axis_sd, point_sd_m = np.zeros((4, 3))
    kind = "none"
    match element:
        case Plane(normal, offset_m, covariance):
            kind, axis, point_m = "face", normal, offset_m * normal
            jacobian = np.hstack([offset_m * np.eye(3), normal[:, None]])
            axis_sd = _standard_deviations(covariance, 4)[:3]
            of_point = None if covariance is None else jacobian @ covariance @ jacobian.T
            point_sd_m = _standard_deviations(of_point, 3)
        case Line(axis, point_m, covariance):
            kind, sd = "edge", _standard_deviations(covariance, 6)
            axis_sd, point_sd_m = sd[:3], sd[3:]
        case Point(point_m, covariance):
            kind, point_sd_m = "vertex", _standard_deviations(covariance, 3)
    return {
        "type": kind,
        "name": "" if element is None or element.name is None else element.name,
        "axis": _numbers(axis),
        "point_m": _numbers(point_m),
        "axis_sd": _numbers(axis_sd),
        "point_sd_m": _numbers(point_sd_m),
        "unobserved": json.dumps([way.to_json() for way in element.unobserved] if element else []),
    }


_SIZES: Final = {Plane: 4, Line: 6, Point: 3}
_KINDS: Final = tuple(_SIZES)
_WAYS: Final[tuple[Literal["turns_about"], Literal["shifts_along"]]] = ("turns_about", "shifts_along")
_HEADER: Final = 5


def pack(geometry: ContactGeometry) -> Array:
    """A geometry as a row of numbers (n,), whose length depends on the elements."""
    return np.concatenate([*_packed(geometry.object), *_packed(geometry.environment)])


def unpack(packed: Array) -> ContactGeometry:
    """The geometry of a row that ``pack`` returned, bit-identical."""
    object, remainder = _unpacked(packed)
    return ContactGeometry(object, _unpacked(remainder)[0])


def _packed(element: Element) -> Iterator[Array]:
    covariance, free_motions = element.covariance, element.unobserved
    name = () if element.name is None else tuple(element.name.encode())
    kind, named = _KINDS.index(type(element)), element.name is not None
    yield np.array([kind, covariance is not None, len(free_motions), named, len(name), *name], float)
    yield numbers(element)
    if covariance is not None:
        yield covariance.ravel()
    for way in free_motions:
        yield from (np.array([_WAYS.index(way.how)], float), way.direction)


def _unpacked(packed: Array) -> tuple[Element, Array]:
    """The first element of a row, and the remainder of the row."""
    kind, has_covariance, free_motions, named, letters = packed[:_HEADER].astype(int).tolist()
    size = _SIZES[_KINDS[kind]]
    bounds = np.cumsum([_HEADER, letters, size, size**2 * has_covariance, 4 * free_motions])
    _, text, place, matrix, directions, remainder = np.split(packed, bounds)
    covariance = matrix.reshape(size, size) if has_covariance else None
    unobserved = tuple(Unobserved(_WAYS[int(way[0])], way[1:]) for way in directions.reshape(-1, 4))
    name = bytes(text.astype(np.uint8)).decode() if named else None
    return of_numbers(_KINDS[kind], place, covariance, unobserved, name), remainder
