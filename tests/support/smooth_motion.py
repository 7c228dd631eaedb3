"""Smooth random motion with sensor noise, for tests of noise, free motion and ticks."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Pose, Poses

Array = NDArray[np.float64]
START_NS = 1_700_000_000_123_456_789


def smooth(rng: np.random.Generator, time_s: Array, rms: float, bandwidth_hz: float = 1.0) -> Array:
    """Three independent smooth signals (N, 3) of root mean square ``rms``: sums of slow sinusoids."""
    waves = 12
    frequency = rng.uniform(0.1, bandwidth_hz, (waves, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (waves, 3))
    signal = np.sin(2.0 * np.pi * frequency * time_s[:, None, None] + phase).sum(axis=1)
    return np.asarray(signal * rms / np.sqrt(waves / 2.0))


def moving(
    rng: np.random.Generator,
    seconds: float,
    rate_hz: float,
    sigma_m: float | Array = 0.0,
    sigma_rad: float | Array = 0.0,
    rms_m: float = 0.05,
    rms_rad: float = 0.4,
) -> Poses:
    """Free motion by hand, with white noise per axis (rotation in the body frame)."""
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    position = smooth(rng, time_s, rms_m) + rng.normal(size=(len(time_s), 3)) * sigma_m
    turn = Rotation.random(random_state=rng) * Rotation.from_rotvec(smooth(rng, time_s, rms_rad))
    noise = Rotation.from_rotvec(rng.normal(size=(len(time_s), 3)) * sigma_rad)
    stamp_ns = START_NS + np.rint(time_s * 1e9).astype(np.int64)
    return Poses(stamp_ns, position, (turn * noise).as_quat())


def least_jerk(share: ArrayLike) -> Array:
    """The way from 0 to 1 of a move by hand, at these shares of its time; it rests before and after."""
    part = np.clip(np.asarray(share, float), 0.0, 1.0)
    return np.asarray(part**3 * (10.0 - 15.0 * part + 6.0 * part**2))


def with_noise(
    rng: np.random.Generator,
    time_s: Array,
    position_m: Array,
    turn: Rotation,
    sigma_m: float = 3e-4,
    sigma_rad: float = float(np.radians(0.15)),
) -> Poses:
    """Poses of an exact motion with white noise per axis (rotation in the body frame)."""
    error = Rotation.from_rotvec(sigma_rad * rng.normal(size=position_m.shape))
    measured_m = position_m + sigma_m * rng.normal(size=position_m.shape)
    return Poses(np.rint(1e9 * time_s).astype(np.int64), measured_m, (turn * error).as_quat())


def exact_transfers(rng: np.random.Generator, seconds: float, rate_hz: float) -> Poses:
    """A robot's commanded poses, without noise: straight moves with a constant acceleration, speed and
    deceleration, and rests between."""
    time_s, begin_s, ramp = np.arange(0.0, seconds, 1.0 / rate_hz), 0.0, 0.25
    place = np.zeros((len(time_s), 6))
    while begin_s < seconds:
        move_s, rest_s = rng.uniform(0.8, 2.0), rng.uniform(0.2, 0.8)
        way = rng.uniform(-1.0, 1.0, 6) * np.repeat([0.15, 0.4], 3)
        share = np.clip((time_s - begin_s) / move_s, 0.0, 1.0)
        parts = [share**2 / (2.0 * ramp), share - 0.5 * ramp, 1.0 - ramp - (1.0 - share) ** 2 / (2.0 * ramp)]
        place += (
            np.select([share < ramp, share < 1.0 - ramp], parts[:2], parts[2])[:, None] / (1 - ramp) * way
        )
        begin_s += move_s + rest_s
    stamp_ns = START_NS + np.rint(time_s * 1e9).astype(np.int64)
    return Poses(stamp_ns, place[:, :3], Rotation.from_rotvec(place[:, 3:]).as_quat())


def slid_and_tilted(rng: np.random.Generator, size_m: Array) -> Poses:
    """A box that slides and turns on the table z = 0, for 8 s on a face and then on an edge; poses of its
    middle."""
    time_s = np.arange(0.0, 18.0, 1.0 / 150.0)
    yaw, (x, y, roll) = 0.8 * np.sin(0.9 * time_s), smooth(rng, time_s, 0.08, 0.4).T
    begun = np.clip(time_s - 8.0, 0.0, 1.0)
    tilt = begun**2 * (3.0 - 2.0 * begun) * (0.45 + roll)
    turn = Rotation.from_euler("ZX", np.column_stack([yaw, tilt]))
    edge_m = -0.5 * size_m * [0.0, 1.0, 1.0]
    place_m = np.column_stack([x, y, 0.0 * x]) - turn.apply(edge_m)
    poses = with_noise(rng, time_s, place_m, turn)
    return replace(poses, stamp_ns=START_NS + poses.stamp_ns)


def unturned(position_m: ArrayLike, period_ns: int = 10_000_000, start_ns: int = 0) -> Poses:
    """Poses at these positions (N, 3) without turns, by default at 100 Hz."""
    position = np.array(position_m, float)
    stamp_ns = start_ns + period_ns * np.arange(len(position), dtype=np.int64)
    return Poses(stamp_ns, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(position), 1)))


def pass_through(poses: Iterable[Pose]) -> tuple[list[Pose], dict[str, int]]:
    """What a gate passes on of poses that come one by one, and its counts."""
    gate = PoseGate()
    kept = [admitted for pose in poses for admitted in gate.admit(pose)]
    kept += gate.finish()
    return kept, dict(gate.counts)
