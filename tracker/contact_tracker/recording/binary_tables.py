"""Tables of poses in Parquet, in arrays of NumPy (.npy, .npz) and in C3D files with rigid bodies.

Values in lists and structs of Parquet are columns of their own. What its pages declare is checked before a
library decompresses them: a few bytes can expand to billions of rows or to gigabytes. Footer and page headers
are in Thrift's compact protocol: https://parquet.apache.org/docs/file-format/

C3D has a header, groups of parameters, and data in blocks of 512 bytes (https://www.c3d.org). Theia3D and
Visual3D write matrices of the data type ROTATION: 16 floats by columns and one of reliability, negative where
there is none (https://www.c-motion.com/v3dwiki/index.php?title=ROTATION_DATA_TYPE). It is read here, as the
library ezc3d ends the process at damaged files.
"""

import os
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import compress
from typing import IO, Any, Final

import numpy as np
import pyarrow
from numpy.lib import format as npy
from numpy.typing import NDArray
from pyarrow import compute, types
from pyarrow.parquet import ColumnChunkMetaData, FileMetaData, ParquetFile

from contact_tracker.config.quantities import LENGTHS_M
from contact_tracker.config.table_reading import TableReading, reading_of
from contact_tracker.errors import ChoiceError, UnreadableRecording, first_line, printable
from contact_tracker.recording.bytestream import SHARE_OF_RECORD, TooMuchWork, WorkBudget
from contact_tracker.recording.items import ROWS_AT_ONCE
from contact_tracker.recording.table_layouts import Body, TableLayout, numbers
from contact_tracker.recording.table_proposals import FIRST_ROWS, layout_of_names, layout_without_names

_PARQUET_ERRORS: Final = (pyarrow.ArrowException, OSError, ValueError, OverflowError, KeyError)
_BUFFER_BYTES: Final = 2**16
_LONGEST_LINE: Final = 120
"""Longest text of an error of pyarrow, which may list all columns."""
_LONGEST_NAME: Final = 40
_WIDEST: Final = 64
"""Values of a list or an array that are columns; an image has more."""
_DEEPEST: Final = 5


_Leaf = tuple[str, tuple[str | int, ...], Any]
"""Name, path and type of a column of single values, which is the file's column ``path[0]``, or in its structs
or lists."""


