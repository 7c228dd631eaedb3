"""Wrenches on the object, as columns."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.errors import UsageError
from contact_tracker.geometry.linalg import between, cross, matrices, nearest, rotation_vectors
from contact_tracker.motion.poses import Poses, real_numbers

GREATEST_N: Final = 1e6
"""Largest value (N, N m) that counts as a measurement."""


@dataclass(frozen=True, eq=False)
class Wrenches:
    """N wrenches on the object about the body's origin, in the body's axes, in order of time.

    Parameters
    ----------
    stamp_ns : (N,) integer nanoseconds, on the clock of the poses.
    force_n, moment_nm : (N, 3) in newtons and newton metres.

    Raises
    ------
    UsageError
        The shapes differ, the stamps are not integers, or the others no real numbers.
    """

    stamp_ns: Ints
    force_n: Array
    moment_nm: Array

    def __post_init__(self) -> None:
        try:
            stamp_ns = np.asarray(self.stamp_ns)
            numbers = real_numbers(self.force_n), real_numbers(self.moment_nm)
        except (TypeError, ValueError, OverflowError) as error:
            raise UsageError("forces and moments are no real numbers") from error
        if stamp_ns.ndim != 1 or (len(stamp_ns) and stamp_ns.dtype.kind not in "iu"):
            raise UsageError("stamps of wrenches are (N,) integers in nanoseconds: multiply seconds by 1e9")
        object.__setattr__(self, "stamp_ns", stamp_ns.astype(np.int64))
        object.__setattr__(self, "force_n", numbers[0])
        object.__setattr__(self, "moment_nm", numbers[1])
        shape = (len(self.stamp_ns), 3)
        if np.shape(self.force_n) != shape or np.shape(self.moment_nm) != shape:
            shapes = f"{np.shape(self.force_n)} and {np.shape(self.moment_nm)}"
            raise UsageError(f"{shape[0]} wrenches need forces and moments of shape {shape}, not {shapes}")

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def valid(self) -> "Wrenches":
        """The finite wrenches no larger than ``GREATEST_N`` in order of time; the first of those with equal
        stamps."""
        numbers = np.concatenate([self.force_n, self.moment_nm], axis=1)
        finite = np.flatnonzero((np.abs(numbers) <= GREATEST_N).all(axis=1))  # false for NaN
        _, first = np.unique(self.stamp_ns[finite], return_index=True)
        return self.at(finite[first])

    def at(self, rows: Ints) -> "Wrenches":
        """The wrenches in ``rows``, in this order."""
        return Wrenches(self.stamp_ns[rows], self.force_n[rows], self.moment_nm[rows])


def reversed_wrenches(wrenches: Wrenches) -> Wrenches:
    """The reaction wrenches: forces and moments with the opposite sign."""
    return replace(wrenches, force_n=-wrenches.force_n, moment_nm=-wrenches.moment_nm)


def about_body(wrenches: Wrenches, poses: Poses, from_world: bool = True) -> Wrenches:
    """Wrenches given in the world's axes about its origin, or if not ``from_world`` about the body's, about
    the body's origin in its own axes.

    Each wrench is turned by the pose nearest in time; ``poses``: at least one, in order of time.
    """
    later = np.clip(poses.stamp_ns.searchsorted(wrenches.stamp_ns), 1, max(len(poses) - 1, 1))
    earlier = later - 1
    later = np.minimum(later, len(poses) - 1)
    is_nearer = poses.stamp_ns[later] - wrenches.stamp_ns < wrenches.stamp_ns - poses.stamp_ns[earlier]
    pose = poses[np.where(is_nearer, later, earlier)]
    turn = pose.rotation.swapaxes(1, 2)
    return _moved(wrenches, turn, np.einsum("tij,tj->ti", turn, -float(from_world) * pose.position_m))


def about_parent(wrenches: Wrenches, frames: Poses) -> Wrenches:
    """Wrenches in moving frames, transformed to the parent of these; ``frames`` (one for each wrench) are
    their poses in the parent."""
    return _moved(wrenches, frames.rotation, frames.position_m)


def _moved(wrenches: Wrenches, rotation: Array, position_m: Array) -> Wrenches:
    """Wrenches in frames with ``rotation`` (N, 3, 3) at ``position_m`` (N, 3) of another one, in that one."""
    force_n, moment_nm = (
        np.einsum("tij,tj->ti", rotation, vectors) for vectors in (wrenches.force_n, wrenches.moment_nm)
    )
    return Wrenches(wrenches.stamp_ns, force_n, moment_nm + cross(position_m, force_n))


STEADY: Final = 1.5
"""Largest interval of ticks for accelerations, relative to the median."""
LEAST_VARIANCE: Final = (0.05**2, 0.005**2)
"""Least variance of a tick's mean (N^2, (N m)^2), by sensor and tremor."""


