"""Residuals of contacts with curved surfaces, which are none of the six and impose one constraint.

Either two elements at a constant distance: a vertex on a sphere or a cylinder, an edge on either, two
cylinders. Or a rim (circle) on a face. (A sphere on a face is v-f with the sphere's centre, a cylinder on a
face e-f with its axis.)

Each residual takes parameters (S, p) and poses of frame 1 in frame 2, as ``CONTACT_MODELS`` do.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PARALLEL: Final = 1e-3
"""Sine of the angle below which the nearest points of two lines are not unique."""
TINY: Final = 1e-12


class Touch(NamedTuple):
    """Residuals of S elements and N poses: ``residual`` (S, N) in m, its ``normal`` (S, N, 3) in frame 2, the
    touching ``point`` (S, N, 3) in frame 1, and the ``jacobian`` (S, N, p)."""

    residual: Array
    normal: Array
    point: Array
    jacobian: Array


class CurvedContact(NamedTuple):
    """A kind of curved contact with ``size`` parameters.

    ``directions`` are the indices at which vectors begin of which only the direction matters; the other
    parameters are in m. ``of_inverse``: poses are those of frame 2 in frame 1.
    """

    name: str
    size: int
    directions: tuple[int, ...]
    of_inverse: bool
    touch: Callable[[Array, Array, Array], Touch]


def point_at_point(x: Array, rotation: Array, position: Array) -> Touch:
    """A point q of frame 1 stays at distance r from a point c of frame 2; x = (q, c, r)."""
    q, c, r = x[:, None, :3], x[:, None, 3:6], x[:, 6:]
    offset = _in_frame_2(rotation, q) + position - c
    distance = _length(offset)
    normal = offset / distance
    columns = _in_frame_1(rotation, normal), -normal, -np.ones_like(distance)
    return Touch(
        distance[..., 0] - r, normal, np.broadcast_to(q, offset.shape), np.concatenate(columns, axis=-1)
    )


def point_at_line(x: Array, rotation: Array, position: Array) -> Touch:
    """A point q of frame 1 stays at distance r from the line through c along d of frame 2;
    x = (q, c, d, r)."""
    q, c, r = x[:, None, :3], x[:, None, 3:6], x[:, 9:]
    d, scale = _unit(x[:, None, 6:9])
    offset = _in_frame_2(rotation, q) + position - c
    along = (offset * d).sum(axis=-1, keepdims=True)
    across = offset - along * d
    distance = _length(across)
    normal = across / distance
    columns = (
        *(_in_frame_1(rotation, normal), -normal),
        *(-along / scale * normal, -np.ones_like(distance)),
    )
    return Touch(
        distance[..., 0] - r, normal, np.broadcast_to(q, offset.shape), np.concatenate(columns, axis=-1)
    )


def line_at_line(x: Array, rotation: Array, position: Array) -> Touch:
    """A line through q along e of frame 1 stays at distance r, signed by the side, from one through c along d
    of frame 2; x = (q, c, d, e, r)."""
    q, c, r = x[:, None, :3], x[:, None, 3:6], x[:, 12:]
    (d, scale_d), (e_1, scale_e) = _unit(x[:, None, 6:9]), _unit(x[:, None, 9:12])
    e = _in_frame_2(rotation, e_1)
    offset = _in_frame_2(rotation, q) + position - c
    normal = np.cross(e, d)
    sine = np.maximum(_length(normal), PARALLEL)
    normal = normal / sine
    cosine, by_e, by_d = ((a * b).sum(axis=-1, keepdims=True) for a, b in ((e, d), (e, offset), (d, offset)))
    on_1 = (cosine * by_d - by_e) / sine**2  # positions of the nearest points along the lines
    on_2 = by_d + cosine * on_1
    in_1 = _in_frame_1(rotation, normal)
    columns = (
        *(in_1, -normal, -on_2 / scale_d * normal),
        *(on_1 / scale_e * in_1, -np.ones_like(sine)),
    )
    residual = (normal * offset).sum(axis=-1) - r
    return Touch(residual, normal, q + on_1 * e_1, np.concatenate(columns, axis=-1))


def rim_on_plane(x: Array, rotation: Array, position: Array) -> Touch:
    """A circle of frame 1, with radius r, centre q and axis a, stays on the plane of frame 2 through c with
    normal n; x = (q, c, n, a, r)."""
    q, c, r = x[:, None, :3], x[:, None, 3:6], x[:, 12:, None]
    (n, scale_n), (a, scale_a) = _unit(x[:, None, 6:9]), _unit(x[:, None, 9:12])
    normal_1 = np.einsum("nij,smi->snj", rotation, n)
    cosine = (normal_1 * a).sum(axis=-1, keepdims=True)
    down = cosine * a - normal_1
    sine = np.maximum(_length(down), PARALLEL)
    point = q + r * down / sine
    offset = _in_frame_2(rotation, point) + position - c
    residual = (n * offset).sum(axis=-1, keepdims=True)
    columns = (
        *(normal_1, -np.broadcast_to(n, offset.shape), (offset - residual * n) / scale_n),
        *(r * cosine / sine * (normal_1 - cosine * a) / scale_a, -sine),
    )
    normal = np.broadcast_to(n, offset.shape)
    return Touch(residual[..., 0], normal, point, np.concatenate(columns, axis=-1))


CURVED_CONTACTS: Final = (
    CurvedContact("point at point", 7, (), False, point_at_point),
    CurvedContact("point at line", 10, (6,), False, point_at_line),
    CurvedContact("line at point", 10, (6,), True, point_at_line),
    CurvedContact("line at line", 13, (6, 9), False, line_at_line),
    CurvedContact("rim on plane", 13, (6, 9), False, rim_on_plane),
    CurvedContact("plane on rim", 13, (6, 9), True, rim_on_plane),
)


def _in_frame_2(rotation: Array, vectors: Array) -> Array:
    """Vectors (S, 1 or N, 3) of frame 1 in frame 2 (S, N, 3)."""
    return np.asarray((rotation @ vectors[..., None])[..., 0])


def _in_frame_1(rotation: Array, vectors: Array) -> Array:
    """Vectors (S, N, 3) of frame 2 in frame 1."""
    return np.asarray(np.einsum("nij,sni->snj", rotation, vectors))


def _length(vectors: Array) -> Array:
    """Lengths (..., 1)."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True)) + TINY)


def _unit(vectors: Array) -> tuple[Array, Array]:
    """Unit vectors, and the lengths (..., 1)."""
    length = _length(vectors)
    return vectors / length, length