class ParquetTable:
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
            leaves = list[_Leaf]()
            for one in self._file.schema_arrow:
                first = self._first_of(one.name, path, budget) if _has_list(one.type) else None
                leaves += _leaves(one.name, (one.name,), one.type, first)
        except _PARQUET_ERRORS as error:
            raise UnreadableRecording(
                f"it cannot be read as a table: {first_line(error)[:_LONGEST_LINE]}"
            ) from error
        names, rows = [name for name, _, _ in leaves], partial(self._first_rows, leaves, path, budget)
        self.layout = replace(layout_of_names(names, reading, path, rows=rows), kind="Parquet")
        self._chosen = {place: leaves[place] for place in self.layout.places if place >= 0}
        for place, (name, _, kind) in self._chosen.items():
            is_time = place == self.layout.time and types.is_temporal(kind)
            if not (is_time or _is_number(kind)):
                named = f"its column {printable(name[:_LONGEST_NAME])} is of the type {kind}"
                raise UnreadableRecording(f"{named}: columns of numbers are read")
            if is_time:
                self.layout = replace(self.layout, time_ns=1, has_own_unit=types.is_duration(kind))
        self._columns = list(dict.fromkeys(str(path[0]) for _, path, _ in self._chosen.values()))
        _check_pages(self._file.metadata, path, {*self._columns}, len(self.layout.bodies), budget)

    def __iter__(self) -> Iterator[dict[int, Any]]:
        done = 0
        try:
            for batch in self._file.iter_batches(ROWS_AT_ONCE, columns=self._columns, use_threads=False):
                yield self._values(batch, done)
                done += len(batch)
        except _PARQUET_ERRORS as error:
            self.damage = (f"it is damaged: {first_line(error)[:_LONGEST_LINE]}",)
        finally:
            self._file.close()

    def _values(self, batch: Any, done: int) -> dict[int, Any]:
        """Times as text, and numbers, of a batch after ``done`` rows; rows without any are left out."""
        found, time = dict[int, Any](), self.layout.time
        for place, (_, path, _) in self._chosen.items():
            column = _single(batch.column(str(path[0])), path[1:])
            found[place] = _texts(column) if place in (time, self.layout.rest) else _numbers(column)
        if time < 0:
            return {**found, time: [str(done + i) for i in range(len(batch))]}
        numbers = [values for values in found.values() if isinstance(values, np.ndarray)]
        is_row = np.array([bool(text) for text in found[time]]) | np.isfinite(numbers).any(axis=0)
        return {
            place: values[is_row] if isinstance(values, np.ndarray) else list(compress(values, is_row))
            for place, values in found.items()
        }

    def _first_rows(self, leaves: Sequence[_Leaf], path: str, budget: WorkBudget) -> list[list[str]]:
        """The numbers of the first rows as text, ``nan`` for others; none where they cannot be read."""
        names = dict.fromkeys(str(own[0]) for _, own, kind in leaves if _is_number(kind))
        try:
            _check_pages(self._file.metadata, path, {*names}, 1, budget)
            batch = next(self._file.iter_batches(FIRST_ROWS, columns=[*names], use_threads=False))
            columns = [
                _numbers(_single(batch.column(str(own[0])), own[1:]))
                if _is_number(kind)
                else np.full(len(batch), np.nan)
                for _, own, kind in leaves
            ]
        except (UnreadableRecording, StopIteration, *_PARQUET_ERRORS):
            return []
        rows: list[list[str]] = np.array(columns).T.astype(str).tolist()
        return rows

    def _first_of(self, name: str, path: str, budget: WorkBudget) -> Any:
        """The value of a column in the first row; None where it cannot be read."""
        try:
            _check_pages(self._file.metadata, path, {name}, 1, budget)
            batch = next(self._file.iter_batches(1, columns=[name], use_threads=False), None)
        except UnreadableRecording:
            return None
        return None if batch is None else batch.column(0)[0].as_py()


def _leaves(name: str, path: tuple[str | int, ...], kind: Any, first: Any) -> Iterator[_Leaf]:
    """The columns of single values in a column of the file; the ``first`` row has the length of lists."""
    if len(path) > _DEEPEST:
        return
    if types.is_struct(kind):
        for field in map(kind.field, range(min(kind.num_fields, _WIDEST))):
            own = first.get(field.name) if isinstance(first, dict) else None
            yield from _leaves(f"{name}.{field.name}", (*path, field.name), field.type, own)
    elif _is_list(kind):
        values = first if isinstance(first, list) else []
        many = kind.list_size if types.is_fixed_size_list(kind) else len(values)
        for i in range(min(many, _WIDEST)):
            own = values[i] if i < len(values) else None
            yield from _leaves(f"{name}[{i}]", (*path, i), kind.value_type, own)
        if many > _WIDEST:
            yield f"{name}[{_WIDEST}:{many}]", path, kind  # is only told of
    else:
        yield name, path, kind


def _is_list(kind: Any) -> bool:
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))


def _has_list(kind: Any) -> bool:
    """Whether the length of a list, at any depth, is not in the type."""
    if types.is_struct(kind):
        return any(_has_list(kind.field(i).type) for i in range(min(kind.num_fields, _WIDEST)))
    if not _is_list(kind):
        return False
    return not types.is_fixed_size_list(kind) or _has_list(kind.value_type)


def feather_columns(path: str) -> list[str]:
    """Names and types of the columns of a file of Arrow; a damaged one can raise anything."""
    with pyarrow.ipc.open_file(path) as file:
        return [f"{one.name} {one.type}" for one in file.schema]


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
            return _single(pyarrow.array(rows, column.type.value_type), path[i + 1 :])
        column = compute.struct_field(column, step)
    return column


