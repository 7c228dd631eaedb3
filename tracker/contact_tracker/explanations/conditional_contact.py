"""Evidence for a further contact, given the contacts that are known already (docs/theory.md, T35), and the
search for its elements by moments of the ticks (T36).

Constraints that the known contacts imply hold anyway and are no evidence for a further one. The residuals of
a further contact are as small as the noise, although motion that keeps the known contacts could make them
large. Squared residual, noise and free motion are quadratic forms of the residual's coefficients.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import log
from typing import Final, NamedTuple, Self

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.contacts.family import turns
from contact_tracker.geometry import lifted_pose, linalg
from contact_tracker.geometry.lifted_pose import R, T
from contact_tracker.geometry.linalg import adapted, unit
from contact_tracker.hypotheses import compiled, gauss_newton
from contact_tracker.hypotheses.evidence import EvidenceParameters, weak_prior
from contact_tracker.hypotheses.gauss_newton import Prior
from contact_tracker.hypotheses.global_search import directions
from contact_tracker.motion.window import LEVERS_M, Window
from contact_tracker.states import Contact

SAME_ROW: Final = 0.05
"""Unit gradients of constraints that differ by less count as one constraint."""
JITTER: Final = 1e-9
TINY: Final = 1e-30
_MOVES: Final = lifted_pose.perturbations()


def coefficients(model: ContactModel, x: Array) -> Array:
    """Coefficients (..., K, 25) of a contact's residuals in terms of the whole lifted pose, at x (..., S)."""
    return np.asarray(model.family.rows(x) @ _every(model))


@cache
def _every(model: ContactModel) -> Array:
    return np.asarray(model.lifted(np.eye(lifted_pose.SIZE)).T)


class ConditionalEvidence(NamedTuple):
    """Evidence (nats) of W ticks for a further contact against motion without it."""

    log_ratio: Array
    """(W,)"""
    gain: Array
    """(W,) log ratio for zero residuals."""
    chi_sq: Array
    """(W,) mean square of the residuals over their noise."""


@dataclass(frozen=True, eq=False)
class ConditionalMotion:
    """W ticks in which an object keeps some contacts, and the motion that these allow.

    Parameters
    ----------
    new : (W, 25) lifted poses; of correlated errors only the innovation (T34).
    moved : (W, 6, 25) their derivatives, see ``perturbed``.
    noise_sd : (W, 6) measurement noise of a tick in these directions (rad, m).
    excess_sd : (W, 6) unpredictable part of the motion in these directions (rad, m).
    free : (W, 6, 6) factors F: motion that keeps the contacts has the covariance F F^T in a tick.
    """

    new: Array
    moved: Array
    noise_sd: Array
    excess_sd: Array
    free: Array

    @classmethod
    def of(cls, window: Window, scales: EvidenceParameters) -> Self:
        """Ticks in which no contact is kept."""
        zeta, new = window.zeta, scales.innovations(window.zeta, window.before)
        excess_sd = np.sqrt(window.innovation_excess[:, lifted_pose.NOISE_OF_PERTURBATION])
        free = excess_sd[:, :, None] * np.eye(6)
        noise_sd = np.sqrt(window.variance[:, lifted_pose.NOISE_OF_PERTURBATION])
        return cls(new, perturbed(zeta), noise_sd, excess_sd, free)

    def keeping(self, c: Array, first: int = 0, end: int | None = None) -> "ConditionalMotion":
        """The motion with the constraints c (K, 25) kept as well in ticks ``first`` to ``end`` (excluded)."""
        span = slice(first, end)
        gradient = self.gradients(c)[span]
        length = np.linalg.norm(gradient * self.excess_sd[span, None], axis=2, keepdims=True)
        rows = gradient @ self.free[span] / (length + TINY)
        _, values, axes = np.linalg.svd(rows, full_matrices=False)
        pinned = axes * (values > SAME_ROW)[:, :, None]
        free = self.free.copy()
        free[span] -= free[span] @ np.swapaxes(pinned, 1, 2) @ pinned
        return replace(self, free=free)

    def cut(self, first: int, end: int) -> "ConditionalMotion":
        """Ticks ``first`` to ``end`` (excluded)."""
        return ConditionalMotion(*(column[first:end] for column in vars(self).values()))

    def __len__(self) -> int:
        return len(self.new)

    def gradients(self, c: Array) -> Array:
        """Derivatives (W, K, 6) of residuals c (K, 25) by the pose."""
        return np.asarray(np.swapaxes(self.moved @ c.T, 1, 2))

    def evidence(self, c: Array) -> ConditionalEvidence:
        """Evidence of each tick for a contact with the constraints c (K, 25)."""
        gradient, residual = self.gradients(c), self.new @ c.T
        noise, free = gradient * self.noise_sd[:, None], gradient @ self.free
        scale = np.sqrt(np.square(noise).sum(axis=2)) + TINY  # makes the result independent of a row's units
        noise, free, residual = noise / scale[..., None], free / scale[..., None], residual / scale
        noise_cov = noise @ np.swapaxes(noise, 1, 2) + JITTER * np.eye(len(c))
        loose = noise_cov + free @ np.swapaxes(free, 1, 2)
        gain = 0.5 * (np.linalg.slogdet(loose)[1] - np.linalg.slogdet(noise_cov)[1])
        pull = np.linalg.solve(noise_cov, residual[..., None]) - np.linalg.solve(loose, residual[..., None])
        misfit = 0.5 * (residual * pull[..., 0]).sum(axis=1)
        return ConditionalEvidence(gain - misfit, gain, np.square(residual).mean(axis=1))


