"""Tables of poses in Parquet, read by pyarrow; values in lists and structs are columns of their own."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import compress
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import compute, types
from pyarrow.parquet import ParquetFile

from contact_tracker.config.table_reading import TableReading
from contact_tracker.errors import UnreadableRecording, printable
from contact_tracker.recording.bytestream import WorkBudget
from contact_tracker.recording.items import ROWS_AT_ONCE
from contact_tracker.recording.parquet_pages import check_pages
from contact_tracker.recording.table_layouts import layout_of_names
from contact_tracker.recording.table_times import numbers

_ERRORS: Final = (pyarrow.ArrowException, OSError, ValueError, OverflowError, KeyError)
_BUFFER_BYTES: Final = 2**16
_LONGEST_LINE: Final = 120
"""Longest text of an error of pyarrow, which may list all columns."""
_LONGEST_NAME: Final = 40
_LONGEST_LIST: Final = 64
"""Values of a list that are columns; an image has more."""
_DEEPEST: Final = 5


class _Leaf(NamedTuple):
    """A column of single values: in a struct or a list of the file's column ``path[0]``, or that itself."""

    name: str
    path: tuple[str | int, ...]
    type: Any


class ParquetRows:
    """A Parquet file in columns, some rows after others; after iteration ``damage`` says what is not read.

    Raises
    ------
    UnreadableRecording
        It is damaged, takes more work than its size explains, or has no columns of poses.
    """

    def __init__(self, path: str, reading: TableReading, budget: WorkBudget) -> None:
        self.damage: tuple[str, ...] = ()
        try:
            self._file = ParquetFile(path, buffer_size=_BUFFER_BYTES, pre_buffer=False)
            leaves = [leaf for field in self._file.schema_arrow for leaf in self._leaves(field, path, budget)]
        except _ERRORS as error:
            raise UnreadableRecording(f"it cannot be read as a table: {_line(error)}") from error
        self.layout = layout_of_names([leaf.name for leaf in leaves], reading, path, "Parquet")
        self._chosen = {place: leaves[place] for place in self.layout.places if place >= 0}
        for place, leaf in self._chosen.items():
            is_time = place == self.layout.time and types.is_temporal(leaf.type)
            if not (is_time or _is_number(leaf.type)):
                named = f"its column {printable(leaf.name[:_LONGEST_NAME])} is of the type {leaf.type}"
                raise UnreadableRecording(f"{named}: columns of numbers are read")
            if is_time:
                self.layout = replace(self.layout, time_ns=1, has_own_unit=types.is_duration(leaf.type))
        self._columns = list(dict.fromkeys(str(leaf.path[0]) for leaf in self._chosen.values()))
        check_pages(path, set(self._columns), len(self.layout.bodies), budget)

    def __iter__(self) -> Iterator[dict[int, Any]]:
        done = 0
        try:
            for batch in self._file.iter_batches(ROWS_AT_ONCE, columns=self._columns, use_threads=False):
                yield self._values(batch, done)
                done += len(batch)
        except _ERRORS as error:
            self.damage = (f"it is damaged: {_line(error)}",)
        finally:
            self._file.close()

    def _values(self, batch: Any, done: int) -> dict[int, Any]:
        """Times as text, and numbers, of a batch after ``done`` rows; rows without any are left out."""
        found: dict[int, Any] = {}
        for place, leaf in self._chosen.items():
            column = _single(batch.column(str(leaf.path[0])), leaf.path[1:])
            is_text = place in (self.layout.time, self.layout.rest)
            found[place] = _texts(column) if is_text else _numbers(column)
        if self.layout.time < 0:
            found[self.layout.time] = [str(done + i) for i in range(len(batch))]
            return found
        is_row = np.array([bool(text) for text in found[self.layout.time]])
        for values in found.values():
            is_row |= np.isfinite(values) if isinstance(values, np.ndarray) else is_row
        return {
            place: values[is_row]
            if isinstance(values, np.ndarray)
            else list(compress(values, is_row.tolist()))
            for place, values in found.items()
        }

    def _leaves(self, field: Any, path: str, budget: WorkBudget) -> Iterator[_Leaf]:
        """The columns of single values in a column of the file; the first row has the length of lists."""
        if not types.is_list(field.type) and not types.is_large_list(field.type):
            yield from _leaves(field.name, (field.name,), field.type)
            return
        try:
            check_pages(path, {field.name}, 1, budget)
            batch = next(self._file.iter_batches(1, columns=[field.name], use_threads=False), None)
        except UnreadableRecording:
            batch = None
        first = None if batch is None else batch.column(0)[0].as_py()
        for i in range(min(len(first or ()), _LONGEST_LIST)):
            yield from _leaves(f"{field.name}[{i}]", (field.name, i), field.type.value_type)


def _leaves(name: str, path: tuple[str | int, ...], kind: Any) -> Iterator[_Leaf]:
    if len(path) > _DEEPEST:
        return
    if types.is_struct(kind):
        for i in range(min(kind.num_fields, _LONGEST_LIST)):
            inner = kind.field(i)
            yield from _leaves(f"{name}.{inner.name}", (*path, inner.name), inner.type)
    elif types.is_fixed_size_list(kind):
        for i in range(min(kind.list_size, _LONGEST_LIST)):
            yield from _leaves(f"{name}[{i}]", (*path, i), kind.value_type)
    else:
        yield _Leaf(name, path, kind)


def _is_number(kind: Any) -> bool:
    if types.is_dictionary(kind):
        return _is_number(kind.value_type)
    is_text = types.is_string(kind) or types.is_large_string(kind) or types.is_null(kind)
    return bool(is_text or types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def _single(column: Any, path: tuple[str | int, ...]) -> Any:
    """The values at a place in the structs or lists of a column; null where a list is shorter."""
    for i, step in enumerate(path):
        if isinstance(step, int):
            rows = [row[step] if row is not None and len(row) > step else None for row in column.to_pylist()]
            kind = column.type.value_type
            return _single(pyarrow.array(rows, kind), path[i + 1 :])
        column = compute.struct_field(column, step)
    return column


def _texts(column: Any) -> list[str]:
    """Times as text, dates and durations in nanoseconds; empty where there is none."""
    for is_kind, unit in (
        (types.is_date, pyarrow.timestamp("ns")),
        (types.is_timestamp, pyarrow.timestamp("ns")),
        (types.is_duration, pyarrow.duration("ns")),
        (types.is_time, pyarrow.time64("ns")),
    ):
        if is_kind(column.type):
            column = column.cast(unit).cast(pyarrow.int64())
            break
    return ["" if value is None else str(value) for value in column.to_pylist()]


def _numbers(column: Any) -> NDArray[np.float64]:
    if types.is_dictionary(column.type):
        column = column.dictionary_decode()
    if types.is_string(column.type) or types.is_large_string(column.type):
        return numbers([text or "" for text in column.to_pylist()])
    return np.asarray(column.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False), np.float64)


def _line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:_LONGEST_LINE]
