"""Meshes of elements: round for the object, square for the surroundings.

An object's face is a wheel, its edge a round rod, its vertex a ball; a face of the surroundings is a square
sheet, an edge a square bar, a vertex a cube. Uncertainty is the surface at two standard deviations: a pair of
bowls about a plane, a tube that widens along a line, an ellipsoid about a point.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Array, Element, Line, Plane, Point

SIGMAS: Final = 2.0
_ROUND: Final = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
SQUARE: Final = 0.25 * np.pi + np.linspace(0.0, 2.0 * np.pi, 4, endpoint=False)
_CORNER: Final = np.sqrt(2.0)
"""From the middle of a square to its corners, by half its side."""
_ROD: Final = 0.04
_BAR: Final = 0.05
_BALL: Final = 0.1
_CUBE: Final = 0.1
_RIM: Final = 0.02
_SPOKES: Final = 3
_WIDEST: Final = 1.0


class Mesh(NamedTuple):
    """``vertices`` (V, 3) in metres, ``triangles`` (T, 3) of their indices, ``normals`` (V, 3)."""

    vertices: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    normals: NDArray[np.float32]


EMPTY: Final = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32), np.zeros((0, 3), np.float32))


def of_object(element: Element, centre: Array, half_m: float) -> Mesh:
    """An object's element within ``half_m`` of ``centre``, a point on it; EMPTY where it is not finite."""
    match element:
        case Plane(normal):
            return _wheel(normal, centre, half_m)
        case Line(direction):
            return _mesh(_capped(direction, centre, half_m, _ROD * half_m, _ROUND))
        case Point():
            return _mesh(_ball(centre, np.eye(3) * _BALL * half_m))


def of_surroundings(element: Element, centre: Array, half_m: float) -> Mesh:
    """An element of the surroundings within ``half_m`` of ``centre``; EMPTY where it is not finite."""
    match element:
        case Plane(normal):
            return _mesh(_disc(normal, centre, half_m, 2, SQUARE))
        case Line(direction):
            return _faceted(_mesh(_capped(direction, centre, half_m, _BAR * _CORNER * half_m, SQUARE)))
        case Point():
            size = _CUBE * half_m
            return _faceted(_mesh(_capped(np.array([0.0, 0.0, 1.0]), centre, size, _CORNER * size, SQUARE)))


def uncertainty(element: Element, centre: Array, half_m: float, angles: Array = _ROUND) -> Mesh:
    """The surface at two standard deviations; EMPTY where the covariance is unknown.

    Its width is limited to ``half_m``. ``angles`` are those of the corners of a plane.
    """
    covariance, widest = element.covariance, _WIDEST * half_m
    if covariance is None or not np.all(np.isfinite(covariance)):
        return EMPTY
    match element:
        case Plane(normal):
            disc = _disc(normal, centre, half_m, 5, angles)
            shift = np.minimum(SIGMAS * distance_sd_m(element, disc), widest)[..., None] * normal
            return joined((_mesh(disc + shift), _mesh(disc - shift)))
        case Line(direction):
            along, across = np.linspace(-half_m, half_m, 7), _across(direction)
            dd, dp, pp = covariance[:3, :3], covariance[:3, 3:], covariance[3:, 3:]
            spread = pp + along[:, None, None] * (dp + dp.T) + along[:, None, None] ** 2 * dd
            return _mesh(_tube(direction, centre, along, _root(across.T @ spread @ across, widest), _ROUND))
        case Point():
            return _mesh(_ball(centre, _root(covariance, widest)))


def distance_sd_m(plane: Plane, points: Array) -> Array:
    """Standard deviation (...) of the distance of ``plane``, which has a covariance, from points (..., 3)."""
    assert plane.covariance is not None
    lifted = np.concatenate([points, -np.ones((*points.shape[:-1], 1))], axis=-1)
    variance = np.einsum("...i,ij,...j->...", lifted, plane.covariance, lifted)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def needle(direction: Array, centre: Array, half_m: float) -> Mesh:
    """A thin rod along a direction in which a position is unknown."""
    return _mesh(_capped(direction, centre, half_m, 0.5 * _RIM * half_m, _ROUND))


def across(axis: Array) -> Array:
    """Two unit vectors (3, 2) towards the corners of a square across the unit vector ``axis``."""
    return np.asarray(_across(axis) @ (np.array([[1.0, 1.0], [1.0, -1.0]]) / _CORNER))