def perturbed(zeta: Array) -> Array:
    """Derivatives (W, 6, 25) of lifted poses (W, 25) by rotation about the body's axes and translation along
    the world's."""
    return (zeta @ _MOVES.reshape(-1, lifted_pose.SIZE).T).reshape(len(zeta), 6, lifted_pose.SIZE)


def count_constraints(moved: Array, contacts: Sequence[Array]) -> int:
    """Number of independent constraints that contacts c (K, 25) impose together: the median over ticks with
    derivatives ``moved`` (W, 6, 25), see ``perturbed``."""
    rows = np.swapaxes(moved @ np.concatenate(contacts).T, 1, 2) * LEVERS_M
    rows /= np.linalg.norm(rows, axis=2, keepdims=True) + TINY
    return int(linalg.median((np.linalg.svd(rows, compute_uv=False) > SAME_ROW).sum(axis=1)))


AT_FIRST: Final = 0.1
"""Probability that a further contact is present when the first one begins."""


class Run(NamedTuple):
    """Ticks ``first`` to ``end`` (excluded) in which a contact holds."""

    first: int
    end: int

    def overlaps(self, run: "Run") -> bool:
        """Whether the runs share a tick."""
        return self.first < run.end and run.first < self.end


class Presence(NamedTuple):
    """The most probable ``runs``, and their log odds (nats) against no run."""

    runs: tuple[Run, ...]
    log_odds: float


def most_probable(log_ratio: Array, log_change: Array) -> Presence:
    """Viterbi path over the states absent and present.

    Parameters
    ----------
    log_ratio : (W,) evidence of each tick for the contact.
    log_change : (W,) log probability that it begins or ends right before a tick.
    """
    absent, present = log(1.0 - AT_FIRST), log(AT_FIRST)
    came_from_present, came_from_absent = [], []  # predecessors of absent, of present
    stays = np.log1p(-np.exp(log_change)).tolist()
    never = absent + float(np.sum(stays[1:]))
    for tick, (ratio, change, stay) in enumerate(
        zip(log_ratio.tolist(), log_change.tolist(), stays, strict=True)
    ):
        ends = joined = False
        if tick:
            ends, joined = present + change > absent + stay, absent + change > present + stay
            was_absent, was_present = absent, present
            absent = was_present + change if ends else was_absent + stay
            present = was_absent + change if joined else was_present + stay
        present += ratio
        came_from_present.append(ends)
        came_from_absent.append(joined)
    is_present, runs, end = present >= absent, list[Run](), len(came_from_present)
    for tick in range(end - 1, -1, -1):  # back along the path
        if is_present and came_from_absent[tick]:
            runs.append(Run(tick, end))
            is_present = False
        elif not is_present and came_from_present[tick]:
            end, is_present = tick, True
    if is_present:
        runs.append(Run(0, end))
    return Presence(tuple(reversed(runs)), max(absent, present) - never)


MIN_RATIO: Final = 2.0
"""Least ratio of free motion to squared residual for a constraint to be kept; at least one row of every
contact has it."""
RELAXED: Final = tuple(CONTACT_MODELS[c.column] for c in (Contact.VF, Contact.FV, Contact.EE))
"""Contact kinds of single constraints: every contact implies at least one of them."""
NOISE_SHARE: Final = 0.1
LEAST_NORMAL: Final = 1e-9
RIDGE: Final = 1e-9
ROUNDING: Final = 1e-14
"""Accuracy of the sums of squares, relative to their trace."""
FOLLOWED_STARTS: Final = 12
ROUNDS: Final = ((4, 5), (10, 2))
"""Numbers of descent steps, and of the best starts that continue after them."""
FIRST_DAMPING: Final = 1.0
LEAST_SQUARE: Final = 1e-12
LEAST_CURVATURE: Final = 1e-9
DAMPED_SHARE: Final = 1e-3
"""Damping of all directions, as a share of their curvature; turns have an additional damping of 1."""
RELAXED_STARTS: Final = 2
DRAWS: Final = 7
"""Seed of the random directions."""


