"""Many minima of one objective at once: batched Levenberg-Marquardt on the Kronecker form.

``F = v.T K v`` with ``v = x (x) y`` is a sum of squares that are linear in v, so that ``J.T K J`` with
``J = dv/dtheta`` is the Gauss-Newton matrix: no step touches a frame. theta are minimal coordinates: unit
vectors move in their tangent planes and moments stay normal to their lines.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.labels import Contact
from contact_tracker.paper.kronecker import Kind, form

Array = NDArray[np.float64]

_DAMPING: Final = (1e-3, 1e-12, 1e12)


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
    cost = _cost(k, x, y)
    damping = np.full(len(cost), _DAMPING[0])
    active = np.arange(len(cost))
    for _ in range(iterations):
        if not len(active):
            break
        step = _step(k[active], x[active], y[active], damping[active], f.x, f.y)
        tx, ty = _move(f.x, x[active], step[0]), _move(f.y, y[active], step[1])
        tried = _cost(k[active], tx, ty)
        gain = cost[active] - tried
        accept = gain > 0
        done = np.where(accept, gain <= tolerance * cost[active], damping[active] >= _DAMPING[2])
        rows = active[accept]
        x[rows], y[rows], cost[rows] = tx[accept], ty[accept], tried[accept]
        damping[active] = np.clip(damping[active] * np.where(accept, 0.2, 8.0), *_DAMPING[1:])
        active = active[~done]
    converged = np.ones(len(cost), bool)
    converged[active] = False
    return Batch(cost, x, y, converged)


def _cost(k: Array, x: Array, y: Array) -> Array:
    v = (x[:, :, None] * y[:, None, :]).reshape(len(x), -1, 1)
    cost: Array = (v.swapaxes(-1, -2) @ (k @ v))[:, 0, 0]
    return cost


def _step(k: Array, x: Array, y: Array, damping: Array, kind_x: Kind, kind_y: Kind) -> tuple[Array, Array]:
    """Damped Gauss-Newton step, in the ambient coordinates of x and of y."""
    tangent_x, tangent_y = _tangent(kind_x, x), _tangent(kind_y, y)
    size = (len(x), x.shape[1] * y.shape[1], -1)
    by_x = (tangent_x[:, :, None, :] * y[:, None, :, None]).reshape(size)
    by_y = (x[:, :, None, None] * tangent_y[:, None, :, :]).reshape(size)
    v = (x[:, :, None] * y[:, None, :]).reshape(size)
    jacobian = np.concatenate([by_x, by_y], axis=-1)
    kj = k @ jacobian
    gradient = kj.swapaxes(-1, -2) @ v
    hessian = jacobian.swapaxes(-1, -2) @ kj
    diagonal = np.einsum("bii->bi", hessian)
    # directions that the motion leaves free have no curvature: keep their steps short instead of infinite
    floor = 1e-11 * diagonal.max(axis=1, keepdims=True) + np.finfo(float).tiny
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
    across = _across(e[:, :3])
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


def _across(n: Array) -> Array:
    """Two orthonormal directions (B, 3, 2) normal to n (B, 3)."""
    helper = np.eye(3)[np.argmin(np.abs(n), axis=1)]
    first = np.cross(n, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(n, first)], axis=-1)


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
