"""Named convex bodies: objects of hand size, and surroundings."""

from collections.abc import Mapping
from itertools import product
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.polyhedron import Polyhedron, convex

Array = NDArray[np.float64]


def _box(x: float, y: float, z: float) -> Array:
    return np.array(list(product((-x / 2, x / 2), (-y / 2, y / 2), (-z / 2, z / 2))))


def _prism(polygon: list[tuple[float, float]], length: float) -> Array:
    """A polygon in x and z, extended along y."""
    return np.array([(x, y, z) for y in (-length / 2, length / 2) for x, z in polygon])


def _frustum(bottom: float, top: float, height: float) -> Array:
    corners = list(product((-0.5, 0.5), repeat=2))
    low = [(bottom * x, bottom * y, -height / 2) for x, y in corners]
    return np.array([*low, *((top * x, top * y, height / 2) for x, y in corners)])


_HEXAGON: Final = [(0.12 * float(np.cos(a)), 0.12 * float(np.sin(a))) for a in np.radians(range(0, 360, 60))]
_TETRAHEDRON: Final = 0.12 * np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], float)

OBJECTS: Final[Mapping[str, Array]] = MappingProxyType(
    {
        "cube": _box(0.2, 0.2, 0.2),
        "box": _box(0.16, 0.22, 0.3),
        "prism": _prism(_HEXAGON, 0.26),
        "wedge": _prism([(-0.1, -0.09), (0.16, -0.09), (-0.1, 0.12)], 0.24),
        "tetrahedron": _TETRAHEDRON,
    }
)
SURROUNDINGS: Final[Mapping[str, Array]] = MappingProxyType(
    {
        "desk": _box(0.8, 0.6, 0.7),
        "block": _box(0.45, 0.4, 0.35),
        "ridge": _prism([(-0.4, -0.2), (0.4, -0.2), (0.15, 0.2), (-0.15, 0.2)], 0.6),
        "frustum": _frustum(0.7, 0.36, 0.4),
    }
)


def object_shape(name: str) -> Polyhedron:
    """The object ``name``, centred at its middle."""
    return convex(OBJECTS[name])


def surroundings_shape(name: str) -> Polyhedron:
    """The fixed body ``name``; objects touch its top face (+z) or an edge or corner of it."""
    return convex(SURROUNDINGS[name])
