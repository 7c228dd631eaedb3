"""Many minima of one objective at once: batched Levenberg-Marquardt on the Kronecker form.

``F = v.T K v`` with ``v = x (x) y`` is a sum of squares that are linear in v, so that ``J.T K J`` with
``J = dv/dtheta`` is the Gauss-Newton matrix, and steps need no sums over frames. Since v is a product, all
terms follow from K contracted with one factor. theta are minimal coordinates: unit vectors move in their
tangent planes and moments stay normal to their lines.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.damping import MOST_DAMPING, adapted
from contact_tracker.geometry.vectors import sphere_tangent
from contact_tracker.paper.kronecker import Kind, form
from contact_tracker.states import Contact

Array = NDArray[np.float64]

FIRST_DAMPING: Final = 1e-3
LEAST_SHARE: Final = 1e-11
LEAST_CURVATURE: Final = np.finfo(float).tiny
"""Added to every curvature: a share of the largest one, and a constant for windows without curvature."""


class Batch(NamedTuple):
    """B minimisations: ``value`` (B,), factors ``x`` (B, a) and ``y`` (B, b), ``converged`` (B,).

    Not converged means that the last accepted step still lowered the value noticeably.
    """

    value: Array
    x: Array
    y: Array
    converged: NDArray[np.bool_]

    def better(self, other: "Batch") -> "Batch":
        """The lower of each pair."""
        take = self.value <= other.value
        rows = take[:, None]
        return Batch(
            np.where(take, self.value, other.value),
            np.where(rows, self.x, other.x),
            np.where(rows, self.y, other.y),
            np.where(take, self.converged, other.converged),
        )


def random_starts(
    contact: Contact, count: int, rng: np.random.Generator, offset_m: float
) -> tuple[Array, Array]:
    """Factors x (count, a) and y (count, b): directions uniform, points normal with ``offset_m``."""
    f = form(contact)
    return _random(f.x, count, rng, offset_m), _random(f.y, count, rng, offset_m)


def minimise_batched(
    contact: Contact, k: Array, x: Array, y: Array, tolerance: float = 1e-7, iterations: int = 100
) -> Batch:
    """Minimise from one start each.

    Parameters
    ----------
    k : (B, n, n), from ``kronecker.matrix``.
    x, y : (B, a) and (B, b), factors that meet their constraints.
    tolerance : relative gain of a step below which a minimisation has converged.
    """
    f = form(contact)
    x, y = x.copy(), y.copy()
    near = _contracted(k, x, y)
    cost = near.cost(x)
    damping = np.full(len(cost), FIRST_DAMPING)
    active = np.arange(len(cost))
    for _ in range(iterations):
        if not len(active):
            break
        step = _step(near.pick(active), x[active], y[active], damping[active], f.x, f.y)
        tx, ty = _move(f.x, x[active], step[0]), _move(f.y, y[active], step[1])
        there = _contracted(k[active], tx, ty)
        tried = there.cost(tx)
        gain = cost[active] - tried
        accept = gain > 0
        done = np.where(accept, gain <= tolerance * cost[active], damping[active] >= MOST_DAMPING)
        rows = active[accept]
        x[rows], y[rows], cost[rows] = tx[accept], ty[accept], tried[accept]
        for now, then in zip(near, there, strict=True):
            now[rows] = then[accept]
        damping[active] = adapted(damping[active], accept)
        active = active[~done]
    converged = np.ones(len(cost), bool)
    converged[active] = False
    return Batch(cost, x, y, converged)


class _Contracted(NamedTuple):
    """K contracted with one factor of v on either side: ``by_x`` (B, a, a) with y, ``by_y`` (B, b, b) with x,
    and ``mixed`` (B, b, a) with x on the left and y on the right."""

    by_x: Array
    by_y: Array
    mixed: Array

    def cost(self, x: Array) -> Array:
        """F (B,) at x."""
        return np.asarray(np.einsum("bi,bij,bj->b", x, self.by_x, x))

    def pick(self, rows: NDArray[np.int64]) -> "_Contracted":
        return _Contracted(*(part[rows] for part in self))


def _contracted(k: Array, x: Array, y: Array) -> _Contracted:
    (count, a), b = x.shape, y.shape[1]
    with_y = (y[:, None, None, :] @ k.reshape(count, a, b, a * b)).reshape(count, a, a, b)
    with_x = (x[:, None, :] @ k.reshape(count, a, b * a * b)).reshape(count, b, a, b)
    on_y, on_x = y[:, None, :, None], x[:, None, None, :]
    return _Contracted((with_y @ on_y)[..., 0], (on_x @ with_x)[:, :, 0], (with_x @ on_y)[..., 0])


def _step(
    near: _Contracted, x: Array, y: Array, damping: Array, kind_x: Kind, kind_y: Kind
) -> tuple[Array, Array]:
    """Damped Gauss-Newton step, in the ambient coordinates of x and of y."""
    tangent_x, tangent_y = _tangent(kind_x, x), _tangent(kind_y, y)
    along_x, along_y = np.swapaxes(tangent_x, -1, -2), np.swapaxes(tangent_y, -1, -2)
    mixed = along_y @ near.mixed @ tangent_x
    hessian = np.block(
        [
            [along_x @ near.by_x @ tangent_x, np.swapaxes(mixed, -1, -2)],
            [mixed, along_y @ near.by_y @ tangent_y],
        ]
    )
    by_x, by_y = along_x @ near.by_x @ x[..., None], along_y @ near.by_y @ y[..., None]
    gradient = np.concatenate([by_x, by_y], axis=1)
    diagonal = np.einsum("bii->bi", hessian)
    # directions that the motion leaves free have no curvature: keep their steps short instead of infinite
    floor = LEAST_SHARE * diagonal.max(axis=1, keepdims=True) + LEAST_CURVATURE
    diagonal += damping[:, None] * (diagonal + floor) + floor
    step = -np.linalg.solve(hessian, gradient)
    split = tangent_x.shape[-1]
    return (tangent_x @ step[:, :split])[..., 0], (tangent_y @ step[:, split:])[..., 0]


def _tangent(kind: Kind, e: Array) -> Array:
    """Directions in which an element may move, (B, 4, 3) for planes and points, (B, 6, 4) for lines."""
    out = np.zeros((*e.shape, 4 if kind == "line" else 3))
    if kind == "point":
        out[:, :3] = np.eye(3)
        return out
    across = sphere_tangent(e[:, :3])
    out[:, :3, :2] = across
    if kind == "plane":
        out[:, 3, 2] = 1.0
    else:
        # m stays normal to the turning d
        out[:, 3:, :2] = -e[:, :3, None] * np.einsum("bi,bij->bj", e[:, 3:], across)[:, None, :]
        out[:, 3:, 2:] = across
    return out


def _move(kind: Kind, e: Array, step: Array) -> Array:
    """The element after a step, back on its constraints."""
    moved = e + step
    if kind == "point":
        return moved
    moved[:, :3] /= np.linalg.norm(moved[:, :3], axis=1, keepdims=True)
    if kind == "line":
        moved[:, 3:] -= moved[:, :3] * np.einsum("bi,bi->b", moved[:, :3], moved[:, 3:])[:, None]
    return moved


def _random(kind: Kind, count: int, rng: np.random.Generator, offset_m: float) -> Array:
    direction, offset = rng.normal(size=(count, 3)), rng.normal(size=(count, 3)) * offset_m
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    match kind:
        case "plane":
            return np.hstack([direction, offset[:, :1]])
        case "line":
            return np.hstack([direction, np.cross(offset, direction)])
        case "point":
            return np.hstack([offset, np.ones((count, 1))])
