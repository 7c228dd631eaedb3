"""Measurement of poses: stamps, noise, outliers, dropouts, repeated poses, and filters of the noise."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt
from scipy.spatial.transform import Rotation

from contact_tracker.geometry.polyhedron import unit
from contact_tracker.motion.poses import Poses
from contact_tracker_lab.simulate.chart import Rigid
from contact_tracker_lab.simulate.scenarios import Scenario

Array = NDArray[np.float64]

START_NS = 1_700_000_000_000_000_000
OUTLIER_M = (0.01, 0.06)
OUTLIER_RAD = (float(np.radians(4.0)), float(np.radians(25.0)))


def stamps(rng: np.random.Generator, count: int, scenario: Scenario) -> NDArray[np.int64]:
    """Stamps (count,) in ns, strictly increasing; jitter moves the stamp, not the pose."""
    period = 1e9 / scenario.rate_hz
    jitter = np.clip(rng.normal(0.0, 1.0, count) * scenario.jitter_s * 1e9, -0.4 * period, 0.4 * period)
    return START_NS + np.rint(np.arange(count) * period + jitter).astype(np.int64)


def measure(rng: np.random.Generator, stamp_ns: NDArray[np.int64], pose: Rigid, scenario: Scenario) -> Poses:
    """Measured poses of the true poses ``pose`` (N,) of the body in the world."""
    count = len(stamp_ns)
    turn = rng.normal(0.0, 1.0, (count, 3)) * scenario.sigma_rotation_rad
    shift = rng.normal(0.0, 1.0, (count, 3)) * scenario.sigma_position_m
    wrong = rng.random(count) < scenario.outlier_probability
    turn[wrong] += _random_vectors(rng, count, OUTLIER_RAD)[wrong]
    shift[wrong] += _random_vectors(rng, count, OUTLIER_M)[wrong]
    quat = (Rotation.from_matrix(pose.rotation) * Rotation.from_rotvec(turn)).as_quat()
    same = np.einsum("ni,ni->n", quat[1:], quat[:-1]) >= 0.0
    quat[1:] *= np.cumprod(np.where(same, 1.0, -1.0))[:, None]  # q and -q are one rotation
    fresh = rng.random(count) >= scenario.hold_probability
    fresh[0] = True
    source = np.maximum.accumulate(np.where(fresh, np.arange(count), 0))
    kept = rng.random(count) >= scenario.drop_probability
    kept[0] = True
    return Poses(stamp_ns, (pose.translation + shift)[source], quat[source])[kept]


def _random_vectors(rng: np.random.Generator, count: int, length: tuple[float, float]) -> Array:
    """Vectors (count, 3) of random direction, with lengths uniform in ``length``."""
    directions = unit(rng.normal(0.0, 1.0, (count, 3)))
    return np.asarray(directions * rng.uniform(*length, (count, 1)), float)


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
