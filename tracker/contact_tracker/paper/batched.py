"""The paper's objectives in Kronecker form and their minima: many at once by batched Levenberg-Marquardt, or
one by SLSQP.

``F = v.T K v`` with ``v = x (x) y`` is a sum of squares that are linear in v, so that ``J.T K J`` with
``J = dv/dtheta`` is the Gauss-Newton matrix, and steps need no sums over frames. Since v is a product, all
terms follow from K contracted with one factor. theta are minimal coordinates: unit vectors move in their
tangent planes and moments stay normal to their lines.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.geometry.linalg import LEAST_SHARE, MOST_DAMPING, adapted, sphere_tangent
from contact_tracker.paper.objectives import motion
from contact_tracker.states import Contact

Kind = Literal["plane", "line", "point"]

SIZE: Final[dict[Kind, int]] = {"plane": 4, "line": 6, "point": 4}


@dataclass(frozen=True)
class Form:
    """Kinds and order of the elements that are the factors x and y.

    Parameters
    ----------
    x, y : kinds of the first and the second factor.
    residuals : rows of each frame, by the motion (..., N, 3, 3) and (..., N, 3).
    object_first : whether x is the object's element.
    swapped : whether the frames are exchanged (f-e is e-f of the inverse motion).
    """

    x: Kind
    y: Kind
    residuals: Callable[[Array, Array], Array]
    object_first: bool
    swapped: bool = False

    @property
    def size(self) -> int:
        """Length of ``x (x) y``: 16, 24 or 36."""
        return SIZE[self.x] * SIZE[self.y]

    def factors(self, obj: Array, environment: Array) -> tuple[Array, Array]:
        """(x, y) from (object, environment), or the reverse."""
        return (obj, environment) if self.object_first else (environment, obj)


def matrix(contact: Contact, rotation: Array, p: Array) -> Array:
    """K (..., n, n), summed over the frames.

    Parameters
    ----------
    rotation, p : (..., N, 3, 3) and (..., N, 3); leading axes are independent sums.
    """
    a = rows(contact, rotation, p)
    a = a.reshape(*p.shape[:-2], -1, a.shape[-1])
    return np.asarray(np.swapaxes(a, -1, -2) @ a)


def value(contact: Contact, k: Array, obj: Array, environment: Array) -> float:
    """The objective function from K."""
    v = np.kron(*form(contact).factors(obj, environment))
    return float(v @ k @ v)


def rows(contact: Contact, rotation: Array, p: Array) -> Array:
    """Rows A (..., N, r, n) of each frame: its residuals are ``A @ kron(x, y)``."""
    frames = motion(rotation, p) if form(contact).swapped else (rotation, p)
    return form(contact).residuals(*frames)


def _face_face(rotation: Array, p: Array) -> Array:
    """(7) over (8), ``p_sb`` with its sign corrected: 6 rows on plane (x) plane."""
    a = np.zeros((*p.shape[:-1], 6, 4, 4))
    a[..., :3, :3, :] = _offsets(rotation, p)
    a[..., :3, 3, :3] = -rotation
    a[..., 3:, :3, :3] = _cross_rows(rotation)
    return a.reshape(*p.shape[:-1], 6, 16)


def _edge_face(rotation: Array, p: Array) -> Array:
    """(12) with (13) negated, and ``vec(R.T)``: 4 rows on line (x) plane."""
    a = np.zeros((*p.shape[:-1], 4, 6, 4))
    a[..., :3, :3, :] = _offsets(rotation, p)
    a[..., :3, 3:, :3] = -_cross_rows(rotation)
    a[..., 3, :3, :3] = rotation
    return a.reshape(*p.shape[:-1], 4, 24)


def _vertex_face(rotation: Array, p: Array) -> Array:
    """(17): 1 row on point (x) plane."""
    a = np.zeros((*p.shape[:-1], 1, 4, 4))
    a[..., 0, :3, :3] = rotation
    a[..., 0, 3, :3] = -np.einsum("...ij,...i->...j", rotation, p)
    a[..., 0, 3, 3] = -1.0
    return a.reshape(*p.shape[:-1], 1, 16)


def _edge_edge(rotation: Array, p: Array) -> Array:
    """(21) with columns for rows of R: 1 row on environment's line (x) object's line."""
    columns = np.swapaxes(rotation, -1, -2)
    a = np.zeros((*p.shape[:-1], 1, 6, 6))
    a[..., 0, :3, :3] = np.cross(p[..., None, :], columns)
    a[..., 0, :3, 3:] = columns
    a[..., 0, 3:, :3] = columns
    return a.reshape(*p.shape[:-1], 1, 36)


_FORMS: Final[dict[Contact, Form]] = {
    Contact.FF: Form("plane", "plane", _face_face, object_first=True),
    Contact.EF: Form("line", "plane", _edge_face, object_first=True),
    Contact.FE: Form("line", "plane", _edge_face, object_first=False, swapped=True),
    Contact.VF: Form("point", "plane", _vertex_face, object_first=True),
    Contact.FV: Form("point", "plane", _vertex_face, object_first=False, swapped=True),
    Contact.EE: Form("line", "line", _edge_edge, object_first=False),
}


def form(contact: Contact) -> Form:
    """The factors of a contact's Kronecker product."""
    return _FORMS[contact]


