"""Distortions of real logs, applied to the poses of a labelled recording; the truth is unchanged.

Each distortion takes poses and a random generator and returns poses in the order of their arrival, with the
stamps of their headers: before the gate.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation, Slerp

from contact_tracker.arrays import Array, Bools
from contact_tracker.motion.poses import Poses
from contact_tracker_lab.simulate.simulator import low_pass, rate_hz, smoothed

Random = np.random.Generator
Distortion = Callable[[Poses, Random], Poses]

IDENTITY: Final = (0.0, 0.0, 0.0, 1.0)
WANDER_M, WANDER_DEG, WANDER_S = 1e-3, 0.3, 2.0
"""Correlated errors: standard deviations per axis, and the time after which the autocorrelation is 1/e."""


def seconds(poses: Poses) -> Array:
    """Times (N,) since the first pose."""
    return np.asarray((poses.stamp_ns - poses.stamp_ns[0]) * 1e-9)


def turned(poses: Poses, turn: Array) -> Array:
    """Quaternions (N, 4) after turns (N, 3) about the body's axes."""
    return np.asarray((Rotation.from_quat(poses.quat_xyzw) * Rotation.from_rotvec(turn)).as_quat())


# Filters and interpolation before recording, which correlate the noise.


def moving_average(poses: Poses, frames: int) -> Poses:
    def smooth(rows: Array) -> Array:
        wide = np.pad(rows, ((frames // 2, frames // 2), (0, 0)), mode="edge")
        return np.asarray(np.array([wide[i : i + len(rows)] for i in range(frames)]).mean(axis=0))

    return smoothed(poses, smooth)


def exponential(poses: Poses, share: float) -> Poses:
    """A causal filter of first order with the gain ``share``."""

    def smooth(rows: Array) -> Array:
        start = (1.0 - share) * rows[:1]
        return np.asarray(lfilter([share], [1.0, share - 1.0], rows, axis=0, zi=start)[0])

    return smoothed(poses, smooth)


def interpolated(poses: Poses) -> Poses:
    """Every other pose is interpolated between its neighbours."""
    kept = np.arange(0, len(poses), 2)
    poses = poses[: kept[-1] + 1]
    at_s, known_s = seconds(poses), seconds(poses)[kept]
    position = [np.interp(at_s, known_s, column) for column in poses.position_m[kept].T]
    quat = Slerp(known_s, Rotation.from_quat(poses.quat_xyzw[kept]))(at_s).as_quat()
    return replace(poses, position_m=np.stack(position, axis=1), quat_xyzw=quat)


# Correlated errors.


def bent(poses: Poses, rng: Random) -> Poses:
    """Errors of camera calibration: 0.5 mm that vary over 0.3 m, 0.1 deg that vary with the orientation."""
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 3))
    wave = np.sin(2.0 * np.pi * poses.position_m[:, None] / 0.3 + phase).sum(axis=2)
    turn = np.radians(0.1) * np.sin(2.0 * Rotation.from_quat(poses.quat_xyzw).as_rotvec() + phase[0])
    position = poses.position_m + wave * (0.0005 / np.sqrt(1.5))
    return replace(poses, position_m=position, quat_xyzw=turned(poses, turn))


def wandering(poses: Poses, rng: Random) -> Poses:
    """Errors of 1 mm and 0.3 deg with a correlation time of 2 s, in addition to the noise."""
    keep = np.exp(-np.diff(seconds(poses), prepend=0.0) / WANDER_S)
    fresh = np.sqrt(1.0 - keep**2)[:, None] * rng.normal(size=(len(poses), 6))
    error = np.zeros(6)
    errors = np.array([error := k * error + new for k, new in zip(keep, fresh, strict=True)])
    position = poses.position_m + WANDER_M * errors[:, :3]
    return replace(
        poses, position_m=position, quat_xyzw=turned(poses, np.radians(WANDER_DEG) * errors[:, 3:])
    )


# Failures of the sensor.


def random_intervals(poses: Poses, rng: Random, share: float, mean_s: float) -> Bools:
    """Which poses (N,) are in intervals of random length that cover this share of the time."""
    at_s, inside = seconds(poses), np.zeros(len(poses), bool)
    while inside.mean() < share:
        begin = rng.uniform(0.0, at_s[-1])
        inside |= (at_s >= begin) & (at_s < begin + rng.exponential(mean_s))
    return inside


def default_where(poses: Poses, hidden: Bools) -> Poses:
    """The identity while the object is hidden."""
    position, quat = poses.position_m.copy(), poses.quat_xyzw.copy()
    position[hidden], quat[hidden] = 0.0, IDENTITY
    return replace(poses, position_m=position, quat_xyzw=quat)


def frozen(poses: Poses, rng: Random) -> Poses:
    """The last pose repeated while the object is lost."""
    lost = random_intervals(poses, rng, 0.1, 0.4)
    lost[0] = False
    last = np.maximum.accumulate(np.where(lost, 0, np.arange(len(poses))))
    return replace(poses, position_m=poses.position_m[last], quat_xyzw=poses.quat_xyzw[last])


def swapped(poses: Poses, rng: Random) -> Poses:
    """Swapped markers: 20 mm and 8 deg off for 0.1 s, in 5 % of the time."""
    off = random_intervals(poses, rng, 0.05, 0.1)
    number = np.cumsum(np.diff(off, prepend=False) & off) * off  # of the burst, zero outside
    ways = rng.normal(size=(2, number.max() + 1, 3))
    ways /= np.linalg.norm(ways, axis=2, keepdims=True)
    ways[:, 0] = 0.0
    position = poses.position_m + 0.02 * ways[0, number]
    return replace(poses, position_m=position, quat_xyzw=turned(poses, np.radians(8.0) * ways[1, number]))


# Low rate, wrong stamps and missing poses.


def thinned(poses: Poses, hz: float, jitter_s: float, rng: Random) -> Poses:
    """Poses at the rate ``hz``, with jitter."""
    grid = np.arange(poses.stamp_ns[0], poses.stamp_ns[-1], round(1e9 / hz))
    grid = np.sort(grid + (1e9 * rng.normal(0.0, jitter_s, len(grid))).astype(np.int64))
    return poses[np.unique(np.clip(np.searchsorted(poses.stamp_ns, grid), 0, len(poses) - 1))]


def leading(poses: Poses, rng: Random) -> Poses:
    """One stamp in a thousand is a second ahead."""
    ahead = rng.uniform(size=len(poses)) < 0.001
    return replace(poses, stamp_ns=poses.stamp_ns + 1_000_000_000 * ahead)


def jittering(poses: Poses, rng: Random) -> Poses:
    """Stamps of receipt: jitter of half a period, in order."""
    period_ns = 1e9 / rate_hz(poses)
    jitter_ns = (rng.normal(0.0, 0.5, len(poses)) * period_ns).astype(np.int64)
    return replace(poses, stamp_ns=np.sort(poses.stamp_ns + jitter_ns))


DISTORTIONS: Final[dict[str, Distortion]] = {
    "none": lambda poses, _: poses,
    "moving_average_3": lambda poses, _: moving_average(poses, 3),
    "moving_average_5": lambda poses, _: moving_average(poses, 5),
    "interpolated_2x": lambda poses, _: interpolated(poses),
    "exponential_03": lambda poses, _: exponential(poses, 0.3),
    "lowpass_20hz": lambda poses, _: low_pass(poses, 20.0),
    "lowpass_8hz": lambda poses, _: low_pass(poses, 8.0),
    "volume_distortion": bent,
    "slow_wander": wandering,
    "default_pose_8pct": lambda poses, rng: default_where(poses, rng.uniform(size=len(poses)) < 0.08),
    "default_pose_stretches": lambda poses, rng: default_where(poses, random_intervals(poses, rng, 0.1, 0.4)),
    "frozen_stretches": frozen,
    "shifted_bursts": swapped,
    "rate_10hz_jitter": lambda poses, rng: thinned(poses, 10.0, 0.01, rng),
    "rate_5hz": lambda poses, rng: thinned(poses, 5.0, 0.0, rng),
    "dropouts_50pct": lambda poses, rng: poses[rng.uniform(size=len(poses)) < 0.5],
    "dropout_bursts_30pct": lambda poses, rng: poses[~random_intervals(poses, rng, 0.3, 0.15)],
    "stamps_ahead": leading,
    "stamp_jitter": jittering,
}
