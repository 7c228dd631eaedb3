"""Minimise the objective of one contact over many windows at once, from their moments alone.

Levenberg-Marquardt in the free directions of x: with residuals ``c(x) . zeta`` the cost of a window is
``1/2 sum_k w_k c_k M c_k^T``, its gradient and its Gauss-Newton Hessian come from the same moments M
(docs/theory.md, T15), so a step costs the same however long the window is. Turns are damped; for given
directions the shifts are a linear problem, which is solved anew after each step.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array, Ints
from contact_tracker.contacts.family import Family, directions, shifts, turns
from contact_tracker.geometry.linalg import LEAST_SHARE, adapted, dot


@dataclass(frozen=True, eq=False)
class Prior:
    """Cost ``1/2 x P x - information x + constant`` of x in nats.

    ``precision`` P (B, S, S), ``information`` (B, S), ``constant`` (B,); priors add up. ``flat`` (S,) is the
    precision of an unknown direction due to its finite sphere: it counts in volumes but has no gradient.
    """

    precision: Array
    information: Array
    constant: Array
    flat: Array

    @classmethod
    def around(cls, mean: Array, precision: Array, flat: Array) -> "Prior":
        """Gaussians around ``mean`` (B, S)."""
        information = np.einsum("bst,bt->bs", precision, mean)
        return cls(precision, information, 0.5 * np.einsum("bs,bs->b", information, mean), flat)

    def __add__(self, other: "Prior") -> "Prior":
        """The sum of both costs, with ``flat`` of the first."""
        return Prior(
            self.precision + other.precision,
            self.information + other.information,
            self.constant + other.constant,
            self.flat,
        )

    def pick(self, rows: NDArray[np.generic]) -> "Prior":
        return Prior(self.precision[rows], self.information[rows], self.constant[rows], self.flat)

    def gradient(self, x: Array) -> Array:
        """Derivative (B, S) of the cost at x (B, S)."""
        return np.asarray((self.precision @ x[..., None])[..., 0] - self.information)

    def cost(self, x: Array) -> Array:
        """Half the squared distance (B,) of x (B, S) from the mean."""
        half = dot(x, self.gradient(x) - self.information)
        return np.asarray(0.5 * half + self.constant)


TOLERANCE: Final = 1e-3
"""A fit has converged when a step would lower its cost by less than this (nats)."""
FIRST_DAMPING: Final = 10.0
"""Damping of turns in nats per squared radian; it limits first steps to about a third of a radian."""
LEAST_CURVATURE: Final = 1e-12


@dataclass(frozen=True, eq=False)
class Fit:
    """Minima of B windows. Where ``converged`` is False, x is the best point so far.

    The hessian is evaluated ``at`` (B, S), where the last step began. At its end it would cost half a step
    more, and near a minimum it is the same.
    """

    x: Array
    cost: Array
    hessian: Array
    at: Array
    converged: NDArray[np.bool_]


def minimise(
    family: Family,
    moments: Array,
    row_weight: Array,
    prior: Prior,
    anchors: Array,
    x: Array,
    iterations: int | Ints,
    tolerance: float = TOLERANCE,
    of: Ints | None = None,
) -> Fit:
    """Fit one family to W windows from B starts.

    Parameters
    ----------
    moments : (W, C, C) sums of weighted ``zeta zeta^T`` over each window, in the family's columns.
    row_weight : (W, K) precision of each residual, 1/rad^2 or 1/m^2; the scale of the last row per metre of
        distance is divided out here, at each x (``Family.scale_sq``).
    prior : weak knowledge that keeps unobservable directions finite.
    anchors : (W, 6) where the body is in frames 1 and 2 (see ``contacts.family``).
    x : (B, S) starts.
    iterations : steps at most, of all or of each start (B,).
    tolerance : see ``TOLERANCE``.
    of : (B,) the window of each start; by default each window has one start.

    Returns
    -------
    Fit with x (B, S), cost (B,) in nats, hessian (B, K, P, P) of the data alone by row, at (B, S), and
    converged (B,).
    """
    steps_left = np.broadcast_to(np.asarray(iterations, np.int64), len(x)).copy()
    of = np.arange(len(x)) if of is None else of
    moments, row_weight, prior, anchors = moments[of], row_weight[of], prior.pick(of), anchors[of]
    damping = np.full(len(x), FIRST_DAMPING)
    x, cost_now = complete(family, moments, row_weight, prior, anchors, x)
    tangent, gradient, hessian, prior_precision = _normal_equations(
        family, moments, row_weight, prior, anchors, x
    )
    at = x.copy()
    converged = np.zeros(len(x), bool)
    rows = np.arange(len(x))
    while True:
        step = _step(family, gradient[rows], hessian[rows], prior_precision[rows], damping[rows])
        converged[rows] = np.abs(dot(gradient[rows], step)) < tolerance
        go_on = ~converged[rows] & (steps_left[rows] > 0)
        rows, step = rows[go_on], step[go_on]
        if not len(rows):
            return Fit(x, cost_now, hessian, at, converged)
        steps_left[rows] -= 1
        moving = moments[rows], row_weight[rows], prior.pick(rows)
        moved = x[rows] + (tangent[rows] @ step[..., None])[..., 0]
        proposal, proposed_cost = complete(family, *moving, anchors[rows], moved)
        better = proposed_cost < cost_now[rows]
        damping[rows] = adapted(damping[rows], better)
        won = rows[better]
        x[won], cost_now[won] = proposal[better], proposed_cost[better]
        won = won[steps_left[won] > 0]
        if len(won):
            at[won] = x[won]
            tangent[won], gradient[won], hessian[won], prior_precision[won] = _normal_equations(
                family, moments[won], row_weight[won], prior.pick(won), anchors[won], x[won]
            )


def _step(family: Family, gradient: Array, hessian: Array, prior_precision: Array, damping: Array) -> Array:
    """Gauss-Newton step (B, P) with damped turns; ``complete`` then solves for the shifts."""
    curvature = hessian.sum(axis=1) + prior_precision
    diagonal = np.einsum("bii->bi", curvature)
    # a direction without any curvature, as in an empty window, or with none but that of rounding, as of exact
    # poses, must not make the whole batch singular
    diagonal += LEAST_SHARE * diagonal + LEAST_CURVATURE
    diagonal[:, turns(family.FORM)] += damping[:, None]
    return np.asarray(-np.linalg.solve(curvature, gradient[..., None])[..., 0])


def complete(
    family: Family,
    moments: Array,
    row_weight: Array,
    prior: Prior,
    anchors: Array,
    x: Array,
    of: Ints | None = None,
) -> tuple[Array, Array]:
    """x (B, S) with its coordinates at their optimum for the given directions, and its cost (B,).

    That is a linear problem: rows are affine in the shifts. Arguments as of ``minimise``.
    """
    of = np.arange(len(x)) if of is None else of
    moments, row_weight, prior, anchors = moments[of], row_weight[of], prior.pick(of), anchors[of]
    bare, turning = np.zeros_like(x), directions(family.FORM)
    bare[:, turning] = x[:, turning]
    bare = family.normalise(bare, anchors)
    along = np.swapaxes(family.tangent(bare, anchors)[..., shifts(family.FORM)], -1, -2)
    slopes = along[:, None] @ family.rows_derivative(bare)
    design = np.concatenate([family.rows(bare)[:, :, None], slopes], axis=2)
    gram = (design @ moments[:, None]) @ np.swapaxes(design, -1, -2)
    weight = per_metre(family, moments, row_weight, bare)
    gram = (weight[..., None, None] * gram).sum(axis=1)
    normal = gram[:, 1:, 1:] + along @ prior.precision @ np.swapaxes(along, -1, -2)
    pull = gram[:, 1:, 0] + (along @ prior.gradient(bare)[..., None])[..., 0]
    trace = np.einsum("bll->b", normal)[:, None]
    np.einsum("bll->bl", normal)[...] += LEAST_SHARE * trace + LEAST_CURVATURE
    shift = -np.linalg.solve(normal, pull[..., None])
    x = bare + (np.swapaxes(along, -1, -2) @ shift)[..., 0]
    coefficients = np.concatenate([np.ones((len(x), 1, 1)), shift], axis=1)
    squares = (np.swapaxes(coefficients, 1, 2) @ gram @ coefficients)[:, 0, 0]
    return x, 0.5 * squares + prior.cost(x)


def information(
    family: Family, squares: Array, row_weight: Array, moments: Array, anchors: Array, x: Array
) -> Array:
    """Hessian (B, P, P) at x (B, S) of lifted poses with second moments ``squares`` (B, C, C), in the scale
    of the window of ``moments``."""
    along = np.swapaxes(family.tangent(x, anchors), -1, -2)
    slopes = along[:, None] @ family.rows_derivative(x)
    weight = per_metre(family, moments, row_weight, x)[..., None, None]
    return np.asarray((weight * (slopes @ squares[:, None]) @ np.swapaxes(slopes, -1, -2)).sum(axis=1))


def _normal_equations(
    family: Family, moments: Array, row_weight: Array, prior: Prior, anchors: Array, x: Array
) -> tuple[Array, Array, Array, Array]:
    tangent, c = family.tangent(x, anchors), family.rows(x)
    along, derivative = np.swapaxes(tangent, -1, -2), family.rows_derivative(x)
    # the last row is per metre, and its scale changes with x as well
    derivative[:, -1] -= 0.5 * family.log_scale_sq_derivative(x, moments)[..., None] * c[:, -1, None, :]
    jacobian = along[:, None] @ derivative
    row_weight = per_metre(family, moments, row_weight, x)
    weighted = row_weight[..., None, None] * (jacobian @ moments[:, None])
    hessian = weighted @ np.swapaxes(jacobian, -1, -2)
    gradient = (weighted @ c[..., None])[..., 0].sum(axis=1) + (along @ prior.gradient(x)[..., None])[..., 0]
    prior_precision = along @ prior.precision @ tangent
    return tangent, gradient, hessian, prior_precision


def per_metre(family: Family, moments: Array, row_weight: Array, x: Array) -> Array:
    """``row_weight`` (..., K) at x (..., S), the last one divided by its row's squared scale per metre."""
    weight = row_weight.copy()
    weight[..., -1] /= family.scale_sq(x, moments)
    return weight
