"""Arrays and tables in memory as poses: stamps in ns, positions, rotations of any kind as quaternions.

The columns of a table, such as a DataFrame, are found by name, as in files.
"""

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contact_tracker.config.quantities import RANGE_NS
from contact_tracker.config.table_reading import (
    POSITION,
    QUATERNION,
    TIME,
    TIME_UNITS_NS,
    TableReading,
    reading_of,
)
from contact_tracker.errors import ChoiceError, UnreadableRecording, UsageError
from contact_tracker.geometry.elements import Array
from contact_tracker.motion.poses import real_number, real_numbers
from contact_tracker.recording.table_layouts import doubt_of_angles, quaternions
from contact_tracker.recording.table_proposals import FIRST_ROWS, layout_of_names
from contact_tracker.suggestions import closest
from contact_tracker.trajectory.arguments import python_words

_NO_TIMES: Final = "stamps are no real numbers or dates: convert text, as by pandas.to_datetime"
_ORDERS: Final = {"xyzw": (0, 1, 2, 3), "wxyz": (1, 2, 3, 0)}


def stated(unit: Any = None, time_unit: Any = None, **others: Any) -> TableReading:
    """The reading that arguments state; a ``unit`` of time is that of the stamps, as before there was a
    ``time_unit``. Raises UsageError."""
    if isinstance(unit, str) and unit in TIME_UNITS_NS and time_unit is None:
        unit, time_unit = None, unit
    try:
        return reading_of(unit=unit, time_unit=time_unit, **others)
    except (TypeError, ValueError) as error:
        raise UsageError(str(error)) from error


