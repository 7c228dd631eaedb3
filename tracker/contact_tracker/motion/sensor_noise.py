"""Online estimate of the sensor noise from third differences of the poses (docs/theory.md, T27).

Third differences nearly cancel the motion, which is smooth from frame to frame, but not the noise. The noise
of positions is modelled in the world's axes (cameras measure depth less well), that of orientations in the
body's. Errors of position and orientation are independent only for one point of the body, the *centre*, which
need not be the origin of its frame. Weights and medians make the estimate robust against outliers and jolts.
"""

from dataclasses import dataclass
from functools import cached_property
from math import comb, sqrt
from typing import Final, NamedTuple

import numpy as np
from scipy.special import chdtri

from contact_tracker.arrays import Array
from contact_tracker.geometry.linalg import between, cross_matrix, matrices, rotation_vectors
from contact_tracker.motion.poses import Poses

ORDER: Final = 3
STRIDE: Final = 2
"""Stride of the differences: neighbours are strongly correlated, so that half of them carry the
information."""
MEMORY: Final = 1000
"""Number of differences in memory."""
PRIOR: Final = 5
"""Weight of the model's noise, as a number of differences."""
ISOTROPY_PRIOR: Final = 15
"""Weight of isotropic noise, as a number of differences."""
REGULAR: Final = 1.5
"""Differences are only taken where the interval is within this factor of the usual one."""
FIRST_ITERATIONS: Final = 15
"""Steps of Tyler's iteration from a sphere; from the last estimate one is enough."""
NEW_SHARE: Final = 0.05
"""The noise is re-estimated once this share of the differences is new; it changes by a quarter of its
standard error."""
SPREAD_M: Final = 0.3
"""Usual distance of the centre of the noise from the body's origin."""
SLOW_PERIOD_S: Final = 0.045
"""Above this period, differences of poses may be motion as much as noise."""
POINT_ROUNDS: Final = 3
"""Rounds of the search of the tracked point, from one without weights. By the first 60 poses of 17 recordings
whose origin is moved by 10 m, one is 6 mm (median; at most 16) from the limit of many rounds, three are 1 mm
(4), and by 2,000 poses one is 0.1 mm."""
SCALE: Final = sqrt(sum(comb(ORDER, i) ** 2 for i in range(ORDER + 1)))
MEDIAN_OF_CHI_SQ: Final = float(chdtri(3, 0.5))
"""Median of the chi-squared distribution with three degrees of freedom."""
ROUNDING_RAD: Final = 1e-9
"""Smaller differences of orientations are rounding errors, by which a point may seem to be anywhere. Larger
ones of poses that usually have such are jerks of the motion."""
TINY: Final = 1e-30


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Estimated noise of one pose.

    Covariances of the *centre*'s position ``position_m2`` (3, 3) in the world's axes and of the orientation
    ``rotation_rad2`` (3, 3) in the body's; ``centre_m`` (3,) in the body. ``shape`` (6, 6) is the normalised
    covariance of the origin's position and the orientation in the body's axes.
    """

    position_m2: Array
    rotation_rad2: Array
    centre_m: Array
    shape: Array

    @cached_property
    def sigma_rotation_rad(self) -> float:
        """Root mean square over the axes."""
        return sqrt(self.rotation_rad2.trace() / 3.0)

    @cached_property
    def sigma_position_m(self) -> float:
        """Root mean square over the axes, of the position of the frame's origin."""
        return self.sigma_at(np.zeros(3))

    def sigma_at(self, point_m: Array) -> float:
        """Root mean square over the axes, of the position of a point (3,) of the body."""
        rotation, lever = self.rotation_rad2, self.centre_m - point_m
        swung = rotation.trace() * (lever @ lever) - lever @ rotation @ lever
        return sqrt((self.position_m2.trace() + swung) / 3.0)


class NoiseBuffer(NamedTuple):
    """Data of the estimate.

    ``differences`` (15, n) are every second third difference of the last frames, scaled to the noise of a
    frame: of the origin's position in the body's axes at the time (m), of the orientation in the body's axes
    (rad), and the rotation ``R`` then. ``frames`` are those since the last estimate, ``frame_count`` of them.
    """

    differences: Array
    frames: tuple[Poses, ...] = ()
    frame_count: int = 0

    def is_due(self, count: int) -> bool:
        """Whether ``count`` frames are enough for a new estimate."""
        new, held = (count - ORDER + 1) // STRIDE, int(self.differences.shape[1])
        return new >= NEW_SHARE * min(held + new, MEMORY)


