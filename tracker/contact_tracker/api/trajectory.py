"""Validated poses from a recording, arrays or a table."""

import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contact_tracker.api.given import errors_as, name_from, path_from
from contact_tracker.api.notices import log_counts, warn_of
from contact_tracker.config.quantities import RANGE_NS, TIMES_NS
from contact_tracker.errors import NoPoses, UnreadableRecording, UsageError
from contact_tracker.geometry.elements import Array
from contact_tracker.motion.pose_validation import first_refused, gate, remark_on_loss, remarks_on
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.motion.real_numbers import real_numbers
from contact_tracker.recording import PoseSource, open_log, read_metadata
from contact_tracker.recording.named_columns import metres_of, time_ns_of
from contact_tracker.recording.time_units import doubt_of_unit
from contact_tracker.suggestions import closest
from contact_tracker.viewer.scene import vertices_from_metadata

Order = Literal["xyzw", "wxyz"]
Unit = Literal["s", "ms", "us", "ns"]

_ORDERS: Final = {"xyzw": (0, 1, 2, 3), "wxyz": (1, 2, 3, 0)}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The poses ``T_world_body`` of one object that have passed the pose gate.

    Parameters
    ----------
    poses : in order of time, with unit quaternions.
    counts : numbers of dropped and repaired poses, by kind (docs/conventions.md).
    name : of the recording, for display.
    path : of the recording, None if there is none that can be read again.
    source : the source in the recording.
    damage : one line if most poses were dropped, or the recording is truncated or damaged.
    log_offset_ns : delay from a pose's stamp to its log time.
    vertices_m : (V, 3) of the object in the body frame, if the recording has them.
    notes : one line for each warning about the recording, except for the damage.
    by_log_time : whether the stamps are log times, as the headers have none.
    """

    poses: Poses
    counts: Mapping[str, int] = field(default_factory=dict)
    name: str = "poses"
    path: str | None = None
    source: PoseSource | None = None
    damage: str | None = None
    log_offset_ns: int = 0
    vertices_m: Array | None = None
    notes: tuple[str, ...] = ()
    by_log_time: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.poses, Poses) or not isinstance(self.counts, Mapping):
            raise UsageError("poses are columns that have passed the gate: take Trajectory.from_arrays")

    @classmethod
    def from_arrays(
        cls,
        stamps: ArrayLike,
        positions_m: ArrayLike,
        quaternions: ArrayLike,
        order: Order = "xyzw",
        unit: Unit = "s",
    ) -> Self:
        """Poses from arrays.

        Parameters
        ----------
        stamps : (N,) times in ``unit``, from any origin; or dates or durations of numpy, pandas or the
            standard library, which have their own unit.
        positions_m : (N, 3) positions of the body's origin in the world (m); masked ones are not finite.
        quaternions : (N, 4) rotations from body to world, their components in ``order``.

        Raises
        ------
        UsageError
            The arrays' shapes differ, they are not of real numbers, or ``unit`` or ``order`` is unknown.
        NoPoses
            No pose has passed the gate; the message says why.

        Warns
        -----
        ContactTrackerWarning
            The unit of the stamps is doubtful, or many poses are dropped.
        """
        stamp_ns, is_time, in_range = _nanoseconds(stamps, unit)
        place, turn = _rows(positions_m, "positions_m", 3), _rows(quaternions, "quaternions", 4)
        if not isinstance(order, str) or order not in _ORDERS:
            raise UsageError(f"order is 'xyzw' or 'wxyz', not {order!r}")
        if not len(stamp_ns) == len(place) == len(turn):
            raise UsageError(f"{len(stamp_ns)} stamps, {len(place)} positions_m and {len(turn)} quaternions")
        counts = Counter(nonfinite=int((~is_time).sum()), out_of_range=int((is_time & ~in_range).sum()))
        usable = is_time & in_range
        columns = Poses(stamp_ns, place, np.ascontiguousarray(turn[:, _ORDERS[order]]))[usable]
        passed = gate(columns, counts)
        counts = +counts
        loss = remark_on_loss(counts, len(place), first_refused(turn[:, _ORDERS[order]]))
        if not len(passed):
            noted = ", ".join(f"{kind} {count}" for kind, count in counts.items())
            reason = "" if loss is None else f": {loss}"
            raise NoPoses(f"no pose that can be used of {len(place)}{f' ({noted})' if noted else ''}{reason}")
        doubt = (
            None
            if _has_own_unit(stamps)
            else doubt_of_unit(stamp_ns[usable] / TIMES_NS[unit], TIMES_NS[unit])
        )
        notes = (*filter(None, (doubt,)), *remarks_on(counts, len(place)))
        warn_of((*filter(None, (loss,)), *notes))
        log_counts("poses", counts)
        return cls(passed, counts, damage=loss, notes=notes)

    @classmethod
    def from_dataframe(
        cls,
        table: Any,
        stamp: str = "stamp_ns",
        position_m: Sequence[str] = ("x", "y", "z"),
        quat_xyzw: Sequence[str] = ("qx", "qy", "qz", "qw"),
        unit: Unit | None = None,
    ) -> Self:
        """Poses from a table of pandas or polars, or any mapping of names to columns.

        Parameters
        ----------
        stamp, position_m, quat_xyzw : names of the columns; those of the quaternion in the order xyzw.
            Positions are in the unit of their names (``x [mm]``, ``x_mm``), as in files; without one in
            metres.
        unit : of the stamps; by default that of their name (``time [ms]``, ``stamp_ns``), else seconds.
            Columns of dates have their own.

        Raises
        ------
        UsageError
            A column is missing or not numeric, or the unit in a name is unknown.
        NoPoses
            No pose has passed the gate.

        Warns
        -----
        ContactTrackerWarning
            As ``from_arrays``.
        """
        if not is_table(table):
            raise UsageError(f"a table is a DataFrame or a mapping of columns, not {type(table).__name__}")
        if unit is not None:
            _refuse_other(unit)
        place = _side_by_side(table, position_m, "position_m", 3)
        turn = _side_by_side(table, quat_xyzw, "quat_xyzw", 4)
        time = _column(table, stamp)
        try:
            metres = metres_of(position_m)
            time_ns = None if unit or _has_own_unit(time) else time_ns_of(stamp)
        except UnreadableRecording as error:
            raise UsageError(str(error)) from error
        named: Unit = next((name for name in get_args(Unit) if TIMES_NS[name] == time_ns), "s")
        return cls.from_arrays(time, place * metres, turn, "xyzw", unit or named)

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        """(N,) integer nanoseconds."""
        return self.poses.stamp_ns

    @property
    def position_m(self) -> Array:
        """(N, 3)"""
        return self.poses.position_m

    @property
    def quat_xyzw(self) -> Array:
        """(N, 4)"""
        return self.poses.quat_xyzw

    @property
    def duration_s(self) -> float:
        """Time from the first pose to the last."""
        return float(self.stamp_ns[-1] - self.stamp_ns[0]) * 1e-9 if len(self) else 0.0

    def __len__(self) -> int:
        return len(self.poses)

    def __iter__(self) -> Iterator[Pose]:
        return iter(self.poses)

    def batches(self) -> Iterator[Poses]:
        """The poses in columns, many at once."""
        return self.poses.batches()

    def __repr__(self) -> str:
        noted = ", ".join(f"{kind} {count}" for kind, count in self.counts.items())
        noted = f"; noted: {noted}" if noted else ""
        return f"<Trajectory {self.name}: {len(self)} poses, {self.duration_s:.2f} s{noted}>"


def read(
    path: str | os.PathLike[str],
    topic: str | None = None,
    parent: str | None = None,
    child: str | None = None,
    relative_to: str | None = None,
    unit: Unit | None = None,
) -> Trajectory:
    """The poses of a recording.

    Parameters
    ----------
    path : a recording of any kind (docs/formats.md), or a folder of its parts.
    topic : the topic of the poses, if there are several.
    parent, child : poses of the frame ``child`` in ``parent``; transforms between them are composed.
    relative_to : a frame, or another body (its topic, or its name in a table), which may move, in
        which poses are given.
    unit : of the times of a table; by default by the column's name, else guessed from the values.

    Raises
    ------
    UnreadableRecording, NoPoses
        There are no usable poses.
    AmbiguousSource
        There are several sources; choose one.
    MissingExtra
        The format needs a library that is not installed.
    UsageError
        An argument is of the wrong type.

    Warns
    -----
    ContactTrackerWarning
        What ``contact-tracker`` says of the recording: damage, a guess, many dropped poses.
    """
    text = path_from(path)
    given = (("topic", topic), ("parent", parent), ("child", child), ("relative_to", relative_to))
    topic, parent, child, relative_to = (name_from(value, name) for name, value in given)
    if parent is not None and child is None:
        raise UsageError("parent needs child, the frame of the body")
    if unit is not None:
        _refuse_other(unit)
    frame = child if parent is None else f"{parent}->{child}"
    if text == "-":
        raise UsageError("a recording is read from a file, not from standard input")
    with errors_as(UnreadableRecording, text):
        log = open_log(text, topic, frame, relative_to=relative_to, time_unit=unit)
        poses = Poses.join(list(log.batches()))
    counts = dict(log.counts)
    if not len(poses):
        noted = ", ".join(f"{kind} {count}" for kind, count in counts.items())
        reason = "" if log.loss is None else f": {log.loss}"
        raise NoPoses(f"{text}: no pose that can be used{reason}{f'; noted: {noted}' if noted else ''}")
    with errors_as(UnreadableRecording, text):
        vertices_m = vertices_from_metadata(read_metadata(text))
    warn_of(log.warnings)
    log_counts(text, counts)
    return Trajectory(
        poses,
        counts,
        name=Path(text).name or text,
        path=text,
        source=log.source,
        damage=log.damage,
        log_offset_ns=log.stamping.log_offset_ns,
        vertices_m=vertices_m,
        notes=(*(() if log.note is None else (log.note,)), *log.remarks),
        by_log_time=log.stamping.by_log_time,
    )


def _refuse_other(unit: str) -> None:
    if not isinstance(unit, str) or unit not in TIMES_NS:
        raise UsageError(f"unit is {', '.join(map(repr, TIMES_NS))}, not {unit!r}")


def _nanoseconds(
    stamps: ArrayLike, unit: str
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Stamps, which of them are finite times, and which of these are in range."""
    _refuse_other(unit)
    wrong = "stamps are no real numbers or dates: convert text, as by pandas.to_datetime"
    try:
        given = _times(stamps)
    except ValueError as error:  # lists of different lengths
        raise UsageError(wrong) from error
    if given.ndim != 1:
        raise UsageError(f"stamps have the shape (N,), not {given.shape}")
    if given.dtype.kind in "mM":
        is_time = ~np.isnat(given)
        return given.astype(f"{given.dtype.kind}8[ns]").astype(np.int64), is_time, np.ones(len(given), bool)
    try:
        numbers = given if given.dtype.kind in "iu" and not np.ma.is_masked(given) else real_numbers(given)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(wrong) from error
    with np.errstate(all="ignore"):
        is_time = np.isfinite(numbers)
        in_range = is_time & (np.abs(numbers.astype(float)) * TIMES_NS[unit] <= RANGE_NS)
    sound = np.where(in_range, numbers, 0)
    if sound.dtype.kind in "iu":
        return sound.astype(np.int64) * TIMES_NS[unit], is_time, in_range
    whole = np.floor(sound)  # keeps the precision of seconds since 1970
    rest_ns = np.round((sound - whole) * TIMES_NS[unit]).astype(np.int64)
    return whole.astype(np.int64) * TIMES_NS[unit] + rest_ns, is_time, in_range


