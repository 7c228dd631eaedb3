"""Validated poses from a recording, arrays or a table."""

import json
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contact_tracker.config.quantities import LENGTHS, TIMES_NS
from contact_tracker.config.table_reading import AS_NAMED, PYTHON, TableReading
from contact_tracker.errors import NoPoses, UnreadableRecording, UsageError, shown
from contact_tracker.geometry.elements import Array
from contact_tracker.motion.losses import counts_text, first_refused, remark_on_loss, remarks_on
from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.poses import AS_GIVEN, Pose, Poses, ReadAs
from contact_tracker.recording import PoseLog, PoseSource, open_log, read_metadata
from contact_tracker.recording.table_times import doubt_of_unit
from contact_tracker.trajectory.arguments import (
    errors_as,
    in_python,
    log_counts,
    name_from,
    path_from,
    warn_of,
    with_known_arguments,
    with_known_arguments_of_methods,
)
from contact_tracker.trajectory.arrays import (
    columns_of,
    moment_ns,
    nanoseconds,
    positions_and_quaternions,
    stated,
    times,
    with_index,
)

Order = Literal["xyzw", "wxyz"]


@with_known_arguments_of_methods
@dataclass(frozen=True, eq=False)
class Trajectory:
    """The poses ``T_world_body`` of one object that have passed the pose gate.

    Parameters
    ----------
    poses : in order of time, with unit quaternions.
    counts : numbers of dropped and repaired poses, by kind (docs/conventions.md).
    name : of the recording, for display.
    path : of the recording; None unless the path alone suffices to read it again.
    source : of the poses in the recording.
    damage : one line if most poses were dropped, or the recording is truncated or damaged.
    log_offset_ns : delay from a pose's stamp to its log time.
    vertices_m : (V, 3) of the object in the body frame, if the recording has them.
    notes : one line for each warning about the recording, except for the damage.
    by_log_time : whether the stamps are log times, as the headers have no stamps.
    read_as : units and conventions in which the poses were read.
    origin_ns : stamp of the time zero of displays; by default that of the first pose.
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
    read_as: ReadAs = AS_GIVEN
    origin_ns: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.poses, Poses) or not isinstance(self.counts, Mapping):
            raise UsageError("poses are columns that have passed the gate: take Trajectory.from_arrays")

    @classmethod
    def from_log(cls, log: PoseLog, name: str, poses: Poses, is_rereadable: bool) -> Self:
        """The trajectory of ``poses`` from a log at the path ``name``."""
        return cls(
            poses,
            dict(log.counts),
            name="standard input" if name == "-" else Path(name).name or name,
            path=name if is_rereadable else None,
            source=log.source,
            damage=log.damage,
            log_offset_ns=log.stamping.log_offset_ns,
            vertices_m=vertices_from_metadata(read_metadata(name)),
            notes=(*(() if log.note is None else (log.note,)), *log.remarks),
            by_log_time=log.stamping.by_log_time,
            read_as=log.source.read_as,
            origin_ns=log.origin_ns,
        )

    @classmethod
    def from_arrays(
        cls,
        stamps: ArrayLike,
        positions_m: ArrayLike,
        quaternions: Any = None,
        order: Order = "xyzw",
        unit: str = "m",
        time_unit: str | None = None,
        euler: str | None = None,
        rotation_vector: bool = False,
        rate: float | None = None,
    ) -> Self:
        """Poses from arrays.

        Parameters
        ----------
        stamps : (N,) times in ``time_unit``, from any origin; or dates or durations of numpy, pandas or the
            standard library, which have their own unit.
        positions_m : (N, 3) positions of the body's origin in the world, in ``unit``; masked positions count
            as not finite. Or whole poses (N, 4, 4), without ``quaternions``.
        quaternions : rotations from body to world: quaternions (N, 4), their components in ``order``;
            SciPy's ``Rotation``; matrices (N, 3, 3); or angles or vectors (N, 3), as ``euler`` or
            ``rotation_vector`` says.
        unit : m, cm, mm or um.
        time_unit : s (the default), ms, us, ns, 100ns, or the rate of frame numbers, as ``200Hz``.
        euler : order and unit of angles, as ``XYZ:deg``, in SciPy's letters: ``xyz`` are about fixed axes.
            The columns are the angles about x, y and z.
        rate : of frames (Hz), if ``stamps`` are numbers of frames (``time_unit="frames"``).

        Raises
        ------
        UsageError
            Shapes of arrays differ, values are not real numbers, or a unit or an order is unknown.
        NoPoses
            No pose has passed the gate; the message says why.

        Warns
        -----
        ContactTrackerWarning
            The unit of the stamps is doubtful, or many poses are dropped.
        """
        reading = stated(unit, time_unit, euler=euler, rotation_vector=rotation_vector, rate=rate)
        place, turn = positions_and_quaternions(positions_m, quaternions, order, reading)
        if len(place) != len(turn):
            raise UsageError(f"{len(place)} positions_m and {len(turn)} quaternions: one of each per pose")
        poses = np.hstack([place * LENGTHS[reading.unit or "m"], turn])
        return cls._passed(stamps, reading.time_ns, poses, reading)

    @classmethod
    def from_dataframe(
        cls,
        table: Any,
        unit: str | None = None,
        time_unit: str | None = None,
        euler: str | None = None,
        rotation_vector: bool = False,
        matrix: str | None = None,
        columns: Mapping[str, str] | None = None,
        rate: float | None = None,
    ) -> Self:
        """Poses from a table of pandas, polars or Arrow, or any mapping of names to columns.

        Parameters
        ----------
        table : columns are identified by their names, as in files; an index with a name or times is a column.
        unit, time_unit : of positions and stamps; by default as in their names (``x [mm]``, ``x_mm``,
            ``time [ms]``, ``stamp_ns``), else metres and seconds. Columns of dates have their own unit.
        euler, rotation_vector, matrix, columns, rate : meaning of the columns, see ``read``.

        Raises
        ------
        UsageError
            A column is missing or not numeric, or the meaning of the columns is unknown.
        NoPoses
            No pose has passed the gate.

        Warns
        -----
        ContactTrackerWarning
            See ``from_arrays``.
        """
        kind = {"euler": euler, "rotation_vector": rotation_vector, "matrix": matrix, "rate": rate}
        table = with_index(table)
        reading = stated(unit, time_unit, columns=columns, **kind)
        return cls._passed(*columns_of(table, reading), reading)

    @classmethod
    def _passed(cls, stamps: ArrayLike, unit_ns: float | None, rows: Array, reading: TableReading) -> Self:
        """The trajectory of those ``rows`` (N, 7), positions (m) and quaternions, that pass the gate. Stamps
        without a unit are dates, durations or seconds."""
        given = times(stamps)
        unit_ns = None if given.dtype.kind in "mM" else unit_ns or TIMES_NS["s"]
        stamp_ns, is_time, in_range = nanoseconds(given, unit_ns or 1)
        if len(stamp_ns) != len(rows):
            raise UsageError(f"{len(stamp_ns)} stamps, and {len(rows)} positions_m and quaternions")
        counts = Counter(nonfinite=int((~is_time).sum()), out_of_range=int((is_time & ~in_range).sum()))
        usable = is_time & in_range
        passed = gate(Poses(stamp_ns, rows[:, :3], np.ascontiguousarray(rows[:, 3:]))[usable], counts)
        counts = +counts
        loss = remark_on_loss(counts, len(rows), first_refused(rows[:, 3:]))
        if not len(passed):
            noted = counts_text(counts)
            reason = "" if loss is None else f": {loss}"
            raise NoPoses(f"no pose that can be used of {len(rows)}{f' ({noted})' if noted else ''}{reason}")
        doubt = None
        if unit_ns is not None:  # by the stamps as given, as those in ns are whole
            doubt = doubt_of_unit(np.asarray(given, float)[usable], unit_ns)
        notes = (*filter(None, (doubt,)), *remarks_on(counts, len(rows)))
        warn_of((*filter(None, (loss,)), *notes))
        log_counts("poses", counts)
        return cls(passed, counts, damage=loss, notes=notes, read_as=ReadAs(table=reading))

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        """Stamps (N,) in integer nanoseconds."""
        return self.poses.stamp_ns

    @property
    def position_m(self) -> Array:
        """Positions (N, 3) of the body in the world, in m."""
        return self.poses.position_m

    @property
    def quat_xyzw(self) -> Array:
        """Unit quaternions (N, 4) from body to world."""
        return self.poses.quat_xyzw

    @property
    def frames(self) -> tuple[str, str]:
        """Names of the world frame and the body frame; empty if the poses have no frames."""
        return ("", "") if self.source is None else (self.source.frame_id, self.source.child_frame_id)

    @property
    def duration_s(self) -> float:
        """Time in seconds from the first pose to the last."""
        return float(self.stamp_ns[-1] - self.stamp_ns[0]) * 1e-9 if len(self) else 0.0

    def __len__(self) -> int:
        return len(self.poses)

    def __getitem__(self, span: slice) -> "Trajectory":
        """The poses of a span of time, without its end; times are seconds or durations since the first pose,
        or dates.

        Raises
        ------
        UsageError
            ``span`` is not a slice of times, or has no pose.
        """
        if not isinstance(span, slice) or span.step is not None:
            raise UsageError(f"poses are taken by times, as trajectory[2.0:5.0], not by {shown(span)}")
        first_ns = int(self.stamp_ns[0])
        start, stop = (
            default if time is None else int(np.searchsorted(self.stamp_ns, moment_ns(time, first_ns)))
            for time, default in ((span.start, 0), (span.stop, len(self)))
        )
        if start >= stop:
            raise UsageError(
                f"no pose from {span.start} to {span.stop}: there are {self.duration_s:.2f} s of poses"
            )
        return replace(self, poses=self.poses[start:stop], origin_ns=None)

    def __iter__(self) -> Iterator[Pose]:
        return iter(self.poses)

    def batches(self) -> Iterator[Poses]:
        """The poses in batches of columns."""
        return self.poses.batches()

    def __repr__(self) -> str:
        noted = f"; noted: {counts_text(self.counts)}" if self.counts else ""
        return f"<Trajectory {self.name}: {len(self)} poses, {self.duration_s:.2f} s{noted}>"


@with_known_arguments
def read(
    path: str | os.PathLike[str],
    topic: str | None = None,
    parent: str | None = None,
    child: str | None = None,
    relative_to: str | None = None,
    unit: str | None = None,
    time_unit: str | None = None,
    euler: str | None = None,
    rotation_vector: bool = False,
    matrix: str | None = None,
    columns: Mapping[str, str] | None = None,
    field: str | None = None,
    rate: float | None = None,
) -> Trajectory:
    """The poses of a recording.

    Parameters
    ----------
    path : a recording of any kind (docs/formats.md), or a folder with its parts.
    topic : the topic of the poses, if there are several.
    parent, child : poses of the frame ``child`` in ``parent``; transforms between them are composed.
    relative_to : poses are relative to this frame or other body (its topic, or its name in a table), which
        may move.
    unit, time_unit : of the positions and times of a table: ``mm``, ``ms``, ``100ns``, or the rate of frame
        numbers, as ``200Hz``. By default as in the names of columns, else metres, and a unit of time that
        suits the values.
    euler : rotations in a table are angles of this order and unit, as ``xyz:deg``, in SciPy's letters:
        ``XYZ`` are about the axes of the body.
    rotation_vector : rotations in a table are rotation vectors.
    matrix : rotations in a table are matrices numbered along ``rows`` or ``columns``.
    columns : names of columns by role, as ``{"time": "t", "position": "tcp[0:3]"}`` (docs/formats.md).
    field : path to the poses in messages of other types, as ``tracked.pose`` (docs/formats.md).
    rate : of frames (Hz), if the times of a table are numbers of frames (``time_unit="frames"``).

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
        The recording is damaged, its format or unit is a guess, or many poses were dropped.
    """
    text = path_from(path)
    names = (("topic", topic), ("parent", parent), ("child", child), ("relative_to", relative_to))
    topic, parent, child, relative_to = (name_from(value, name) for name, value in names)
    if parent is not None and child is None:
        raise UsageError("parent needs child, the frame of the body")
    kind = {"euler": euler, "rotation_vector": rotation_vector, "matrix": matrix, "rate": rate}
    words = (PYTHON, *(f"{name}={value!r}" for name, value in names if value is not None))
    reading = replace(stated(unit, time_unit, columns=columns, field=field, **kind), given=words)
    frame = child if parent is None else f"{parent}->{child}"
    if text == "-":
        raise UsageError("a recording is read from a file, not from standard input")
    with errors_as(UnreadableRecording, text), in_python():
        log = open_log(text, topic, frame, relative_to=relative_to, table=reading)
        poses = Poses.join(list(log.batches()))
        if not len(poses):
            raise log.no_poses(text)
    warn_of(log.warnings)
    log_counts(text, log.counts)
    with errors_as(UnreadableRecording, text):
        return Trajectory.from_log(log, text, poses, reading == AS_NAMED)


def vertices_from_metadata(metadata: Mapping[str, Mapping[str, str]]) -> Array | None:
    """The object's vertices (V, 3) in the body frame; None if no record has a list of points."""
    for record in metadata.values():
        try:
            vertices = np.asarray(json.loads(record["object_vertices_m"]), float)
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
            continue
        if vertices.ndim == 2 and vertices.shape[1] == 3 and np.all(np.isfinite(vertices)):
            return vertices
    return None
