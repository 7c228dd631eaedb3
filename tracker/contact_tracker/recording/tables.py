"""Tables of poses in columns, and advice on formats that are not read."""

import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import compress
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.table_reading import AS_NAMED, TableReading, reading_of
from contact_tracker.errors import ChoiceError, UnreadableRecording, printable
from contact_tracker.motion.poses import Poses, ReadAs
from contact_tracker.recording.bytestream import (
    FROM_ARRAYS,
    TABLE_ENDINGS,
    WHAT_IS_READ,
    Notes,
    WorkBudget,
    first_bytes,
    is_text,
)
from contact_tracker.recording.items import ROWS, Channel, PoseSource, Rows
from contact_tracker.recording.table_bodies import begin_body
from contact_tracker.recording.table_layouts import (
    BLANKS,
    LONGEST_CELL,
    SEPARATORS,
    Body,
    ProposedReading,
    TableLayout,
    are_numbers,
    numbers,
)
from contact_tracker.recording.table_times import NEVER, TableTimes
from contact_tracker.recording.table_units import doubt_angles, doubt_degrees, largest_deg
from contact_tracker.recording.text_tables import TUM, TextTable

if TYPE_CHECKING:
    from contact_tracker.recording.binary_tables import ArrayTable, ParquetTable

_BINARY: Final[Sequence[tuple[str, re.Pattern[bytes], str]]] = (
    ("Parquet", re.compile(b"PAR1"), ""),
    ("Feather", re.compile(b"ARROW1"), ""),
    ("NumPy", re.compile(b"\x93NUMPY"), ""),
    ("NumPy", re.compile(b"PK\x03\x04"), ".npz"),
    ("HDF5", re.compile(rb"\x89HDF\r\n\x1a\n|MATLAB 7\.3"), ""),
    ("MATLAB", re.compile(b"MATLAB "), ""),
    ("MATLAB", re.compile(b"(?s).[\0-\x13]\0\0|\0\0"), ".mat"),
    ("C3D", re.compile(b"(?s).P"), ".c3d"),
)
"""Kinds of tables, by first bytes and suffix; files of MATLAB 4 begin with a number."""
_RECORDINGS: Final = (".mcap", ".mcap.zst", ".mcap.zstd")
Columns = Mapping[int, Sequence[str] | NDArray[Any]]
"""Values by the index of their column; numbers may be text."""

_PICKLE: Final = (
    f"it is a pickle, which runs code when it is loaded: if you trust it, load it in Python; {FROM_ARRAYS}"
)
_EXCEL: Final = (
    "it is a workbook of Excel: save the sheet as CSV; or "
    "contact_tracker.Trajectory.from_dataframe(pandas.read_excel({name!r})) takes it"
)
_DTRACK: Final = (
    "it is DTrack's log: numpy.savetxt('body.txt', [' '.join(body).split() for body in re.findall("
    r"r'\nts (\S+)\n(?:(?!fr ).*\n)*?6d .*?\[0 \S+\]\[([^]]*)\]\[([^]]*)\]', open({name!r}).read())], '%s') "
    "makes a file of body 0, read by contact-tracker segment body.txt --time-unit s --unit mm "
    "--matrix columns --columns 'time=c0,position=c[1:4],matrix=c[7:16]'"
)
_OTHERS: Final = {
    b"\xd0\xcf\x11\xe0": _EXCEL,
    b"fr ": _DTRACK,
    b"\xff\xff\xff\xff": "it is a stream of Arrow: pyarrow.feather.write_feather(pyarrow.ipc.open_stream("
    "{name!r}).read_all(), 'a.feather') makes a file that is read",
    b"FEA1": "it is Feather of version 1: pyarrow.feather.write_feather("
    "pyarrow.feather.read_table({name!r}), 'a.feather') makes a file that is read",
    b"\x04\x22\x4d\x18": "it is compressed: lz4 -dc {quoted} > {unpacked} makes a file that is read",
    b"\x1f\x8b": "it is compressed: gunzip -c {quoted} > {unpacked} makes a file that is read",
    rb"\s*<(?i:\?xml|!doctype|html|\w+>\s*\n)": "it is XML or HTML, not a table of poses: " + FROM_ARRAYS,
    b"PK\x03\x04": "it is compressed: unzip {quoted} first",
    b"BZh": "it is compressed: bunzip2 -c {quoted} > {unpacked} makes a file that is read",
    b"\x80[\2-\5]": _PICKLE,
    b"ULog": "it is ULog of PX4: ulog2csv {quoted}, of pyulog, writes CSV, of which that of vehicle_odometry "
    "has poses",
    b"RRF": "it is a recording of rerun, which is not read: give the file from which it was made; "
    + FROM_ARRAYS,
    b"# Image list with": "it is COLMAP's images.txt, which has the world in the frames of cameras, without "
    "times: image.cam_from_world().inverse() of pycolmap.Reconstruction('FOLDER').images are poses; "
    + FROM_ARRAYS,
    b"# Bundle file": "it is a file of Bundler, which has the world in the frames of cameras, without times: "
    "invert the matrices [R | t] of the cameras; " + FROM_ARRAYS,
    b"header:|transforms:": "it is YAML, as topic echo prints: json.dump([one for one in "
    "yaml.safe_load_all(open({name!r})) if one], open('poses.json', 'w')) makes a file that is read; or "
    "record a bag, or print by ros2 topic echo --csv or rostopic echo -p",
    b"At time ": "it is what tf_echo prints, rounded: record /tf in a bag",
    b"- [^{]": "it is YAML: json.dump(yaml.safe_load(open({name!r})), open('poses.json', 'w')) makes a file "
    "that is read",
    b"PathFileType": "it is TRC, which has markers, not bodies: export bodies (6D) as text; or find the "
    "rotations of markers by scipy's Rotation.align_vectors; " + FROM_ARRAYS,
    b"version https://git-lfs": "it is a pointer of Git LFS, not the file itself: git lfs pull",
}
"""Patterns of the first bytes of files that are not read, and advice on how to read their content."""


