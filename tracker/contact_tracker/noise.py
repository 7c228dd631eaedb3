"""Sensor noise from the stream itself: what third differences of the poses leave of the motion.

Motion is smooth from frame to frame and noise is not. Positions have noise in the world's axes (a camera
sees depth badly), orientations in the body's. What is measured of the position need not be independent of the
orientation: that is so for one point of the body, the *centre*, wherever the body's frame was put.
Outliers and jolts are made harmless by weights and medians (docs/theory.md, T27).
"""

from dataclasses import dataclass
from functools import cached_property
from math import comb, sqrt
from statistics import median
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.poses import Poses
from contact_tracker.quaternions import between, matrices, rotation_vectors

Array = NDArray[np.float64]

ORDER: Final = 3
MEMORY_FRAMES: Final = 2000
PRIOR_FRAMES: Final = 10
"""Weight of the model's noise against the stream's own."""
BALL_FRAMES: Final = 30
"""Weight of the same noise in all axes against the shape that the stream shows."""
REGULAR: Final = 1.5
"""Differences are only taken where the interval is within this factor of the usual one."""
STEPS: Final = 3
"""Of Tyler's iteration, from where the last tick left it; ``THOROUGH`` where there was none."""
THOROUGH: Final = 15
UNTOLD_FRAMES: Final = 60
"""The noise is told again once so many of ``MEMORY_FRAMES`` are new; of n, (n / MEMORY_FRAMES)^2 of it.

``untold`` new ones of n move it by about sqrt(untold) / n: by 1 % at most in 99 of 100 ticks.
"""
SPREAD_M: Final = 0.3
"""How far the centre of the noise usually lies from the body's origin."""
_SCALE: Final = sqrt(sum(comb(ORDER, i) ** 2 for i in range(ORDER + 1)))
_MEDIAN_OF_CHI_SQ: Final = 2.3659738843753377
"""With three degrees of freedom."""
_TINY: Final = 1e-30


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Noise of one pose, as the last frames show it.

    It is that of the *centre*'s position ``position_m2`` (3, 3) in the world's axes, of the orientation
    ``rotation_rad2`` (3, 3) in the body's, and ``centre_m`` (3,) in the body.
    """

    position_m2: Array
    rotation_rad2: Array
    centre_m: Array

    @cached_property
    def sigma_rotation_rad(self) -> float:
        """Root mean square over the axes."""
        return sqrt(self.rotation_rad2.trace() / 3.0)

    @cached_property
    def sigma_position_m(self) -> float:
        """Root mean square over the axes, of the position of the body's origin."""
        rotation, centre = self.rotation_rad2, self.centre_m
        swung = rotation.trace() * (centre @ centre) - centre @ rotation @ centre
        return sqrt((self.position_m2.trace() + swung) / 3.0)


@dataclass(frozen=True, eq=False)
class Differences:
    """Third differences, scaled to the noise's deviation: what the noise is told from.

    In the rows of ``told`` (15, n), and of ``untold`` ones (15, k) that came after the noise was last told:
    of the origin's position in the body's axes at the time (m), of the orientation in the body's axes (rad),
    and the rotation ``R`` then. ``recent`` frames wait for the next.
    """

    told: Array
    untold: tuple[Array, ...]
    recent: Poses


NO_DIFFERENCES: Final = Differences(np.zeros((15, 0)), (), Poses.collect([]))


def begin(sigma_position_m: float, sigma_rotation_rad: float) -> NoiseEstimate:
    """Start from the model's noise, the same in all axes and centred at the body's origin."""
    ball = np.eye(3)
    return NoiseEstimate(ball * sigma_position_m**2, ball * sigma_rotation_rad**2, np.zeros(3))


def advance(
    differences: Differences, estimate: NoiseEstimate, frames: Poses, prior: tuple[float, float]
) -> tuple[Differences, NoiseEstimate]:
    """Take in the frames of one tick; ``prior`` are the model's deviations (m, rad)."""
    frames = Poses.join([differences.recent, frames])
    untold, told = (*differences.untold, _third_differences(frames)), differences.told
    new = sum(rows.shape[1] for rows in untold)
    if new >= UNTOLD_FRAMES * (min(told.shape[1] + new, MEMORY_FRAMES) / MEMORY_FRAMES) ** 2:
        told, untold = np.concatenate([told, *untold], axis=1)[:, -MEMORY_FRAMES:], ()
        estimate = _told(estimate, told, prior)
    return Differences(told, untold, frames[-ORDER:]), estimate


def _told(estimate: NoiseEstimate, differences: Array, prior: tuple[float, float]) -> NoiseEstimate:
    """The noise that the differences (15, n) tell; near the last one."""
    across, about, turn = differences[:3], differences[3:6], differences[6:].reshape(3, 3, -1)
    centre_m = _centre(differences[:6], (estimate.sigma_position_m, estimate.sigma_rotation_rad))
    at_centre = np.einsum("ijn,jn->in", turn, across - _cross_matrix(centre_m) @ about)
    start = np.array([estimate.position_m2, estimate.rotation_rad2])
    covariance = _covariance(np.array([at_centre, about]), np.array(prior), start)
    return NoiseEstimate(covariance[0], covariance[1], centre_m)


