"""The interface of a contact family: fit and evidence treat all contacts alike.

A contact pairs an element that is fixed in frame 1 with an element that is fixed in frame 2, for a pose that
maps frame 1 to frame 2. For f-f, e-f, v-f and e-e frame 1 is the body and frame 2 the world. The swapped
contacts (f-e, f-v) are the same families with the inverse pose, whose lift is a signed permutation of the
pose's lift: so there is one file per family, and ``ContactModel`` has ``body_in_1=False`` for a swapped
contact.

Elements are stacked in one parameter vector x (..., S); unit vectors stay on the sphere, so that only P <= S
directions are free (``tangent``). ``anchors`` (..., 6) are the positions of the body in frames 1 and 2, or of
a known point of a line (``refit.anchors_of``): a line is parametrised by its point nearest to the anchor, and
the prior of touching points has the size of the body's reach.
"""

from functools import cache
from typing import Final, NamedTuple, Protocol

import numpy as np

from contact_tracker.arrays import Array as Array
from contact_tracker.arrays import Bools, Ints
from contact_tracker.geometry.elements import Element
from contact_tracker.geometry.lifted_pose import TXR, R, T, U
from contact_tracker.geometry.linalg import EYE, dot, sphere_tangent, unit


class Form(NamedTuple):
    """Layout of x: the index of the first entry of the direction and point (or foot) of element 1, of the
    direction and foot of element 2, and of the offset of element 2; negative if there is no such parameter.

    A family takes from here what depends on the layout alone (described in ``Family``).
    """

    d1: int = -1
    q1: int = -1
    d2: int = -1
    q2: int = -1
    h: int = -1

    @property
    def elements(self) -> tuple[tuple[int, int, slice], ...]:
        """Of each element the indices of direction and point, and its part of the anchors."""
        return (self.d1, self.q1, slice(0, 3)), (self.d2, self.q2, slice(3, 6))

    @property
    def size(self) -> int:
        return max(self.h + 1, *(max(d, q) + 3 for d, q, _ in self.elements))

    @property
    def parameters(self) -> int:
        return len(_turns(self))

    @property
    def spread(self) -> Array:
        return (self.place(np.ones(6)) > 0.0).astype(float)

    def place(self, anchors: Array) -> Array:
        out = np.zeros((*anchors.shape[:-1], self.size))
        for _, q, span in self.elements:
            if q >= 0:
                out[..., q : q + 3] = anchors[..., span]
        return out

    def normalise(self, x: Array, anchors: Array) -> Array:
        out = np.array(x, float)
        for d, q, span in self.elements:
            if d >= 0:
                direction = out[..., d : d + 3] = unit(x[..., d : d + 3])
                if q >= 0:
                    arm = x[..., q : q + 3] - anchors[..., span]
                    out[..., q : q + 3] -= direction * dot(direction, arm)[..., None]
        return out

    def tangent(self, x: Array, anchors: Array) -> Array:
        out, end = np.zeros((*x.shape[:-1], self.size, self.parameters)), 0
        for d, q, span in self.elements:
            across = EYE
            if d >= 0:
                direction = x[..., d : d + 3]
                across = out[..., d : d + 3, end : end + 2] = sphere_tangent(direction)
                if q >= 0:  # as the line turns, its foot stays the point nearest to the anchor
                    along = (x[..., q : q + 3] - anchors[..., span])[..., None, :] @ across
                    out[..., q : q + 3, end : end + 2] = -direction[..., None] * along
                end += 2
            if q >= 0:
                out[..., q : q + 3, end : end + across.shape[-1]] = across
                end += across.shape[-1]
        if self.h >= 0:
            out[..., self.h, end] = 1.0
        return out


@cache
def directions(form: Form) -> Ints:
    """Indices of the entries of x that belong to unit vectors; the other entries are coordinates."""
    return np.array([d + i for d in (form.d1, form.d2) if d >= 0 for i in range(3)], np.int64)


@cache
def turns(form: Form) -> Ints:
    """Indices of the free directions (columns of ``Family.tangent``) that rotate an element."""
    return np.flatnonzero(_turns(form))


@cache
def shifts(form: Form) -> Ints:
    """Indices of the free directions that translate a point, line or face; rows are affine in them."""
    return np.flatnonzero(~_turns(form))


@cache
def _turns(form: Form) -> Bools:
    """Whether each free direction (P,) rotates an element."""
    free: list[bool] = []
    for d, q in ((form.d1, form.q1), (form.d2, form.q2)):
        free += [True] * 2 * (d >= 0) + [False] * (2 if d >= 0 else 3) * (q >= 0)
    return np.array(free + [False] * (form.h >= 0))


class Measurement(NamedTuple):
    """Residuals of B hypotheses in T ticks.

    ``residual`` (B, K, T): the K residuals, angles (rad) first and one distance (m) last.
    ``lever_sq`` (B, T): squared lever arm (m^2) with which an error of orientation enters the distance.
    ``reach_sq`` (B, T): squared distance (m^2) of the touching point from the body's origin.
    ``along`` (B, T or 1, 3): unit vectors in the world along which the distance is measured.
    """

    residual: Array
    lever_sq: Array
    reach_sq: Array
    along: Array


