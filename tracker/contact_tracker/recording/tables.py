"""Tables of poses in columns, the stamps of their rows, and advice on formats that are not read.

Times are numbers in a unit that is named or guessed, or dates (ISO 8601).
"""

import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from decimal import Decimal
from itertools import compress
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.quantities import RANGE_NS, TIME_WORDS, TIMES_NS
from contact_tracker.config.table_reading import AS_NAMED, DAY, TICK, TIME_UNITS_NS, TableReading
from contact_tracker.errors import ChoiceError, UnreadableRecording, printable
from contact_tracker.motion.poses import Poses, ReadAs
from contact_tracker.recording.bytestream import TABLE_ENDINGS, WHAT_IS_READ, WorkBudget, first_bytes, is_text
from contact_tracker.recording.items import ROWS, Channel, PoseSource, Rows
from contact_tracker.recording.table_layouts import (
    NO_FRAMES,
    SEPARATORS,
    Body,
    ProposedReading,
    TableLayout,
    are_numbers,
    check_angles,
    numbers,
    plain_number,
)
from contact_tracker.recording.text_tables import TextTable

if TYPE_CHECKING:
    from contact_tracker.recording.binary_tables import ArrayTable, ParquetTable

_STEP_S: Final = (0.0005, 0.2)
"""Steps between poses at 5 to 2000 Hz; the ranges of different units do not overlap."""
_DATE_S: Final = (946684800.0, 4102444800.0)
"""Range of dates since 1970: the years 2000 to 2100."""
_DAY_S: Final = 86_400
_EPOCHS_S: Final[Mapping[str, tuple[tuple[int, int], str]]] = {
    TICK: ((11_644_473_600, 62_135_596_800), "ticks of 100 ns since the year 1 or 1601"),
    DAY: ((25_569 * _DAY_S, 719_529 * _DAY_S), "days since the year 0 or 1900, as of MATLAB and Excel"),
}
"""Units of dates other than seconds: seconds from their epochs to 1970, and their description."""
_FASTEST_HZ: Final = 20_000.0
"""Highest rate of a tracker of poses (Hz); above it, the unit is probably wrong."""
_FEW: Final = 10
"""Number of times above which steps of exactly one are taken for numbers of frames."""
_SECONDS: Final = 1.0
"""Step, in the unit of the times; shorter steps may be seconds at a low pose rate."""
_LONGEST_STEP_S: Final = 100.0
"""Longest step between times that are dates (s)."""
NEVER: Final = np.iinfo(np.int64).min
"""Stands for the stamp of text that is no time."""
_DATE: Final = re.compile(
    r"\s*(?:(?P<days>\d{1,5}) days?,? )?"
    r"(?:(?:(?P<year>\d{4})(?P<mark>[-/.]?)(?P<month>\d\d?)(?P=mark)(?P<day>\d\d?)"
    r"|(?P<first>\d\d?)(?P<dots>[-/.])(?P<second>\d\d?)(?P=dots)(?P<last>\d{4}))(?:T|,? ))?"
    r"(?P<hour>\d\d?)(?P<colon>:|(?<=T\d\d))(?P<minute>\d\d)"
    r"(?:(?P=colon)(?P<second_>\d\d)(?:(?:[.,]|:(?=\d{3}))(?P<fraction>\d{1,18}))?)?"
    r"(?: ?(?P<half>[AP])M)?(?: ?(?:Z|UTC)| ?(?P<sign>[+-])(?P<zone>\d\d)(?::?(?P<zone_minutes>\d\d))?)?\s*",
    re.IGNORECASE,
)
"""Dates and times of a day, or durations of pandas; 10:22:31:123 has milliseconds, and 10:22:31:12 would have
frames. Digits alone are numbers."""
_YEARS: Final = range(1900, 2110)
"""Years of dates that are read; stamps in nanoseconds reach from 1824 to 2116."""
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_YEAR_NS: Final = 365.25 * _DAY_S * 1e9
_DAY_NS: Final = _DAY_S * 10**9
_MOST_DAYS: Final = 20
"""Most days between two rows; if days and months are confused, there are steps of a month."""