EMPTY_BUFFER: Final = NoiseBuffer(np.zeros((15, 0)))


def begin(sigma_position_m: float, sigma_rotation_rad: float) -> NoiseEstimate:
    """Start from the model's noise, the same in all axes and centred at the body's origin."""
    ball = np.eye(3)
    return NoiseEstimate(ball * sigma_position_m**2, ball * sigma_rotation_rad**2, np.zeros(3), np.eye(6))


def advance(
    buffer: NoiseBuffer, estimate: NoiseEstimate, frames: Poses, prior: tuple[float, float]
) -> tuple[NoiseBuffer, NoiseEstimate]:
    """Advance by the frames of one tick; ``prior`` are the model's standard deviations (m, rad).

    Repeated poses carry no information on the noise, and are left out.
    """
    parts, count = (*buffer.frames, frames), buffer.frame_count + frames.stamp_ns.size
    if not buffer.is_due(count):
        return NoiseBuffer(buffer.differences, parts, count), estimate
    joined = Poses.join(parts).fresh
    count = joined.stamp_ns.size
    if not buffer.is_due(count):
        return NoiseBuffer(buffer.differences, (joined,), count), estimate
    differences = np.concatenate([buffer.differences, _third_differences(joined)], axis=1)[:, -MEMORY:]
    unused = joined[max((count - ORDER + 1) // STRIDE, 0) * STRIDE :]
    return NoiseBuffer(differences, (unused,), unused.stamp_ns.size), _estimate(estimate, differences, prior)


def _estimate(estimate: NoiseEstimate, differences: Array, prior: tuple[float, float]) -> NoiseEstimate:
    """The noise estimated from the differences (15, n), starting from the last estimate."""
    if differences.shape[1] < 2 * ORDER:
        return begin(*prior)
    deviation = np.array([estimate.sigma_position_m, estimate.sigma_rotation_rad])
    across, about, turn = differences[:3], differences[3:6], differences[6:].reshape(3, 3, -1)
    shape = _shape(differences[:6] / deviation.repeat(3)[:, None], estimate.shape)
    centre_m = _centre(shape, deviation[0] / deviation[1], differences.shape[1])
    at_centre = np.einsum("ijn,jn->in", turn, across - cross_matrix(centre_m) @ about)
    start = np.array([estimate.position_m2, estimate.rotation_rad2])
    covariance = _covariance(np.array([at_centre, about]), np.array(prior), start)
    return NoiseEstimate(covariance[0], covariance[1], centre_m, shape)


def estimate_noise(poses: Poses) -> tuple[float, float]:
    """Standard deviations per axis (m, rad) of a whole recording; nan where it is too short."""
    differences = _third_differences(poses.fresh)
    if not differences.shape[1]:
        return float("nan"), float("nan")
    across, about, turn = differences[:3], differences[3:6], differences[6:].reshape(3, 3, -1)
    rows = np.array([np.einsum("ijn,jn->in", turn, across), about])
    sigma = np.sqrt(_size_sq(rows, _shape(rows, np.eye(3)[None], FIRST_ITERATIONS)))
    return float(sigma[0]), float(sigma[1])


def independent_point(poses: Poses) -> Array:
    """The point (3,) of the body that is tracked, in the body frame: the centre of the noise (T47).

    An origin elsewhere moves with each error of the orientation. It is zero, the origin itself, unless the
    Bayesian information criterion prefers the centre, and if poses have no noise.

    Parameters
    ----------
    poses : consecutive poses, of which only the first count; in a slow stream none does.
    """
    if len(poses) <= ORDER or np.median(np.diff(poses.stamp_ns)) > SLOW_PERIOD_S * 1e9:
        return np.zeros(3)
    differences = _third_differences(poses[: STRIDE * MEMORY].fresh)
    across, about, count = differences[:3], differences[3:6], differences.shape[1]
    if count < 2 * ORDER or np.median(np.linalg.norm(about, axis=0)) < ROUNDING_RAD:
        return np.zeros(3)
    gain, swung = 0.0, cross_matrix(-about.T).reshape(-1, 3)
    unobserved = ROUNDING_RAD * np.sqrt(count) / np.linalg.norm(about)  # such as along the axis of all turns
    point_m = np.array(np.linalg.lstsq(swung, across.T.ravel(), rcond=unobserved)[0], np.float64)
    for _ in range(POINT_ROUNDS):  # with weights; the prior of isotropy shrinks the steps, not their limit
        rows = np.array([across - cross_matrix(point_m) @ about, about])
        deviation = np.sqrt(np.maximum(np.mean(rows**2, axis=(1, 2)), TINY))
        shape = _shape((rows / deviation[:, None, None]).reshape(6, -1), np.eye(6), FIRST_ITERATIONS)
        lever_m = deviation[0] / deviation[1]
        point_m = point_m + _centre(shape, lever_m, count)
        swing = cross_matrix(point_m / lever_m)
        gain = np.log1p(np.trace(swing @ shape[3:, 3:] @ swing.T) / np.trace(shape[:3, :3]))
    return point_m if across.size * gain > len(point_m) * np.log(across.size) else np.zeros(3)


def _third_differences(frames: Poses) -> Array:
    """Columns (15, n) of ``NoiseBuffer.differences``."""
    if frames.stamp_ns.size <= ORDER:
        return EMPTY_BUFFER.differences
    quat, position, interval = frames.quat_xyzw, frames.position_m, np.diff(frames.stamp_ns)
    turns = rotation_vectors(between(quat[:-1], quat[1:]))
    steps = np.concatenate([position[1:] - position[:-1], turns], axis=1)
    third = np.diff(steps, ORDER - 1, axis=0)[::STRIDE] / SCALE
    rotation = matrices(quat[1 : 1 - ORDER : STRIDE])
    third[:, :3] = (third[:, None, :3] @ rotation)[:, 0]
    intervals = np.array([interval[i : len(interval) + 1 - ORDER + i] for i in range(ORDER)])[:, ::STRIDE]
    regular = intervals.max(axis=0) < REGULAR * intervals.min(axis=0)
    return np.asarray(np.concatenate([third, rotation.reshape(-1, 9)], axis=1)[regular].T)


def _centre(shape: Array, lever_m: float, count: int) -> Array:
    """The point of the body (3,) whose position error is independent of the orientation's.

    An error of orientation rotates the origin about it, so the origin's error contains ``centre x rotation``.
    ``shape`` is the normalised covariance of both, with standard deviations whose ratio is ``lever_m``, from
    ``count`` differences.
    """
    swing = shape[:3, 3:] @ np.linalg.inv(shape[3:, 3:])
    unexplained = np.trace(shape[:3, :3] - swing @ shape[3:, :3])
    centre = np.array([swing[2, 1] - swing[1, 2], swing[0, 2] - swing[2, 0], swing[1, 0] - swing[0, 1]])
    doubt_sq = unexplained / np.trace(shape[3:, 3:]) * lever_m**2 / count
    return np.asarray(centre * (0.5 * lever_m / (1.0 + doubt_sq / SPREAD_M**2)))


def _covariance(rows: Array, prior: Array, start: Array) -> Array:
    """Covariances (..., 3, 3) of the columns of ``rows`` (..., 3, n), shrunk to ``prior`` and to isotropy."""
    shape = _shape(rows, start)
    measured = np.maximum(_size_sq(rows, shape), np.square(1e-3 * prior))
    share = PRIOR / (rows.shape[-1] + PRIOR)
    return np.asarray(shape * (measured ** (1.0 - share) * prior ** (2.0 * share))[..., None, None])


def _shape(rows: Array, start: Array, steps: int = 1) -> Array:
    """Tyler's scatter (..., d, d), with trace d, of the columns of ``rows`` (..., d, n).

    It depends on the directions of the columns only.
    """
    size, count = rows.shape[-2:]
    ball = ISOTROPY_PRIOR * np.eye(size)
    shape = start
    for _ in range(steps):
        length_sq = _distance_sq(rows, shape)
        weight = np.divide(1.0, length_sq, out=np.zeros_like(length_sq), where=length_sq > TINY)
        scatter = (rows * weight[..., None, :]) @ rows.swapaxes(-1, -2)
        trace = scatter.trace(axis1=-2, axis2=-1)[..., None, None]
        shape = scatter * (size * count / np.maximum(trace, TINY)) + ball
    return np.asarray(shape * (size / shape.trace(axis1=-2, axis2=-1)[..., None, None]))


def _size_sq(rows: Array, shape: Array) -> Array:
    """Scale (...) of ``shape``, from the median squared length of the columns."""
    distance_sq, middle = _distance_sq(rows, shape), rows.shape[-1] // 2
    return np.asarray(np.partition(distance_sq, middle)[..., middle] / MEDIAN_OF_CHI_SQ)


def _distance_sq(rows: Array, shape: Array) -> Array:
    return np.asarray(np.einsum("...in,...in->...n", np.linalg.inv(shape) @ rows, rows))