class Family(Protocol):
    """Members of the module of a family; functions broadcast over leading axes of x. Moments are sums over at
    least one pose."""

    SIZE: int
    """S, length of x."""
    PARAMETERS: int
    """P, free directions of x."""
    ROWS: int
    """K, residuals per pose (the codimension); all but the last are angles."""
    COLUMNS: Ints
    """The C entries of zeta on which the residuals depend."""
    SPREAD: Array
    """(S,) 1 for coordinates of a point, which has a prior near the body; else 0."""

    FORM: Form
    """Layout of x. Rows are affine in all entries of x that are not directions; the columns of ``tangent``
    are in the order of ``turns`` and ``shifts``."""
    RANDOM_STARTS: int
    """Number of random directions that a search screens: more for narrow minima."""

    def rows(self, x: Array) -> Array:
        """Coefficients c (..., K, C) with ``residual = c @ zeta[COLUMNS]``."""

    def rows_derivative(self, x: Array) -> Array:
        """Derivative of ``rows`` by x, (..., K, S, C)."""

    def scale_sq(self, x: Array, moments: Array) -> Array:
        """Mean square (...) of the last row's change per metre of distance, over moments (..., C, C)."""

    def log_scale_sq_derivative(self, x: Array, moments: Array) -> Array:
        """Derivative (..., S) of the logarithm of ``scale_sq`` by x."""

    def tangent(self, x: Array, anchors: Array) -> Array:
        """Free directions of x, (..., S, P)."""

    def normalise(self, x: Array, anchors: Array) -> Array:
        """x with directions of length 1 and points of lines nearest to ``anchors`` (..., 6)."""

    def place(self, anchors: Array) -> Array:
        """Mean (..., S) of a prior: points and lines are at ``anchors`` (..., 6), other entries zero."""

    def starts(self, moments: Array) -> Array:
        """Starts of a search (B, N, S): relaxed solutions from moments (B, C, C), with points at zero."""

    def measure(self, x: Array, frames: "Frames") -> Measurement:
        """Exact residuals and lever arms of hypotheses x (B, S) on T poses."""

    def elements(self, x: Array, covariance: Array, reach_m: float) -> tuple[Element, Element]:
        """The elements in frame 1 and frame 2 for x (S,) with its covariance (S, S)."""


def constant_scale_sq(x: Array, moments: Array) -> Array:
    """``Family.scale_sq`` of residuals that are distances."""
    return np.ones(x.shape[:-1])


def constant_log_scale_sq_derivative(x: Array, moments: Array) -> Array:
    return np.zeros_like(x)


RIDGE: Final = 1e-6
"""Ridge of relaxed problems, relative to the moments' trace, against unobserved directions."""


def smallest_directions(moments: Array, keep: slice) -> Array:
    """Solutions (..., k, k) of a relaxed problem, in columns, in order of their minima.

    Minimises ``c M c`` over coefficients c (..., C) with unit length in the k entries ``keep``, which are
    returned; the other entries are eliminated (Schur complement with a ridge).
    """
    kept, eliminated = _kept_and_eliminated(moments.shape[-1], keep.start, keep.stop)
    scale = RIDGE * moments.trace(axis1=-2, axis2=-1)[..., None, None]
    inner = moments[..., eliminated[:, None], eliminated] + scale * np.eye(len(eliminated))
    coupling = -np.linalg.solve(inner, moments[..., eliminated[:, None], kept])
    schur = moments[..., kept[:, None], kept] + moments[..., kept[:, None], eliminated] @ coupling
    return np.asarray(np.linalg.eigh(0.5 * (schur + np.swapaxes(schur, -1, -2)))[1])


@cache
def _kept_and_eliminated(count: int, start: int, stop: int) -> tuple[Ints, Ints]:
    """Indices from ``start`` to before ``stop``, and all others below ``count``."""
    every = np.arange(count)
    return every[start:stop], np.delete(every, np.s_[start:stop])


def outer(a: Array, b: Array) -> Array:
    """vec(a b^T) (..., 9), row-major: the coefficients of ``a . R b`` on ``vec R``."""
    product = a[..., :, None] * b[..., None, :]
    return np.asarray(product.reshape(*product.shape[:-2], 9))


def outer_derivative_first(b: Array) -> Array:
    """Derivative (..., 3, 9) of ``outer(a, b)`` by a."""
    return np.asarray((EYE[:, :, None] * b[..., None, None, :]).reshape(*b.shape[:-1], 3, 9))


def outer_derivative_second(a: Array) -> Array:
    """Derivative (..., 3, 9) of ``outer(a, b)`` by b."""
    return np.asarray((a[..., None, :, None] * EYE[:, None, :]).reshape(*a.shape[:-1], 3, 9))


class Frames(NamedTuple):
    """T lifted poses of frame 1 in frame 2, split into the parts that the families read."""

    rotation: Array  # (T, 9)
    t: Array  # (T, 3)
    u: Array  # (T, 3)
    t_cross_r: Array  # (T, 9)
    body_in_1: bool
    """Whether frame 1 is the body; else it is the world, and the poses are inverse ones."""

    @classmethod
    def of(cls, zeta: Array, body_in_1: bool) -> "Frames":
        return cls(zeta[:, R], zeta[:, T], zeta[:, U], zeta[:, TXR], body_in_1)

    @property
    def body_origin(self) -> Array:
        """The body's origin in frame 1, (T, 3)."""
        return np.zeros_like(self.u) if self.body_in_1 else -self.u

    def in_world(self, n: Array) -> Array:
        """Directions n (B, 3) of frame 2 in the world, (B, T or 1, 3)."""
        if self.body_in_1:
            return n[:, None, :]
        return np.asarray(n @ self.rotation.reshape(-1, 3, 3)).swapaxes(0, 1)
