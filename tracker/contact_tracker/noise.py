"""Sensor noise from the stream itself: what third differences of the poses leave of the motion.

Motion is smooth from frame to frame and noise is not. The median makes outliers and jolts harmless.
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
REGULAR: Final = 1.5
"""Differences are only taken where the interval is within this factor of the usual one."""
_GAIN: Final = float(sum(comb(ORDER, i) ** 2 for i in range(ORDER + 1)))
_MEDIAN_OF_CHI_SQ: Final = 0.4549364231195724


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Squared third differences of the last frames, (n, 3) in m^2 and rad^2, scaled to the noise variance."""

    position_sq: Array
    rotation_sq: Array
    recent: Poses
    sigma_position_m: float
    sigma_rotation_rad: float


def begin(sigma_position_m: float, sigma_rotation_rad: float) -> NoiseEstimate:
    """Start from the model's noise."""
    empty = np.zeros((0, 3))
    return NoiseEstimate(empty, empty, Poses.collect([]), sigma_position_m, sigma_rotation_rad)


def advance(estimate: NoiseEstimate, frames: Poses, prior: tuple[float, float]) -> NoiseEstimate:
    """Take in the frames of one tick; ``prior`` are the model's deviations (m, rad)."""
    recent = _join(estimate.recent, frames)
    position, rotation = _third_differences(recent)
    position_sq = np.concatenate([estimate.position_sq, position])[-MEMORY_FRAMES:]
    rotation_sq = np.concatenate([estimate.rotation_sq, rotation])[-MEMORY_FRAMES:]
    return NoiseEstimate(
        position_sq,
        rotation_sq,
        recent[-ORDER:],
        _sigma(position_sq, prior[0]),
        _sigma(rotation_sq, prior[1]),
    )


def estimate_noise(poses: Poses) -> tuple[float, float]:
    """Standard deviations per axis (m, rad) of a whole recording, nan where it is too short to tell."""
    position, rotation = _third_differences(poses[poses.fresh])
    return _median_sigma(position), _median_sigma(rotation)


def _third_differences(frames: Poses) -> tuple[Array, Array]:
    if len(frames) <= ORDER:
        return np.zeros((0, 3)), np.zeros((0, 3))
    turn = Rotation.from_quat(frames.quat_xyzw)
    steps = (turn[:-1].inv() * turn[1:]).as_rotvec()
    interval = np.diff(frames.stamp_ns).astype(float)
    widest = np.lib.stride_tricks.sliding_window_view(interval, ORDER)
    regular = widest.max(axis=1) < REGULAR * np.median(interval)
    position = np.diff(frames.position_m, ORDER, axis=0)[regular]
    rotation = np.diff(steps, ORDER - 1, axis=0)[regular]
    return np.square(position) / _GAIN, np.square(rotation) / _GAIN


def _sigma(squares: Array, prior: float) -> float:
    frames = len(squares)
    if frames < ORDER:
        return prior
    measured = max(_median_sigma(squares), 1e-3 * prior)
    share = frames / (frames + PRIOR_FRAMES)
    return float(np.exp(share * np.log(measured) + (1.0 - share) * np.log(prior)))


def _median_sigma(squares: Array) -> float:
    if not len(squares):
        return float("nan")
    return float(np.sqrt(np.mean(np.median(squares, axis=0)) / _MEDIAN_OF_CHI_SQ))


def _join(first: Poses, second: Poses) -> Poses:
    return Poses(
        np.concatenate([first.stamp_ns, second.stamp_ns]),
        np.concatenate([first.position_m, second.position_m]),
        np.concatenate([first.quat_xyzw, second.quat_xyzw]),
    )
