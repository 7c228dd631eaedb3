"""Covariance of elements by systematic errors of the poses (docs/theory.md, T45).

Errors that depend on the pose, as those of calibration, change the motion as another geometry would. They do
not show in the residuals and do not average out, so that their size has to be given.
"""

from typing import Final, NamedTuple

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
"""Number of ticks that represent a longer window."""
SHARE_OF_REST: Final = 0.05
"""Weight of a tick at rest, relative to one in motion, when these are chosen."""
LEAST_SHARE: Final = 1e-14
"""Eigenvalues below this share of the largest are rounding errors."""


class Representatives(NamedTuple):
    """Some ticks of a window, and how many ``ticks`` (N,) each stands for."""

    window: Window
    ticks: Array


def systematic_covariance(
    one: Bank,
    model: ContactModel,
    window: Window,
    reach_m: float,
    errors: SystematicErrors,
    is_refined: bool,
) -> Array:
    """Covariance (S, S) that systematic errors of the poses add to the geometry x of a single hypothesis.

    Ticks since the onset count, as far as they are in the window; ticks before are left out.

    Parameters
    ----------
    one : bank of one hypothesis.
    is_refined : whether each tick counts by its noise alone; else also by its motion.
    """
    ticks, count = representatives(window.cut(int(np.searchsorted(window.index, one.onset[0])), None))
    x, family, lifted = one.x[0], model.family, model.lifted(ticks.zeta)
    tangent = family.tangent(x, anchors_of(one, model)[0])
    weight = count / ticks.variance[:, 0]
    if not is_refined:
        weight *= np.maximum(ticks.motion_ratio, REST_WEIGHT)
    precision = gauss_newton.per_metre(family, one.second_moment[0], one.row_weight[0], x)
    slopes = np.einsum("sp,ksc,tc->pkt", tangent, family.rows_derivative(x), lifted)
    weighted = slopes * precision[:, None] * weight
    information = np.einsum("pkt,qkt->pq", weighted, slopes)
    by_error = np.einsum("pkt,kdt->dpt", weighted, perturbed_rows(one, model) @ lifted.T)
    prior = prior_along(one, model, tangent, reach_m)
    return np.asarray(
        tangent @ added_covariance(information, prior, by_error, ticks.zeta, errors) @ tangent.T
    )


def added_covariance(
    information: Array, prior: Array, by_error: Array, zeta: Array, errors: SystematicErrors
) -> Array:
    """Covariance (P, P) that the systematic errors of N poses add to that by noise.

    Parameters
    ----------
    information, prior : (P, P) information of the ticks, and of the prior, on the parameters.
    by_error : (6, P, N) derivatives of the cost's gradient by the errors of each pose: three turns about the
        body's axes, three shifts along the world's.
    zeta : (N, 25) the lifted poses.
    """
    turn, shift = _error_covariances(zeta, errors)
    spread = (by_error @ np.repeat([turn, shift], 3, axis=0) @ by_error.swapaxes(1, 2)).sum(axis=0)
    scale = 1.0 / np.sqrt(np.diag(information + prior))
    units = np.outer(scale, scale)
    information, prior, spread = information * units, prior * units, spread * units
    # the errors lower the information of the ticks, not that of the prior
    left = information @ _inverse(information + spread) @ information
    return np.asarray((_inverse(left + prior) - _inverse(information + prior)) * units)


def _inverse(symmetric: Array) -> Array:
    """Inverse of a positive semidefinite matrix (P, P), with its eigenvalues above rounding errors."""
    values, vectors = linalg.eigenvectors(symmetric)
    return np.asarray((vectors / np.maximum(values, LEAST_SHARE * values[-1])) @ vectors.T)


def representatives(window: Window) -> Representatives:
    """All ticks of a window, or if it is long some of them, more of those in motion."""
    if len(window) <= MOST_TICKS:
        return Representatives(window, np.ones(len(window)))
    passed = np.cumsum(window.motion_ratio + SHARE_OF_REST)
    cuts = np.unique(np.searchsorted(passed, np.linspace(0.0, passed[-1], MOST_TICKS + 1)[1:-1]))
    first, end = np.append(0, cuts), np.append(cuts, len(window))
    some = end > first
    first, end = first[some], end[some]
    return Representatives(window.pick((first + end) // 2, window.before), (end - first).astype(float))


def _error_covariances(zeta: Array, errors: SystematicErrors) -> tuple[Array, Array]:
    """Covariances (N, N) of the errors of N poses about one axis (rad^2) and along one axis (m^2)."""
    return (
        errors.rotation_rad**2 * np.exp(-_squared_distances(zeta[:, R]) / (4.0 * errors.angle_rad**2)),
        errors.position_m**2 * np.exp(-_squared_distances(zeta[:, T]) / (2.0 * errors.length_m**2)),
    )


def _squared_distances(points: Array) -> Array:
    """(N, N) squared distances of points (N, D)."""
    apart = points[:, None] - points
    return np.asarray((apart * apart).sum(axis=2))
