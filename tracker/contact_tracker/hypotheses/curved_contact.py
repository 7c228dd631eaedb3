"""Contacts of curved surfaces, which are none of the six: what one constraint they keep, as residuals.

Two elements at a distance that stays the same: a vertex on a sphere or a cylinder, an edge on either, two
cylinders. And a rim, that is a circle, on a face. (A sphere on a face is v-f with the sphere's centre, a
cylinder on a face e-f with its axis.)

Each residual takes parameters (S, p) and poses of frame 1 in frame 2, as ``CONTACT_MODELS`` do.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PARALLEL: Final = 1e-3
"""Sine of the angle below which two lines have no single nearest points."""
TINY: Final = 1e-12


class Touch(NamedTuple):
    """Of S elements and N poses: the ``residual`` (S, N) in m, the ``normal`` (S, N, 3) in frame 2 along
    which it is measured, where that is in frame 1 (``point``, (S, N, 3)), and the ``jacobian`` (S, N, p)."""

    residual: Array
    normal: Array
    point: Array
    jacobian: Array


class CurvedContact(NamedTuple):
    """``directions`` are where the parameters have vectors of free length, which count by their direction
    only; the others are in m. ``of_inverse`` poses, of frame 2 in frame 1."""

    name: str
    size: int
    directions: tuple[int, ...]
    of_inverse: bool
    touch: Callable[[Array, Array, Array], Touch]


def point_at_point(x: Array, rotation: Array, position: Array) -> Touch:
    """A point q of frame 1 stays at distance r of a point c of frame 2; x = (q, c, r)."""
    q, c, r = x[:, None, :3], x[:, None, 3:6], x[:, 6:]
    way = _moved(rotation, q) + position - c
    distance = _length(way)
    normal = way / distance
    columns = _in_frame_1(rotation, normal), -normal, -np.ones_like(distance)
    return Touch(
        distance[..., 0] - r, normal, np.broadcast_to(q, way.shape), np.concatenate(columns, axis=-1)
    )


def point_at_line(x: Array, rotation: Array, position: Array) -> Touch:
    """A point q of frame 1 stays at distance r of the line through c along d of frame 2; x = (q, c, d, r)."""
    q, c, r = x[:, None, :3], x[:, None, 3:6], x[:, 9:]
    d, scale = _unit(x[:, None, 6:9])
    way = _moved(rotation, q) + position - c
    along = (way * d).sum(axis=-1, keepdims=True)
    across = way - along * d
    distance = _length(across)
    normal = across / distance
    columns = (
        *(_in_frame_1(rotation, normal), -normal),
        *(-along / scale * normal, -np.ones_like(distance)),
    )
    return Touch(
        distance[..., 0] - r, normal, np.broadcast_to(q, way.shape), np.concatenate(columns, axis=-1)
    )


def line_at_line(x: Array, rotation: Array, position: Array) -> Touch:
    """A line through q along e of frame 1 stays at distance r of one through c along d of frame 2; the sign
    says on which side; x = (q, c, d, e, r)."""
    q, c, r = x[:, None, :3], x[:, None, 3:6], x[:, 12:]
    (d, scale_d), (own, scale_e) = _unit(x[:, None, 6:9]), _unit(x[:, None, 9:12])
    e = _moved(rotation, own)
    way = _moved(rotation, q) + position - c
    normal = np.cross(e, d)
    sine = np.maximum(_length(normal), PARALLEL)
    normal = normal / sine
    cosine, by_e, by_d = ((a * b).sum(axis=-1, keepdims=True) for a, b in ((e, d), (e, way), (d, way)))
    on_1 = (cosine * by_d - by_e) / sine**2  # how far along each line the nearest points are
    on_2 = by_d + cosine * on_1
    in_1 = _in_frame_1(rotation, normal)
    columns = (
        *(in_1, -normal, -on_2 / scale_d * normal),
        *(on_1 / scale_e * in_1, -np.ones_like(sine)),
    )
    residual = (normal * way).sum(axis=-1) - r
    return Touch(residual, normal, q + on_1 * own, np.concatenate(columns, axis=-1))


def rim_on_plane(x: Array, rotation: Array, position: Array) -> Touch:
    """A circle of frame 1 of radius r about q across a stays on the plane through c across n of frame 2;
    x = (q, c, n, a, r)."""
    q, c, r = x[:, None, :3], x[:, None, 3:6], x[:, 12:, None]
    (n, scale_n), (a, scale_a) = _unit(x[:, None, 6:9]), _unit(x[:, None, 9:12])
    normal_1 = np.einsum("nij,smi->snj", rotation, n)
    cosine = (normal_1 * a).sum(axis=-1, keepdims=True)
    down = cosine * a - normal_1
    sine = np.maximum(_length(down), PARALLEL)
    point = q + r * down / sine
    way = _moved(rotation, point) + position - c
    residual = (n * way).sum(axis=-1, keepdims=True)
    columns = (
        *(normal_1, -np.broadcast_to(n, way.shape), (way - residual * n) / scale_n),
        *(r * cosine / sine * (normal_1 - cosine * a) / scale_a, -sine),
    )
    normal = np.broadcast_to(n, way.shape)
    return Touch(residual[..., 0], normal, point, np.concatenate(columns, axis=-1))


CURVED_CONTACTS: Final = (
    CurvedContact("point at point", 7, (), False, point_at_point),
    CurvedContact("point at line", 10, (6,), False, point_at_line),
    CurvedContact("line at point", 10, (6,), True, point_at_line),
    CurvedContact("line at line", 13, (6, 9), False, line_at_line),
    CurvedContact("rim on plane", 13, (6, 9), False, rim_on_plane),
    CurvedContact("plane on rim", 13, (6, 9), True, rim_on_plane),
)


def _moved(rotation: Array, vectors: Array) -> Array:
    """Vectors (S, 1 or N, 3) of frame 1 as they are in frame 2 (S, N, 3)."""
    return np.asarray((rotation @ vectors[..., None])[..., 0])


def _in_frame_1(rotation: Array, vectors: Array) -> Array:
    """Vectors (S, N, 3) of frame 2 as they are in frame 1."""
    return np.asarray(np.einsum("nij,sni->snj", rotation, vectors))


def _length(vectors: Array) -> Array:
    """(..., 1)"""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True)) + TINY)


def _unit(vectors: Array) -> tuple[Array, Array]:
    """Their directions and lengths."""
    length = _length(vectors)
    return vectors / length, length
