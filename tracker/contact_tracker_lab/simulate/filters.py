"""Filters of recording software, which correlate the noise of poses."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt

from contact_tracker.motion.poses import Poses

Array = NDArray[np.float64]


def rate_hz(poses: Poses) -> float:
    """Pose rate by the median step between stamps."""
    return 1e9 / float(np.median(np.diff(poses.stamp_ns)))


def smoothed(poses: Poses, smooth: Callable[[Array], Array]) -> Poses:
    """Apply a filter along time to positions and quaternions of continuous sign."""
    quat = smooth(poses.quat_xyzw)
    norm = np.linalg.norm(quat, axis=1)[:, None]
    return replace(poses, position_m=smooth(poses.position_m), quat_xyzw=quat / norm)


def low_pass(poses: Poses, cutoff_hz: float) -> Poses:
    """Second-order Butterworth filter, forward and backward; poses at too low a rate stay unchanged."""
    if rate_hz(poses) <= 2.2 * cutoff_hz:
        return poses
    b, a = butter(2, 2.0 * cutoff_hz / rate_hz(poses))
    return smoothed(poses, lambda rows: np.asarray(filtfilt(b, a, rows, axis=0)))