def _texts(column: Any) -> list[str]:
    """Times as text, dates and durations in nanoseconds; empty where there is none."""
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
"""Longest page header (bytes); it may contain statistics of long texts."""
_WHOLE: Final = (0, 6)
"""Encodings in which each text is there in full; in others many values may share a long one."""
_MOST_SHARED: Final = 2**28
"""Most bytes that texts in other encodings may become."""
_VALUES_PER_ROW: Final = 7
"""Values of lists that count as a row: a pose has as many."""
_Struct = Mapping[int, Any]
"""The fields of a Thrift struct by number."""


def _check_pages(about: FileMetaData, path: str, names: Set[str], bodies: int, budget: WorkBudget) -> None:
    """Check the columns of these names in a file with ``bodies`` bodies; raises UnreadableRecording if they
    exceed the limits for the file's size, or page headers cannot be parsed."""
    try:
        with open(path, "rb") as file:
            for group in map(about.row_group, range(about.num_row_groups)):
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
    except TooMuchWork as error:
        raise UnreadableRecording(f"it is too much for its size: {error}") from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise UnreadableRecording(f"it is damaged: where its pages begin cannot be read ({error})") from error


def _pages(file: IO[bytes], column: ColumnChunkMetaData) -> Iterator[tuple[int, int]]:
    """Stored and decompressed bytes of each page of a column."""
    at = min(column.data_page_offset, column.dictionary_page_offset or column.data_page_offset)
    end, values, longest, shared = at + column.total_compressed_size, 0, 0, 0
    if not 0 < at <= end:
        raise ValueError("a page is outside of the file")
    while at < end:
        file.seek(at)
        page, size = _thrift_struct(file.read(min(_PAGE_HEADER, end - at)), 0)
        plain, packed = page[2], page[3]
        of_data = page.get(5) or page.get(8) or {}
        values += of_data.get(1, 0)
        if min(plain, packed, of_data.get(1, 0)) < 0 or values > column.num_values:
            raise ValueError("a page has more values than its column")
        at, longest = at + size + packed, max(longest, plain)
        if (
            column.physical_type.endswith("BYTE_ARRAY")
            and of_data.get(2 if page.get(5) else 4, 0) not in _WHOLE
        ):
            shared += of_data[1] * longest
        if shared > _MOST_SHARED:
            raise UnreadableRecording(f"its column {column.path_in_schema} is text: write numbers")
        yield size + packed, plain
    if at != end:
        raise ValueError("a page is longer than its column")