def _offsets(rotation: Array, p: Array) -> Array:
    """(..., 3, 3, 4): row k takes ``v_k ((R n) . p + h)`` from ``v (x) [n, h]``."""
    plane = np.concatenate([np.einsum("...ij,...i->...j", rotation, p), np.ones((*p.shape[:-1], 1))], axis=-1)
    return np.asarray(np.einsum("kl,...j->...klj", np.eye(3), plane))


def _cross_rows(rotation: Array) -> Array:
    """(8), (..., 3, 3, 3): row k takes ``(v x R n)_k`` from ``v (x) n``."""
    return np.asarray(np.einsum("klm,...mj->...klj", _LEVI_CIVITA, rotation))


_LEVI_CIVITA: Final = np.cross(np.eye(3)[:, None], np.eye(3))
FIRST_DAMPING: Final = 1e-3
LEAST_CURVATURE: Final = np.finfo(float).tiny
"""Minimal curvature: a share of the largest one, and a constant for windows without curvature."""


class Batch(NamedTuple):
    """B minimisations: ``value`` (B,), factors ``x`` (B, a) and ``y`` (B, b), ``converged`` (B,).

    Not converged means that the last accepted step still lowered the value noticeably.
    """

    value: Array
    x: Array
    y: Array
    converged: Bools

    def better(self, batch: "Batch") -> "Batch":
        """The lower of each pair."""
        take, pairs = self.value <= batch.value, zip(self, batch, strict=True)
        return Batch(*(np.where(take if a.ndim == 1 else take[:, None], a, b) for a, b in pairs))


def random_starts(
    contact: Contact, count: int, rng: np.random.Generator, offset_m: float
) -> tuple[Array, Array]:
    """Factors x (count, a) and y (count, b): directions uniform, points normal with ``offset_m``."""
    f = form(contact)
    return _random(f.x, count, rng, offset_m), _random(f.y, count, rng, offset_m)


