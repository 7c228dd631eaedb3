"""Tables of poses: text, Parquet and arrays of NumPy, in columns."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import ChoiceError, UnreadableRecording, printable
from contact_tracker.motion.poses import Poses, ReadAs
from contact_tracker.recording.bytestream import TABLE_ENDINGS, WorkBudget, is_text
from contact_tracker.recording.items import ROWS, ROWS_AT_ONCE, Channel, PoseSource, Rows
from contact_tracker.recording.other_formats import is_other_format, what_it_is
from contact_tracker.recording.parquet_pages import PARQUET_MAGIC
from contact_tracker.recording.table_layouts import SEPARATORS, Body, TableLayout
from contact_tracker.recording.table_times import NEVER, TableTimes, numbers
from contact_tracker.recording.text_tables import TextRows, head_of, layout_of_text

if TYPE_CHECKING:
    from contact_tracker.recording.array_rows import ArrayRows
    from contact_tracker.recording.parquet_rows import ParquetRows

NPY_MAGIC: Final = b"\x93NUMPY"
NPZ_MAGIC: Final = b"PK\x03\x04"
CUT_OFF: Final = (
    "its last line is cut off inside a row and left out: if more was recorded, copy the file again"
)
_LONGEST_TIME: Final = 40
_BEGIN: Final = 4096
_RECORDINGS: Final = (".mcap", ".mcap.zst", ".mcap.zstd")
Columns = Mapping[int, Sequence[str] | NDArray[np.float64]]
"""Values by the index of their column, numbers perhaps as text."""


def is_array_file(path: str, begin: bytes) -> bool:
    """Whether a file with these first bytes has arrays of NumPy."""
    return begin.startswith(NPY_MAGIC) or (begin.startswith(NPZ_MAGIC) and path.lower().endswith(".npz"))


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
    read_as = ReadAs(table=reading)
    sources = tuple(PoseSource(topic, layout.kind, "", body.name, None, read_as) for body in layout.bodies)
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
        from contact_tracker.recording.array_rows import ArrayRows

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
        while some := list(islice(rows, ROWS_AT_ONCE)):
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
