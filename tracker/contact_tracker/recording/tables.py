"""Tables of poses: text, Parquet and arrays of NumPy. Files of other formats are refused with advice."""

import os
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from itertools import islice
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import ChoiceError, UnreadableRecording, printable
from contact_tracker.motion.poses import Poses
from contact_tracker.recording.bytestream import TABLE_ENDINGS, TooMuchWork, WorkBudget, is_text
from contact_tracker.recording.items import ROWS, Channel, PoseSource, Rows
from contact_tracker.recording.table_layouts import SEPARATORS, Body, TableLayout, layout_of_names
from contact_tracker.recording.table_times import NEVER, TableTimes, numbers
from contact_tracker.recording.text_tables import TextRows, head_of, layout_of_text, layout_without_names

_FROM: Final = "contact_tracker.Trajectory.from_"
_ARRAYS: Final = f"{_FROM}arrays(t, p, q) takes times, positions and rotations"
_PACKED: Final = {
    b"\x04\x22\x4d\x18": "lz4 -d",
    b"\x1f\x8b": "gunzip",
    b"PK\x03\x04": "unzip",
    b"BZh": "bunzip2",
}
"""First bytes of compressed files, and the commands that decompress them."""
_HDF5: Final = b"\x89HDF\r\n\x1a\n"
_MATLAB: Final = b"MATLAB "
_SHOWN: Final = 8


def what_it_is(path: str, begin: bytes) -> str | None:
    """One line on a file with these first bytes, if it is of a known format that is not read."""
    name = os.path.basename(path)
    for magic, command in _PACKED.items():
        if begin.startswith(magic):
            return f"it is compressed: {command} {name} first"
    for magic, describe in _KNOWN.items():
        if begin.startswith(magic):
            return describe(path, repr(name))
    return None


def is_other_format(begin: bytes) -> bool:
    """Whether a file begins as one of a known format that is not read; some of these begin with text."""
    return begin.startswith((*_PACKED, *_KNOWN))


def _hdf5(path: str, name: str) -> str:
    return (
        f"it is HDF5, which is not read: file = h5py.File({name}); file.visit(print) shows the names of its "
        f"arrays; {_ARRAYS}"
    )


def _matlab(path: str, name: str) -> str:
    return (
        f"it is a file of MATLAB{_arrays_in(path)}, which is not read: data = scipy.io.loadmat({name}); "
        f"{_ARRAYS}"
    )


def _arrays_in(path: str) -> str:
    """Names and shapes of the arrays in a file of MATLAB."""
    from scipy.io import whosmat

    try:
        found = whosmat(path)
    except Exception:  # damaged files can raise anything
        return ""
    shown = ", ".join(f"{printable(name)} {shape}" for name, shape, _ in found[:_SHOWN])
    return f" with {shown}{', ...' if len(found) > _SHOWN else ''}"


def _feather(path: str, name: str) -> str:
    return (
        f"it is a table of Arrow (Feather), which is not read: table = pyarrow.feather.read_table({name}); "
        f"{_FROM}dataframe(table) takes it"
    )


def _pickle(path: str, name: str) -> str:
    return f"it is a pickle, which runs code when it is loaded: if you trust it, load it in Python; {_ARRAYS}"


def _rerun(path: str, name: str) -> str:
    return f"it is a recording of rerun, which is not read: give the file from which it was made; {_ARRAYS}"


def _lfs(path: str, name: str) -> str:
    return "it is a pointer of Git LFS, not the file itself: git lfs pull"


_KNOWN: Final[dict[bytes, Callable[[str, str], str]]] = {
    _HDF5: _hdf5,
    _MATLAB: _matlab,
    b"ARROW1": _feather,
    b"\x80\x04\x95": _pickle,
    b"\x80\x05\x95": _pickle,
    b"RRF": _rerun,
    b"version https://git-lfs": _lfs,
}


PARQUET_MAGIC: Final = b"PAR1"
NPY_MAGIC: Final = b"\x93NUMPY"
NPZ_MAGIC: Final = b"PK\x03\x04"
_WIDEST: Final = 64
_MOST_ARRAYS: Final = 200
_ERRORS: Final = (
    ValueError,
    OSError,
    EOFError,
    zipfile.BadZipFile,
    zlib.error,
    NotImplementedError,
    RuntimeError,
    MemoryError,
)