def nanoseconds(
    stamps: ArrayLike, unit_ns: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Stamps in nanoseconds, which of them are finite times, and which of these are in range."""
    given = times(stamps)
    if given.ndim != 1:
        raise UsageError(f"stamps have the shape (N,), not {given.shape}")
    if given.dtype.kind in "mM":
        is_time = ~np.isnat(given)
        return given.astype(f"{given.dtype.kind}8[ns]").astype(np.int64), is_time, np.ones(len(given), bool)
    try:
        numbers = given if given.dtype.kind in "iu" and not np.ma.is_masked(given) else real_numbers(given)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(_NO_TIMES) from error
    with np.errstate(all="ignore"):
        is_time = np.isfinite(numbers)
        in_range = is_time & (np.abs(numbers.astype(float)) * unit_ns <= RANGE_NS)
    sound = np.where(in_range, numbers, 0)
    if sound.dtype.kind in "iu" and unit_ns == round(unit_ns):
        return sound.astype(np.int64) * round(unit_ns), is_time, in_range
    whole = np.floor(sound) if unit_ns == round(unit_ns) else np.zeros(len(sound))
    rest_ns = np.round((sound - whole) * unit_ns).astype(
        np.int64
    )  # keeps the precision of seconds since 1970
    return whole.astype(np.int64) * round(unit_ns) + rest_ns, is_time, in_range


def moment_ns(value: Any, first_ns: int) -> int:
    """The stamp of a time: seconds or a duration since the first pose, or a date; raises UsageError."""
    try:
        given = times([value])
        if given.dtype.kind == "M":
            return int(given.astype("datetime64[ns]").astype(np.int64)[0])
        if given.dtype.kind == "m":
            return first_ns + int(given.astype("timedelta64[ns]").astype(np.int64)[0])
        return first_ns + round(real_number(value) * 1e9)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(
            f"a time is seconds or a duration since the first pose, or a date, not {value!r}"
        ) from error


def times(stamps: ArrayLike) -> NDArray[Any]:
    """Stamps as numbers, or as dates and durations of numpy; those with a time zone in UTC."""
    if getattr(getattr(stamps, "dtype", None), "tz", None) is not None:  # dates of pandas
        return np.asarray(stamps.to_numpy("datetime64[ns]"))  # type: ignore[union-attr]
    try:
        given = np.asanyarray(stamps)  # with its mask, if it has one
    except ValueError as error:  # lists of different lengths
        raise UsageError(_NO_TIMES) from error
    if given.dtype.kind == "O" and given.size and all(isinstance(one, timedelta) for one in given.flat):
        return given.astype("timedelta64[ns]")
    if given.dtype.kind != "O" or not all(isinstance(one, datetime) for one in given.flat):
        return given
    utc = [one.astimezone(UTC).replace(tzinfo=None) if one.tzinfo else one for one in given.flat]
    return np.array(utc, "datetime64[ns]").reshape(given.shape)


def rows(values: ArrayLike, name: str, *shape: int) -> Array:
    """Real numbers of the shape (N, *shape); raises UsageError."""
    try:
        found = real_numbers(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(f"{name} are no real numbers") from error
    if found.ndim != 1 + len(shape) or found.shape[1:] != shape:
        raise UsageError(f"{name} have the shape (N, {', '.join(map(str, shape))}), not {found.shape}")
    return found


def positions_and_quaternions(
    positions: ArrayLike, rotations: Any, order: Any, reading: TableReading
) -> tuple[Array, Array]:
    """Positions in their unit, and quaternions ``xyzw``: of quaternions in ``order``, of angles or vectors as
    ``reading`` says, of matrices (N, 3, 3), of SciPy's Rotation; or both of matrices (N, 4, 4).

    Raises
    ------
    UsageError
        Shapes differ, or values are no real numbers.
    """
    if not isinstance(order, str) or order not in _ORDERS:
        raise UsageError(f"order is 'xyzw' or 'wxyz', not {order!r}")
    if rotations is None:
        whole = rows(positions, "poses without rotations", 4, 4)
        return whole[:, :3, 3], quaternions("matrix", whole[:, :3, :3].reshape(-1, 9), "rows")
    place = rows(positions, "positions_m", 3)
    if hasattr(rotations, "as_quat"):  # SciPy's Rotation
        return place, rows(rotations.as_quat(), "rotations", 4)
    if reading.euler is not None:
        if ":" not in reading.euler:
            raise UsageError(f"euler has the unit of the angles, as in {reading.euler}:deg")
        return place, quaternions("euler", rows(rotations, "Euler angles", 3), reading.euler)
    if reading.rotation_vector:
        return place, quaternions("rotation_vector", rows(rotations, "rotation vectors", 3), "rad")
    if getattr(rotations, "ndim", 2) == 3:
        return place, quaternions("matrix", rows(rotations, "matrices", 3, 3).reshape(-1, 9), "rows")
    return place, np.ascontiguousarray(rows(rotations, "quaternions", 4)[:, _ORDERS[order]])


def is_table(value: Any) -> bool:
    """Whether ``value`` has named columns."""
    return hasattr(value, "columns") or isinstance(value, Mapping)


def with_index(table: Any) -> Any:
    """A DataFrame with its index as a column, if that has a name or times."""
    index = getattr(table, "index", None)
    name, kind = getattr(index, "name", None), getattr(getattr(index, "dtype", None), "kind", "")
    if not hasattr(table, "rename_axis") or (name is None and kind not in ("m", "M")):
        return table
    named = table.rename_axis("time") if name is None else table
    return table if str(named.index.name) in names_in(table) else named.reset_index()


def names_in(table: Any) -> list[str]:
    """Names of the columns of a table: a DataFrame, a table of Arrow or a mapping."""
    if not is_table(table):
        raise UsageError(f"a table is a DataFrame or a mapping of columns, not {type(table).__name__}")
    return [str(key) for key in _keys(table)]


def _keys(table: Any) -> list[Any]:
    """What the columns of a table are called in it, as numbers."""
    return list(getattr(table, "column_names", None) or getattr(table, "columns", table))


def cells_of(table: Any) -> list[list[str]]:
    """The names of the columns of a table, and below them its values as text; raises UsageError."""
    names = names_in(table)
    again = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if again is not None:
        raise UsageError(f"two columns are {again}: name each of them otherwise")
    try:
        rows = list(zip(*(table[key] for key in _keys(table)), strict=True))
    except (TypeError, ValueError) as error:
        raise UsageError("the columns of a table are lists of one length, as of a DataFrame") from error
    return [names, *([str(value) for value in row] for row in rows)]


def with_columns(
    table: Any, reading: TableReading, stamp: Any, position_m: Any, quat_xyzw: Any
) -> TableReading:
    """The reading with columns that are named one by one; raises UsageError if one is not there."""
    columns = {} if stamp is None else {TIME: stamp}
    for name, given, roles in (("position_m", position_m, POSITION), ("quat_xyzw", quat_xyzw, QUATERNION)):
        if given is None:
            continue
        if not isinstance(given, Sequence) or isinstance(given, str) or len(given) != len(roles):
            raise UsageError(f"{name} names {len(roles)} columns, {' '.join(roles)}")
        columns |= dict(zip(roles, given, strict=True))
    names = names_in(table)
    for name in columns.values():
        if not isinstance(name, str):
            raise UsageError(f"the name of a column is text, not {name!r}")
        if name not in names:
            with_unit = (one for one in names if re.match(rf"{re.escape(name)}\W", one))
            near = next(with_unit, None) or closest(name, names)
            meant = f"; did you mean {near!r}?" if near else f"; there are {', '.join(names[:20])}"
            raise UsageError(f"no column {name!r}{meant}")
    return reading.with_(reading_of(columns))


def columns_of(table: Any, reading: TableReading) -> tuple[NDArray[Any], float | None, Array, str | None]:
    """Times, their unit (ns; None if it is not known), and poses (N, 7) of the body in a table; one line if
    its angles are doubtful.

    Raises
    ------
    UsageError
        Its columns are not those of one body, or not of numbers.
    """
    keys = _keys(table)

    def first_rows() -> list[tuple[str, ...]]:
        columns = (_column(table, key)[:FIRST_ROWS].astype(str).tolist() for key in keys)
        return list(zip(*columns, strict=False))

    try:
        layout = layout_of_names(names_in(table), reading, "", rows=first_rows)
    except (UnreadableRecording, ChoiceError) as error:
        raise UsageError(python_words(str(error))) from error
    if len(layout.bodies) > 1:
        bodies = ", ".join(body.name for body in layout.bodies)
        raise UsageError(f"several bodies, {bodies}: name the columns of one, as columns={{'x': ...}}")
    (body,) = layout.bodies
    columns = [_column(table, keys[place]) for place in body.columns]
    try:
        values = rows(np.ma.column_stack(columns), "columns of a pose", len(columns))
    except ValueError as error:
        raise UsageError("columns of a pose have different lengths") from error
    poses, doubt = body.poses(values), doubt_of_angles(values, body, reading, "")
    if layout.time < 0:
        return np.arange(len(values)), layout.time_ns, poses, doubt
    time = _column(table, keys[layout.time])
    if layout.rest is not None:
        seconds, rest = np.asarray(time, np.int64), np.asarray(_column(table, keys[layout.rest]), np.int64)
        return seconds * 10**9 + rest * round(layout.rest_ns), 1.0, poses, doubt
    return time, layout.time_ns, poses, doubt


def _column(table: Any, key: Any) -> NDArray[Any]:
    column = table[key]
    if getattr(getattr(column, "dtype", None), "tz", None) is not None:
        return times(column)
    return np.asanyarray(column.to_numpy() if hasattr(column, "to_numpy") else column)
