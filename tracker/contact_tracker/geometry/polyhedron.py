"""Convex polyhedra and their features: the faces, edges and vertices that can touch."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from contact_tracker.geometry.elements import Element, Line, Plane, Point
from contact_tracker.geometry.linalg import Array

KINDS: Final = "vef"
_DIGITS: Final = 6
"""Number of decimal digits to which the planes of triangles of the same face agree."""
_ENOUGH_VERTICES: Final = 2000
"""Number of vertices at which the search for a hull stops. A hull of 60 faces, in any number of triangles,
needs 100; a ball would need all its points."""
_CHUNK_POINTS: Final = 4096
"""Number of points that are compared with all faces at once, to bound memory."""


@dataclass(frozen=True, eq=False)
class Feature:
    """A face, edge or vertex: a convex set of points with a convex cone of outward normals.

    Parameters
    ----------
    indices : of the polyhedron's vertices that span the feature.
    points : (k, 3) these vertices in m, for a face in order around it.
    normals : (j, 3) unit normals of the faces that meet in the feature; they generate the normal cone.
    walls : (w, 3) unit vectors; ``arcsin(walls @ n)`` are the angles of a unit normal n from the cone's
        sides.
    """

    indices: frozenset[int]
    points: Array
    normals: Array
    walls: Array

    @property
    def kind(self) -> str:
        """``v``, ``e`` or ``f``."""
        return KINDS[min(len(self.points), 3) - 1]

    @property
    def span(self) -> Array:
        """(d, 3) orthonormal directions within the feature: two for a face, one for an edge."""
        dimension = KINDS.index(self.kind)
        if dimension == 0:
            return np.empty((0, 3))
        along = unit(self.points[1] - self.points[0])
        return np.array([along, np.cross(self.normals[0], along)][:dimension])

    @property
    def axis(self) -> Array:
        """Unit vector (3,) in the middle of the normal cone."""
        return unit(self.normals.sum(axis=0))

    @property
    def reference(self) -> Array:
        """A direction (3,) that is parallel to no normal of the cone, and along a face or an edge."""
        directions = self.span if len(self.span) else self.tangents(self.axis)
        return np.asarray(directions[0], float)

    def tangents(self, normal: Array) -> Array:
        """(2 - d, 3) orthonormal directions in which ``normal`` can turn within the cone."""
        if self.kind == "f":
            return np.empty((0, 3))
        if self.kind == "e":
            return np.cross(self.span, normal)
        helper = np.eye(3)[0 if abs(normal[0]) < 0.9 else 1]
        tangent = unit(np.cross(normal, helper))
        return np.array([tangent, np.cross(normal, tangent)])

    def point_clearance(self, point: Array) -> float:
        """Distance (m) of a point of the feature from the feature's rim."""
        if self.kind == "v":
            return 0.0
        if self.kind == "e":
            return float(np.linalg.norm(self.points - point, axis=1).min())
        inward = unit(np.cross(self.normals[0], np.roll(self.points, -1, axis=0) - self.points))
        return float(np.einsum("ij,ij->i", point - self.points, inward).min())

    def normal_clearance(self, normal: Array) -> float:
        """Angle (rad) of a normal of the cone from the cone's sides."""
        if not len(self.walls):
            return 0.0
        return float(np.arcsin(np.clip((self.walls @ normal).min(), 0.0, 1.0)))

    def element(self, rotation: Array, translation: Array, near: Array) -> Element:
        """The plane, line or point of this feature after ``rotation`` (3, 3) and ``translation`` (3,).

        ``near`` (3,) is the point of a line, before them.
        """
        if self.kind == "f":
            normal = rotation @ self.normals[0]
            return Plane(normal, float(normal @ (rotation @ self.points[0] + translation)))
        if self.kind == "e":
            return Line(rotation @ self.span[0], rotation @ near + translation)
        return Point(rotation @ self.points[0] + translation)


@dataclass(frozen=True, eq=False)
class Polyhedron:
    """A convex body: ``vertices`` (n, 3) in m and its features."""

    vertices: Array
    features: tuple[Feature, ...]

    def of_kind(self, kind: str) -> tuple[Feature, ...]:
        """The features of a kind of ``KINDS``."""
        return tuple(f for f in self.features if f.kind == kind)

    def depth_m(self, points: Array) -> Array:
        """Depth (n,) in m of ``points`` (n, 3) below the surface."""
        faces = self.of_kind("f")
        normals = np.array([face.normals[0] for face in faces])
        offsets = np.array([face.normals[0] @ face.points[0] for face in faces])
        return -_height(points, normals, -offsets)

    @property
    def radius(self) -> float:
        """Largest distance (m) of a vertex from the origin."""
        return float(np.linalg.norm(self.vertices, axis=1).max())

    @property
    def top(self) -> tuple[Feature, ...]:
        """The face whose normal is nearest to +z, with its edges and vertices."""
        top = max(self.of_kind("f"), key=lambda face: float(face.normals[0, 2]))
        return tuple(feature for feature in self.features if feature.indices <= top.indices)


