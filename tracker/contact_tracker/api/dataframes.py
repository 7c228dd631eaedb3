"""Tables in memory, such as DataFrames: their columns are found by name, as in files."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_tracker.api.arrays import have_own_unit, rows, times
from contact_tracker.config.table_reading import POSITION, QUATERNION, TIME, TableReading, reading_of
from contact_tracker.errors import ChoiceError, UnreadableRecording, UsageError
from contact_tracker.geometry.elements import Array
from contact_tracker.recording.table_layouts import layout_of_names
from contact_tracker.suggestions import closest


def is_table(value: Any) -> bool:
    """Whether ``value`` has named columns."""
    return hasattr(value, "columns") or isinstance(value, Mapping)


def names_in(table: Any) -> list[str]:
    """Names of the columns of a table: a DataFrame, a table of Arrow or a mapping."""
    if not is_table(table):
        raise UsageError(f"a table is a DataFrame or a mapping of columns, not {type(table).__name__}")
    names = getattr(table, "column_names", None) or getattr(table, "columns", table)
    return [str(one) for one in names]


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


def columns_of(table: Any, reading: TableReading) -> tuple[NDArray[Any], float | None, Array]:
    """Times, their unit (ns; None if they have their own, or it is not known), and poses (N, 7) of the body
    in a table.

    Raises
    ------
    UsageError
        Its columns are not those of one body, or not of numbers.
    """
    names = names_in(table)
    try:
        layout = layout_of_names(names, reading, "")
    except (UnreadableRecording, ChoiceError) as error:
        raise UsageError(str(error)) from error
    if len(layout.bodies) > 1:
        bodies = ", ".join(body.name for body in layout.bodies)
        raise UsageError(f"several bodies, {bodies}: name the columns of one, as columns={{'x': ...}}")
    (body,) = layout.bodies
    columns = [_column(table, names[place]) for place in body.columns]
    try:
        values = rows(np.ma.column_stack(columns), "columns of a pose", len(columns))
    except ValueError as error:
        raise UsageError("columns of a pose have different lengths") from error
    if layout.time < 0:
        return np.arange(len(values)), layout.time_ns, body.poses(values)
    time = _column(table, names[layout.time])
    if layout.rest is not None:
        seconds, rest = np.asarray(time, np.int64), np.asarray(_column(table, names[layout.rest]), np.int64)
        return seconds * 10**9 + rest, 1.0, body.poses(values)
    return time, None if have_own_unit(time) else layout.time_ns, body.poses(values)


def _column(table: Any, name: str) -> NDArray[Any]:
    column = table[name]
    if getattr(getattr(column, "dtype", None), "tz", None) is not None:
        return times(column)
    return np.asanyarray(column.to_numpy() if hasattr(column, "to_numpy") else column)