class Moments(NamedTuple):
    """Mean second moments (C, C) of a contact's lifted poses over ``ticks``, scaled by position noise.

    ``square``: of the measurement; ``free``: of the motion in a tick that the known contacts allow;
    ``noise``: of the measurement noise.
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
    noise = model.lifted(motion.moved * motion.noise_sd[:, :, None]) * weight[:, None]
    noise, count = noise.reshape(free.shape[0], -1), len(motion)
    return Moments(square.T @ square / count, free.T @ free / count, noise.T @ noise / count, count)


def relaxed_ratio(sums: Moments) -> float:
    """Largest ratio of free motion to squared residual over all coefficients: up to noise, an upper bound for
    contacts."""
    return float(np.linalg.eigvalsh(_congruent(*_whitened(sums)))[-1])


def relaxed_starts(model: ContactModel, sums: Moments, x: Array) -> Array:
    """Starting points: directions from the relaxed problem, other coordinates from x (B, S)."""
    lower, free = _whitened(sums)
    scale = np.sqrt(sums.noise.diagonal() + RIDGE * sums.noise.trace())
    vectors = np.linalg.eigh(_congruent(lower, free))[1][:, : -1 - RELAXED_STARTS : -1]
    c = (np.linalg.solve(lower.T, vectors) / scale[:, None]).T
    form, starts = model.family.FORM, []
    for row in c:
        start = np.array(x)
        if form.h < 0:
            world_axes, _, right = np.linalg.svd(row[9:18].reshape(3, 3))
            start = start[:1]
            start[:, form.d1 : form.d1 + 3], start[:, form.d2 : form.d2 + 3] = right[0], world_axes[:, 0]
        else:
            if not np.linalg.norm(row[9:12]) > LEAST_NORMAL * np.linalg.norm(row):
                continue  # no plane
            normal = unit(row[9:12])
            start[:, form.d2 : form.d2 + 3] = normal
            if model.contact is Contact.FF:
                rotation = sums.square[:9, 12].reshape(3, 3)
                start = start[:1]
                start[:, form.d1 : form.d1 + 3] = unit(normal @ rotation)
        starts.append(start)
    return np.concatenate([x[:0], *starts])


def _whitened(sums: Moments) -> tuple[Array, Array]:
    """The Cholesky factor of the regularised squares, and the free motion, both whitened by the noise."""
    scale = np.sqrt(sums.noise.diagonal() + RIDGE * sums.noise.trace())
    outer = scale[:, None] * scale
    lift = ROUNDING * sums.square.trace()
    square = (sums.square + NOISE_SHARE * sums.noise + lift * np.eye(len(scale))) / outer
    square += RIDGE * np.trace(sums.noise / outer) * np.eye(len(square))
    return np.linalg.cholesky(square), sums.free / outer


def _congruent(lower: Array, matrix: Array) -> Array:
    half = np.linalg.solve(lower, matrix)
    return np.asarray(np.linalg.solve(lower, half.T))


def search(model: ContactModel, motion: ConditionalMotion, window: Window, reach_m: float) -> Array:
    """The elements x (S,) of ``model`` with the least cost in the ticks of ``motion`` and ``window``."""
    family = model.family
    anchors = model.anchors(window.zeta[:, T].mean(axis=0))[None]
    prior = weak_prior(family, anchors, reach_m)
    sums = moments(model, motion)
    problem = Problem(model, sums, np.array(sums[:3])[:, None], prior, anchors, reach_m)
    turn = window.zeta[-1, R].reshape(3, 3)
    x = model.turned(directions(model, DRAWS), turn)
    x = problem.complete(np.concatenate([x, relaxed_starts(model, problem.of, x)]))
    x = x[np.argsort(problem.ratio(x), kind="stable")[:FOLLOWED_STARTS]]
    for steps, count in ROUNDS:
        x = problem.descend(x, steps)
        x = x[np.argsort(problem.ratio(x), kind="stable")[:count]]
    return np.asarray(x[np.argmin(problem.cost(x))])


class Problem(NamedTuple):
    """Cost of one contact: half the squared residuals over noise, less the log of free motion over noise."""

    model: ContactModel
    of: Moments
    matrices: Array
    """(3, 1, C, C) the moments ``square``, ``free`` and ``noise``."""
    prior: Prior
    """Prior of one hypothesis, the same for all."""
    anchors: Array
    reach_m: float

    def cost(self, x: Array) -> Array:
        """Cost (B,) in nats at x (B, S)."""
        square, free, noise = self._forms(self.model.family.rows(x))
        terms = square / noise - np.log1p(free / noise)
        return np.asarray(0.5 * self.of.ticks * terms.sum(axis=1) + self.prior.cost(x))

    def ratio(self, x: Array) -> Array:
        """Squared residual over free motion (B,) at x (B, S); large for implied constraints."""
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

        limits = FIRST_DAMPING, LEAST_SQUARE, LEAST_CURVATURE, DAMPED_SHARE
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
            moved = family.normalise(x + (tangent @ step)[..., 0], anchors)
            moved_cost = self.cost(moved)
            better = moved_cost < cost
            x, cost = np.where(better[:, None], moved, x), np.where(better, moved_cost, cost)
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
        """Quadratic forms (3, B, K) of c (B, K, C): squared residual, free motion and noise."""
        return np.asarray(np.maximum(((c @ self.matrices) * c).sum(axis=-1), LEAST_SQUARE))