def refuse_other_formats(path: str, begin: bytes) -> None:
    """Raise UnreadableRecording if a file that is no table begins like another known format, or is named as a
    table."""
    text = next((text for magic, text in _OTHERS.items() if re.match(magic, begin)), None)
    text = _PICKLE if path.lower().endswith((".pt", ".pth")) else text
    text = _EXCEL if path.lower().endswith((".xlsx", ".ods")) else text
    if text is not None:
        name = os.path.basename(path)
        unpacked = re.sub(r"(?i)\.(gz|bz2|lz4)$", "", name)
        unpacked = shlex.quote(unpacked if unpacked != name else f"unpacked_{name}")
        raise UnreadableRecording(text.format(name=name, quoted=shlex.quote(name), unpacked=unpacked))
    if begin and path.lower().endswith(TABLE_ENDINGS):
        raise UnreadableRecording("it is named as a table, but is not text: save it as UTF-8")


def _kind(path: str, begin: bytes) -> str:
    """The kind of a table, a key of ``binary_tables.TABLES``, by the first bytes and the name of a file;
    empty for others."""
    name = path.lower()
    return next((kind for kind, magic, end in _BINARY if magic.match(begin) and name.endswith(end)), "")


def is_table(path: str, begin: bytes) -> bool:
    """Whether a file with these first bytes may be a table: of a known kind, or text without the suffix
    ``.mcap``."""
    is_other = path.lower().endswith(_RECORDINGS) or any(re.match(magic, begin) for magic in _OTHERS)
    return bool(_kind(path, begin)) or (not is_other and is_text(begin, path))


def has_poses(path: str) -> bool:
    """Whether a file is a table with the columns of poses."""
    begin = first_bytes(path)
    try:
        return is_table(path, begin) and bool(_opened(path, AS_NAMED, WorkBudget()))
    except (UnreadableRecording, ChoiceError):
        return False


