"""Covariance of elements by systematic errors of the poses (docs/theory.md, T45).

Errors that depend on the pose, as those of calibration, change the motion as another geometry would. They do
not show in the residuals and do not average out, so that their size has to be given.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.contacts import ContactModel
from contact_tracker.geometry import linalg
from contact_tracker.hypotheses import gauss_newton
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.observability import perturbed_rows, prior_along
from contact_tracker.hypotheses.pruning import anchors_of
from contact_tracker.hypotheses.schedule import REST_WEIGHT
from contact_tracker.motion.lifted_pose import R, T
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]

MOST_TICKS: Final = 300
"""Number of ticks that represent a longer window; neighbours have nearly the same errors."""


def systematic_covariance(
    one: Bank,
    model: ContactModel,
    window: Window,
    reach_m: float,
    errors: SystematicErrors,
    is_refined: bool,
) -> Array:
    """Covariance (S, S) of the geometry x of a single hypothesis by the systematic errors of the poses.

    Parameters
    ----------
    one : bank of one hypothesis.
    window : the ticks that it is fitted to, and maybe earlier ones, which are left out.
    is_refined : whether each tick counts by its noise alone; else also by its motion.
    """
    since = window.cut(int(np.searchsorted(window.index, one.onset[0])), None)
    ticks = representative(since)
    x, family, lifted = one.x[0], model.family, model.lifted(ticks.zeta)
    tangent = family.tangent(x, anchors_of(one, model)[0])
    weight = len(since) / len(ticks) / ticks.variance[:, 0]
    if not is_refined:
        weight *= np.maximum(ticks.motion_ratio, REST_WEIGHT)
    precision = gauss_newton.per_metre(family, one.second_moment[0], one.row_weight[0], x)
    slopes = np.einsum("sp,ksc,tc->pkt", tangent, family.rows_derivative(x), lifted)
    weighted = slopes * precision[:, None] * weight
    information = np.einsum("pkt,qkt->pq", weighted, slopes) + prior_along(one, model, tangent, reach_m)
    by_residual = tangent @ linalg.solve(information, weighted.reshape(len(weighted), -1))
    residuals = perturbed_rows(one, model) @ lifted.T
    by_error = np.einsum("skt,kdt->dst", by_residual.reshape(len(x), *slopes.shape[1:]), residuals)
    return propagated(by_error, ticks.zeta, errors)


def propagated(by_error: Array, zeta: Array, errors: SystematicErrors) -> Array:
    """Covariance (S, S) of parameters whose derivatives by the errors of N poses are ``by_error`` (6, S, N):
    three turns about the body's axes, three shifts along the world's. ``zeta`` (N, 25) are the poses."""
    turn, shift = _error_covariances(zeta, errors)
    each = by_error @ np.repeat([turn, shift], 3, axis=0) @ by_error.swapaxes(1, 2)
    return np.asarray(each.sum(axis=0))


def representative(window: Window) -> Window:
    """The window, or if it is long some of its ticks."""
    if len(window) <= MOST_TICKS:
        return window
    return window.pick(np.linspace(0, len(window) - 1, MOST_TICKS).astype(int), window.before)


def _error_covariances(zeta: Array, errors: SystematicErrors) -> tuple[Array, Array]:
    """Covariances (N, N) of the errors of N poses about one axis (rad^2) and along one axis (m^2)."""
    away_m = zeta[:, None, T] - zeta[None, :, T]
    cosine = 0.5 * (zeta[:, R] @ zeta[:, R].T - 1.0)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    turn = np.exp(-0.5 * (angle / errors.angle_rad) ** 2)
    shift = np.exp(-0.5 * np.sum(away_m**2, axis=2) / errors.length_m**2)
    return errors.rotation_rad**2 * turn, errors.position_m**2 * shift
