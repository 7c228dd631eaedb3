"""Poses of the object: one value, a column of them, and the gate that validates what enters.

``T_world_body``: ``x_world = R x_body + t``. Quaternions are ``xyzw``. Stamps are integer nanoseconds.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.quaternions import matrices

Array = NDArray[np.float64]


class Pose(NamedTuple):
    """One measured pose ``T_world_body``; plain floats, so that streams of them are cheap."""

    stamp_ns: int
    position_m: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Poses:
    """Columns of poses: ``stamp_ns`` (N,) int64, ``position_m`` (N, 3), ``quat_xyzw`` (N, 4)."""

    stamp_ns: NDArray[np.int64]
    position_m: Array
    quat_xyzw: Array

    @classmethod
    def collect(cls, poses: Iterable[Pose]) -> "Poses":
        rows = list(poses)
        return cls(
            np.array([p.stamp_ns for p in rows], np.int64),
            np.array([p.position_m for p in rows], float).reshape(-1, 3),
            np.array([p.quat_xyzw for p in rows], float).reshape(-1, 4),
        )

    @classmethod
    def join(cls, parts: Sequence["Poses"]) -> "Poses":
        """Poses one after the other, copied."""
        parts = parts or [cls.collect([])]
        return cls(
            np.concatenate([part.stamp_ns for part in parts]),
            np.concatenate([part.position_m for part in parts]),
            np.concatenate([part.quat_xyzw for part in parts]),
        )

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def __iter__(self) -> Iterator[Pose]:
        columns = (self.stamp_ns.tolist(), self.position_m.tolist(), self.quat_xyzw.tolist())
        for stamp, position, quat in zip(*columns, strict=True):
            yield Pose(stamp, tuple(position), tuple(quat))

    def __getitem__(self, rows: slice | NDArray[np.generic]) -> "Poses":
        return Poses(self.stamp_ns[rows], self.position_m[rows], self.quat_xyzw[rows])

    @property
    def fresh(self) -> NDArray[np.bool_]:
        """(N,) whether a pose differs from the one before; one that is held says nothing new."""
        new = np.ones(len(self), bool)
        new[1:] = (self.position_m[1:] != self.position_m[:-1]).any(axis=1)
        new[1:] |= (self.quat_xyzw[1:] != self.quat_xyzw[:-1]).any(axis=1)
        return new

    @property
    def rotation(self) -> Array:
        """Rotation matrices (N, 3, 3) of ``T_world_body``."""
        return matrices(self.quat_xyzw)
