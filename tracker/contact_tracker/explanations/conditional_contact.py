"""Evidence for a further contact, given the contacts that are known already (docs/theory.md, T35), and the
search for its elements by moments of the ticks (T36).

Constraints that the known contacts imply hold anyway and are no evidence for a further one. The residuals of
a further contact are as small as the noise, although motion that keeps the known contacts could make them
large. Squared residual, noise and free motion are quadratic forms of the residual's coefficients.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from math import log
from typing import Final, NamedTuple, Self

import numpy as np
from scipy.linalg import eigh

from contact_tracker.arrays import Array
from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.contacts.family import turns
from contact_tracker.geometry import lifted_pose, linalg
from contact_tracker.geometry.elements import Origins
from contact_tracker.geometry.lifted_pose import R, T
from contact_tracker.geometry.linalg import adapted, unit
from contact_tracker.hypotheses import gauss_newton
from contact_tracker.hypotheses.evidence import EvidenceParameters, weak_prior
from contact_tracker.hypotheses.gauss_newton import Prior
from contact_tracker.hypotheses.global_search import directions
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.window import LEVERS_M, Window
from contact_tracker.states import CONTACTS, Contact

SAME_ROW: Final = 0.05
"""Unit gradients of constraints that differ by less count as one constraint."""
JITTER: Final = 1e-9
TINY: Final = 1e-30
_MOVES: Final = lifted_pose.perturbations()


@dataclass(frozen=True, eq=False)
class KnownContact:
    """A contact and the parameters x (S,) of its elements."""

    contact: Contact
    x: Array

    @property
    def model(self) -> ContactModel:
        """Its model."""
        return CONTACT_MODELS[self.contact.column]

    @cached_property
    def c(self) -> Array:
        """Coefficients (K, 25) of its constraints in terms of the whole lifted pose."""
        return np.asarray(self.model.family.rows(self.x) @ _every(self.model))


@cache
def _every(model: ContactModel) -> Array:
    return np.asarray(model.lifted(np.eye(lifted_pose.SIZE)).T)


@dataclass(frozen=True, eq=False)
class ExplainedTicks:
    """The ticks of a segment, and the parameters of what may explain their motion.

    Parameters
    ----------
    leave_per_s : rate at which contacts end.
    origins : of the ticks' coordinates.
    systematic : errors of the poses that are not noise.
    """

    window: Window
    scales: EvidenceParameters
    systematic: SystematicErrors = field(default_factory=SystematicErrors)
    leave_per_s: float = 0.0
    origins: Origins = field(default_factory=Origins.zero)
    known_map: Map = EMPTY_MAP

    def __len__(self) -> int:
        return len(self.window)

    def cut(self, first: int, end: int | None = None) -> Self:
        """Ticks ``first`` to ``end`` (excluded)."""
        return replace(self, window=self.window.cut(first, end))

    @cached_property
    def noise_sd(self) -> Array:
        """(W, 6) measurement noise of turns about the body's axes and shifts along the world's (rad, m)."""
        return np.sqrt(self.window.variance[:, lifted_pose.NOISE_OF_PERTURBATION])

    def numbered(self, run: "Run") -> "Run":
        """A run of rows, by the numbers of ticks."""
        return Run(int(self.window.index[run.first]), int(self.window.index[run.end - 1]) + 1)

    @property
    def kinds(self) -> tuple[Contact, ...]:
        """Contact kinds that the map allows."""
        return tuple(filter(self.known_map.allows, CONTACTS))

    @property
    def log_change(self) -> Array:
        """(W,) log probability that a contact begins or ends before each tick; zero motion allows hardly
        any."""
        moved = self.window.motion_ratio * (self.leave_per_s * self.scales.tick_s)
        return np.asarray(np.log(-np.expm1(-np.maximum(moved, 1e-4))))


def noise_factors(noise: Array) -> Array:
    """Cholesky factors (W, K, K) of the covariance of residuals, of which ``noise`` (W, K, D) are derivatives
    by standard errors; residuals may depend on each other, and have any units."""
    scale = np.linalg.norm(noise, axis=2, keepdims=True) + TINY
    unit_rows = noise / scale
    square = unit_rows @ np.swapaxes(unit_rows, 1, 2) + JITTER * np.eye(noise.shape[1])
    return np.asarray(scale * np.linalg.cholesky(square))


def against_free(lower: Array, residual: Array, free: Array) -> tuple[Array, Array, Array]:
    """Residuals (W, K) of unit variance; half the log ratio (W,) of the determinants of their covariances in
    free motion and by noise; and their quadratic form (W,) in free motion.

    Parameters
    ----------
    lower : (W, K, K) as from ``noise_factors``.
    free : (W, K, D) derivatives of the residuals by standard deviations of free motion.
    """
    white: Array = np.linalg.solve(lower, residual[..., None]).astype(float)
    moved: Array = np.linalg.solve(lower, free).astype(float)
    loose = np.eye(residual.shape[1]) + moved @ np.swapaxes(moved, 1, 2)
    form = (white * np.linalg.solve(loose, white))[..., 0].sum(axis=1)
    return white[..., 0], np.asarray(0.5 * np.linalg.slogdet(loose)[1]), np.asarray(form)


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
    excess_sd : (W, 6) unpredictable part of the motion in these directions (rad, m).
    free : (W, 6, 6) factors F: motion that keeps the contacts has the covariance F F^T in a tick.
    """

    ticks: ExplainedTicks
    new: Array
    moved: Array
    excess_sd: Array
    free: Array

    @classmethod
    def of(cls, ticks: ExplainedTicks) -> Self:
        """Ticks in which no contact is kept."""
        window = ticks.window
        excess_sd = np.sqrt(window.innovation_excess[:, lifted_pose.NOISE_OF_PERTURBATION])
        new = ticks.scales.innovations(window.zeta, window.before)
        return cls(ticks, new, perturbed(window.zeta), excess_sd, excess_sd[:, :, None] * np.eye(6))

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
        columns = (column[first:end] for column in (self.new, self.moved, self.excess_sd, self.free))
        return ConditionalMotion(self.ticks.cut(first, end), *columns)

    def __len__(self) -> int:
        return len(self.new)

    def gradients(self, c: Array) -> Array:
        """Derivatives (W, K, 6) of residuals c (K, 25) by the pose."""
        return np.asarray(np.swapaxes(self.moved @ c.T, 1, 2))

    def evidence(self, c: Array) -> ConditionalEvidence:
        """Evidence of each tick for a contact with the constraints c (K, 25)."""
        gradient = self.gradients(c)
        lower = noise_factors(gradient * self.ticks.noise_sd[:, None])
        white, gain, free_form = against_free(lower, self.new @ c.T, gradient @ self.free)
        square = np.square(white)
        return ConditionalEvidence(gain - 0.5 * (square.sum(axis=1) - free_form), gain, square.mean(axis=1))


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
    log_stay = np.log1p(-np.exp(log_change))
    absent, present, before = log(1.0 - AT_FIRST), log(AT_FIRST) + float(log_ratio[0]), []
    never = absent + float(np.sum(log_stay[1:]))
    ticks = log_ratio[1:].tolist(), log_change[1:].tolist(), log_stay[1:].tolist()
    for ratio, change, stay in zip(*ticks, strict=True):
        ended, began = present + change, absent + change
        absent, present = absent + stay, present + stay
        before.append((ended > absent, began <= present))  # whether it was present, by whether it is
        absent, present = max(absent, ended), max(present, began) + ratio
    path = [present >= absent]
    for was_present in reversed(before):
        path.append(was_present[path[-1]])
    bounds = np.flatnonzero(np.diff(path[::-1], prepend=False, append=False)).reshape(-1, 2).tolist()
    return Presence(tuple(Run(*run) for run in bounds), max(absent, present) - never)