def unit_of(times: NDArray[np.float64]) -> tuple[str, str | None]:
    """Guess the unit of times; returns it and one line on the assumption, if it is one.

    The steps decide, or the times as dates; dates if both fit and poses would not be minutes apart.
    """
    step = _median_step(times)
    by_date = _first_within(_DATE_S, float(times[0]) if len(times) else None)
    if by_date is not None and (step is None or step * TIMES_NS[by_date] <= _LONGEST_STEP_S * 1e9):
        return by_date, None
    by_step = _first_within(_STEP_S, step)
    if step is None or by_step == "s":
        return "s", None
    unit = by_step if by_step is not None and step >= _SECONDS else "s"
    return unit, (
        f"its times have no unit and are taken as {TIME_WORDS[unit]}, with steps of {step:g}: if they are "
        "not, say so with --time-unit s, ms, us or ns, or in the name of their column, as in time_ms; the "
        "rate of numbers of frames is given as --time-unit 200Hz"
    )


def doubt_of_unit(times: NDArray[np.float64], unit_ns: float) -> str | None:
    """One line if the times, in this unit, would have a rate that no tracker has; else None."""
    step = _median_step(times)
    if step == 1.0 and unit_ns == TIMES_NS["s"] and len(times) > _FEW and (np.diff(times) == 1.0).all():
        return (
            "its times are whole seconds, one after the other: if they are numbers of frames, give their "
            "rate, as --time-unit 200Hz"
        )
    likely = None if step is None else _first_within(_STEP_S, step)
    is_slow = likely is not None and (step or 0.0) * unit_ns > _LONGEST_STEP_S * 1e9
    if step is None or (1e9 / (step * unit_ns) <= _FASTEST_HZ and not is_slow):
        return None
    named = next((unit for unit, ns in TIMES_NS.items() if ns == unit_ns), f"{unit_ns:g} ns")
    remedy = "give their unit with --time-unit s, ms, us or ns, or in the name of their column"
    if likely is not None:
        advice = f"give --time-unit {likely}, or name their column time_{likely}"
        remedy = f"they look like {TIME_WORDS[likely]}: {advice}"
    return f"its times, taken as {named}, are those of {1e9 / (step * unit_ns):.6g} poses a second; {remedy}"


def _median_step(times: NDArray[np.float64]) -> float | None:
    """The median of the steps forward; None if there is none."""
    steps = np.diff(times)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else None


def _first_within(bounds_s: tuple[float, float], value: float | None) -> str | None:
    """The first unit in which a value is within bounds."""
    lower, upper = bounds_s
    units = (unit for unit, ns in TIMES_NS.items() if value and lower <= value * ns * 1e-9 <= upper)
    return next(units, None)