def is_array_file(path: str, begin: bytes) -> bool:
    """Whether a file with these first bytes has arrays of NumPy."""
    return begin.startswith(NPY_MAGIC) or (begin.startswith(NPZ_MAGIC) and path.lower().endswith(".npz"))


class ArrayRows:
    """The columns of arrays with as many rows, some rows after others.

    Raises
    ------
    UnreadableRecording
        It is damaged, too large when decompressed, or it is not known which columns are what.
    """

    def __init__(self, path: str, reading: TableReading, budget: WorkBudget) -> None:
        self.damage: tuple[str, ...] = ()
        try:
            arrays = _read(path, budget)
        except TooMuchWork as error:
            raise UnreadableRecording(f"it is too much for its size: {error}") from error
        except _ERRORS as error:
            raise UnreadableRecording(f"it cannot be read as arrays of NumPy: {error}") from error
        lengths = Counter(len(array) for array in arrays.values())
        if not lengths:
            raise UnreadableRecording("it has no array of numbers with a row for each pose")
        self._rows = lengths.most_common(1)[0][0]
        whole = [one for one in arrays.items() if len(one[1]) == self._rows]
        columns = [column for one in whole for column in _columns(*one)]
        self._values = [values for _, values in columns]
        if list(arrays) == [""]:
            first = [str(values[0]) for values in self._values] if self._rows else []
            self.layout = layout_without_names(first, reading, path, "NumPy")
        else:
            self.layout = layout_of_names([name for name, _ in columns], reading, path, "NumPy")

    def __iter__(self) -> Iterator[dict[int, Any]]:
        layout = self.layout
        for begin in range(0, self._rows, _ROWS):
            part = slice(begin, min(begin + _ROWS, self._rows))
            found: dict[int, Any] = {}
            for place in layout.places:
                if place < 0:
                    found[place] = [str(i) for i in range(part.start, part.stop)]
                elif place in (layout.time, layout.rest):
                    found[place] = [str(value) for value in self._values[place][part].tolist()]
                else:
                    found[place] = self._values[place][part].astype(np.float64)
            yield found


def _columns(name: str, array: NDArray[Any]) -> list[tuple[str, NDArray[Any]]]:
    if array.ndim == 1:
        return [(name, array)]
    rows = array.reshape(len(array), -1)
    return [(f"{name}[{i}]", rows[:, i]) for i in range(rows.shape[1])]


def _read(path: str, budget: WorkBudget) -> dict[str, NDArray[Any]]:
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


if TYPE_CHECKING:
    from contact_tracker.recording.parquet_rows import ParquetRows

CUT_OFF: Final = (
    "its last line is cut off inside a row and left out: if more was recorded, copy the file again"
)
_LONGEST_TIME: Final = 40
_ROWS: Final = 10_000
_BEGIN: Final = 4096
_RECORDINGS: Final = (".mcap", ".mcap.zst", ".mcap.zstd")
Columns = Mapping[int, Sequence[str] | NDArray[np.float64]]
"""Values by the index of their column, numbers perhaps as text."""


def is_table(path: str, begin: bytes) -> bool:
    """Whether a file with these first bytes may be a table: Parquet, arrays of NumPy, or text without the
    suffix ``.mcap``."""
    if begin.startswith(PARQUET_MAGIC) or is_array_file(path, begin):
        return True
    is_other = path.lower().endswith(_RECORDINGS) or is_other_format(begin)
    return not is_other and is_text(begin, path)


def refuse_other_formats(path: str, begin: bytes) -> None:
    """Raise UnreadableRecording if a file with these first bytes, which is no table, is of another known
    format, or named as a table."""
    known = what_it_is(path, begin)
    if known is not None:
        raise UnreadableRecording(known)
    if begin and path.lower().endswith(TABLE_ENDINGS):
        raise UnreadableRecording("it is named as a table, but is not text")


def has_poses(path: str) -> bool:
    """Whether a file is a table with the columns of poses."""
    with open(path, "rb") as file:
        begin = file.read(_BEGIN)
    try:
        return is_table(path, begin) and bool(_opened(path, AS_NAMED, WorkBudget()))
    except (UnreadableRecording, ChoiceError):
        return False


def _no_table(why: UnreadableRecording) -> str:
    return (
        f"it is neither a recording nor a table of poses ({why}). What is read: MCAP files, ROS bags (.db3, "
        ".bag), tables (CSV, TUM, JSON lines, Parquet), and exports of Motive, Vicon and Qualisys"
    )