def _thrift_struct(data: bytes, at: int) -> tuple[_Struct, int]:
    """The struct at an offset, and the offset after it; raises LookupError, ValueError or RecursionError."""
    fields, number = dict[int, Any](), 0
    while head := data[at]:
        number, kind, at = number + (head >> 4), head & 15, at + 1
        if not head >> 4:
            number, at = _varint(data, at)
            number >>= 1
        value: Any = kind == 1
        if kind == 3:
            value, at = data[at], at + 1
        elif kind in (4, 5, 6):
            value, at = _varint(data, at)
            value = (value >> 1) ^ -(value & 1)
        elif kind == 8:
            size, at = _varint(data, at)
            value, at = None, at + size
        elif kind == 12:
            value, at = _thrift_struct(data, at)
        elif kind not in (1, 2):
            raise ValueError(f"a field of the kind {kind}")
        fields[number] = value
    return fields, at + 1


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of 7 bits in each byte."""
    number = shift = 0
    while data[at] > 127:
        number |= (data[at] & 127) << shift
        at, shift = at + 1, shift + 7
    return number | data[at] << shift, at + 1


_MOST_ARRAYS: Final = 200
_ARRAY_ERRORS: Final = (
    *(ValueError, OSError, EOFError, RuntimeError, MemoryError),
    *(zipfile.BadZipFile, zlib.error, NotImplementedError),
)


class ArrayTable:
    """The columns of arrays with as many rows, some rows after others; these have no ``damage``.

    Raises
    ------
    UnreadableRecording
        It is damaged, too large when decompressed, or it is not known which columns are what.
    """

    damage: tuple[str, ...] = ()

    def __init__(self, path: str, reading: TableReading, budget: WorkBudget) -> None:
        try:
            arrays = _arrays(path, budget)
        except TooMuchWork as error:
            raise UnreadableRecording(f"it is too much for its size: {error}") from error
        except _ARRAY_ERRORS as error:
            raise UnreadableRecording(f"it cannot be read as arrays of NumPy: {error}") from error
        lengths = Counter(len(array) for array in arrays.values())
        if not lengths:
            raise UnreadableRecording("it has no array of numbers with a row for each pose")
        self._rows = lengths.most_common(1)[0][0]
        names, self._values = list[str](), list[NDArray[Any]]()
        for name, array in arrays.items():
            if len(array) == self._rows:
                rows = array.reshape(self._rows, array.size // max(self._rows, 1))
                names += [name] if array.ndim == 1 else [f"{name}[{i}]" for i in range(rows.shape[1])]
                self._values += list(rows.T)
        rows = np.array([values[:FIRST_ROWS] for values in self._values]).T.astype(str).tolist()
        if list(arrays) == [""]:
            layout = layout_without_names(rows, reading, path)
        else:
            layout = layout_of_names(names, reading, path, rows=lambda: rows)
        self.layout = replace(layout, kind="NumPy")

    def __iter__(self) -> Iterator[dict[int, Any]]:
        layout = self.layout
        for begin in range(0, self._rows, ROWS_AT_ONCE):
            end = min(begin + ROWS_AT_ONCE, self._rows)
            found: dict[int, Any] = {}
            for place in layout.places:
                values = np.arange(begin, end) if place < 0 else self._values[place][begin:end]
                is_time = place in (layout.time, layout.rest)
                found[place] = list(map(str, values.tolist())) if is_time else values.astype(np.float64)
            yield found


def _arrays(path: str, budget: WorkBudget) -> dict[str, NDArray[Any]]:
    """The arrays of numbers by name; that of an ``.npy`` file has none."""
    if not path.lower().endswith(".npz"):
        with open(path, "rb") as file:
            array = _array(file, os.path.getsize(path), os.path.getsize(path), budget)
        return {} if array is None else {"": array}
    found = dict[str, NDArray[Any]]()
    with closing(zipfile.ZipFile(path)) as archive:
        for info in archive.infolist()[:_MOST_ARRAYS]:
            with archive.open(info) as file:
                array = _array(file, info.compress_size, info.file_size, budget)
            if array is not None:
                found[printable(info.filename.removesuffix(".npy"))] = array
    return found


def _array(file: IO[bytes], packed: int, size: int, budget: WorkBudget) -> NDArray[Any] | None:
    """An array in a file of so many bytes, ``packed`` and not, if it has numbers in rows of few values."""
    version = npy.read_magic(file)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, by_columns, kind = read_header(file)
    width = int(np.prod(shape[1:], dtype=object)) if shape else 0
    if not 1 <= width <= _WIDEST or kind.kind not in "iuf":
        return None
    if min(shape) < 0 or width * shape[0] * kind.itemsize > size:
        raise ValueError("an array is longer than its file")
    budget.inflate(packed, size)
    values = np.frombuffer(file.read(width * shape[0] * kind.itemsize), kind)
    return values.reshape(shape, order="F" if by_columns else "C")


_BLOCK: Final = 512
_INTEL: Final = 84
_VALUES: Final = 17
_POSE: Final = 12
"""Values of a pose: the columns of the matrix and the position, without the last row."""
_KINDS: Final = {-1: "S1", 1: "i1", 2: "<i2", 4: "<f4"}
_MARKERS_SHOWN: Final = 5
_SUFFIX: Final = "_4x4"
_NO_BODIES: Final = (
    "it is C3D with markers ({names}), not bodies: export bodies (6D) as text; or points = "
    "ezc3d.c3d({name!r})['data']['points'] (4, markers, N), of which scipy's Rotation.align_vectors finds "
    "rotations; contact_tracker.Trajectory.from_arrays(t, p, q) takes times, positions and rotations"
)


class C3DTable(ArrayTable):
    """The bodies of a C3D file in columns, some frames after others; ``damage`` says what is missing.

    Raises
    ------
    UnreadableRecording
        It is damaged, or has no bodies.
    ChoiceError
        The user says of its columns what the file says itself.
    """

    def __init__(self, path: str, reading: TableReading, budget: WorkBudget) -> None:
        if reading != reading_of(unit=reading.unit):
            raise ChoiceError(f"{path}: C3D says what its rotations and times are: leave out all but --unit")
        try:
            with open(path, "rb") as file:
                head = file.read(_BLOCK)
                file.seek((head[0] - 1) * _BLOCK)
                blocks = file.read(4)
                if blocks[3] != _INTEL:
                    raise UnreadableRecording("its numbers are not those of a PC: write it for Intel")
                found = _parameters(file.read(blocks[2] * _BLOCK))
            names = [n for key in sorted(found) if key.startswith("ROTATION:LABELS") for n in found[key]]
            names = names[: int(found.get("ROTATION:USED", [0])[0])]
            if not names:
                markers = [*map(printable, found.get("POINT:LABELS", []))]
                shown = markers[:_MARKERS_SHOWN] + ["..."] * (len(markers) > _MARKERS_SHOWN)
                about = {"names": ", ".join(shown) or "none", "name": os.path.basename(path)}
                raise UnreadableRecording(_NO_BODIES.format(**about))
            unit = str([*found.get("ROTATION:UNITS", []), *found.get("POINT:UNITS", []), "mm"][0]).lower()
            ratio = found.get("ROTATION:RATIO", [1])[0]
            own_rate = found.get("ROTATION:RATE")
            rate = float(found["POINT:RATE"][0] * float(ratio) if own_rate is None else own_rate[0])
            if not 0.0 < rate < 1e6:
                raise ValueError(f"a rate of {rate:g} Hz")
            bodies = tuple(
                Body(
                    name[: -len(_SUFFIX)] if name.lower().endswith(_SUFFIX) else name,
                    tuple(_POSE * i + place for place in (9, 10, 11, 0, 3, 6, 1, 4, 7, 2, 5, 8)),
                    LENGTHS_M[reading.unit or unit],
                    "matrix",
                )
                for i, name in enumerate(names)
            )
            first, last = struct.unpack_from("<HH", head, 6)
            rows, start = (last - first + 1) * int(ratio), int(found["ROTATION:DATA_START"][0]) % 2**16 - 1
            there = max(os.path.getsize(path) - start * _BLOCK, 0) // (4 * _VALUES * len(bodies))
            self._rows = there if last == 2**16 - 1 else min(rows, there)  # longer ones do not fit
            values = np.fromfile(path, "<f4", self._rows * len(bodies) * _VALUES, offset=start * _BLOCK)
        except (LookupError, ValueError, TypeError, struct.error, OSError) as error:
            raise UnreadableRecording(f"it is damaged: its parameters cannot be read ({error})") from error
        if self._rows < rows:
            text = f"it ends after {self._rows} of {rows} frames: if more was recorded, copy it again"
            self.damage = (text,)
        self.layout = TableLayout(-1, 1e9 / rate, bodies, "C3D", has_own_unit=True)
        matrices = values.reshape(self._rows, len(bodies), _VALUES).astype(np.float64)
        matrices[matrices[:, :, -1] < 0.0] = np.nan
        poses = matrices[:, :, :16].reshape(self._rows, len(bodies), 4, 4)[..., :3]
        self._values = list(poses.reshape(self._rows, _POSE * len(bodies)).T)


def _parameters(data: bytes) -> dict[str, Any]:
    """The parameters as ``GROUP:NAME``; raises LookupError, ValueError or struct.error."""
    groups, found, at = dict[int, str](), list[tuple[int, str, Any]](), 0
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
            found.append((group, name, values))
        if not step:
            break
        at += step
    return {f"{groups.get(group, '')}:{name}": values for group, name, values in found}
