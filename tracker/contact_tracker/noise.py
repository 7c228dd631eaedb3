"""Sensor noise from the stream itself: what third differences of the poses leave of the motion.

Motion is smooth from frame to frame and noise is not. Positions have noise in the world's axes (a camera
sees depth badly), orientations in the body's. What is measured of the position need not be independent of the
orientation: that is so for one point of the body, the *centre*, wherever the body's frame was put.
Outliers and jolts are made harmless by weights and medians (docs/theory.md, T27).
"""

from dataclasses import dataclass
from math import comb, sqrt
from statistics import median
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.poses import Poses
from contact_tracker.quaternions import inverse, matrices, product, rotation_vectors

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
_GAIN: Final = float(sum(comb(ORDER, i) ** 2 for i in range(ORDER + 1)))
_MEDIAN_OF_CHI_SQ: Final = 2.3659738843753377
"""With three degrees of freedom."""
_TINY: Final = 1e-30


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Noise of one pose, as the last frames show it.

    ``position`` and ``rotation`` (n, 3) are third differences in m and rad, scaled to the noise's deviation:
    of the origin's position in the body's axes at the time, of the orientation in the body's axes;
    ``turn`` (n, 3, 3) are the rotations ``R`` then. ``recent`` frames wait for the next. The noise is that of
    the centre's position ``position_m2`` (3, 3) in the world's axes, of the orientation ``rotation_rad2``
    (3, 3) in the body's, and ``centre_m`` (3,) in the body; it leaves out the last ``untold`` differences.
    """

    position: Array
    rotation: Array
    turn: Array
    recent: Poses
    untold: int
    position_m2: Array
    rotation_rad2: Array
    centre_m: Array

    @property
    def sigma_rotation_rad(self) -> float:
        """Root mean square over the axes."""
        return sqrt(self.rotation_rad2.trace() / 3.0)

    @property
    def sigma_position_m(self) -> float:
        """Root mean square over the axes, of the position of the body's origin."""
        rotation, centre = self.rotation_rad2, self.centre_m
        swung = rotation.trace() * (centre @ centre) - centre @ rotation @ centre
        return sqrt((self.position_m2.trace() + swung) / 3.0)


def begin(sigma_position_m: float, sigma_rotation_rad: float) -> NoiseEstimate:
    """Start from the model's noise, the same in all axes and centred at the body's origin."""
    none = np.zeros((0, 3))
    return NoiseEstimate(
        none,
        none,
        np.zeros((0, 3, 3)),
        Poses.collect([]),
        0,
        np.eye(3) * sigma_position_m**2,
        np.eye(3) * sigma_rotation_rad**2,
        np.zeros(3),
    )


def advance(estimate: NoiseEstimate, frames: Poses, prior: tuple[float, float]) -> NoiseEstimate:
    """Take in the frames of one tick; ``prior`` are the model's deviations (m, rad)."""
    recent = _join(estimate.recent, frames)
    new = _third_differences(recent)
    old = (estimate.position, estimate.rotation, estimate.turn)
    position, rotation, turn = (
        np.concatenate([a, b])[-MEMORY_FRAMES:] for a, b in zip(old, new, strict=True)
    )
    untold = estimate.untold + len(new[0])
    told = (estimate.position_m2, estimate.rotation_rad2, estimate.centre_m)
    if untold >= UNTOLD_FRAMES * (len(position) / MEMORY_FRAMES) ** 2:
        untold, told = 0, _told(estimate, position, rotation, turn, prior)
    return NoiseEstimate(position, rotation, turn, recent[-ORDER:], untold, *told)


def _told(
    estimate: NoiseEstimate, position: Array, rotation: Array, turn: Array, prior: tuple[float, float]
) -> tuple[Array, Array, Array]:
    """The noise (3, 3) in m^2 and rad^2 that the differences tell, and its centre (3,); near the last one."""
    across, about = (np.ascontiguousarray(rows.T) for rows in (position, rotation))
    centre_m = _centre(across, about, (estimate.sigma_position_m, estimate.sigma_rotation_rad))
    at_centre = np.einsum("nij,jn->in", turn, across - _cross_matrix(centre_m) @ about)
    start = np.array([estimate.position_m2, estimate.rotation_rad2])
    covariance = _covariance(np.array([at_centre, about]), np.array(prior), start)
    return covariance[0], covariance[1], centre_m


def estimate_noise(poses: Poses) -> tuple[float, float]:
    """Standard deviations per axis (m, rad) of a whole recording, nan where it is too short to tell."""
    position, rotation, turn = _third_differences(poses[poses.fresh])
    if not len(position):
        return float("nan"), float("nan")
    rows = np.array([np.einsum("nij,nj->in", turn, position), rotation.T])
    sigma = np.sqrt(_size_sq(rows, _shape(rows, np.eye(3)[None], THOROUGH)))
    return float(sigma[0]), float(sigma[1])


def _third_differences(frames: Poses) -> tuple[Array, Array, Array]:
    """Scaled differences (n, 3) of the position, in the body's axes, and of the turn; rotations (n, 3, 3)."""
    if len(frames) <= ORDER:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))
    quat = frames.quat_xyzw
    steps = rotation_vectors(product(inverse(quat[:-1]), quat[1:]))
    interval = np.diff(frames.stamp_ns)
    count = len(frames) - ORDER
    widest = np.max([interval[i : i + count] for i in range(ORDER)], axis=0)
    regular = widest < REGULAR * median(interval.tolist())
    rotation = matrices(quat[1 : 1 - ORDER])[regular]
    shift = np.diff(frames.position_m, ORDER, axis=0)[regular]
    position = np.einsum("nji,nj->ni", rotation, shift)
    scale = np.sqrt(_GAIN)
    return position / scale, np.diff(steps, ORDER - 1, axis=0)[regular] / scale, rotation


def _centre(position: Array, rotation: Array, deviation: tuple[float, float]) -> Array:
    """The point of the body (3,) of which the noise is independent of that of the orientation, both (3, n).

    An error of orientation swings the origin about it: the position's share of it is ``centre x rotation``.
    """
    count = position.shape[1]
    if count < 2 * ORDER:
        return np.zeros(3)
    both = np.concatenate([position / deviation[0], rotation / deviation[1]])
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


def _join(first: Poses, second: Poses) -> Poses:
    return Poses(
        np.concatenate([first.stamp_ns, second.stamp_ns]),
        np.concatenate([first.position_m, second.position_m]),
        np.concatenate([first.quat_xyzw, second.quat_xyzw]),
    )