def _wheel(normal: Array, centre: Array, half_m: float) -> Mesh:
    basis, thick = _across(normal), _RIM * half_m
    turn = np.append(_ROUND, _ROUND[:1])
    out = np.stack([np.cos(turn), np.sin(turn)], axis=-1) @ basis.T
    around = _ROUND[::4, None]
    section = np.cos(around) * out[:, None] + np.sin(around) * normal
    rim = _mesh(centre + (half_m - thick) * out[:, None] + thick * section)
    angles = np.pi * np.arange(_SPOKES) / _SPOKES
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=-1) @ basis.T
    spokes = (_mesh(_capped(way, centre, half_m, 0.5 * thick, _ROUND)) for way in ways)
    return joined([rim, *spokes])


def _root(covariance: Array, widest: float) -> Array:
    """Two symmetric square roots of ``covariance``, no axis longer than ``widest``."""
    variance, axes = np.linalg.eigh(covariance)
    axis = np.minimum(SIGMAS * np.sqrt(np.maximum(variance, 0.0)), widest)
    root: Array = axes * axis[..., None, :] @ np.swapaxes(axes, -1, -2)
    return root


def _disc(normal: Array, centre: Array, radius_m: float, rings: int, angles: Array) -> Array:
    """Rings (K, M, 3) of a disc about ``centre``, the first of them a point; with four angles a square."""
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1) @ _across(normal).T
    return centre + np.linspace(0.0, radius_m, rings)[:, None, None] * circle


def _tube(direction: Array, centre: Array, along_m: Array, sections: Array, angles: Array) -> Array:
    """Rings (K, M, 3) at ``along_m`` (K,): the unit circle through ``sections`` (K or 1, 2, 2)."""
    circle = np.stack([np.cos(angles), np.sin(angles)])
    rings = np.swapaxes(_across(direction) @ sections @ circle, -1, -2)
    tube: Array = centre + along_m[:, None, None] * direction + rings
    return tube


def _capped(direction: Array, centre: Array, half_m: float, radius_m: float, angles: Array) -> Array:
    """Rings of a rod that is closed at its ends."""
    along = half_m * np.array([-1.0, -1.0, 1.0, 1.0])
    radii = radius_m * np.array([0.0, 1.0, 1.0, 0.0])
    return _tube(direction, centre, along, radii[:, None, None] * np.eye(2), angles)


def _ball(centre: Array, axes: Array) -> Array:
    """Rings (K, M, 3) of the unit sphere through ``axes`` (3, 3)."""
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 9)[:, None]
    sphere = [
        np.cos(latitude) * np.cos(_ROUND),
        np.cos(latitude) * np.sin(_ROUND),
        np.sin(latitude) + 0.0 * _ROUND,
    ]
    ball: Array = centre + np.stack(sphere, axis=-1) @ axes.T
    return ball


def _across(axis: Array) -> Array:
    """Two unit vectors (3, 2) that complete the unit vector ``axis`` to a basis."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)], axis=-1)


def _mesh(rings: Array) -> Mesh:
    """The surface through ``rings`` (K, M, 3), each closed; EMPTY where it is not finite."""
    if not np.all(np.isfinite(rings)):
        return EMPTY
    count, size = rings.shape[:2]
    at = np.arange(count * size).reshape(count, size)
    here, there = at, np.roll(at, -1, axis=1)
    low, up = np.stack([here[:-1], there[:-1], here[1:]]), np.stack([here[1:], there[:-1], there[1:]])
    triangles = np.concatenate([low.reshape(3, -1), up.reshape(3, -1)], axis=1).T
    vertices = rings.reshape(-1, 3)
    return Mesh(vertices.astype(np.float32), triangles.astype(np.uint32), _normals(vertices, triangles))


def _normals(vertices: Array, triangles: NDArray[np.intp]) -> NDArray[np.float32]:
    """The mean of the adjoining triangles' normals."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    sums = np.zeros_like(vertices)
    np.add.at(sums, triangles, np.cross(b - a, c - a)[:, None])
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    return (sums / np.where(length > 0.0, length, 1.0)).astype(np.float32)


def _faceted(mesh: Mesh) -> Mesh:
    """The mesh with separate vertices per triangle, so that its sides look flat."""
    if mesh is EMPTY:
        return EMPTY
    corners = mesh.vertices[mesh.triangles].reshape(-1, 3)
    apart = np.arange(len(corners)).reshape(-1, 3)
    return Mesh(corners, apart.astype(np.uint32), _normals(corners.astype(float), apart))


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])[:-1]
    shifted = [mesh.triangles + np.uint32(start) for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(shifted),
        np.concatenate([mesh.normals for mesh in meshes]),
    )
