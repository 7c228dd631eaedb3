"""Search for the elements of a further contact from moments of the ticks (docs/theory.md, T36).

Residuals of a further contact are as small as the noise, although motion that keeps the known contacts could
make them large; those that the known contacts imply are not. Squared residual, noise and free motion are
quadratic forms of the residual's coefficients.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.contacts.family import turns
from contact_tracker.formations.conditional import ConditionalMotion
from contact_tracker.geometry.linalg import adapted
from contact_tracker.geometry.vectors import unit
from contact_tracker.hypotheses import compiled, gauss_newton
from contact_tracker.hypotheses.evidence import weak_prior
from contact_tracker.hypotheses.gauss_newton import Prior
from contact_tracker.hypotheses.global_search import directions
from contact_tracker.motion.lifted_pose import R, T
from contact_tracker.motion.window import Window
from contact_tracker.states import Contact

Array = NDArray[np.float64]

MIN_RATIO: Final = 2.0
"""Least ratio of free motion to squared residual for a constraint to be kept; every contact has at least one
such row."""
RELAXED: Final = tuple(CONTACT_MODELS[c.column] for c in (Contact.VF, Contact.FV, Contact.EE))
"""Contact kinds of single constraints: every contact keeps at least one of them."""
NOISE_SHARE: Final = 0.1
LEAST_NORMAL: Final = 1e-9
RIDGE: Final = 1e-9
ROUNDING: Final = 1e-14
"""Accuracy of the sums of squares, relative to their trace."""
FOLLOWED_STARTS: Final = 12
ROUNDS: Final = ((4, 5), (10, 2))
"""Numbers of descent steps, and of the best starts that continue after them."""
FIRST_DAMPING: Final = 1.0
TINY: Final = 1e-12
LEAST_CURVATURE: Final = 1e-9
DAMPED_SHARE: Final = 1e-3
"""The damping of all directions, as a share of their curvature; turns are damped by 1 beyond it."""
RELAXED_STARTS: Final = 2
DRAWS: Final = 7
"""Seed of the random directions."""


class Moments(NamedTuple):
    """Mean second moments (C, C) of a contact's lifted poses over some ticks, scaled by position noise.

    ``square`` of the measurement, ``free`` of the motion in a tick that the known contacts allow, ``noise``
    of the measurement noise.
    """

    square: Array
    free: Array
    noise: Array
    ticks: int


def moments(model: ContactModel, motion: ConditionalMotion) -> Moments:
    """Moments of the ticks of ``motion``."""
    weight = 1.0 / motion.noise_sd[:, 3:4]
    square = model.lifted(motion.new) * weight
    moved = np.swapaxes(motion.free, 1, 2) @ motion.moved
    free = (model.lifted(moved) * weight[:, None]).reshape(-1, square.shape[1])
    noise = (model.lifted(motion.moved * motion.noise_sd[:, :, None]) * weight[:, None]).reshape(
        -1, square.shape[1]
    )
    count = len(motion)
    return Moments(square.T @ square / count, free.T @ free / count, noise.T @ noise / count, count)


def relaxed_ratio(of: Moments) -> float:
    """The largest ratio of free motion to squared residual over all coefficients: an upper bound for
    contacts, up to noise."""
    lower, free = _whitened(of)
    return float(np.linalg.eigvalsh(_congruent(lower, free))[-1])


def relaxed_starts(model: ContactModel, of: Moments, x: Array) -> Array:
    """Starting points: directions from the relaxed problem, other coordinates from x (B, S)."""
    lower, free = _whitened(of)
    scale = np.sqrt(of.noise.diagonal() + RIDGE * of.noise.trace())
    vectors = np.linalg.eigh(_congruent(lower, free))[1][:, : -1 - RELAXED_STARTS : -1]
    c = (np.linalg.solve(lower.T, vectors) / scale[:, None]).T
    form, starts = model.family.FORM, []
    for one in c:
        start = np.array(x)
        if form.h < 0:
            left, _, right = np.linalg.svd(one[9:18].reshape(3, 3))
            start = start[:1]
            start[:, form.d1 : form.d1 + 3], start[:, form.d2 : form.d2 + 3] = right[0], left[:, 0]
        else:
            if not np.linalg.norm(one[9:12]) > LEAST_NORMAL * np.linalg.norm(one):
                continue  # no plane
            normal = unit(one[9:12])
            start[:, form.d2 : form.d2 + 3] = normal
            if model.contact is Contact.FF:
                rotation = of.square[:9, 12].reshape(3, 3)
                start = start[:1]
                start[:, form.d1 : form.d1 + 3] = unit(normal @ rotation)
        starts.append(start)
    return np.concatenate([x[:0], *starts])


def _whitened(of: Moments) -> tuple[Array, Array]:
    """The Cholesky factor of the regularised squares, and the free motion, both whitened by the noise."""
    scale = np.sqrt(of.noise.diagonal() + RIDGE * of.noise.trace())
    outer = scale[:, None] * scale
    lift = ROUNDING * of.square.trace()
    square = (of.square + NOISE_SHARE * of.noise + lift * np.eye(len(scale))) / outer
    square += RIDGE * np.trace(of.noise / outer) * np.eye(len(square))
    return np.linalg.cholesky(square), of.free / outer


def _congruent(lower: Array, matrix: Array) -> Array:
    half = np.linalg.solve(lower, matrix)
    return np.asarray(np.linalg.solve(lower, half.T))


def search(model: ContactModel, motion: ConditionalMotion, window: Window, reach_m: float) -> Array:
    """The elements x (S,) of ``model`` with the least cost in the ticks of ``motion``, which are those of
    ``window``."""
    family = model.family
    anchors = model.anchors(window.zeta[:, T].mean(axis=0))[None]
    prior = weak_prior(family, anchors, reach_m)
    of = moments(model, motion)
    problem = Problem(model, of, np.array(of[:3])[:, None], prior, anchors, reach_m)
    turn = window.zeta[-1, R].reshape(3, 3)
    x = model.turned(directions(model, DRAWS), turn)
    x = problem.complete(np.concatenate([x, relaxed_starts(model, problem.of, x)]))
    x = x[np.argsort(problem.ratio(x), kind="stable")[:FOLLOWED_STARTS]]
    for steps, kept in ROUNDS:
        x = problem.descend(x, steps)
        x = x[np.argsort(problem.ratio(x), kind="stable")[:kept]]
    return np.asarray(x[np.argmin(problem.cost(x))])


class Problem(NamedTuple):
    """Cost of one contact: half the squared residuals over noise, less the log of what free motion allows."""

    model: ContactModel
    of: Moments
    matrices: Array
    """(3, 1, C, C) those of the moments."""
    prior: Prior
    """Of one hypothesis: the same for all."""
    anchors: Array
    reach_m: float

    def cost(self, x: Array) -> Array:
        """(B,) nats at x (B, S)."""
        square, free, noise = self._forms(self.model.family.rows(x))
        terms = square / noise - np.log1p(free / noise)
        return np.asarray(0.5 * self.of.ticks * terms.sum(axis=1) + self.prior.cost(x))

    def ratio(self, x: Array) -> Array:
        """(B,) squared residual over that of free motion; large for constraints that are implied."""
        square, free, noise = self._forms(self.model.family.rows(x))
        return np.asarray((square / noise).sum(axis=1) / (free / noise).sum(axis=1))

    def complete(self, x: Array) -> Array:
        """x (B, S) with the other coordinates at their minimum, given its directions."""
        count = len(x)
        return gauss_newton.complete(
            self.model.family,
            np.broadcast_to(self.of.square, (count, *self.of.square.shape)) * self.of.ticks,
            np.ones((count, self.model.family.ROWS)),
            self.prior.pick(np.zeros(count, np.int64)),
            self.anchors.repeat(count, axis=0),
            x,
        )[0]

    def descend(self, x: Array, steps: int) -> Array:
        """The result of ``steps`` damped Gauss-Newton steps from x (B, S)."""
        if not compiled.in_use():
            return self.descend_reference(x, steps)
        from contact_tracker.hypotheses.compiled import calls

        limits = FIRST_DAMPING, TINY, LEAST_CURVATURE, DAMPED_SHARE
        model = calls.model_of(self.model, self.reach_m)
        return calls.descend(model, self.matrices[:, 0], self.of.ticks, self.anchors[0], x, steps, limits)

    def descend_reference(self, x: Array, steps: int) -> Array:
        """``descend`` in numpy: the reference of the compiled kernel."""
        family, anchors = self.model.family, self.anchors.repeat(len(x), axis=0)
        cost, damping = self.cost(x), np.full(len(x), FIRST_DAMPING)
        for _ in range(steps):
            tangent, gradient, hessian = self._normal(x, anchors)
            diagonal = np.einsum("bii->bi", hessian)
            turning = turns(family.FORM)
            diagonal += LEAST_CURVATURE + DAMPED_SHARE * damping[:, None] * diagonal
            diagonal[:, turning] += damping[:, None]
            step = -np.linalg.solve(hessian, gradient[..., None])
            there = family.normalise(x + (tangent @ step)[..., 0], anchors)
            then = self.cost(there)
            better = then < cost
            x, cost = np.where(better[:, None], there, x), np.where(better, then, cost)
            damping = adapted(damping, better)
        return x

    def _normal(self, x: Array, anchors: Array) -> tuple[Array, Array, Array]:
        family, prior = self.model.family, self.prior
        tangent, c = family.tangent(x, anchors), family.rows(x)
        along = np.swapaxes(tangent, -1, -2)
        slopes = along[:, None] @ family.rows_derivative(x)  # (B, K, P, C)
        square, free, noise = self._forms(c)
        # half the derivative of each form
        d_square, d_free, d_noise = (slopes @ self.matrices[:, None] @ c[..., None])[..., 0]
        pull = (
            d_square / noise[..., None]
            - (square / noise**2)[..., None] * d_noise
            - (d_free + d_noise) / (free + noise)[..., None]
            + d_noise / noise[..., None]
        )
        ticks = self.of.ticks
        curvature = (slopes / noise[..., None, None]) @ self.of.square @ np.swapaxes(slopes, -1, -2)
        gradient = ticks * pull.sum(axis=1) + (along @ prior.gradient(x)[..., None])[..., 0]
        hessian = ticks * curvature.sum(axis=1) + along @ prior.precision @ tangent
        return tangent, gradient, hessian

    def _forms(self, c: Array) -> Array:
        """(3, B, K) the quadratic forms of c (B, K, C): squared residual, free motion and noise."""
        return np.asarray(np.maximum(((c @ self.matrices) * c).sum(axis=-1), TINY))