def read_table(
    path: str,
    wanted: Callable[[Channel], bool],
    report: Callable[[str], None],
    budget: WorkBudget,
    assume: Callable[[str], None],
    reading: TableReading = AS_NAMED,
) -> Iterator[Rows]:
    """The poses of a table, in columns of some rows; a body is a source.

    Parameters
    ----------
    wanted : whether poses of such a channel are read.
    report : called with one line on rows that cannot be read.
    budget : bounds the size of a compressed table.
    assume : called with one line on each assumption.
    reading : what the user says of its columns.

    Raises
    ------
    UnreadableRecording
        It has no pose columns, or it is not known how they are meant.
    ChoiceError
        The reading does not fit it.
    """
    try:
        table = _opened(path, reading, budget)
    except UnreadableRecording as error:
        is_named = path.lower().endswith(TABLE_ENDINGS)
        raise error if is_named else UnreadableRecording(_no_table(error)) from error
    layout, topic = table.layout, os.path.basename(path)
    sources = tuple(PoseSource(topic, layout.kind, "", body.name) for body in layout.bodies)
    is_wanted = wanted(Channel(topic, ROWS, layout.kind, "", b""))
    times, lost, why = TableTimes(path, layout, reading, assume), 0, ""
    for columns in table if is_wanted else ():
        texts = [str(time) for time in columns[layout.time]]
        rests = None if layout.rest is None else [str(rest) for rest in columns[layout.rest]]
        stamps = times.stamps_ns(texts, rests)
        good = stamps != NEVER
        if not good.all():
            first = int(good.argmin())
            why = why or _without_time(texts[first], columns, first, layout)
            lost += int((~good).sum())
        yield Rows(sources, tuple(_poses(columns, stamps, body)[good] for body in layout.bodies))
    if lost:
        report(f"{lost} {'row has' if lost == 1 else 'rows have'} {why}")
    for damage in table.damage:
        report(damage)


def _opened(path: str, reading: TableReading, budget: WorkBudget) -> "TextTable | ParquetRows | ArrayRows":
    budget.count_read(os.path.getsize(path))
    with open(path, "rb") as file:
        begin = file.read(_BEGIN)
    if begin.startswith(PARQUET_MAGIC):
        from contact_tracker.recording.parquet_rows import ParquetRows

        return ParquetRows(path, reading, budget)
    if is_array_file(path, begin):
        return ArrayRows(path, reading, budget)
    return TextTable(path, begin, reading)


class TextTable:
    """A text table in columns, some rows after others; after iteration ``damage`` says what is not read."""

    def __init__(self, path: str, begin: bytes, reading: TableReading) -> None:
        self.layout = layout_of_text(head_of(path, begin), reading, path)
        self.damage: tuple[str, ...] = ()
        self._rows = TextRows(path, begin, self.layout)

    def __iter__(self) -> Iterator[Columns]:
        places, rows = self.layout.places, iter(self._rows)
        while some := list(islice(rows, _ROWS)):
            yield dict(zip(places, zip(*some, strict=True), strict=True))
        self.damage = (CUT_OFF,) if self._rows.is_cut else ()


def _without_time(text: str, columns: Columns, row: int, layout: TableLayout) -> str:
    """What a row without a time lacks: a time, or, if it has nothing but text in its first cell, the
    separators of the others."""
    lacks = "no time that is a number or a date"
    others = [columns[place][row] for place in layout.places if place != layout.time]
    is_alone = text and not any(isinstance(value, str) and value for value in others)
    if is_alone and layout.kind not in ("Parquet", "JSON"):
        return f"{lacks}: separate their values by {SEPARATORS[layout.separator or ' ']}, as in the first row"
    shown = f" ({printable(text[:_LONGEST_TIME])!r})" if text else ""
    return f"{lacks}{shown}: give each a number, or a date as 2026-03-01T10:00:00.25"


def _poses(columns: Columns, stamps: NDArray[np.int64], body: Body) -> Poses:
    """The poses of a body; empty cells are NaN."""
    values = [columns[place] for place in body.columns]
    given = np.column_stack([one if isinstance(one, np.ndarray) else numbers(one) for one in values])
    poses = body.poses(given)
    return Poses(stamps, poses[:, :3], poses[:, 3:])
