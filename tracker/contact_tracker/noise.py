"""Sensor noise from the stream itself: what third differences of the poses leave of the motion.

Motion is smooth from frame to frame and noise is not. Positions have noise in the world's axes (a camera
sees depth badly), orientations in the body's. What is measured of the position need not be independent of the
orientation: that is so for one point of the body, the *centre*, wherever the body's frame was put.
Outliers and jolts are made harmless by weights and medians (docs/theory.md, T27).
"""

from dataclasses import dataclass
from math import comb
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.poses import Poses

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
    (3, 3) in the body's, and ``centre_m`` (3,) in the body.
    """

    position: Array
    rotation: Array
    turn: Array
    recent: Poses
    position_m2: Array
    rotation_rad2: Array
    centre_m: Array

    @property
    def sigma_rotation_rad(self) -> float:
        """Root mean square over the axes."""
        return float(np.sqrt(np.trace(self.rotation_rad2) / 3.0))

    @property
    def sigma_position_m(self) -> float:
        """Root mean square over the axes, of the position of the body's origin."""
        rotation, centre = self.rotation_rad2, self.centre_m
        swung = np.trace(rotation) * (centre @ centre) - centre @ rotation @ centre
        return float(np.sqrt((np.trace(self.position_m2) + swung) / 3.0))


def begin(sigma_position_m: float, sigma_rotation_rad: float) -> NoiseEstimate:
    """Start from the model's noise, the same in all axes and centred at the body's origin."""
    none = np.zeros((0, 3))
    return NoiseEstimate(
        none,
        none,
        np.zeros((0, 3, 3)),
        Poses.collect([]),
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
    deviation = estimate.sigma_position_m, estimate.sigma_rotation_rad
    centre_m = _centre(position, rotation, deviation)
    at_centre = np.einsum("nij,nj->ni", turn, position + np.cross(rotation, centre_m))
    return NoiseEstimate(
        position,
        rotation,
        turn,
        recent[-ORDER:],
        _covariance(at_centre, prior[0], estimate.position_m2),
        _covariance(rotation, prior[1], estimate.rotation_rad2),
        centre_m,
    )


def estimate_noise(poses: Poses) -> tuple[float, float]:
    """Standard deviations per axis (m, rad) of a whole recording, nan where it is too short to tell."""
    position, rotation, turn = _third_differences(poses[poses.fresh])
    if not len(position):
        return float("nan"), float("nan")
    in_world = np.einsum("nij,nj->ni", turn, position)
    sizes = (_size_sq(rows, _shape(rows, np.eye(3), THOROUGH)) for rows in (in_world, rotation))
    sigma_m, sigma_rad = (float(np.sqrt(size_sq)) for size_sq in sizes)
    return sigma_m, sigma_rad


def _third_differences(frames: Poses) -> tuple[Array, Array, Array]:
    """Scaled differences (n, 3) of the position, in the body's axes, and of the turn; rotations (n, 3, 3)."""
    if len(frames) <= ORDER:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))
    turn = Rotation.from_quat(frames.quat_xyzw)
    steps = (turn[:-1].inv() * turn[1:]).as_rotvec()
    interval = np.diff(frames.stamp_ns).astype(float)
    widest = np.lib.stride_tricks.sliding_window_view(interval, ORDER)
    regular = widest.max(axis=1) < REGULAR * np.median(interval)
    rotation = turn.as_matrix()[1 : 1 - ORDER][regular]
    shift = np.diff(frames.position_m, ORDER, axis=0)[regular]
    position = np.einsum("nji,nj->ni", rotation, shift)
    scale = np.sqrt(_GAIN)
    return position / scale, np.diff(steps, ORDER - 1, axis=0)[regular] / scale, rotation


def _centre(position: Array, rotation: Array, deviation: tuple[float, float]) -> Array:
    """The point of the body (3,) of which the noise is independent of that of the orientation.

    An error of orientation swings the origin about it: the position's share of it is ``centre x rotation``.
    """
    count = len(position)
    if count < 2 * ORDER:
        return np.zeros(3)
    both = np.concatenate([position / deviation[0], rotation / deviation[1]], axis=1)
    shape = _shape(both, np.eye(6), STEPS)
    swing = shape[:3, 3:] @ np.linalg.inv(shape[3:, 3:]) * deviation[0] / deviation[1]
    centre = 0.5 * np.array([swing[2, 1] - swing[1, 2], swing[0, 2] - swing[2, 0], swing[1, 0] - swing[0, 1]])
    left = np.trace(shape[:3, :3] - shape[:3, 3:] @ np.linalg.inv(shape[3:, 3:]) @ shape[3:, :3])
    doubt_sq = left / np.trace(shape[3:, 3:]) * (deviation[0] / deviation[1]) ** 2 / count
    return np.asarray(centre / (1.0 + doubt_sq / SPREAD_M**2))


def _covariance(rows: Array, prior: float, start: Array) -> Array:
    """Covariance (3, 3) of ``rows`` (n, 3), drawn towards ``prior`` in size and towards a ball in shape."""
    count = len(rows)
    if count < ORDER:
        return np.eye(3) * prior**2
    shape = _shape(rows, start, STEPS)
    measured = max(_size_sq(rows, shape), (1e-3 * prior) ** 2)
    share = count / (count + PRIOR_FRAMES)
    return np.asarray(shape * np.exp(share * np.log(measured) + (1.0 - share) * np.log(prior**2)))


def _shape(rows: Array, start: Array, steps: int) -> Array:
    """Tyler's scatter (d, d) of ``rows`` (n, d), with the trace d: no row counts by its length."""
    count, size = rows.shape
    shape = start / np.trace(start) * size
    for _ in range(steps):
        weight = 1.0 / np.maximum(_distance_sq(rows, shape), _TINY)
        weight[np.square(rows).sum(axis=1) < _TINY] = 0.0
        scatter = (rows * weight[:, None]).T @ rows * size / max(np.count_nonzero(weight), 1)
        shape = count * scatter / max(np.trace(scatter) / size, _TINY) + BALL_FRAMES * np.eye(size)
        shape = shape / np.trace(shape) * size
    return np.asarray(shape)


def _size_sq(rows: Array, shape: Array) -> float:
    """By what ``shape`` is to be multiplied, from the median row."""
    return float(np.median(_distance_sq(rows, shape))) / _MEDIAN_OF_CHI_SQ


def _distance_sq(rows: Array, shape: Array) -> Array:
    return np.asarray(np.einsum("ni,ni->n", rows @ np.linalg.inv(shape), rows))


def _join(first: Poses, second: Poses) -> Poses:
    return Poses(
        np.concatenate([first.stamp_ns, second.stamp_ns]),
        np.concatenate([first.position_m, second.position_m]),
        np.concatenate([first.quat_xyzw, second.quat_xyzw]),
    )