RELAXED: Final = tuple(CONTACT_MODELS[c.column] for c in (Contact.VF, Contact.FV, Contact.EE))
"""Contact kinds of single constraints: every contact implies at least one of them."""
NOISE_SHARE: Final = 0.1
ROUNDING: Final = 1e-14
"""Accuracy of the sums of squares, relative to their trace."""
LEAST_SQUARE: Final = 1e-12
FOLLOWED_STARTS: Final = 4
STEPS: Final = 10
"""Numbers of starts with the least ratio of squared residual to free motion that are followed, and of steps
from each."""
DAMPED_SHARE: Final = 1e-3
"""Damping of all directions, as a share of their curvature; turns have an additional damping of 1."""
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
    noise_sd = motion.ticks.noise_sd
    weight = 1.0 / noise_sd[:, 3:4]
    square = model.lifted(motion.new) * weight
    moved = np.swapaxes(motion.free, 1, 2) @ motion.moved
    free = (model.lifted(moved) * weight[:, None]).reshape(-1, square.shape[1])
    noise = model.lifted(motion.moved * noise_sd[:, :, None]) * weight[:, None]
    noise, count = noise.reshape(free.shape[0], -1), len(motion)
    return Moments(square.T @ square / count, free.T @ free / count, noise.T @ noise / count, count)


