"""Geometry of many ticks as rows of numbers, in a tenth of the memory of objects."""

from collections.abc import Iterator
from typing import Final, Literal

import numpy as np

from contact_tracker.geometry.elements import Array, ContactGeometry, Element, Line, Plane, Point, Unobserved

_SIZES: Final = {Plane: 4, Line: 6, Point: 3}
_KINDS: Final = tuple(_SIZES)
_WAYS: Final[tuple[Literal["turns_about"], Literal["shifts_along"]]] = ("turns_about", "shifts_along")
_HEADER: Final = 5


def pack(geometry: ContactGeometry) -> Array:
    """A geometry as one row of numbers, whose length depends on the elements."""
    return np.concatenate([*_packed(geometry.object), *_packed(geometry.environment)])


def unpack(packed: Array) -> ContactGeometry:
    """The geometry that was packed, bit-identical."""
    object, rest = _unpacked(packed)
    return ContactGeometry(object, _unpacked(rest)[0])


def _packed(element: Element) -> Iterator[Array]:
    covariance, free_motions = element.covariance, element.unobserved
    name = () if element.name is None else tuple(element.name.encode())
    kind, named = _KINDS.index(type(element)), element.name is not None
    yield np.array([kind, covariance is not None, len(free_motions), named, len(name), *name], float)
    match element:
        case Plane(normal, offset_m):
            yield from (normal, np.array([offset_m]))
        case Line(direction, point_m):
            yield from (direction, point_m)
        case Point(point_m):
            yield point_m
    if covariance is not None:
        yield covariance.ravel()
    for way in free_motions:
        yield from (np.array([_WAYS.index(way.how)], float), way.direction)


def _unpacked(packed: Array) -> tuple[Element, Array]:
    """The first element of a row, and the rest of the row."""
    kind, has_covariance, free_motions, named, letters = packed[:_HEADER].astype(int).tolist()
    size = _SIZES[_KINDS[kind]]
    bounds = np.cumsum([_HEADER, letters, size, size**2 * has_covariance, 4 * free_motions])
    _, text, place, matrix, directions, rest = np.split(packed, bounds)
    covariance = matrix.reshape(size, size) if has_covariance else None
    unobserved = tuple(Unobserved(_WAYS[int(way[0])], way[1:]) for way in directions.reshape(-1, 4))
    name = bytes(text.astype(np.uint8)).decode() if named else None
    if _KINDS[kind] is Plane:
        return Plane(place[:3], float(place[3]), covariance, unobserved, name), rest
    if _KINDS[kind] is Line:
        return Line(place[:3], place[3:], covariance, unobserved, name), rest
    return Point(place, covariance, unobserved, name), rest
