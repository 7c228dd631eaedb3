"""Wrenches on the object, as columns."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.errors import UsageError
from contact_tracker.geometry.vectors import cross
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.real_numbers import real_numbers

Array = NDArray[np.float64]

GREATEST_N: Final = 1e6
"""No sensor measures more (N, N m): what is beyond is not a measurement."""


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

    stamp_ns: NDArray[np.int64]
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
        for name, values in zip(("force_n", "moment_nm"), numbers, strict=True):
            object.__setattr__(self, name, values)
        shape = (len(self.stamp_ns), 3)
        if np.shape(self.force_n) != shape or np.shape(self.moment_nm) != shape:
            shapes = f"{np.shape(self.force_n)} and {np.shape(self.moment_nm)}"
            raise UsageError(f"{shape[0]} wrenches need forces and moments of shape {shape}, not {shapes}")

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def valid(self) -> "Wrenches":
        """Those that are finite and no larger than ``GREATEST_N``, in order of time; of one stamp the
        first."""
        numbers = np.concatenate([self.force_n, self.moment_nm], axis=1)
        good = np.flatnonzero((np.abs(numbers) <= GREATEST_N).all(axis=1))  # false of NaN
        _, first = np.unique(self.stamp_ns[good], return_index=True)
        return self.at(good[first])

    def at(self, rows: NDArray[np.int64]) -> "Wrenches":
        """Those of these rows, in their order."""
        return Wrenches(self.stamp_ns[rows], self.force_n[rows], self.moment_nm[rows])


def reversed_wrenches(wrenches: Wrenches) -> Wrenches:
    """The reactions: forces and moments with the opposite sign."""
    return Wrenches(wrenches.stamp_ns, -wrenches.force_n, -wrenches.moment_nm)


def about_body(wrenches: Wrenches, poses: Poses) -> Wrenches:
    """Wrenches that are given about the world's origin and in its axes, about the body's and in its own.

    Each takes the pose nearest in time; ``poses`` are in order of time, and there is one at least.
    """
    nearest = _nearest(wrenches, poses)
    moment = wrenches.moment_nm - cross(nearest.position_m, wrenches.force_n)
    return _turned_to(nearest, Wrenches(wrenches.stamp_ns, wrenches.force_n, moment))


def turned_to_body(wrenches: Wrenches, poses: Poses) -> Wrenches:
    """Wrenches that are given about the body's origin in the axes of the world, in the body's own axes; as
    ``about_body``."""
    return _turned_to(_nearest(wrenches, poses), wrenches)


def _nearest(wrenches: Wrenches, poses: Poses) -> Poses:
    """The pose nearest in time to each wrench."""
    after = np.clip(poses.stamp_ns.searchsorted(wrenches.stamp_ns), 1, max(len(poses) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(poses) - 1)
    is_nearer = poses.stamp_ns[after] - wrenches.stamp_ns < wrenches.stamp_ns - poses.stamp_ns[before]
    return poses[np.where(is_nearer, after, before)]


def _turned_to(poses: Poses, wrenches: Wrenches) -> Wrenches:
    """Wrenches in the axes of the bodies that have these poses, one for each."""
    force_n, moment_nm = (
        np.einsum("tji,tj->ti", poses.rotation, values) for values in (wrenches.force_n, wrenches.moment_nm)
    )
    return Wrenches(wrenches.stamp_ns, force_n, moment_nm)


def about_parent(wrenches: Wrenches, frames: Poses) -> Wrenches:
    """Wrenches in moving frames, transformed to the parent of these; ``frames`` (one for each wrench) are
    their poses in the parent."""
    turned = frames.rotation
    force_n = np.einsum("tij,tj->ti", turned, wrenches.force_n)
    moment = np.einsum("tij,tj->ti", turned, wrenches.moment_nm)
    return Wrenches(wrenches.stamp_ns, force_n, moment + cross(frames.position_m, force_n))
