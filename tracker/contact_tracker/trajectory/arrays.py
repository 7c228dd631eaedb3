"""Arrays and tables in memory as poses: stamps in ns, positions, rotations of any kind as quaternions.

The columns of a table, such as a DataFrame, are identified by name, as in files.
"""

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contact_tracker.config.quantities import RANGE_NS
from contact_tracker.config.table_reading import (
    TIME_UNITS_NS,
    TableReading,
    reading_of,
)
from contact_tracker.errors import ChoiceError, UnreadableRecording, UsageError, shown
from contact_tracker.geometry.elements import Array
from contact_tracker.motion.poses import Poses, real_number, real_numbers
from contact_tracker.recording.table_bodies import begin_body
from contact_tracker.recording.table_layouts import UNNAMED, TableLayout, quaternions
from contact_tracker.recording.table_proposals import FIRST_ROWS, layout_of_names
from contact_tracker.recording.table_units import are_no_radians, doubt_angles, doubt_degrees, largest_deg
from contact_tracker.trajectory.arguments import python_words, warn_of

_NO_TIMES: Final = "stamps are no real numbers or dates: convert text, as by pandas.to_datetime"
_ORDERS: Final = {"xyzw": (0, 1, 2, 3), "wxyz": (1, 2, 3, 0)}
"""Columns of x, y, z and w by the order of components."""


def stated(unit: Any = None, time_unit: Any = None, **options: Any) -> TableReading:
    """The reading of a table that arguments state; raises UsageError. A ``unit`` of time counts as
    ``time_unit``, as in earlier versions."""
    if isinstance(unit, str) and unit in TIME_UNITS_NS and time_unit is None:
        unit, time_unit = None, unit
    try:
        return reading_of(unit=unit, time_unit=time_unit, **options)
    except (TypeError, ValueError) as error:
        raise UsageError(str(error)) from error


