"""Poses of the object: one value, a column of them, and the steps between consecutive ones.

``T_world_body``: ``x_world = R x_body + t``. Quaternions are ``xyzw``. Stamps are integer nanoseconds.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from math import nan, radians, sin, sqrt
from operator import attrgetter
from typing import Any, Final, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contact_tracker.arrays import Array
from contact_tracker.config.table_reading import AS_NAMED, TableReading, reading_of
from contact_tracker.errors import InvalidPose
from contact_tracker.geometry.linalg import matrices

BATCH: Final = 500
"""Number of poses per batch, where latency does not matter."""

_COLUMNS: Final = attrgetter("stamp_ns", "position_m", "quat_xyzw")


class Pose(NamedTuple):
    """One measured pose ``T_world_body``; plain floats, so that streams of them are cheap."""

    stamp_ns: int
    position_m: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


class ReadAs(NamedTuple):
    """How the poses of a stream were read, as the user asked.

    Parameters
    ----------
    frame_moves : whether they are in the frame of a body that moves. Then they look like inverse poses of
        that body, and are right.
    table : meaning of the columns of their table.
    path : of the table; empty for one in memory.
    turn : names of the columns of quaternions or angles, in the order of their roles, if others can be given.
    has_angles : whether the names of columns say that rotations are angles.
    """

    frame_moves: bool = False
    table: TableReading = AS_NAMED
    path: str = ""
    turn: tuple[str, ...] = ()
    has_angles: bool = False

    def command(self, **stated: Any) -> str:
        """The command that reads the table with these settings added or replaced."""
        return self.table.with_(reading_of(**stated)).command(self.path)


AS_GIVEN: Final = ReadAs()


@dataclass(frozen=True, eq=False)
class Poses:
    """Columns of poses: ``stamp_ns`` (N,) int64, ``position_m`` (N, 3), ``quat_xyzw`` (N, 4)."""

    stamp_ns: NDArray[np.int64]
    position_m: Array
    quat_xyzw: Array

    @classmethod
    def collect(cls, poses: Iterable[Pose]) -> "Poses":
        """Poses in columns; raises InvalidPose where stamps are no integers."""
        rows = list(poses)
        if not rows:
            return NO_POSES
        stamp_ns, position_m, quat_xyzw = zip(*rows, strict=True)
        stamps = np.array(stamp_ns)
        if stamps.dtype.kind == "f":
            raise InvalidPose("stamps are integers in nanoseconds: multiply seconds by 1e9 and round")
        return cls(stamps.astype(np.int64), np.array(position_m, float), np.array(quat_xyzw, float))

    @classmethod
    def join(cls, parts: Sequence["Poses | Pose"]) -> "Poses":
        """Concatenate parts, among which may be single poses."""
        if len(parts) == 1 and isinstance(parts[0], Poses):
            return parts[0]
        columns, single = list[Poses](), list[Pose]()
        for part in parts:
            if isinstance(part, Pose):
                single.append(part)
            else:
                columns += [cls.collect(single), part] if single else [part]
                single = []
        if single or not columns:
            columns.append(cls.collect(single))
        stamp_ns, position_m, quat_xyzw = zip(*map(_COLUMNS, columns), strict=True)
        return cls(np.concatenate(stamp_ns), np.concatenate(position_m), np.concatenate(quat_xyzw))

    @property
    def columns(self) -> tuple[NDArray[np.int64], Array, Array]:
        """The three columns."""
        return self.stamp_ns, self.position_m, self.quat_xyzw

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def __iter__(self) -> Iterator[Pose]:
        columns = (self.stamp_ns.tolist(), self.position_m.tolist(), self.quat_xyzw.tolist())
        for stamp, position, quat in zip(*columns, strict=True):
            yield Pose(stamp, tuple(position), tuple(quat))

    def of_point(self, point_m: Array) -> "Poses":
        """The poses of a frame with the same axes at ``point_m`` (3,) of the body frame."""
        if not point_m.any():
            return self
        return Poses(self.stamp_ns, self.position_m + (self.rotation * point_m).sum(axis=-1), self.quat_xyzw)

    def __getitem__(self, rows: slice | NDArray[np.generic]) -> "Poses":
        return Poses(self.stamp_ns[rows], self.position_m[rows], self.quat_xyzw[rows])

    def batches(self) -> Iterator["Poses"]:
        """Batches of a few seconds."""
        return (self[first : first + BATCH] for first in range(0, len(self), BATCH))

    def differ_from(self, previous: "Poses") -> NDArray[np.bool_]:
        """(N,) whether each pose differs, in a bit, from the one before it; the first from the last of
        ``previous``, if there is one."""
        differs = np.ones(self.stamp_ns.size, np.bool_)
        differs[1:] = (self.position_m[1:] != self.position_m[:-1]).any(axis=1)
        if previous.stamp_ns.size:
            differs[0] = (self.position_m[0] != previous.position_m[-1]).any()
        if not differs.all():
            differs[1:] |= (self.quat_xyzw[1:] != self.quat_xyzw[:-1]).any(axis=1)
            differs[0] |= not previous.stamp_ns.size or (self.quat_xyzw[0] != previous.quat_xyzw[-1]).any()
        return differs

    @property
    def fresh(self) -> "Poses":
        """The poses that do not repeat the one before."""
        differs = self.differ_from(NO_POSES)
        return self if differs.all() else self[differs]

    @property
    def rotation(self) -> Array:
        """Rotation matrices (N, 3, 3) of ``T_world_body``."""
        return matrices(self.quat_xyzw)


NO_POSES: Final = Poses(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)))


@runtime_checkable
class Batched(Protocol):
    """A stream of poses that comes in columns, none of them empty."""

    def batches(self) -> Iterator[Poses]: ...


def batches(poses: Iterable[Pose] | Batched) -> Iterator[Poses]:
    """A stream of poses in batches, in its order."""
    if isinstance(poses, Batched):
        yield from poses.batches()
        return
    stream = iter(poses)
    while rows := list(islice(stream, BATCH)):
        yield Poses.collect(rows)


NEAR_M: Final = 0.01
NEAR_TURN: Final = 2.0 * sin(radians(3.0) / 2.0)
"""A pose that is within both limits of the last one is near, whatever the motion."""


ARM_M: Final = 0.1
"""Lever arm with which turns count as distances."""
STEPS_KEPT: Final = 25
"""Number of steps that determine the usual step."""


class Step(NamedTuple):
    """``turn`` is twice the sine of half the angle: of small angles as good as the angle in radians."""

    distance_m: float
    turn: float


def reach(steps: Collection[Step], times: float, quantile: float) -> Step:
    """How far a pose may be from the last one: ``times`` the usual step, at least near."""
    if not steps:
        return Step(NEAR_M, NEAR_TURN)
    rank = int(quantile * (len(steps) - 1))
    distance_m = sorted(step.distance_m for step in steps)[rank]
    turn = sorted(step.turn for step in steps)[rank]
    return Step(max(NEAR_M, times * distance_m), max(NEAR_TURN, times * turn))


def step_between(a: Pose, b: Pose) -> Step:
    """The step from pose ``a`` to pose ``b``."""
    (ax, ay, az), (bx, by, bz) = a.position_m, b.position_m
    x, y, z = bx - ax, by - ay, bz - az
    (ax, ay, az, aw), (bx, by, bz, bw) = a.quat_xyzw, b.quat_xyzw
    cosine = ax * bx + ay * by + az * bz + aw * bw
    return Step(sqrt(x * x + y * y + z * z), 2.0 * sqrt(max(1.0 - cosine * cosine, 0.0)))


_NO_NUMBERS: Final = (bool, np.bool_, complex, np.complexfloating, str, bytes)


def real_number(value: Any) -> float:
    """``value`` as a float; raises TypeError, ValueError or OverflowError if it is no real number."""
    if isinstance(value, _NO_NUMBERS):
        raise TypeError(f"{value!r} is no real number")
    return float(value)


def real_numbers(values: ArrayLike) -> NDArray[np.float64]:
    """Numbers as floats, masked and absent ones as NaN; raises as ``real_number``."""
    numbers: np.ma.MaskedArray[Any, Any] = np.ma.asanyarray(values)
    if numbers.dtype.kind == "O":
        hidden = np.ma.getmaskarray(numbers).flat
        pairs = zip(np.ma.getdata(numbers).flat, hidden, strict=True)
        floats = [nan if hides or value is None else real_number(value) for value, hides in pairs]
        return np.array(floats, float).reshape(numbers.shape)
    if numbers.dtype.kind not in "iuf":
        raise TypeError(f"{numbers.dtype} is no type of real numbers")
    return np.asarray(np.ma.filled(numbers.astype(float), nan))


class Outliers(NamedTuple):
    """Poses that were left out as outliers: how many, and the stamps (ns) of the first, at most
    ``MOST_TOLD``."""

    total: int = 0
    first_stamps_ns: tuple[int, ...] = ()

    @classmethod
    def at(cls, stamp_ns: NDArray[np.int64]) -> Self:
        """The outliers at these stamps (N,)."""
        return cls(len(stamp_ns), tuple(stamp_ns[:MOST_TOLD].tolist()))

    def joined(self, later: "Outliers") -> "Outliers":
        """These and later ones."""
        if not later.total:
            return self
        return Outliers(self.total + later.total, (self.first_stamps_ns + later.first_stamps_ns)[:MOST_TOLD])

    def since(self, earlier: "Outliers") -> "Outliers":
        """The outliers after the ``earlier`` ones."""
        return Outliers(self.total - earlier.total, self.first_stamps_ns[len(earlier.first_stamps_ns) :])


NO_OUTLIERS: Final = Outliers()
MOST_TOLD: Final = 3
"""Largest number of outliers whose stamps are kept."""
