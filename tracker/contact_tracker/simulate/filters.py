"""Filters that recording software puts poses through: their noise is correlated afterwards."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt

from contact_tracker.motion.poses import Poses

Array = NDArray[np.float64]


def rate_hz(poses: Poses) -> float:
    """Of the median step between stamps."""
    return 1e9 / float(np.median(np.diff(poses.stamp_ns)))


def smoothed(poses: Poses, smooth: Callable[[Array], Array]) -> Poses:
    """Positions and quaternions (their signs do not jump) through a filter along the first axis."""
    quat = smooth(poses.quat_xyzw)
    norm = np.linalg.norm(quat, axis=1)[:, None]
    return replace(poses, position_m=smooth(poses.position_m), quat_xyzw=quat / norm)


def low_pass(poses: Poses, cutoff_hz: float) -> Poses:
    """Butterworth of second order, forth and back; slow poses are left as they are."""
    if rate_hz(poses) <= 2.2 * cutoff_hz:
        return poses
    b, a = butter(2, 2.0 * cutoff_hz / rate_hz(poses))
    return smoothed(poses, lambda rows: np.asarray(filtfilt(b, a, rows, axis=0)))