class TableTimes:
    """Stamps of the times in a table, batch by batch; the majority of the first times decides their kind.

    Parameters
    ----------
    path : path of the table.
    reading : its time unit replaces the unit of the layout; without either the unit is guessed.
    assume : called with one line on an assumption.

    Raises ChoiceError if both the reading and the layout say the unit of the times.
    """

    def __init__(
        self, path: str, layout: TableLayout, reading: TableReading, assume: Callable[[str], None]
    ) -> None:
        if reading.time_unit is not None and layout.has_own_unit:
            raise ChoiceError(
                f"{path}: its times have a unit: leave out --time-unit, which is for tables whose times have "
                "none"
            )
        self._path, self._assume, self._reading = path, assume, reading
        self._rest_ns = layout.rest_ns
        self._scale = layout.time_ns if layout.rest is not None else reading.time_ns or layout.time_ns
        self._is_certain = reading.time_unit is not None or layout.has_own_unit or layout.rest is not None
        self._are_dates: bool | None = None
        self._last_date_ns: int | None = None
        self._days = 0  # midnights so far, if times have no date
        self._epoch_ns = 0

    def stamps_ns(self, times: Sequence[str], rests: Sequence[str] | None = None) -> NDArray[np.int64]:
        """Stamps (N,) of times as text, and of the nanoseconds of their seconds if these have a column;
        ``NEVER`` for other text.

        Raises ChoiceError if the user gives a unit for dates, or the order of days and months is not known;
        UnreadableRecording if times are ticks since another year than 1970.
        """
        floats = numbers(times)
        is_number, stamps = np.isfinite(floats), np.full(len(times), NEVER)
        if self._are_dates is None:
            dates = sum(bool(_DATE.fullmatch(text)) for text in compress(times, ~is_number))
            if not dates and not is_number.any():
                return stamps
            self._are_dates = dates > is_number.sum()
            if not self._are_dates:
                self._find_unit(floats[is_number])
            elif self._reading.time_unit is not None:
                raise ChoiceError(
                    f"{self._path}: its times are dates: leave out --time-unit, which is for tables whose "
                    "times are numbers"
                )
        if self._are_dates:
            return self._stamps_of_dates(times)
        assert self._scale is not None
        is_number &= np.abs(floats * self._scale - self._epoch_ns) < RANGE_NS
        if self._scale == round(self._scale):  # exact to the written nanosecond
            unit_ns, written = round(self._scale), compress(times, is_number)
            stamps[is_number] = [exact_ns(time, unit_ns) - self._epoch_ns for time in written]
        else:
            stamps[is_number] = np.round(floats[is_number] * self._scale)
        if rests is not None:
            more_ns = numbers(rests) * self._rest_ns
            has_rest = (more_ns >= 0) & (more_ns < 1e9)
            stamps[has_rest & is_number] += more_ns[has_rest & is_number].astype(np.int64)
            stamps[~has_rest] = NEVER
        return stamps

    def _stamps_of_dates(self, times: Sequence[str]) -> NDArray[np.int64]:
        """Stamps (N,) of dates; times of a day continue after midnight."""
        dated = map(stamp_of_date, times)
        stamps = np.array([NEVER if stamp is None else stamp for stamp in dated], np.int64)
        rows = np.flatnonzero(stamps != NEVER)
        if not len(rows):
            return stamps
        last_ns = stamps[rows[0]] if self._last_date_ns is None else self._last_date_ns
        steps = np.diff(stamps[rows], prepend=last_ns)
        self._last_date_ns = int(stamps[rows[-1]])
        if (far := np.flatnonzero(np.abs(steps) > _MOST_DAYS * _DAY_NS)).size:
            raise ChoiceError(
                f"{self._path}: whether the day or the month comes first in its dates is not known "
                f"({times[rows[far[0]]].strip()}): write them as 2026-03-31"
            )
        if np.abs(stamps[rows]).max() < 2 * _DAY_NS:  # there are no dates
            days = self._days + np.cumsum(steps < -_DAY_NS // 2)
            self._days = int(days[-1])
            stamps[rows] += days * _DAY_NS
        return stamps

    def _find_unit(self, times: NDArray[np.float64]) -> None:
        """Find the unit and epoch of times that are numbers, from the first ones; ticks of 100 ns since the
        year 1601 or 1 are recognised by their size."""
        doubt, step = None, _median_step(times)
        if self._reading.has_frame_numbers and (times != np.round(times)).any():
            raise ChoiceError(f"{self._path}: its times are not whole, {NO_FRAMES}")
        for unit, (epochs, description) in _EPOCHS_S.items():
            unit_s = TIME_UNITS_NS[unit] * 1e-9
            first_s = float(times[0]) * unit_s
            dated = [epoch_s for epoch_s in epochs if _DATE_S[0] <= first_s - epoch_s <= _DATE_S[1]]
            if unit == self._reading.time_unit:
                self._epoch_ns = sum(dated[:1]) * 10**9
            elif dated and not self._is_certain and (step or 0.0) * unit_s <= _SECONDS:
                command = TableReading(time_unit=unit).with_(self._reading).command(self._path)
                raise UnreadableRecording(f"its times look like {description}: read them by {command}")
        if self._scale is None:
            unit, doubt = unit_of(times)
            self._scale = TIME_UNITS_NS[unit]
        elif not self._is_certain:
            doubt = doubt_of_unit(times, self._scale)
        if doubt is not None:
            self._assume(doubt)


def exact_ns(time: str, unit_ns: int) -> int:
    """Nanoseconds of a number as text; raises ValueError or OverflowError if it is none."""
    plain = plain_number(time)
    try:
        return round(Decimal(plain) * unit_ns)
    except ArithmeticError:  # an exponent of many digits
        return round(float(plain) * unit_ns)


def stamp_of_date(text: str) -> int | None:
    """Nanoseconds since 1970 of a date, or since midnight of a time of a day; None for other text.

    Without a time zone it is taken as UTC, since only differences matter. ``3/4/2026`` is of March, as in the
    US, unless the first number is above 12; ``3.4.2026`` of April.
    """
    match = _DATE.fullmatch(text)
    if match is None:
        return None
    part = match.groupdict(default="")
    year, month, day = (
        int(part[name] or default) for name, default in (("year", 1970), ("month", 1), ("day", 1))
    )
    if part["last"]:
        year, month, day = int(part["last"]), int(part["first"]), int(part["second"])
        month, day = (day, month) if part["dots"] == "." or month > 12 else (month, day)
    hour, minute, second = (int(part[name] or 0) for name in ("hour", "minute", "second_"))
    hour = hour % 12 + 12 * (part["half"].upper() == "P") if part["half"] else hour
    if year not in _YEARS:
        return None
    try:
        since = datetime(year, month, day, hour, minute, second, tzinfo=UTC) - _EPOCH
    except ValueError:  # as the 31st of June
        return None
    zone_s = 60 * (60 * int(part["zone"] or 0) + int(part["zone_minutes"] or 0))
    zone_s = -zone_s if part["sign"] == "-" else zone_s
    fraction_ns = int(f"{part['fraction'] or 0:0<9}"[:9])
    return ((since.days + int(part["days"] or 0)) * 86_400 + since.seconds - zone_s) * 10**9 + fraction_ns


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
_LONGEST_TIME: Final = 40
_RECORDINGS: Final = (".mcap", ".mcap.zst", ".mcap.zstd")
Columns = Mapping[int, Sequence[str] | NDArray[np.float64]]
"""Values by the index of their column; numbers may be text."""

_ARRAYS: Final = "contact_tracker.Trajectory.from_arrays(t, p, q) takes times, positions and rotations"
_PICKLE: Final = (
    f"it is a pickle, which runs code when it is loaded: if you trust it, load it in Python; {_ARRAYS}"
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
_ECHO: Final = (
    "it is what topic echo or tf_echo prints: record a bag, or print it by ros2 topic echo --csv, or by "
    "rostopic echo -p"
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
    b"PK\x03\x04": "it is compressed: unzip {quoted} first",
    b"BZh": "it is compressed: bunzip2 -c {quoted} > {unpacked} makes a file that is read",
    b"\x80\x04\x95": _PICKLE,
    b"\x80\x05\x95": _PICKLE,
    b"RRF": "it is a recording of rerun, which is not read: give the file from which it was made; " + _ARRAYS,
    b"# Image list with": "it is COLMAP's images.txt, which has the world in the frames of cameras, without "
    "times: image.cam_from_world().inverse() of pycolmap.Reconstruction('FOLDER').images are poses; "
    + _ARRAYS,
    b"# Bundle file": "it is a file of Bundler, which has the world in the frames of cameras, without times: "
    "invert the matrices [R | t] of the cameras; " + _ARRAYS,
    b"header:": _ECHO,
    b"At time ": _ECHO,
    b"- [^{]": "it is YAML: json.dump(yaml.safe_load(open({name!r})), open('poses.json', 'w')) makes a file that "
    "is read",
    b"PathFileType": "it is TRC, which has markers, not bodies: export bodies (6D) as text; or find the "
    "rotations of markers by scipy's Rotation.align_vectors; " + _ARRAYS,
    b"version https://git-lfs": "it is a pointer of Git LFS, not the file itself: git lfs pull",
}
"""Patterns of the first bytes of files that are not read, and advice on how to read their content."""


def refuse_other_formats(path: str, begin: bytes) -> None:
    """Raise UnreadableRecording if a file that is no table begins like another known format, or is named as a
    table."""
    text = next((text for magic, text in _OTHERS.items() if re.match(magic, begin)), None)
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
    path: str,
    is_wanted: Callable[[Channel], bool],
    report: Callable[[str], None],
    budget: WorkBudget,
    assume: Callable[[str], None],
    reading: TableReading = AS_NAMED,
) -> Iterator[Rows]:
    """The poses of a table in columns, batch by batch; each body is a source.

    Parameters
    ----------
    is_wanted : accepts channels; other poses are not read.
    report : called with one line on rows that cannot be read.
    budget : bounds the size of a compressed table.
    assume : called with one line on each assumption.
    reading : what the user states of its columns.

    Raises UnreadableRecording if it has no pose columns, their meaning is not known, or angles exceed a turn
    in radians; and ChoiceError if the reading does not fit.
    """
    try:
        table = _opened(path, reading, budget)
    except ProposedReading:
        raise
    except UnreadableRecording as error:
        if path.lower().endswith(TABLE_ENDINGS) or _kind(path, first_bytes(path)):
            raise
        raise UnreadableRecording(
            f"it is neither a recording nor a table of poses ({error}). What is read: {WHAT_IS_READ}"
        ) from error
    layout, topic = table.layout, os.path.basename(path)
    if layout.note:
        assume(layout.note)
    read_as = ReadAs(False, reading, path, layout.quaternion, layout.has_angles)
    sources = tuple(PoseSource(topic, layout.kind, "", body.name, None, read_as) for body in layout.bodies)
    is_read = is_wanted(Channel(topic, ROWS, layout.kind, "", b""))
    times, lost, why = TableTimes(path, layout, reading, assume), 0, ""
    for columns in table if is_read else ():
        texts = [str(time) for time in columns[layout.time]]
        rests = None if layout.rest is None else [str(rest) for rest in columns[layout.rest]]
        stamps = times.stamps_ns(texts, rests)
        good = stamps != NEVER
        if not good.all():
            row = int(good.argmin())
            why = why or _without_time(texts[row], columns, row, layout)
            lost += int((~good).sum())
        values = [(_values(columns, body), body) for body in layout.bodies]
        for rows, body in values:
            check_angles(rows, body, reading, path)
        poses = (body.poses(rows) for rows, body in values)
        yield Rows(sources, tuple(Poses(stamps, rows[:, :3], rows[:, 3:])[good] for rows in poses))
    if lost:
        report(f"{lost} {'row has' if lost == 1 else 'rows have'} {why}")
    for damage in table.damage:
        report(damage)


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
    cell = f" ({printable(text[:_LONGEST_TIME])!r})" if text else ""
    if are_numbers([text]) and text:
        fault = f"a time more than {RANGE_NS / _YEAR_NS:.0f} years from 1970{cell}"
        return f"{fault}: give its unit by --time-unit s, ms, us or ns"
    return f"{lacks}{cell}: give each a number, or a date as 2026-03-01T10:00:00.25"


def _values(columns: Columns, body: Body) -> NDArray[np.float64]:
    """The values (N, k) of a body's columns; empty cells are NaN."""
    values = [columns[place] for place in body.columns]
    return np.column_stack([v if isinstance(v, np.ndarray) else numbers(v) for v in values])
