"""Tables of poses in Parquet and Feather, in arrays of NumPy, MATLAB and HDF5, and in C3D files with rigid
bodies.

Values in lists and structs of Parquet are columns of their own. The sizes that pages declare are checked
before a library decompresses them: a few bytes can expand to billions of rows or to gigabytes. Footer and
page headers are in Thrift's compact protocol (https://parquet.apache.org/docs/file-format/), and flatbuffers
in Feather, the file format of Arrow (https://arrow.apache.org/docs/format/Columnar.html).

C3D has a header, groups of parameters, and data in blocks of 512 bytes (https://www.c3d.org). Theia3D and
Visual3D write matrices of the data type ROTATION: 16 floats by columns and one of reliability, negative where
there is none (https://www.c-motion.com/v3dwiki/index.php?title=ROTATION_DATA_TYPE). It is read here, as the
library ezc3d ends the process at damaged files.
"""

import math
import os
import struct
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from io import BytesIO
from itertools import chain, compress, islice, starmap
from typing import IO, Any, Final

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import compute, types
from pyarrow.parquet import ColumnChunkMetaData, ParquetFile

from contact_tracker.config.quantities import LENGTHS_M
from contact_tracker.config.table_reading import TableReading, reading_of
from contact_tracker.errors import ChoiceError, UnreadableRecording, first_line, printable
from contact_tracker.recording.array_files import DEEPEST, MOST_ARRAYS, WIDEST, arrays_in, widest_of
from contact_tracker.recording.bytestream import (
    FROM_ARRAYS,
    RECORD_LIMIT,
    SHARE_OF_RECORD,
    TooMuchWork,
    WorkBudget,
)
from contact_tracker.recording.items import ROWS_AT_ONCE
from contact_tracker.recording.table_layouts import (
    LONGEST_CELL,
    MOST_COLUMNS,
    UNNAMED,
    Body,
    TableLayout,
    listed_briefly,
    numbers,
)
from contact_tracker.recording.table_proposals import FIRST_ROWS, layout_of_names, layout_without_names

_PARQUET_ERRORS: Final = (pyarrow.ArrowException, OSError, ValueError, OverflowError, KeyError)
_BROKEN: Final = (ValueError, LookupError, TypeError, AttributeError, RecursionError, struct.error, OSError)
_BUFFER_BYTES: Final = 2**16


class ParquetTable:
    """A Parquet or Feather file in columns, batch by batch; after iteration ``damage`` says what is not read.

    Raises UnreadableRecording if it is damaged, takes more work than its size explains, or has no poses.
    """

    def __init__(self, path: str, reading: TableReading, budget: WorkBudget, kind: str = "Parquet") -> None:
        self.damage: tuple[str, ...] = ()
        try:
            self._file = _OPENED[kind](path)
            leaves = self._first_rows(WorkBudget(budget.bytes_read))  # read again later
        except _PARQUET_ERRORS as error:
            raise UnreadableRecording(
                f"it cannot be read as a table: {first_line(error)[: 2 * LONGEST_CELL]}"
            ) from error
        rows = partial(_rows_of_texts, [values for _, _, values in leaves])
        names = [name for name, _, _ in leaves]
        self.layout = replace(layout_of_names(names, reading, path, rows=rows), kind=kind)
        self._names = {place: names[place] for place in self.layout.places}
        for place, name in self._names.items():
            type_ = leaves[place][2].type
            is_time = place == self.layout.time and types.is_temporal(type_)
            if not (is_time or _is_number(type_)):
                named = f"its column {printable(name[:LONGEST_CELL])} is of the type {type_}"
                raise UnreadableRecording(f"{named}: columns of numbers are read")
            if is_time:
                self.layout = replace(self.layout, time_ns=1, has_own_unit=types.is_duration(type_))
        self._columns = list(dict.fromkeys(leaves[place][1] for place in self._names))
        self._file.check({*self._columns}, len(self.layout.bodies), budget)

    def __iter__(self) -> Iterator[dict[int, Any]]:
        try:
            for batch in self._file.iter_batches(ROWS_AT_ONCE, columns=self._columns, use_threads=False):
                yield self._values(batch)
        except _PARQUET_ERRORS as error:
            self.damage = (f"it is damaged: {first_line(error)[: 2 * LONGEST_CELL]}",)
        finally:
            self._file.close()

    def _values(self, batch: Any) -> dict[int, Any]:
        """The columns of a batch: times as text, and numbers; empty rows are left out."""
        columns, time = dict[int, Any](), self.layout.time
        leaves = dict(chain.from_iterable(_leaves(name, batch.column(name)) for name in self._columns))
        for place, name in self._names.items():
            column = leaves[name] if name in leaves else pyarrow.nulls(len(batch))  # as all lists are shorter
            columns[place] = _texts(column) if place in self.layout.texts else _numbers(column)
        if time < 0:
            return columns
        numbers = [values for values in columns.values() if isinstance(values, np.ndarray)]
        is_row = np.array([bool(text) for text in columns[time]]) | np.isfinite(numbers).any(axis=0)
        return {
            place: values[is_row] if isinstance(values, np.ndarray) else list(compress(values, is_row))
            for place, values in columns.items()
        }

    def _first_rows(self, budget: WorkBudget) -> list[tuple[str, str, Any]]:
        """The columns of single values: name, name of the column of the file, and first values; none if these
        cannot be read."""
        schema, batch, readable = self._file.schema_arrow, None, list[str]()
        nested = [{field.name} for field in schema if types.is_nested(field.type)]
        for names in ({field.name for field in schema if _has_texts(field.type)}, *nested):
            with suppress(UnreadableRecording):
                self._file.check(names, 1, budget)
                readable += names
        with suppress(StopIteration, *_PARQUET_ERRORS):
            batch = next(self._file.iter_batches(FIRST_ROWS, columns=readable, use_threads=False))
        read = {} if batch is None else dict(zip(batch.schema.names, batch.columns, strict=True))
        count, leaves = 0 if batch is None else len(batch), list[tuple[str, str, Any]]()
        for field in schema:
            column = read[field.name] if field.name in read else pyarrow.nulls(count, field.type)
            leaves += ((name, field.name, values) for name, values in _leaves(field.name, column))
        return leaves