def read_table(
    path: str, is_wanted: Callable[[Channel], bool], notes: Notes, reading: TableReading
) -> Iterator[Rows]:
    """The poses of a table in columns, batch by batch; each body is a source. They are not read if
    ``is_wanted`` does not accept their channel. ``reading`` is what the user states of the columns.

    Raises UnreadableRecording if it has no pose columns, their meaning is not known, or angles exceed a turn
    in radians; and ChoiceError if the reading does not fit.
    """
    try:
        table = _opened(path, reading, notes.budget)
    except ProposedReading as error:
        raise UnreadableRecording(str(error)) from error
    except UnreadableRecording as error:
        if path.lower().endswith(TABLE_ENDINGS) or _kind(path, first_bytes(path)):
            raise
        raise UnreadableRecording(
            f"it is neither a recording nor a table of poses ({error}). What is read: {WHAT_IS_READ}"
        ) from error
    layout, topic = table.layout, os.path.basename(path)
    if layout.note:
        notes.assume(layout.note)
    stated = reading_of(TUM).with_(reading) if layout.kind == "TUM" else reading
    read_as = ReadAs(False, stated, path, layout.turn, layout.has_angles)
    sources = tuple(PoseSource(topic, layout.kind, "", body.name, None, read_as) for body in layout.bodies)
    is_read = is_wanted(Channel(topic, ROWS, layout.kind, "", b""))
    times, count, lost, why, doubt = TableTimes(path, layout, reading, notes.assume), 0, 0, "", ""
    bodies = _Bodies(layout.first_body)
    largest = np.nan
    for columns in table if is_read else ():
        rows_read = len(next(iter(columns.values())))
        texts = [*map(str, range(count, count + rows_read) if layout.time < 0 else columns[layout.time])]
        count += rows_read
        rests = None if layout.rest is None else [str(rest) for rest in columns[layout.rest]]
        stamps = times.stamps_ns(texts, rests)
        good = stamps != NEVER
        if not good.all():
            row = int(good.argmin())
            why = why or _without_time(texts[row], columns, row, layout)
            lost += int((~good).sum())
        values = [(_values(columns, body), body) for body in layout.bodies]
        doubts = (doubt_angles(rows, body, reading, path) for rows, body in values if not doubt)
        if doubt_of_batch := next(filter(None, doubts), ""):
            if count == rows_read:
                raise UnreadableRecording(doubt_of_batch)
            notes.assume(doubt := doubt_of_batch)  # unwrapped angles grow with time: a stream goes on
        largest = np.fmax.reduce([largest, *(largest_deg(rows, body) for rows, body in values)])
        by_row = np.stack([body.poses(rows) for rows, body in values], axis=1)[good].reshape(-1, 7)
        poses = Poses(stamps[good].repeat(len(values)), by_row[:, :3], by_row[:, 3:])
        if layout.body is None:
            yield Rows(sources * int(good.sum()), poses)
        else:
            texts = [str(text).strip(BLANKS) for text in compress(columns[layout.body], good)]
            names = bodies.names(texts, poses.stamp_ns)
            named = {name: replace(sources[0], child_frame_id=name) for name in names}
            yield Rows([named[name] for name in names], poses)
    if lost:
        notes.report(f"{lost} {'row has' if lost == 1 else 'rows have'} {why}")
    if doubt := doubt_degrees(largest, reading, path):
        notes.assume(doubt)
    for damage in table.damage:
        notes.report(damage)


class _Bodies:
    """The names of the bodies of rows, batch by batch; of successive ones, that of the first until the time
    goes back, and then those in the column."""

    def __init__(self, first: str | None) -> None:
        self._first = first
        self._last: tuple[str, int] | None = None

    def names(self, texts: Sequence[str], stamp_ns: NDArray[np.int64]) -> Sequence[str]:
        """The names of the bodies of rows with these texts and stamps."""
        if self._first is None or not texts:
            return texts
        text, last_ns = self._last or (texts[0], int(stamp_ns[0]))
        self._last = texts[-1], int(stamp_ns[-1])
        begins = begin_body([text, *texts], np.r_[last_ns, stamp_ns])
        count = int(begins.argmax()) if begins.any() else len(texts)
        names = [*[self._first] * count, *texts[count:]]
        self._first = None if begins.any() else self._first
        return names


def _opened(path: str, reading: TableReading, budget: WorkBudget) -> "TextTable | ArrayTable | ParquetTable":
    budget.bytes_read += os.path.getsize(path)
    begin = first_bytes(path)
    if not (kind := _kind(path, begin)):
        return TextTable(path, begin, reading)
    from contact_tracker.recording.binary_tables import TABLES

    return TABLES[kind](path, reading, budget)


def _without_time(text: str, columns: Columns, row: int, layout: TableLayout) -> str:
    """The fault of a row without a time: no time, or, if only its first cell has text, another separator."""
    lacks = "no time that is a number or a date"
    cells = [columns[place][row] for place in layout.places if place != layout.time]
    is_alone = text and not any(isinstance(value, str) and value for value in cells)
    if is_alone and layout.kind not in ("Parquet", "Feather", "JSON"):
        return f"{lacks}: separate their values by {SEPARATORS[layout.separator or ' ']}, as in the first row"
    cell = f" ({printable(text[:LONGEST_CELL])!r})" if text else ""
    if are_numbers([text]) and text:
        fault = f"a time more than 146 years from 1970{cell}"
        return (
            f"{fault}: give its unit by --time-unit s, ms, us or ns, or write dates as 2026-03-01T10:00:00.25"
        )
    return f"{lacks}{cell}: give each a number, or a date as 2026-03-01T10:00:00.25"


def _values(columns: Columns, body: Body) -> NDArray[np.float64]:
    """The values (N, k) of a body's columns; empty cells are NaN."""
    values = [columns[place] for place in body.columns]
    rows = np.column_stack([v if isinstance(v, np.ndarray) else numbers(v) for v in values])
    return rows.astype(np.float64, copy=False)