def relaxed(sums: Moments) -> tuple[Array, Array]:
    """Ratios (C,) of free motion to squared residual, in ascending order, and the coefficients (C, C), in
    columns, that have them. Up to noise the largest is an upper bound for contacts."""
    scale = np.sqrt(sums.noise.diagonal() + JITTER * sums.noise.trace())
    outer = scale[:, None] * scale
    least = ROUNDING * sums.square.trace() * np.eye(len(scale))
    square = (sums.square + NOISE_SHARE * sums.noise + least) / outer
    square += JITTER * np.trace(sums.noise / outer) * np.eye(len(square))
    ratio, c = eigh(sums.free / outer, square)
    return ratio, c / scale[:, None]


def _relaxed_starts(model: ContactModel, sums: Moments, x: Array) -> Array:
    """x (B, S), twice, with directions of the two relaxed solutions with the largest ratios."""
    form, starts = model.family.FORM, list[Array]()
    for c in relaxed(sums)[1].T[:-3:-1]:
        if form.h < 0:  # two lines
            world_axes, _, body_axes = np.linalg.svd(c[9:18].reshape(3, 3))
            start, first, second = x[:1].copy(), body_axes[0], world_axes[:, 0]
        else:
            second = unit(c[9:12])
            on_one = model.contact is Contact.FF
            start = x[: 1 if on_one else None].copy()
            first = unit(second @ sums.square[:9, 12].reshape(3, 3)) if on_one else None
        start[:, form.d2 : form.d2 + 3] = second
        if first is not None:
            start[:, form.d1 : form.d1 + 3] = first
        starts.append(start)
    return np.concatenate(starts)


def search(model: ContactModel, motion: ConditionalMotion) -> Array:
    """The elements x (S,) of ``model`` with the least cost in the ticks of ``motion``."""
    window, reach_m = motion.ticks.window, motion.ticks.scales.reach_m
    anchors = model.anchors(window.zeta[:, T].mean(axis=0))[None]
    problem = Problem(model, moments(model, motion), weak_prior(model.family, anchors, reach_m), anchors)
    x = model.turned(directions(model, DRAWS), window.zeta[-1, R].reshape(3, 3))
    x = problem.complete(_relaxed_starts(model, problem.of, x))
    x = x[np.argsort(problem.ratio(x), kind="stable")[:FOLLOWED_STARTS]]
    x = problem.descend(x, STEPS)
    return np.asarray(x[np.argmin(problem.cost(x))])


class Problem(NamedTuple):
    """Cost of one contact: half the squared residuals over noise, less the log of free motion over noise.
    The ``prior`` of one hypothesis is the same for all."""

    model: ContactModel
    of: Moments
    prior: Prior
    anchors: Array

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
        family, anchors = self.model.family, self.anchors.repeat(len(x), axis=0)
        cost, damping, turning = self.cost(x), np.ones(len(x)), turns(family.FORM)
        for _ in range(steps):
            tangent, gradient, hessian = self._normal(x, anchors)
            diagonal = np.einsum("bii->bi", hessian)
            diagonal += JITTER + DAMPED_SHARE * damping[:, None] * diagonal
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
        forms = np.array(self.of[:3])[:, None, None]
        # half the derivative of each form
        d_square, d_free, d_noise = (slopes @ forms @ c[..., None])[..., 0]
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
        forms = np.array(self.of[:3])[:, None]
        return np.asarray(np.maximum(((c @ forms) * c).sum(axis=-1), LEAST_SQUARE))