def _leaves(name: str, column: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """The columns of single values in a column, by name: values in structs, and in lists, null where one is
    shorter."""
    kind = column.type
    if depth > DEEPEST:
        return
    if types.is_struct(kind):
        for field, values in islice(zip(kind, column.flatten(), strict=True), WIDEST):
            yield from _leaves(f"{name}.{field.name}", values, depth + 1)
    elif types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        length = compute.max(compute.list_value_length(column)).as_py() or 0
        for i in range(min(length, WIDEST)):
            part = compute.list_slice(column, i, i + 1, return_fixed_size_list=True)
            yield from _leaves(f"{name}[{i}]", compute.list_element(part, 0), depth + 1)
        if length > WIDEST:
            yield f"{name}[{WIDEST}:{length}]", column  # named in messages only
    else:
        yield name, column


def _rows_of_texts(columns: Sequence[Any]) -> list[list[str]]:
    """The numbers, texts and times in rows as text, ``nan`` for other values."""
    texts = (_texts(c) if _has_texts(c.type) else [""] * len(c) for c in columns)
    return [[text or "nan" for text in row] for row in zip(*texts, strict=True)]


def _is_number(kind: Any) -> bool:
    if types.is_dictionary(kind):
        return _is_number(kind.value_type)
    is_text = types.is_string(kind) or types.is_large_string(kind) or types.is_null(kind)
    return bool(is_text or types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def _has_texts(kind: Any) -> bool:
    return _is_number(kind) or bool(types.is_temporal(kind))


def _texts(column: Any) -> list[str]:
    """Times as text, dates and durations in nanoseconds; empty for null."""
    if types.is_temporal(column.type):
        is_time, is_duration = types.is_time(column.type), types.is_duration(column.type)
        kind = pyarrow.time64 if is_time else pyarrow.duration if is_duration else pyarrow.timestamp
        column = column.cast(kind("ns")).cast(pyarrow.int64())
    return ["" if value is None else str(value) for value in column.to_pylist()]


def _numbers(column: Any) -> NDArray[np.float64]:
    if types.is_dictionary(column.type):
        column = column.dictionary_decode()
    if types.is_string(column.type) or types.is_large_string(column.type):
        return numbers([text or "" for text in column.to_pylist()])
    return np.asarray(column.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False), np.float64)


_PAGE_HEADER: Final = 2**16
"""Longest page header (bytes), which may contain statistics of long texts."""
_WHOLE: Final = (0, 6)
"""Encodings that store each text in full; in other encodings many values may share a long text."""
_VALUES_PER_ROW: Final = 7
"""Number of values in lists that count as a row, as of a pose."""
_BYTES_PER_ROW: Final = 8 * _VALUES_PER_ROW


class _Parquet(ParquetFile):  # type: ignore[misc]
    """A Parquet file, whose pages are checked before columns are decompressed."""

    def __init__(self, path: str) -> None:
        super().__init__(path, buffer_size=_BUFFER_BYTES, pre_buffer=False)
        self._path = path

    def check(self, names: Set[str], bodies: int, budget: WorkBudget) -> None:
        """Check the columns with these names; raises UnreadableRecording if they exceed the limits for the
        size of the file, or page headers cannot be parsed. ``bodies`` is the number of poses per row."""
        with _checked(self._path) as file:
            for group in map(self.metadata.row_group, range(self.metadata.num_row_groups)):
                budget.spend(SHARE_OF_RECORD * max(group.num_rows, 0) * bodies)
                pages = list[tuple[int, int]]()
                for column in map(group.column, range(group.num_columns)):
                    if not any(f"{column.path_in_schema}.".startswith(f"{name}.") for name in names):
                        continue
                    if "." in column.path_in_schema:  # lists have more values than there are rows
                        budget.spend(SHARE_OF_RECORD * max(column.num_values, 0) / _VALUES_PER_ROW)
                    for page in _pages(file, column):
                        budget.spend(1)  # several columns may name the same pages
                        pages.append(page)
                budget.inflate(sum(packed for packed, _ in pages), sum(plain for _, plain in pages))


class _Arrow:
    """A Feather file, whose buffers are checked before they are decompressed."""

    def __init__(self, path: str) -> None:
        self._path, self._file, self._is_checked = path, pyarrow.OSFile(path), False
        self.schema_arrow = pyarrow.ipc.open_file(self._file).schema

    def iter_batches(self, rows: int, columns: Sequence[str], use_threads: bool) -> Iterator[Any]:
        """Columns in batches of so many rows."""
        places = [self.schema_arrow.get_field_index(name) for name in columns]
        options = pyarrow.ipc.IpcReadOptions(included_fields=places, use_threads=use_threads)
        opened = pyarrow.ipc.open_file(self._file, options=options)
        for batch in map(opened.get_batch, range(opened.num_record_batches)):
            batch.validate(full=True)
            if len(batch) > batch.nbytes:
                raise ValueError("it has more rows than values")
            yield from (batch.slice(begin, rows) for begin in range(0, len(batch), rows))

    def close(self) -> None:
        self._file.close()

    def check(self, names: Set[str], bodies: int, budget: WorkBudget) -> None:
        """As for Parquet, but all columns at once, as buffers have no names."""
        if self._is_checked:
            return
        with _checked(self._path) as file:
            file.seek(-_ARROW_END, os.SEEK_END)
            (size,) = struct.unpack("<i", file.read(4))
            file.seek(-_ARROW_END - size, os.SEEK_END)
            footer = file.read(size)
            for blocks, *batch in ((3, 2), (2, 2, 1)):  # of rows, and of dictionaries
                for begin, head, _, _ in _structs(footer, "<qiiq", blocks):
                    file.seek(begin)
                    message = file.read(head)[8:]
                    is_packed = _place(message, *batch, 3) > 0
                    for at, packed in _structs(message, "<qq", *batch, 2):
                        file.seek(begin + head + at)
                        size = packed
                        if is_packed and packed:
                            size = max(0, *struct.unpack("<q", file.read(8)))
                            budget.inflate(packed, size)
                        budget.spend(SHARE_OF_RECORD * (1.0 + size / _BYTES_PER_ROW))
        self._is_checked = True


_OPENED: Final[Mapping[str, Callable[[str], _Parquet | _Arrow]]] = {"Parquet": _Parquet, "Feather": _Arrow}
_ARROW_END: Final = 10
"""Number of bytes after the footer of an Arrow file: its size and ``ARROW1``."""


def _place(data: bytes, *fields: int) -> int:
    """The offset of a table or vector in a flatbuffer (https://flatbuffers.dev/internals/), by the fields
    that lead to it; 0 if it is absent."""
    (at,) = struct.unpack_from("<I", data)
    for field in fields:
        names, slot = at - struct.unpack_from("<i", data, at)[0], 4 + 2 * field
        has_it = slot < struct.unpack_from("<H", data, names)[0]
        (offset,) = struct.unpack_from("<H", data, names + slot) if has_it else (0,)
        if not offset:
            return 0
        at += offset + struct.unpack_from("<I", data, at + offset)[0]
    return int(at)


def _structs(data: bytes, form: str, *fields: int) -> Iterator[tuple[int, ...]]:
    """The structs in a vector; ``form`` is their format as in the module ``struct``."""
    if at := _place(data, *fields):
        end = at + 4 + struct.unpack_from("<I", data, at)[0] * struct.calcsize(form)
        yield from struct.iter_unpack(form, data[at + 4 : end])


@contextmanager
def _checked(path: str) -> Iterator[IO[bytes]]:
    """Open a file whose parts are checked; raises UnreadableRecording if they exceed the limits for its size,
    or cannot be parsed."""
    try:
        with open(path, "rb") as file:
            yield file
    except TooMuchWork as error:
        raise UnreadableRecording(f"it is too much for its size: {error}") from error
    except _BROKEN as error:
        raise UnreadableRecording(f"it is damaged: where its pages begin cannot be read ({error})") from error


def _pages(file: IO[bytes], column: ColumnChunkMetaData) -> Iterator[tuple[int, int]]:
    """Stored and decompressed bytes of each page of a column."""
    at = min(column.data_page_offset, column.dictionary_page_offset or column.data_page_offset)
    end, values, longest, shared = at + column.total_compressed_size, 0, 0, 0
    if not 0 < at <= end:
        raise ValueError("a page is outside of the file")
    while at < end:
        file.seek(at)
        header = BytesIO(file.read(min(_PAGE_HEADER, end - at)))
        page, size = _thrift_struct(header), header.tell()
        plain, packed = page[2], page[3]
        of_data = page.get(5) or page.get(8) or {}
        values += of_data.get(1, 0)
        if min(plain, packed, of_data.get(1, 0)) < 0 or values > column.num_values:
            raise ValueError("a page has more values than its column")
        at, longest = at + size + packed, max(longest, plain)
        encoding = of_data.get(2 if page.get(5) else 4, 0)
        if column.physical_type.endswith("BYTE_ARRAY") and encoding not in _WHOLE:
            shared += of_data[1] * longest
        if shared > RECORD_LIMIT:
            raise UnreadableRecording(f"its column {column.path_in_schema} is text: write numbers")
        yield size + packed, plain
    if at != end:
        raise ValueError("a page is longer than its column")


def _thrift_struct(data: IO[bytes]) -> dict[int, Any]:
    """The integers and structs of the next struct, by the numbers of its fields; raises LookupError,
    ValueError or RecursionError."""
    fields, number = dict[int, Any](), 0
    while head := data.read(1)[0]:
        step, kind = divmod(head, 16)
        number = number + step if step else _varint(data) >> 1
        match kind:
            case 1 | 2:  # a truth value
                pass
            case 3:
                data.read(1)
            case 4 | 5 | 6:
                value = _varint(data)
                fields[number] = (value >> 1) ^ -(value & 1)
            case 8:
                data.seek(_varint(data), os.SEEK_CUR)
            case 12:
                fields[number] = _thrift_struct(data)
            case _:
                raise ValueError(f"a field of the kind {kind}")
    return fields


def _varint(data: IO[bytes]) -> int:
    """A number of 7 bits in each byte."""
    number = shift = 0
    while (byte := data.read(1)[0]) > 127:
        number |= (byte & 127) << shift
        shift += 7
    return number | byte << shift


class ArrayTable:
    """Columns in memory, of one length, batch by batch; ``damage`` says what is missing."""

    def __init__(self, layout: TableLayout, values: Sequence[NDArray[Any]], *damage: str) -> None:
        self.layout, self._values, self.damage = layout, values, damage

    def __iter__(self) -> Iterator[dict[int, Any]]:
        for begin in range(0, len(self._values[0]), ROWS_AT_ONCE):
            rows = slice(begin, begin + ROWS_AT_ONCE)
            batch = {place: self._values[place][rows] for place in self.layout.places}
            texts = {*self.layout.texts, *(place for place in batch if batch[place].dtype.kind in "SU")}
            yield batch | {place: _texts_of(batch[place]) for place in texts}


def _texts_of(values: NDArray[Any]) -> list[str]:
    """The values (N,) as text, which may be stored in bytes."""
    return [v.decode(errors="replace") if isinstance(v, bytes) else str(v) for v in values.tolist()]


def _of_arrays(path: str, reading: TableReading, budget: WorkBudget, kind: str) -> ArrayTable:
    """The columns of arrays with as many rows.

    Raises UnreadableRecording if they are damaged, too large when decompressed, or the meaning of the columns
    is not known.
    """
    stated = {name.partition("[")[0].strip().lower() for _, name in reading.columns}
    arrays, left_out = arrays_in(path, kind, stated, budget)
    of_stated = [shape for name, (shape, _) in arrays.items() if (name or UNNAMED).lower() in stated]
    shapes = [shape for shape, _ in arrays.values()]
    choices = (of_stated, WIDEST), (of_stated, MOST_COLUMNS), (shapes, WIDEST)
    count = next(filter(None, starmap(_rows_of, choices)), 0)
    names, not_read, columns = list[str](), dict[str, list[str]](), list[NDArray[Any]]()
    for name, (shape, values) in arrays.items():
        if values is None or count not in (shape[0], shape[-1]):
            most = widest_of(name, stated)
            why = f"more than {most} values a row" if values is None else f"no axis of {count}"
            not_read.setdefault(why, []).append(f"{name} ({' x '.join(map(str, shape))})")
            continue
        rows = (values if shape[0] == count else np.moveaxis(values, -1, 0)).reshape(count, -1)
        names += [name] if rows.shape[1] == 1 else [f"{name}[{i}]" for i in range(rows.shape[1])]
        columns += list(rows.T)
    beyond = f"{left_out} arrays after the first {MOST_ARRAYS} are not read: name them by --columns"
    beyond = beyond if left_out else ""
    try:
        if not names:
            raise UnreadableRecording(f"{_NO_ARRAY}{_OBJECTS * (kind == 'MATLAB')}; {FROM_ARRAYS}")
        first = [*zip(*(_texts_of(values[:FIRST_ROWS]) for values in columns), strict=True)]
        if list(arrays) == [""]:
            layout = layout_without_names(first, reading, path)
        else:
            layout = layout_of_names(names, reading, path, rows=lambda: first)
    except (UnreadableRecording, ChoiceError) as error:
        text = "; ".join(filter(None, (str(error), beyond)))
        for why, entries in not_read.items():
            text += f"; not read: {listed_briefly(entries)}, which {'have' if entries[1:] else 'has'} {why}"
        raise type(error)(text) from error
    return ArrayTable(replace(layout, kind=kind, note="" if stated else beyond), columns)


_NO_ARRAY: Final = "it has no array of numbers with a row for each pose"
_OBJECTS: Final = "; tables, timetables and cells are not read: save table2struct(T, 'ToScalar', true)"


def _rows_of(shapes: Sequence[tuple[int, ...]], widest: int) -> int:
    """The number of rows: the length of the first or last axis of most arrays, weighted by the logarithm of
    their size; 0 without arrays."""
    sizes = defaultdict[int, float](float)
    for shape in shapes:
        size = math.prod(shape)
        for length in dict.fromkeys((shape[0], shape[-1])):
            if size <= widest * length:
                sizes[length] += math.log(size)
    return max(sizes, key=lambda length: (sizes[length], length > 1), default=0)


_BLOCK: Final = 512
_INTEL: Final = 84
_DEC: Final = 85
"""Formats of numbers; those of DEC have the integers of a PC, but other fractions."""
_NO_PC: Final = "its numbers are not those of a PC: write it for Intel"
_VALUES: Final = 17
_POSE: Final = 12
"""Number of values of a pose: the columns of the matrix and the position, without the last row."""
_KINDS: Final = {-1: "S1", 1: "i1", 2: "<i2", 4: "<f4"}
_SUFFIX: Final = "_4x4"
_NO_BODIES: Final = (
    "it is C3D with markers ({names}), not bodies: export bodies (6D) as text; or points = "
    "ezc3d.c3d({name!r})['data']['points'] (4, markers, N), of which scipy's Rotation.align_vectors finds "
    f"rotations; {FROM_ARRAYS}"
)


def _of_c3d(path: str, reading: TableReading, _: WorkBudget) -> ArrayTable:
    """The bodies of a C3D file in columns.

    Raises UnreadableRecording if it is damaged or has no bodies, and ChoiceError if the user states rotations
    or times, which the file states itself.
    """
    if reading != reading_of(unit=reading.unit):
        raise ChoiceError(f"{path}: C3D says what its rotations and times are: leave out all but --unit")
    try:
        with open(path, "rb") as file:
            head = file.read(_BLOCK)
            file.seek((head[0] - 1) * _BLOCK)
            blocks = file.read(4)
            if blocks[3] not in (_INTEL, _DEC):
                raise UnreadableRecording(_NO_PC)
            parameters = _parameters(file.read(blocks[2] * _BLOCK))
        labels = [key for key in sorted(parameters) if key.startswith("ROTATION:LABELS")]
        names = [name for key in labels for name in parameters[key]]
        names = names[: int(parameters.get("ROTATION:USED", [0])[0])]
        if not names:
            markers = listed_briefly([*map(printable, parameters.get("POINT:LABELS", []))])
            about = {"names": markers or "none", "name": os.path.basename(path)}
            raise UnreadableRecording(_NO_BODIES.format(**about))
        if blocks[3] == _DEC:
            raise UnreadableRecording(_NO_PC)
        units = *parameters.get("ROTATION:UNITS", []), *parameters.get("POINT:UNITS", []), "mm"
        ratio = parameters.get("ROTATION:RATIO", [1])[0]
        own_rate = parameters.get("ROTATION:RATE")
        rate = float(parameters["POINT:RATE"][0] * float(ratio) if own_rate is None else own_rate[0])
        if not 0.0 < rate < 1e6:
            raise ValueError(f"a rate of {rate:g} Hz")
        bodies = tuple(
            Body(
                name[: -len(_SUFFIX)] if name.lower().endswith(_SUFFIX) else name,
                tuple(_POSE * i + place for place in (9, 10, 11, 0, 3, 6, 1, 4, 7, 2, 5, 8)),
                LENGTHS_M[reading.unit or str(units[0]).lower()],
                "matrix",
            )
            for i, name in enumerate(names)
        )
        first, last = struct.unpack_from("<HH", head, 6)
        rows = (last - first + 1) * int(ratio)
        start = (int(parameters["ROTATION:DATA_START"][0]) % 2**16 - 1) * _BLOCK
        stored = max(os.path.getsize(path) - start, 0) // (4 * _VALUES * len(bodies))
        count = min(rows, stored) if rows > 0 and last < 2**16 - 1 else stored  # longer ones do not fit
        values = np.fromfile(path, "<f4", count * len(bodies) * _VALUES, offset=start)
    except (LookupError, ValueError, TypeError, struct.error, OSError) as error:
        raise UnreadableRecording(f"it is damaged: its parameters cannot be read ({error})") from error
    cut_off = f"it ends after {count} of {rows} frames: if more was recorded, copy it again"
    layout = TableLayout(-1, 1e9 / rate, bodies, "C3D", has_own_unit=True)
    matrices = values.reshape(count, len(bodies), _VALUES).astype(np.float64)
    matrices[matrices[:, :, -1] < 0.0] = np.nan
    poses = matrices[:, :, :16].reshape(count, len(bodies), 4, 4)[..., :3]
    columns = list(poses.reshape(count, _POSE * len(bodies)).T)
    return ArrayTable(layout, columns, *([cut_off] if count < rows else []))


def _parameters(data: bytes) -> dict[str, Any]:
    """The parameters as ``GROUP:NAME``; raises LookupError, ValueError or struct.error."""
    groups, parameters, at = dict[int, str](), list[tuple[int, str, Any]](), 0
    while at < len(data) and data[at]:
        size, group = struct.unpack_from("bb", data, at)
        name = data[at + 2 : at + 2 + abs(size)].decode("latin-1").upper()
        at += 2 + abs(size)
        (step,) = struct.unpack_from("<H", data, at)
        if group < 0:
            groups[-group] = name
        else:
            kind, rank = struct.unpack_from("bB", data, at + 2)
            shape = tuple(data[at + 4 : at + 4 + rank])
            count = int(np.prod(shape, dtype=int))
            values: Any = np.frombuffer(data, _KINDS[kind], count, at + 4 + rank)
            if kind == -1:  # text in rows of one width
                width, text = max(shape[0] if shape else 1, 1), values.tobytes().decode("latin-1")
                values = [text[i : i + width].strip(" \0") for i in range(0, len(text), width)]
            parameters.append((group, name, values))
        if not step:
            break
        at += step
    return {f"{groups.get(group, '')}:{name}": values for group, name, values in parameters}


TABLES: Final[Mapping[str, Callable[[str, TableReading, WorkBudget], ParquetTable | ArrayTable]]] = {
    **{kind: partial(ParquetTable, kind=kind) for kind in ("Parquet", "Feather")},
    **{kind: partial(_of_arrays, kind=kind) for kind in ("NumPy", "MATLAB", "HDF5")},
    "C3D": _of_c3d,
}
"""Readers of the kinds of tables."""
