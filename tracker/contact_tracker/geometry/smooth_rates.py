"""Rates of smooth vectors that are measured with noise, and their standard deviations."""

from typing import Final

import numpy as np
from numpy.polynomial.polynomial import polyder, polyfit, polyval
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar

from contact_tracker.geometry.elements import Array

_LOG_JERK: Final = (-25.0, 15.0)
"""Log of the searched strengths of jerk, in noise variances per tick^5: from a parabola through all ticks to
ticks that do not constrain each other."""


def smooth_rates(time_s: Array, values: Array, variance: Array) -> tuple[Array, Array]:
    """Rates (T, 3) of smooth vectors (T, 3) that are measured with a noise ``variance`` (T,) per axis, and
    their variances (T,) per axis.

    The vectors move with constant acceleration, disturbed by white jerk as in the free-motion model
    (docs/theory.md, T18), here in all ticks together (a Rauch-Tung-Striebel smoother in information form).
    The strength of the jerk is the most probable one.
    """
    unit_s, unit = float(np.median(np.diff(time_s))), float(np.sqrt(np.median(variance)))
    steps, weights = np.diff(time_s) / unit_s, unit**2 / variance
    since = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    parabola = polyfit(since, values, 2)  # which costs no jerk: without it, sums of squares keep their digits
    scaled = (values - polyval(since, parabola).T) / unit
    jerk, right = _information_of_unit_jerk(steps), np.zeros((3 * len(scaled), 3))
    right[0::3] = weights[:, None] * scaled

    def factor(log_jerk: float) -> Array:
        bands = jerk * np.exp(-log_jerk)
        bands[0, 0::3] += weights
        return np.asarray(cholesky_banded(bands, lower=True))

    def loss(log_jerk: float) -> float:
        root = factor(log_jerk)
        explained = np.sum(right * cho_solve_banded((root, True), right))
        return float(3 * (3 * len(steps) * log_jerk + 2 * np.log(root[0]).sum()) - explained)

    root = factor(minimize_scalar(loss, bounds=_LOG_JERK, method="bounded", options={"xatol": 0.1}).x)
    rates = cho_solve_banded((root, True), right)[1::3]
    spread = _marginal_covariances(root)[:, 1, 1]
    slope = polyval(since, polyder(parabola)).T / (time_s[-1] - time_s[0])
    return slope + rates * unit / unit_s, spread * (unit / unit_s) ** 2


def _marginal_covariances(root: Array) -> Array:
    """Covariance (T, 3, 3) of each tick, from the Cholesky factor (6, 3 T) of the information in bands: a
    recursion from the last tick to the first, in memory and time proportional to T."""
    ticks = root.shape[1] // 3
    own, next_ = np.zeros((ticks, 3, 3)), np.zeros((ticks, 3, 3))
    for row in range(3):
        for column in range(3):
            if row >= column:
                own[:, row, column] = root[row - column, column::3]
            next_[:, row, column] = root[3 + row - column, column::3]
    inverse = np.linalg.inv(own)
    covariance, onto = inverse.swapaxes(1, 2) @ inverse, next_ @ inverse
    for tick in range(ticks - 2, -1, -1):
        covariance[tick] += onto[tick].T @ covariance[tick + 1] @ onto[tick]
    return np.asarray(covariance)


def _information_of_unit_jerk(steps: Array) -> Array:
    """Bands (6, 3 T) of the information of value, rate and acceleration in all ticks (lower form), by white
    jerk of strength one between them, ``steps`` (T - 1,)."""
    h, one, zero = steps, np.ones(len(steps)), np.zeros(len(steps))
    along = np.moveaxis(np.array([[one, h, h**2 / 2], [zero, one, h], [zero, zero, one]]), 2, 0)
    rows = [[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]]
    information = np.linalg.inv(np.moveaxis(np.array(rows), 2, 0))
    cross = -information @ along
    diagonal = np.zeros((len(steps) + 1, 3, 3))
    diagonal[1:] += information
    diagonal[:-1] -= along.swapaxes(1, 2) @ cross
    bands = np.zeros((6, 3 * len(diagonal)))
    for row in range(3):
        for column in range(3):
            if row >= column:
                bands[row - column, column::3] = diagonal[:, row, column]
            bands[3 + row - column, column::3][:-1] = cross[:, row, column]
    return bands