class TooManyFaces(ValueError):
    """A hull has more faces than allowed."""


def convex(points: Array, tolerance_m: float = 0.0, most_faces: int | None = None) -> Polyhedron:
    """The convex hull of ``points`` (n, 3); points within ``tolerance_m`` of a face are on it.

    With ``most_faces`` time is bounded for points of any shape.

    Raises
    ------
    ValueError : the points span no solid.
    TooManyFaces : the hull has more than ``most_faces`` faces.
    """
    stop = f" TA{_ENOUGH_VERTICES}" if most_faces is not None else ""
    try:
        hull = ConvexHull(points, qhull_options=f"Qt C-{tolerance_m:.9f}{stop}")
    except QhullError as error:
        raise ValueError("these points span no solid") from error
    if most_faces is not None and not _is_complete(hull, points, tolerance_m, most_faces):
        raise TooManyFaces(f"more than {most_faces} faces")
    outer = np.sort(hull.vertices)
    vertices = points[outer]
    planes: dict[tuple[float, ...], set[int]] = {}
    for simplex, equation in zip(np.searchsorted(outer, hull.simplices), hull.equations, strict=True):
        planes.setdefault(tuple(np.round(equation, _DIGITS) + 0.0), set()).update(map(int, simplex))
    loops = [_ordered(vertices, members, np.array(key[:3])) for key, members in sorted(planes.items())]
    normals = [_loop_normal(vertices[loop]) for loop in loops]
    faces = [
        Feature(frozenset(loop), vertices[loop], normal[None], np.empty((0, 3)))
        for loop, normal in zip(loops, normals, strict=True)
    ]
    pairs = sorted({tuple(sorted(pair)) for loop in loops for pair in pairwise([*loop, loop[0]])})
    edges = [_edge(vertices, list(pair), faces) for pair in pairs]
    corners = [_corner(vertices, i, faces, pairs) for i in range(len(vertices))]
    return Polyhedron(vertices, (*faces, *edges, *corners))


def _height(points: Array, normals: Array, offsets: Array) -> Array:
    """Height (n,) in m of ``points`` (n, 3) above the highest of the planes ``normals @ x + offsets = 0``."""
    height = np.empty(len(points))
    for start in range(0, len(points), _CHUNK_POINTS):
        chunk = slice(start, start + _CHUNK_POINTS)
        height[chunk] = (normals @ points[chunk].T + offsets[:, None]).max(axis=0)
    return height


def _is_complete(hull: ConvexHull, points: Array, tolerance_m: float, most_faces: int) -> bool:
    """Whether a hull, which may have stopped early, has all ``points`` and at most ``most_faces`` faces."""
    faces = np.unique(np.round(hull.equations, _DIGITS), axis=0)
    if len(faces) > most_faces:
        return False
    return bool(_height(points, faces[:, :3], faces[:, 3]).max() <= 10.0 * tolerance_m + 10.0**-_DIGITS)


def _edge(vertices: Array, pair: list[int], faces: Sequence[Feature]) -> Feature:
    """The edge between the vertices of a ``pair`` of indices."""
    normals = [face.normals[0] for face in faces if face.indices >= set(pair)]
    if len(normals) != 2:
        raise ValueError("faces of these points do not meet in edges")
    m, n = normals
    walls = unit(np.array([n - (m @ n) * m, m - (m @ n) * n]))
    return Feature(frozenset(pair), vertices[pair], np.array([m, n]), walls)


def _corner(vertices: Array, index: int, faces: Sequence[Feature], pairs: Sequence[Sequence[int]]) -> Feature:
    """The vertex of an ``index``."""
    neighbours = [sum(pair) - index for pair in pairs if index in pair]
    normals = np.array([face.normals[0] for face in faces if index in face.indices])
    return Feature(
        frozenset({index}), vertices[[index]], normals, unit(vertices[index] - vertices[neighbours])
    )


def _ordered(vertices: Array, members: set[int], normal: Array) -> list[int]:
    """Indices of a face's vertices, anticlockwise around its outward ``normal`` (3,), from the lowest on."""
    indices = sorted(members)
    relative = vertices[indices] - vertices[indices].mean(axis=0)
    x = relative[0]
    angles = np.arctan2(relative @ np.cross(normal, x), relative @ x)
    return [indices[i] for i in np.argsort((angles + 1e-6) % (2.0 * np.pi))]


def _loop_normal(loop: Array) -> Array:
    """Unit normal (3,) of a face whose vertices (k, 3) are in anticlockwise order."""
    return unit(np.cross(loop[1] - loop[0], loop[2] - loop[1]))


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) scaled to length one."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), float)