def minimise_batched(
    contact: Contact, k: Array, x: Array, y: Array, tolerance: float = 1e-7, iterations: int = 100
) -> Batch:
    """Minimise B problems, each from one start.

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
        ahead = _contracted(k[active], tx, ty)
        trial = ahead.cost(tx)
        gain = cost[active] - trial
        accept = gain > 0
        done = np.where(accept, gain <= tolerance * cost[active], damping[active] >= MOST_DAMPING)
        rows = active[accept]
        x[rows], y[rows], cost[rows] = tx[accept], ty[accept], trial[accept]
        for part, new in zip(near, ahead, strict=True):
            part[rows] = new[accept]
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

    def pick(self, rows: Ints) -> "_Contracted":
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
    by_both_x = along_x @ near.by_x @ tangent_x, np.swapaxes(mixed, -1, -2)
    hessian = np.block([[*by_both_x], [mixed, along_y @ near.by_y @ tangent_y]])
    by_x, by_y = along_x @ near.by_x @ x[..., None], along_y @ near.by_y @ y[..., None]
    gradient = np.concatenate([by_x, by_y], axis=1)
    diagonal = np.einsum("bii->bi", hessian)
    # free directions have no curvature: the floor bounds their steps
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


def _move(kind: Kind, e: Array, step: Array | float) -> Array:
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


@dataclass(frozen=True, eq=False)
class Minimum:
    """The lowest minimum over all starts.

    Parameters
    ----------
    value : the objective function, summed over the frames of K.
    object, environment : its elements, as arrays (package docstring).
    converged : number of starts from which the optimiser succeeded.
    """

    value: float
    object: Array
    environment: Array
    converged: int


def minimise_slsqp(
    contact: Contact, k: Array, rng: np.random.Generator, starts: int = 3, offset_m: float = 0.5
) -> Minimum:
    """Minimise ``(x (x) y).T K (x (x) y)`` under ``|n| = 1``, ``|d| = 1``, ``d . m = 0``.

    Parameters
    ----------
    k : (n, n), from ``matrix``.
    starts : number of random starts; in the paper 10 for one contact and 3 for each window.
    offset_m : standard deviation of the starts' offsets and points.
    """
    from scipy.optimize import minimize  # only here, as loading it takes time

    f = form(contact)
    size = SIZE[f.x]
    # A sum of 500 squares of metres is far above SLSQP's absolute tolerance; one frame's minimum is not.
    scale = 1.0 / max(float(np.trace(k)) / f.size, np.finfo(float).tiny)
    scaled, options = k * scale, {"maxiter": 500, "ftol": 1e-15}
    parts = {"fun": lambda z: _constraints(f, z)[0], "jac": lambda z: _constraints(f, z)[1]}
    settings = {"constraints": {"type": "eq", **parts}, "options": options}

    def objective(z: Array) -> tuple[float, Array]:
        x, y = z[:size], z[size:]
        v = np.kron(x, y)
        kv = scaled @ v
        slope = 2.0 * kv.reshape(size, -1)
        return float(v @ kv), np.concatenate([slope @ y, x @ slope])

    minima, converged = list[tuple[float, Array, Array]](), 0
    for _ in range(starts):
        z0 = np.concatenate(random_starts(contact, 1, rng, offset_m), axis=1)[0]
        result = minimize(objective, z0, jac=True, method="SLSQP", **settings)
        converged += int(result.success)
        # SLSQP meets the constraints to a tolerance only
        x, y = _move(f.x, result.x[None, :size], 0.0)[0], _move(f.y, result.x[None, size:], 0.0)[0]
        v = np.kron(x, y)
        minima.append((float(v @ k @ v), x, y))
    if not minima:
        raise ValueError("at least one start is needed")
    least, x, y = min(minima, key=lambda minimum: minimum[0])
    return Minimum(least, *f.factors(x, y), converged)


def _constraints(f: Form, z: Array) -> tuple[Array, Array]:
    """The constraints of both factors, zero if met, and their derivatives."""
    size = SIZE[f.x]
    (first, by_x), (second, by_y) = _constraint(f.x, z[:size]), _constraint(f.y, z[size:])
    return np.concatenate([first, second]), block_diag(by_x, by_y)


def _constraint(kind: Kind, e: Array) -> tuple[list[float], list[list[float]]]:
    length = float(e[:3] @ e[:3]) - 1.0
    match kind:
        case "plane":
            return [length], [[*(2.0 * e[:3]), 0.0]]
        case "line":
            return [length, float(e[:3] @ e[3:])], [[*(2.0 * e[:3]), 0.0, 0.0, 0.0], [*e[3:], *e[:3]]]
        case "point":
            return [e[3] - 1.0], [[0.0, 0.0, 0.0, 1.0]]