def nanoseconds(
    stamps: ArrayLike, unit_ns: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Stamps (N,) in nanoseconds, whether each is a finite time (N,), and whether it is in range (N,)."""
    array = times(stamps)
    if array.ndim != 1:
        raise UsageError(f"stamps have the shape (N,), not {array.shape}")
    if array.dtype.kind in "mM":
        is_time = ~np.isnat(array)
        return array.astype(f"{array.dtype.kind}8[ns]").astype(np.int64), is_time, np.ones(len(array), bool)
    try:
        numbers = array if array.dtype.kind in "iu" and not np.ma.is_masked(array) else real_numbers(array)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(_NO_TIMES) from error
    with np.errstate(all="ignore"):
        is_time = np.isfinite(numbers)
        in_range = is_time & (np.abs(numbers.astype(float)) * unit_ns <= RANGE_NS)
    sound = np.where(in_range, numbers, 0)
    if sound.dtype.kind in "iu" and unit_ns == round(unit_ns):
        return sound.astype(np.int64) * round(unit_ns), is_time, in_range
    units = np.floor(sound) if unit_ns == round(unit_ns) else np.zeros(len(sound))
    fraction_ns = np.round((sound - units) * unit_ns).astype(np.int64)  # exact for seconds since 1970
    return units.astype(np.int64) * round(unit_ns) + fraction_ns, is_time, in_range


def moment_ns(value: Any, first_ns: int) -> int:
    """The stamp (ns) of a time: seconds or a duration since ``first_ns``, or a date; raises UsageError."""
    try:
        array = times([value])
        if array.dtype.kind == "M":
            return int(array.astype("datetime64[ns]").astype(np.int64)[0])
        if array.dtype.kind == "m":
            return first_ns + int(array.astype("timedelta64[ns]").astype(np.int64)[0])
        return first_ns + round(real_number(value) * 1e9)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(
            f"a time is seconds or a duration since the first pose, or a date, not {shown(value)}"
        ) from error


def times(stamps: ArrayLike) -> NDArray[Any]:
    """Stamps as an array of numbers, or of NumPy's dates or durations; dates with a time zone are in UTC."""
    if getattr(getattr(stamps, "dtype", None), "tz", None) is not None:  # dates of pandas
        return np.asarray(stamps.to_numpy("datetime64[ns]"))  # type: ignore[union-attr]
    try:
        array = np.asanyarray(stamps)  # with its mask, if any
    except ValueError as error:  # lists of different lengths
        raise UsageError(_NO_TIMES) from error
    if array.dtype.kind == "O" and array.size and all(isinstance(item, timedelta) for item in array.flat):
        return array.astype("timedelta64[ns]")
    if (
        array.dtype.kind != "O"
        or not array.ndim
        or not all(isinstance(item, datetime) for item in array.flat)
    ):
        return array
    utc = [date.astimezone(UTC).replace(tzinfo=None) if date.tzinfo else date for date in array.flat]
    return np.array(utc, "datetime64[ns]").reshape(array.shape)


def rows(values: ArrayLike, name: str, *shape: int) -> Array:
    """Real numbers of the shape (N, *shape); raises UsageError about ``name``."""
    try:
        array = real_numbers(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(f"{name} are no real numbers") from error
    if array.ndim != 1 + len(shape) or array.shape[1:] != shape:
        raise UsageError(f"{name} have the shape (N, {', '.join(map(str, shape))}), not {array.shape}")
    return array


def positions_and_quaternions(
    positions: ArrayLike, rotations: Any, order: Any, reading: TableReading
) -> tuple[Array, Array]:
    """Positions (N, 3) in their unit, and quaternions ``xyzw`` (N, 4).

    Parameters
    ----------
    positions : (N, 3), or whole poses (N, 4, 4) without ``rotations``.
    rotations : quaternions (N, 4) in ``order``; angles or vectors (N, 3), as ``reading`` says; matrices
        (N, 3, 3); or SciPy's Rotation.

    Raises
    ------
    UsageError
        Shapes differ, or values are no real numbers.
    """
    if not isinstance(order, str) or order not in _ORDERS:
        raise UsageError(f"order is 'xyzw' or 'wxyz', not {shown(order)}")
    if rotations is None:
        poses = rows(positions, "poses without rotations", 4, 4)
        return poses[:, :3, 3], quaternions("matrix", poses[:, :3, :3].reshape(-1, 9), "rows")
    place = rows(positions, "positions_m", 3)
    if hasattr(rotations, "as_quat"):  # SciPy's Rotation
        return place, rows(rotations.as_quat(), "rotations", 4)
    if reading.euler is not None and ":" not in reading.euler:
        raise UsageError(f"euler has the unit of the angles, as in {reading.euler}:deg")
    if reading.euler is not None or reading.rotation_vector:
        values = rows(rotations, "Euler angles" if reading.euler else "rotation vectors", 3)
        if not (reading.euler or "").endswith("deg") and are_no_radians(values):
            raise UsageError(
                "rotations as radians are larger than a turn: if they are degrees, take numpy.radians of "
                "them; if not, give them within a turn"
            )
        return place, quaternions(str(reading.kind), values, reading.euler or "rad")
    if getattr(rotations, "ndim", 2) == 3:
        return place, quaternions("matrix", rows(rotations, "matrices", 3, 3).reshape(-1, 9), "rows")
    return place, np.ascontiguousarray(rows(rotations, "quaternions", 4)[:, _ORDERS[order]])


def is_table(value: Any) -> bool:
    """Whether ``value`` has named columns."""
    names = getattr(value, "columns", None)
    return isinstance(value, Mapping) or (isinstance(names, Iterable) and not isinstance(value, Poses))


def with_index(table: Any) -> Any:
    """A DataFrame with its index as a column, if the index has a name, times or fractions; other tables
    unchanged."""
    index = getattr(table, "index", None)
    name, kind = getattr(index, "name", None), getattr(getattr(index, "dtype", None), "kind", "")
    if not hasattr(table, "rename_axis") or (name is None and kind not in ("m", "M", "f")):
        return table
    named = table.rename_axis(f"{UNNAMED}0" if kind == "f" else "time") if name is None else table
    return table if str(named.index.name) in names_in(table) else named.reset_index()


def names_in(table: Any) -> list[str]:
    """Names of the columns of a table (a DataFrame, a table of Arrow or a mapping) as text."""
    if not is_table(table):
        raise UsageError(f"a table is a DataFrame or a mapping of columns, not {type(table).__name__}")
    keys = [key if isinstance(key, tuple) else (key,) for key in _keys(table)]  # of several levels
    return [".".join(filter(None, map(str, key))) for key in keys]


def _keys(table: Any) -> list[Any]:
    """Keys of the columns of a table, of any type, such as numbers."""
    return list(getattr(table, "column_names", None) or getattr(table, "columns", table))


def cells_of(table: Any) -> list[list[str]]:
    """Rows of text of a table: the names of its columns, then its values; raises UsageError."""
    names = names_in(table)
    repeated = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if repeated is not None:
        raise UsageError(f"two columns are {repeated}: name each of them otherwise")
    try:
        rows = list(zip(*(table[key] for key in _keys(table)), strict=True))
    except (TypeError, ValueError, LookupError) as error:
        raise UsageError("the columns of a table are lists of one length, as of a DataFrame") from error
    return [names, *([str(value) for value in row] for row in rows)]


def columns_of(table: Any, reading: TableReading) -> tuple[NDArray[Any], float | None, Array]:
    """Times (N,) of a table, their unit (ns; None if it is unknown), and poses (N, 7) of the body.

    Raises
    ------
    UsageError
        The columns are not those of a single body, have no numbers, or angles exceed a turn in radians.
    """
    names, keys = names_in(table), _keys(table)
    if not keys:
        raise UsageError("the table has no columns")

    def first_rows() -> list[tuple[str, ...]]:
        try:
            columns = [_column(table, key)[:FIRST_ROWS].astype(str).tolist() for key in keys]
        except (TypeError, ValueError):  # refused below, if they are of the pose
            return []
        return list(zip(*columns, strict=False))

    try:
        layout = layout_of_names(names, reading, "", rows=first_rows)
    except (UnreadableRecording, ChoiceError) as error:
        raise UsageError(python_words(str(error))) from error
    if len(layout.bodies) > 1:
        bodies = ", ".join(body.name for body in layout.bodies)
        raise UsageError(f"several bodies, {bodies}: name the columns of one, as columns={{'x': ...}}")
    if layout.body is not None and _has_bodies(table, keys, layout):
        raise UsageError(
            f"its rows are of several bodies, by the column {keys[layout.body]}: give the rows of one"
        )
    (body,) = layout.bodies
    columns = [_column(table, keys[place]) for place in body.columns]
    try:
        stacked = np.ma.column_stack(columns)
    except TypeError as error:
        raise UsageError("columns of a pose are no real numbers") from error
    except ValueError as error:
        raise UsageError("columns of a pose have different lengths") from error
    values = rows(stacked, "columns of a pose", len(columns))
    if doubt := doubt_angles(values, body, reading, ""):
        raise UsageError(python_words(doubt))
    warn_of(filter(None, [doubt_degrees(largest_deg(values, body), reading, "")]))
    poses = body.poses(values)
    if layout.time < 0:
        return np.arange(len(values)), layout.time_ns, poses
    time = _column(table, keys[layout.time])
    if layout.rest is not None:
        parts = time, _column(table, keys[layout.rest])
        try:
            numbers = np.stack([real_numbers(part) for part in parts])
            if not np.isfinite(numbers).all():
                raise ValueError
        except (TypeError, ValueError, OverflowError) as error:
            raise UsageError(_NO_TIMES) from error
        if (numbers[0] % 1.0).any():  # both are times
            return time, layout.time_ns, poses
        seconds, subseconds = numbers.astype(np.int64)
        return seconds * 10**9 + subseconds * round(layout.rest_ns), 1.0, poses
    return time, layout.time_ns, poses


def _has_bodies(table: Any, keys: Sequence[Any], layout: TableLayout) -> bool:
    """Whether rows are of several bodies, by the column of their names."""
    names = [*map(str, _column(table, keys[layout.body or 0]))]
    if layout.first_body is None or layout.time < 0:
        return layout.first_body is None and len({*names}) > 1
    try:
        return bool(begin_body(names, _column(table, keys[layout.time])).any())
    except (TypeError, ValueError):  # refused below, if these are no times
        return False


def _column(table: Any, key: Any) -> NDArray[Any]:
    """The values (N,) of a column; raises UsageError."""
    try:
        column = table[key]
        if getattr(getattr(column, "dtype", None), "tz", None) is not None:
            return times(column)
        values: NDArray[Any] = np.asanyarray(column.to_numpy() if hasattr(column, "to_numpy") else column)
    except (TypeError, ValueError, LookupError) as error:
        raise UsageError(f"the column {key} has no numbers or dates") from error
    if not values.ndim:
        raise UsageError(f"the column {key} is one value, not one per pose")
    return values