def _has_own_unit(stamps: ArrayLike) -> bool:
    """Whether stamps are dates or durations."""
    return _times(stamps).dtype.kind in "mM"


def _times(stamps: ArrayLike) -> NDArray[Any]:
    """Stamps as numbers, or as dates and durations of numpy; those with a time zone in UTC."""
    if getattr(getattr(stamps, "dtype", None), "tz", None) is not None:  # dates of pandas
        return np.asarray(stamps.to_numpy("datetime64[ns]"))  # type: ignore[union-attr]
    given = np.asanyarray(stamps)  # with its mask, if it has one
    if given.dtype.kind != "O" or not all(isinstance(one, datetime) for one in given.flat):
        return given
    utc = [one.astimezone(UTC).replace(tzinfo=None) if one.tzinfo else one for one in given.flat]
    return np.array(utc, "datetime64[ns]").reshape(given.shape)


def _rows(values: ArrayLike, name: str, width: int) -> Array:
    try:
        found = real_numbers(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(f"{name} are no real numbers") from error
    if found.ndim != 2 or found.shape[1] != width:
        raise UsageError(f"{name} have the shape (N, {width}), not {found.shape}")
    return found


def is_table(value: Any) -> bool:
    """Whether ``value`` has named columns."""
    return hasattr(value, "columns") or isinstance(value, Mapping)


def _side_by_side(table: Any, names: Sequence[str], name: str, width: int) -> Array:
    """The columns of these names as an array (N, width)."""
    if not isinstance(names, Sequence) or len(names) != width:
        raise UsageError(f"{name} names {width} columns, {' '.join('xyzw'[:width])}")
    columns = [_column(table, one) for one in names]
    try:
        return _rows(np.ma.column_stack(columns), name, width)
    except ValueError as error:
        raise UsageError(f"{name} has columns of different lengths") from error


def _column(table: Any, name: str) -> NDArray[Any]:
    if not isinstance(name, str):
        raise UsageError(f"the name of a column is text, not {name!r}")
    names = [str(one) for one in getattr(table, "columns", table)]
    if name not in names:
        with_unit = (one for one in names if re.match(rf"{re.escape(name)}\W", one))
        near = next(with_unit, None) or closest(name, names)
        meant = f"; did you mean {near!r}?" if near else f"; there are {', '.join(names[:20])}"
        raise UsageError(f"no column {name!r}{meant}")
    column = table[name]
    if getattr(getattr(column, "dtype", None), "tz", None) is not None:
        return _times(column)
    return np.asanyarray(column.to_numpy() if hasattr(column, "to_numpy") else column)
