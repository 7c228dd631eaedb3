"""Elements as triangles: a disc for a plane, a rod for a line, a ball for a point, and their uncertainty.

The uncertainty is the surface at two standard deviations: a pair of bowls about a plane, a tube that widens
along a line, an ellipsoid about a point.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Array, Element, Line, Plane, Point

SIGMAS: Final = 2.0
_ROUND: Final = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
_ROD: Final = 0.04
_BALL: Final = 0.08
_WIDEST: Final = 1.0


class Mesh(NamedTuple):
    """``vertices`` (V, 3) in metres, ``triangles`` (T, 3) of their indices, ``normals`` (V, 3)."""

    vertices: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    normals: NDArray[np.float32]


EMPTY: Final = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32), np.zeros((0, 3), np.float32))


def body(element: Element, centre: Array, half_m: float) -> Mesh:
    """The element itself within ``half_m`` of ``centre``, a point on it; EMPTY where it is not finite."""
    match element:
        case Plane(normal):
            points = _disc(normal, centre, half_m, rings=2)
        case Line(direction):
            ends = np.array([-half_m, half_m])
            points = _tube(direction, centre, ends, np.eye(2)[None] * _ROD * half_m)
        case Point():
            points = _ball(centre, np.eye(3) * _BALL * half_m)
    return _mesh(points)


def uncertainty(element: Element, centre: Array, half_m: float) -> Mesh:
    """The surface at two standard deviations; EMPTY where the covariance is unknown.

    Where it is wider than ``half_m`` it is drawn that wide: nothing is known there.
    """
    covariance, widest = element.covariance, _WIDEST * half_m
    if covariance is None or not np.all(np.isfinite(covariance)):
        return EMPTY
    match element:
        case Plane(normal):
            disc = _disc(normal, centre, half_m, rings=5)
            lifted = np.concatenate([disc, -np.ones((*disc.shape[:2], 1))], axis=-1)
            variance = np.einsum("...i,ij,...j->...", lifted, covariance, lifted)
            shift = np.minimum(SIGMAS * np.sqrt(np.maximum(variance, 0.0)), widest)[..., None] * normal
            return joined((_mesh(disc + shift), _mesh(disc - shift)))
        case Line(direction):
            along, across = np.linspace(-half_m, half_m, 7), _across(direction)
            dd, dp, pp = covariance[:3, :3], covariance[:3, 3:], covariance[3:, 3:]
            spread = pp + along[:, None, None] * (dp + dp.T) + along[:, None, None] ** 2 * dd
            return _mesh(_tube(direction, centre, along, _root(across.T @ spread @ across, widest)))
        case Point():
            return _mesh(_ball(centre, _root(covariance, widest)))


def _root(covariance: Array, widest: float) -> Array:
    """Two symmetric square roots of ``covariance``, no axis longer than ``widest``."""
    variance, axes = np.linalg.eigh(covariance)
    axis = np.minimum(SIGMAS * np.sqrt(np.maximum(variance, 0.0)), widest)
    root: Array = axes * axis[..., None, :] @ np.swapaxes(axes, -1, -2)
    return root


def _disc(normal: Array, centre: Array, half_m: float, rings: int) -> Array:
    """Rings (K, M, 3) of a disc about ``centre``, the first of them a point."""
    circle = np.stack([np.cos(_ROUND), np.sin(_ROUND)], axis=-1) @ _across(normal).T
    return centre + np.linspace(0.0, half_m, rings)[:, None, None] * circle


def _tube(direction: Array, centre: Array, along_m: Array, sections: Array) -> Array:
    """Rings (K, M, 3) at ``along_m`` (K,): the unit circle through ``sections`` (K or 1, 2, 2)."""
    circle = np.stack([np.cos(_ROUND), np.sin(_ROUND)])
    rings = np.swapaxes(_across(direction) @ sections @ circle, -1, -2)
    tube: Array = centre + along_m[:, None, None] * direction + rings
    return tube


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


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])[:-1]
    shifted = [mesh.triangles + np.uint32(start) for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(shifted),
        np.concatenate([mesh.normals for mesh in meshes]),
    )