@dataclass(frozen=True, eq=False)
class TickWrenches:
    """Poses and wrenches of T ticks; values without measurements (``is_measured`` False) are zero.

    Parameters
    ----------
    stamp_ns : (T,) when each ends.
    rotation, position_m : (T, 3, 3), (T, 3) mean pose ``T_world_body``.
    acceleration : (T, 3) of the body's origin, in the body's axes (m/s^2).
    angular_velocity, angular_acceleration : (T, 3) in the body's axes (rad/s, rad/s^2).
    force_n, moment_nm : (T, 3) mean measured wrench about the body's origin, in the body's axes.
    force_variance, moment_variance : (T,) of the mean, per axis, by the scatter within the tick; at least
        ``LEAST_VARIANCE``.
    is_measured : (T,) whether a tick has wrenches, and it and its neighbours have poses.
    """

    stamp_ns: Ints
    rotation: Array
    position_m: Array
    acceleration: Array
    angular_velocity: Array
    angular_acceleration: Array
    force_n: Array
    moment_nm: Array
    force_variance: Array
    moment_variance: Array
    is_measured: Bools

    def at(self, rows: Ints) -> "TickWrenches":
        """Only these ticks."""
        return TickWrenches(*(column[rows] for column in vars(self).values()))


def average(poses: Poses, wrenches: Wrenches, stamp_ns: Ints) -> TickWrenches:
    """Mean poses and wrenches of the ticks that end at ``stamp_ns`` (T,), each beginning at the end of the
    one before."""
    pose_rows, rows = (
        np.append(0, stream.stamp_ns.searchsorted(stamp_ns, side="right")) for stream in (poses, wrenches)
    )
    mean = _means(poses.rotation.reshape(-1, 9), pose_rows).reshape(-1, 3, 3)
    quat = np.array([nearest(matrix) for matrix in mean]).reshape(-1, 4)
    position_m = _means(poses.position_m, pose_rows)
    time_s = _means((poses.stamp_ns - poses.stamp_ns[0])[:, None] * 1e-9, pose_rows)[:, 0]
    steady = _is_steady(time_s, np.diff(pose_rows) > 0)
    return TickWrenches(
        stamp_ns,
        matrices(quat),
        position_m,
        *_motion(quat, position_m, time_s, steady),
        _means(wrenches.force_n, rows),
        _means(wrenches.moment_nm, rows),
        np.maximum(_variances(wrenches.force_n, rows), LEAST_VARIANCE[0]),
        np.maximum(_variances(wrenches.moment_nm, rows), LEAST_VARIANCE[1]),
        steady & (np.diff(rows) > 0),
    )


def _means(values: Array, rows: Ints) -> Array:
    """Means (T, D) of the rows (N, D) between bounds; zero without rows."""
    near = values.mean(axis=0) if len(values) else 0.0  # sums of deviations from it are more precise
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values - near, axis=0)])
    count = np.diff(rows)[:, None]
    mean = np.diff(sums[rows], axis=0) / np.maximum(count, 1) + near
    return np.asarray(np.where(count, mean, 0.0))


def _variances(values: Array, rows: Ints) -> Array:
    """Variances (T,) per axis of the means of rows (N, 3) between bounds; the median for a single row.

    Neighbours differ by noise and by half of the change in a tick, so the scatter bounds both.
    """
    count = np.diff(rows)
    mean = np.repeat(_means(values, rows), count, axis=0)
    squares = ((values[rows[0] : rows[-1]] - mean) ** 2).sum(axis=1)[:, None]
    scatter = _means(squares, rows - rows[0])[:, 0] / 3.0
    has_scatter = count > 1
    usual = float(np.median(scatter[has_scatter])) if has_scatter.any() else 0.0
    return np.asarray(np.where(has_scatter, scatter / np.maximum(count - 1, 1), usual))


def _is_steady(time_s: Array, has_poses: Bools) -> Bools:
    """Whether a tick has poses, and both neighbours are at the usual distance."""
    steps = np.diff(time_s)
    steady = np.zeros(len(time_s), bool)
    if len(time_s) < 3:
        return steady
    consecutive = has_poses[1:] & has_poses[:-1] & (steps > 0.0)
    usual = np.median(steps[consecutive]) if consecutive.any() else 0.0
    near = consecutive & (steps < STEADY * usual) & (steps > usual / STEADY)
    steady[1:-1] = near[1:] & near[:-1]
    return steady


def _motion(quat: Array, position_m: Array, time_s: Array, steady: Bools) -> tuple[Array, Array, Array]:
    """Acceleration of the origin, angular velocity and acceleration (T, 3), in the body's axes; zero where
    not ``steady``."""
    linear, spin, turning = np.zeros((3, len(time_s), 3))
    if len(time_s) < 3:
        return linear, spin, turning
    step_s = np.diff(time_s)[:, None]
    step_s = np.where(step_s > 0.0, step_s, np.inf)
    velocity = np.diff(position_m, axis=0) / step_s
    rate = rotation_vectors(between(quat[:-1], quat[1:])) / step_s
    between_s = 0.5 * (step_s[1:] + step_s[:-1])
    linear[1:-1] = np.einsum("tji,tj->ti", matrices(quat[1:-1]), np.diff(velocity, axis=0) / between_s)
    spin[1:-1] = 0.5 * (rate[1:] + rate[:-1])
    turning[1:-1] = np.diff(rate, axis=0) / between_s
    for values in (linear, spin, turning):
        values[~steady] = 0.0
    return linear, spin, turning