def estimate_noise(poses: Poses) -> tuple[float, float]:
    """Standard deviations per axis (m, rad) of a whole recording, nan where it is too short to tell."""
    differences = _third_differences(poses.fresh)
    if not differences.shape[1]:
        return float("nan"), float("nan")
    across, about, turn = differences[:3], differences[3:6], differences[6:].reshape(3, 3, -1)
    rows = np.array([np.einsum("ijn,jn->in", turn, across), about])
    sigma = np.sqrt(_size_sq(rows, _shape(rows, np.eye(3)[None], THOROUGH)))
    return float(sigma[0]), float(sigma[1])


def _third_differences(frames: Poses) -> Array:
    """Columns (15, n) of ``Differences``."""
    count = len(frames) - ORDER
    if count <= 0:
        return NO_DIFFERENCES.told
    quat, interval = frames.quat_xyzw, frames.stamp_ns[1:] - frames.stamp_ns[:-1]
    turns = rotation_vectors(between(quat[:-1], quat[1:]))
    rotation = matrices(quat[1 : 1 - ORDER])
    shift = np.diff(frames.position_m, ORDER, axis=0)[:, None] @ rotation
    rows = (shift[:, 0] / _SCALE, np.diff(turns, ORDER - 1, axis=0) / _SCALE, rotation.reshape(-1, 9))
    widest = np.max([interval[i : i + count] for i in range(ORDER)], axis=0)
    regular = widest < REGULAR * median(interval.tolist())
    return np.concatenate(rows, axis=1)[regular].T


def _centre(differences: Array, deviation: tuple[float, float]) -> Array:
    """The point of the body (3,) of which the noise is independent of that of the orientation, both (6, n).

    An error of orientation swings the origin about it: the position's share of it is ``centre x rotation``.
    """
    count = differences.shape[1]
    if count < 2 * ORDER:
        return np.zeros(3)
    both = differences / np.repeat(deviation, 3)[:, None]
    shape = _shape(both, np.eye(6), STEPS)
    swing = shape[:3, 3:] @ np.linalg.inv(shape[3:, 3:]) * deviation[0] / deviation[1]
    centre = 0.5 * np.array([swing[2, 1] - swing[1, 2], swing[0, 2] - swing[2, 0], swing[1, 0] - swing[0, 1]])
    left = np.trace(shape[:3, :3] - shape[:3, 3:] @ np.linalg.inv(shape[3:, 3:]) @ shape[3:, :3])
    doubt_sq = left / np.trace(shape[3:, 3:]) * (deviation[0] / deviation[1]) ** 2 / count
    return np.asarray(centre / (1.0 + doubt_sq / SPREAD_M**2))


def _covariance(rows: Array, prior: Array, start: Array) -> Array:
    """Covariances (..., 3, 3) of the columns of ``rows`` (..., 3, n), drawn to ``prior`` and to a ball."""
    count = rows.shape[-1]
    if count < ORDER:
        return np.eye(3) * np.square(prior)[..., None, None]
    shape = _shape(rows, start, STEPS)
    measured = np.maximum(_size_sq(rows, shape), np.square(1e-3 * prior))
    share = count / (count + PRIOR_FRAMES)
    size_sq = np.exp(share * np.log(measured) + (1.0 - share) * np.log(np.square(prior)))
    return np.asarray(shape * size_sq[..., None, None])


def _shape(rows: Array, start: Array, steps: int) -> Array:
    """Tyler's scatter (..., d, d), with the trace d, of the columns of ``rows`` (..., d, n).

    No column counts by its length.
    """
    size, count = rows.shape[-2:]
    ball = BALL_FRAMES * np.eye(size)
    says_nothing = _square(rows, rows) < _TINY
    telling = np.maximum(count - np.count_nonzero(says_nothing, axis=-1), 1)[..., None, None]
    shape = start * (size / _trace(start))
    for _ in range(steps):
        weight = 1.0 / np.maximum(_distance_sq(rows, shape), _TINY)
        weight[says_nothing] = 0.0
        scatter = (rows * weight[..., None, :]) @ rows.swapaxes(-1, -2) * (size / telling)
        shape = scatter * (count / np.maximum(_trace(scatter) / size, _TINY)) + ball
        shape = shape * (size / _trace(shape))
    return np.asarray(shape)


def _size_sq(rows: Array, shape: Array) -> Array:
    """By what ``shape`` is to be multiplied, from the median column (...)."""
    return np.asarray(np.median(_distance_sq(rows, shape), axis=-1)) / _MEDIAN_OF_CHI_SQ


def _distance_sq(rows: Array, shape: Array) -> Array:
    return _square(np.linalg.inv(shape) @ rows, rows)


def _square(first: Array, second: Array) -> Array:
    """Scalar products (..., n) of the columns."""
    return np.asarray(np.einsum("...in,...in->...n", first, second))


def _trace(matrix: Array) -> Array:
    return np.asarray(np.einsum("...ii->...", matrix))[..., None, None]


def _cross_matrix(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])

