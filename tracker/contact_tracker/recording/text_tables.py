"""Text tables: rows, and their layout from the first lines: a known format, a header of names, or rows alone.

Motive writes rows of types, names, IDs (not always), parents (since format 1.25) and values above the row of
axes, without row labels before format 1.23; rotations are quaternions or angles. Vicon Tracker and Nexus
write sections, each with its rate and the names of bodies, columns and units; three columns of rotation are
angles or a helical vector, which most exports do not distinguish. Names are read in any case.
"""

import csv
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import chain, islice, pairwise, repeat, takewhile
from typing import IO, Any, Final

import numpy as np

from contact_tracker.config.quantities import ANGLE_UNITS, LENGTHS, LENGTHS_M, NAMED_NS
from contact_tracker.config.table_reading import REST, TIME, TableReading, reading_of
from contact_tracker.errors import ChoiceError, UnreadableRecording
from contact_tracker.recording.bytestream import encoding_of
from contact_tracker.recording.items import ROWS_AT_ONCE
from contact_tracker.recording.json_entries import (
    LEAST_OF_POSE,
    entries_in,
    flattened,
    is_document,
    loads,
    rows_of,
)
from contact_tracker.recording.table_layouts import (
    BLANKS,
    LONGEST_CELL,
    MOST_COLUMNS,
    SEPARATORS,
    UNNAMED,
    Body,
    OpenReading,
    ProposedReading,
    TableLayout,
    are_numbers,
    bodies_of,
    listed_briefly,
    number,
    numbers,
    plain_number,
)
from contact_tracker.recording.table_proposals import (
    FIRST_ROWS,
    layout_of_names,
    layout_without_names,
    may_be_trajectory,
)

_LINE: Final = 2**18
"""Longest line (characters); the rest of a longer one is a line of its own."""
_LONGEST_PREAMBLE: Final = 1000
_LONGEST_HEAD: Final = 2**20
"""Largest number of lines, and of characters, in which the first row of numbers is looked for."""
_MOST_TRIED: Final = 4 * MOST_COLUMNS
"""Largest number of words that are tried as names of columns, at 20 000 a second."""
_EMPTY: Final = f",;{BLANKS}"
_COMMENT: Final = re.compile(r"#|%|//|;(?!(?:[^;]*;){2})")
"""Beginnings of comments; a row with an empty first cell also begins with a semicolon, but has several."""
_LENGTH: Final = re.compile(
    r"(?:\bunits?\s{0,4}=\s{0,4}1\s?|(?<![^\W_])(?<!\d[\s-]))((?:nano|micro|milli|centi|deci|kilo)met(?:er|re)s?|inch(?:es)?|feet"
    r"|[\u00b5\u03bcumcd]m)(?![^\W_])",
    re.IGNORECASE,
)
"""A unit of length other than metres; not after a number, except as in ``1 unit = 1 mm``."""
_SENTENCE: Final = 1000
"""Number of characters at the beginning of a line in which a unit is looked for."""
_PAIR: Final = re.compile(
    r"(?<![^\s,;{(])([A-Za-z_][\w./]{0,99})\s{0,8}[=:]\s{0,8}(?![A-Za-z_]\w{0,99}[=:])"
    r"([\[(][^\])]{0,500}[\])]|[^\s,;})]+)"
)
"""A value with its name, as ``x=1.0`` or ``q: [0, 0, 0, 1]``."""
_IN_LEAD: Final = re.compile(
    r"(?<![\w:/.,-])(?:(?:\d{4}[-/.]\d\d?[-/.]\d\d?[T_ ])?\d\d?:\d\d:\d\d(?:[.,]\d+)?Z?"
    r"|\d+(?:\.\d+)?(?![\w/-]|[:.,]\d))"
)
"""A date or a number before the pairs, as the time of a message in a log; not part of a word."""
_JSON: Final = re.compile(r"\s*(?:\{|\[[-+\d.,\s\[\]eEaNulInfity]*\]\s*$)")
"""A line of JSON: an object, or a list of numbers."""
_BETWEEN_PAIRS: Final = f"|,;()[]{{}}{BLANKS}"
_OF_NEXT: Final = re.compile(r"(?:[A-Za-z_]\w*:)?")
"""Text that may be between pairs: nothing, or a label of the next ones, as in ``rot: qx=0``."""
_CUT_OFF: Final = (
    "its last line is cut off inside a row and left out: if more was recorded, copy the file again"
)
_BODY_KINDS: Final = ("rigid body", "bone")
_SECTIONS: Final = ("objects", "segments")
_OTHER_SECTIONS: Final = ("trajectories", "model outputs", "devices", "joints", "events")
_ROUNDED_S: Final = 0.00051
_ORDER: Final = re.compile(r"([xyz]{3})", re.IGNORECASE)
_ABOUT: Final = re.compile(r"Global Angle\s*(?:\(([^)]*)\))?\s*")
_TUM: Final = tuple(range(1, 8))
TUM: Final = f"time={UNNAMED}0,position={UNNAMED}[1:4]"
_TURN_OF_TUM: Final = tuple(f"{UNNAMED}{place}" for place in range(4, 8))
"""Names of the columns of a trajectory, for commands with other quaternions."""
_MARKS: Final = (";", "\t", "|", ",")
"""Separators of values; a comma may also be the decimal point."""
_SEPARATOR_LINE: Final = re.compile(r'"?sep=(.)"?\s*', re.IGNORECASE)
_GROUP: Final = re.compile(r"(?:(?<=^)|(?<=[,;\t|])) *(\w*[(\[{][^()\[\]{}]*[)\]}])(?= *(?:[,;\t|\r\n]|$))")
"""A cell with several values in brackets, which the separator of cells may separate as well."""
_OF_COLUMNS: Final = re.compile(r"time|stamp|pos|trans|rot|orient|quat|euler|w *x *y *z", re.IGNORECASE)
"""Text above rows that may say what their columns are."""
_WHOLE: Final = re.compile(r"\s*\w*[(\[]([^()\[\]{}]*)[)\]][\s,;]*")
"""A row in brackets, as a tuple of Python."""
_OPEN_CELL: Final = re.compile(r'(?:^|[,;\t])"[^"\[(]{0,20}[\[(][^"]*$')
_LINES_OF_CELLS: Final = 32
"""Largest number of lines of a row whose cells have matrices in quotes."""
_TYPED: Final = re.compile(r"np\.\w+\(([^()]*)\)")
"""A number with its type, as in ``np.float64(0.1)``."""
_BRACKETS: Final = re.compile(r"[()\[\]{}]")
_CALL: Final = re.compile(r"[A-Za-z]\w*(?=[(\[])")
"""The name before values in brackets, as in ``p[0.1, 0.2, 0.3, 0, 0, 0]`` of UR."""
_BETWEEN: Final = re.compile(r"\s*;\s*|\s*,\s+|\s+")
_QUALISYS: Final = "NO_OF_FRAMES"
_OF_MATRIX: Final = re.compile(r"Rot\[([0-8])\]")
_NUMBER: Final = re.compile(
    r"(?:^|(?<=[\s,;|(\[:=]))[+-]?\d+(?:[.,]\d*)?(?:[eEdD][+-]?\d+)?(?=[\s,;|)\]}]|$)"
)
_QUALISYS_WAY: Final = reading_of(matrix="rows", unit="mm")
"""How the columns of a body are read after they are renamed; Qualisys numbers a matrix along its columns."""
_UNITS: Final = frozenset({*LENGTHS_M, *ANGLE_UNITS, *NAMED_NS, "-", "1"})


class TextTable:
    """A text table in columns, batch by batch; empty lines and comments are left out.

    Iterate once; then ``damage`` says whether the last line is cut off inside a row, and left out. Raises
    as ``layout_of_names``.
    """

    def __init__(self, path: str, begin: bytes, reading: TableReading) -> None:
        self._path, self._encoding = path, encoding_of(begin)
        self.damage: tuple[str, ...] = ()
        with self._opened() as file:
            head = _head(_lines(file))
        self._is_document = is_document(head)
        if self._is_document:
            with self._opened() as file:
                rows = list(islice(chain.from_iterable(map(rows_of, entries_in(file))), FIRST_ROWS))
            layout = _layout_of_fields(rows, reading, path, kind="JSON")
        else:
            layout = _layout_of(head, reading, path)
        _check_unit(head, layout, reading, path)
        self.layout = layout

    def __iter__(self) -> Iterator[dict[int, Sequence[str]]]:
        rows = self._rows()
        while batch := list(islice(rows, ROWS_AT_ONCE)):
            yield dict(zip(self.layout.places, zip(*batch, strict=True), strict=True))

    def _opened(self) -> IO[str]:
        return open(self._path, encoding=self._encoding, errors="replace")

    def _lines_and_cells(self) -> Iterator[tuple[str, list[str]]]:
        """Lines with the cells of each row in them; without these if there are none."""
        layout = self.layout
        with self._opened() as file:
            if self._is_document:
                for fields in chain.from_iterable(map(rows_of, entries_in(file))):
                    yield "\n", [fields.get(name, "") for name in layout.names]
                return
            for line in islice(_lines(file), layout.skip, None):
                if _COMMENT.match(line):
                    continue
                if not line.strip(_EMPTY):
                    yield line, []
                elif layout.names:
                    rows = _named_cells(line, layout)  # a line with several is whole
                    yield from ((line if len(rows) == 1 else "\n", cells) for cells in rows)
                else:
                    yield line, _cells_of(line, layout.separator)

    def _rows(self) -> Iterator[list[str]]:
        layout, previous = self.layout, list[str]()
        places, width = layout.places, max(layout.places) + 1
        for line, cells in self._lines_and_cells():
            if not cells:
                if layout.kind == "Vicon":
                    return  # the end of a section
                continue
            if line[-1] != "\n" and len(line) < _LINE and previous and _is_cut(previous, cells):
                self.damage = (_CUT_OFF,)
                return
            previous = cells
            if len(cells) < width:
                cells = cells + [""] * (width - len(cells))
            row = [cells[place] for place in places]
            if len(line) > LONGEST_CELL * width:
                row = [cell[:LONGEST_CELL] for cell in row]
            if any(map(str.strip, row)):
                yield row


def _lines(file: IO[str]) -> Iterator[str]:
    """The lines; a cell of lists in quotes may go on in the next ones, and numbers of numpy are without their
    type."""
    for line in iter(lambda: file.readline(_LINE), ""):
        if '"' in line and _OPEN_CELL.search(line):
            for more in takewhile(bool, (file.readline(_LINE) for _ in range(_LINES_OF_CELLS))):
                line = f"{line.rstrip()} {more}"
                if line.count('"') % 2 == 0:
                    break
        yield _TYPED.sub(r"\1", line) if "np." in line else line


def _head(lines: Iterator[str]) -> list[str]:
    """The first lines: ``FIRST_ROWS`` in all and from the first row of numbers on, if it is among the first
    ``_LONGEST_PREAMBLE``."""
    head, end, size = list[str](), _LONGEST_PREAMBLE, 0
    for line in islice(lines, _LONGEST_PREAMBLE):
        head.append(line)
        if end == _LONGEST_PREAMBLE and _are_values(_cells_of(line, _separator(line))):
            end = min(len(head) + FIRST_ROWS, _LONGEST_PREAMBLE)
        size += len(line)
        if len(head) == end or (len(head) >= FIRST_ROWS and size > _LONGEST_HEAD):
            break
    return head if end < _LONGEST_PREAMBLE else head[:FIRST_ROWS]


def _is_cut(before: Sequence[str], last: Sequence[str]) -> bool:
    """Whether a last line without a line break is part of a row: it lacks values that the row before it has,
    or its last value is part of a number. A number that is cut to a shorter number is not noticed."""
    before, last = ([cell.strip(BLANKS) for cell in cells] for cells in (before, last))
    if len(last) != len(before):
        return len(last) < len(before)
    is_value_lost = not last[-1] and any(last[-2:-1])  # more than one is missing of a body that is hidden
    return are_numbers(before[-1:]) and (is_value_lost or (bool(last[-1]) and not are_numbers(last[-1:])))


def _cells_of(line: str, separator: str | None) -> list[str]:
    """The values in a line, possibly with blanks around them; an open quote is part of the last value."""
    if separator is not None and '"' not in line and ("(" in line or "[" in line or "{" in line):
        whole = _WHOLE.fullmatch(line)
        line = _GROUP.sub(r'"\1"', line) if whole is None else whole[1]
    if separator is None or '"' not in line:
        return line.split(separator)
    try:
        return [cell.strip(BLANKS) for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return [line[:LONGEST_CELL]]


def _table_of(lines: Sequence[str], separator: str | None) -> list[list[str]]:
    """The cells of each line without blanks; an empty line has one empty cell."""
    rows = (_cells_of(line.replace("\0", ""), separator) or [""] for line in lines)
    return [[cell.strip() for cell in row] for row in rows]


def _fields_in(line: str, heads: Sequence[str] = (), separator: str | None = None) -> list[dict[str, str]]:
    """The numbers and texts by name (``pose.position.x``, ``state[0]``) of each row in a line: of cells with
    several values below ``heads``, of JSON, or of ``name=value`` pairs; raises ValueError."""
    if heads:
        return [flattened(dict(zip(heads, map(_values_in, _cells_of(line, separator)), strict=False)))]
    if _JSON.match(line):
        try:
            return rows_of(loads(line))
        except RecursionError as error:
            raise ValueError("it is too deep") from error
    lead, *between = _PAIR.split(line)[::3]
    before = {f"{UNNAMED}{i}": value for i, value in enumerate(_IN_LEAD.findall(lead))}
    between = [text.strip(_BETWEEN_PAIRS) for text in between]
    if unread := next((text for text in between if not _OF_NEXT.fullmatch(text)), ""):
        raise ValueError(
            f"beside its values with names there is {unread[:LONGEST_CELL]!r}: leave it out, and write "
            "a unit in the name, as in x_cm=29"
        )
    return [flattened(before | {name: _values_in(value) for name, value in _PAIR.findall(line)})]


def _values_in(cell: str) -> Any:
    """The values in a cell with several numbers, as JSON, ``(1.0, 2.0)``, ``[1 2]``, or three or more between
    blanks; the text of any other cell."""
    text = _CALL.sub("", cell.strip(BLANKS))
    if text[:1] not in ("(", "[", "{"):
        if len(pairs := _PAIR.findall(text)) > 2:  # X=1 Y=2 Z=3
            return dict(pairs)
        parts = text.split()
        return parts if len(parts) > 2 and all(are_numbers([part]) for part in parts) else cell
    inner = _BRACKETS.sub(" ", text).strip()
    values: Any = parts if len(parts := _BETWEEN.split(inner)) > 1 else inner.split(",")
    for plain in (text, text.replace("'", '"')):
        with suppress(ValueError, RecursionError):
            values = loads(plain)
    counted = sum(are_numbers([value]) for value in flattened({"": values}).values())
    return values if counted > 1 else cell


def _named_cells(line: str, layout: TableLayout) -> list[list[str]]:
    """The values of each row in a line in the order of the layout's names."""
    try:
        rows = _fields_in(line, layout.heads, layout.separator)
    except ValueError:
        return [[line] * len(layout.names)]  # none of them is a number
    return [[fields.get(name, "") for name in layout.names] for fields in rows]


def _layout_of(head: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout of the rows that begin with the lines ``head``."""
    begin = next((i for i, line in enumerate(head) if line.strip() and not _COMMENT.match(line)), 0)
    kinds = [layout_of for is_known, layout_of in _FORMATS if is_known(head[begin] if head else "")]
    if kinds[:1] != [_json_layout] and any(line.count(c) >= MOST_COLUMNS for line in head for c in ",;\t "):
        raise UnreadableRecording(f"its rows have {MOST_COLUMNS} values or more: leave out those of no body")
    rows = ["\n"] * begin + list(head[begin:]) if kinds else head
    return (kinds or [_layout_of_rows])[0](rows, reading, path)


def _check_unit(head: Sequence[str], layout: TableLayout, reading: TableReading, path: str) -> None:
    """Raise UnreadableRecording if the first lines name a unit of length and the layout would assume
    metres."""
    about, is_above = list[str](), True
    for i, line in enumerate(head):  # comments, and lines above the rows except the names of columns
        cells = _cells_of(line, layout.separator)
        is_above &= layout.kind == "JSON" or not _are_values(cells)
        is_head = layout.skip - 2 <= i < layout.skip and len(cells) > max(layout.places)
        if _COMMENT.match(line) or (is_above and not is_head):
            about.append(line[:_SENTENCE])
    stated = _LENGTH.search("\n".join(about))
    if stated is None or reading.unit or all(body.has_unit for body in layout.bodies):
        return
    factor = LENGTHS_M.get(stated[1].lower())
    unit = next((unit for unit in LENGTHS if LENGTHS[unit] == factor), None)
    remedy = "convert them to metres"
    if unit is not None:
        remedy = f"read them by {reading.with_(reading_of(unit=unit)).command(path)}"
    raise UnreadableRecording(
        f"a unit is {stated[1].lower()} above its rows: if it is that of positions, {remedy} or, if these "
        f"are in metres, by {reading.with_(reading_of(unit='m')).command(path)}"
    )


def _are_values(cells: Sequence[str]) -> bool:
    """Whether most cells of a row are numbers."""
    return 2 * sum(are_numbers([cell]) for cell in cells) > len(cells)


def _motive_layout(lines: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout of an export of Motive, formats 1.2 to 1.25."""
    separator = _separator_after("format version", next(line for line in lines if line.strip()))
    cells = _table_of(lines, separator)
    first = next(row for row in cells if row[0])
    if len(first) < 2:
        raise UnreadableRecording(
            "its columns are separated by nothing known: export it from Motive with commas"
        )
    about = {name.lower(): value for name, value in zip(first[::2], first[1::2], strict=False)}
    rotation = about.get("rotation type", "Quaternion")
    lower = [[cell.lower() for cell in row] for row in cells]
    head = next((i for i, row in enumerate(lower) if row[0] == "frame"), 0)
    kind_row = next((i for i, row in enumerate(lower[1:head], 1) if {*_BODY_KINDS} & set(row)), None)
    if kind_row is None or head - kind_row < 3 or "rotation" not in lower[head - 1]:
        raise UnreadableRecording(
            "no rigid body with Rotation and Position in its header: export it from Motive with rigid bodies"
        )
    is_local = about.get("coordinate space", "Global").lower() != "global"
    turn = "q" if rotation.lower() == "quaternion" else "r"
    by_kind: dict[str, dict[str, dict[str, int]]] = {kind: {} for kind in _BODY_KINDS}
    columns = zip(lower[kind_row], cells[kind_row + 1], lower[head - 1], lower[head], strict=False)
    for place, (kind, name, value, axis) in enumerate(columns):
        if value in ("rotation", "position") and kind in _BODY_KINDS[: 1 if is_local else 2]:
            role, bodies = axis if value == "position" else turn + axis, by_kind[kind]
            names = (name if i == 1 else f"{name} {i}" for i in range(1, len(cells[head]) + 2))
            bodies.setdefault(next(n for n in names if role not in bodies.get(n, ())), {})[role] = place
    unit = reading.unit or about.get("length units", about.get("units", "Meters"))
    by_body, axes = by_kind["bone"] | by_kind["rigid body"], [(name, "") for name in cells[head]]
    try:
        named = bodies_of(by_body, axes, reading, unit)
    except OpenReading:
        stated = reading.with_(reading_of(euler=f"{rotation}:deg")).command(path)
        raise UnreadableRecording(
            f"its rotations are {rotation}: export it from Motive with quaternions, or read them as Motive's "
            f"angles by {stated}"
        ) from None
    if not named:
        raise UnreadableRecording(
            "no rigid body has both position and quaternion, in global coordinates: export it with both"
        )
    time, time_ns = 1, 1e9
    with suppress(ValueError):  # times of Motive 2.3 and 3 are those of the frames rounded to milliseconds
        rate = number(about.get("export frame rate", ""))
        times = [(number(row[0]), number(row[1])) for row in cells[head + 1 :] if len(row) > 1]
        if times and rate > 0 and all(abs(frame / rate - time_s) <= _ROUNDED_S for frame, time_s in times):
            time, time_ns = 0, 1e9 / rate
    return TableLayout(time, time_ns, named, "Motive", separator, head + 1, has_own_unit=True)


def _vicon_layout(lines: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout of the first section of an export of Vicon."""
    begin = next(i for i, line in enumerate(lines) if line.strip())
    head = next((line for line in lines[begin:] if line.strip(BLANKS).lower().startswith("frame")), "")
    separator = _separator_after("frame", head)
    cells = _table_of(lines[begin:], separator)
    section = cells[0][0]
    if section.lower() not in _SECTIONS:
        raise UnreadableRecording(
            f"its section is {section}: export Objects or Segments from Vicon, as the first section"
        )
    if len(cells) < 5 or not are_numbers(cells[1][:1]) or not number(cells[1][0]) > 0:
        raise UnreadableRecording(f"its section {section} lacks rate, names, columns or units above its rows")
    names, axes, units = cells[2], [axis.lower() for axis in cells[3]], map(str.lower, cells[4])
    by_body = dict[str, dict[str, int]]()
    for start, end in pairwise([*(i for i, name in enumerate(names) if name), len(axes)]):
        turn = "q" if "rw" in axes[start:end] else "r"
        roles = {f"r{axis}": turn + axis for axis in "xyzw"} | {f"t{axis}": axis for axis in "xyz"}
        places = {roles[axis]: start + i for i, axis in enumerate(axes[start:end]) if axis in roles}
        by_body.setdefault(_short(names[start]), places)
    columns = list(zip(axes, chain(units, repeat("")), strict=False))
    try:
        bodies = bodies_of(by_body, columns, reading, "mm")
    except OpenReading:
        name = next(filter(None, names))
        kind = (about[1] if (about := _ABOUT.match(name)) is not None else None) or ""
        order, ways = _ORDER.search(kind), [reading_of(rotation_vector=True)]
        ways = [reading_of(euler=order[1].upper())] if order is not None else ways
        unsaid = "three angles or a helical vector, and the file does not say which"
        are = f"rotations of {_short(name)} are {f'of the kind {kind}' if kind else unsaid}"
        ways += [] if kind else [reading_of(euler="XYZ")]
        commands = " or ".join(reading.with_(way).command(path) for way in ways)
        raise UnreadableRecording(
            f"{are}: export quaternions from Vicon, or read them by {commands}"
        ) from None
    if not bodies:
        raise UnreadableRecording("no object with TX to TZ and RX to RW: export quaternions from Vicon")
    frame_ns = 1e9 / number(cells[1][0])
    return TableLayout(0, frame_ns, bodies, "Vicon", separator, begin + 5, has_own_unit=True)


def _qualisys_layout(lines: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout of an export of Qualisys, in which the columns of each body have the same names."""
    about = {row[0]: row[1:] for row in _table_of(lines, "\t")}
    if "BODY_NAMES" not in about and "MARKER_NAMES" in about:
        markers = listed_briefly(about["MARKER_NAMES"])
        raise UnreadableRecording(f"it has markers ({markers}), not bodies: export 6D data from QTM")
    head = next((i for i, line in enumerate(lines) if "Rot[0]" in line), None)
    if head is None or any(role not in (TIME, REST) for role, _ in reading.columns):
        return _layout_of_rows(lines, reading_of(unit=_QUALISYS_WAY.unit).with_(reading), path)
    reading = reading if reading.matrix is None else replace(reading, matrix="rows")  # as renamed below
    bodies, body, named = map("_".join, map(str.split, about.get("BODY_NAMES", []))), "", list[str]()
    for cell in _table_of([lines[head]], "\t")[0]:
        word = "".join(cell.split()[-1:])
        body = next(bodies, "") if word == "X" else body
        if (element := _OF_MATRIX.fullmatch(word)) is not None:  # along columns
            word = f"r{int(element[1]) % 3 + 1}{int(element[1]) // 3 + 1}"
        named.append(f"{body} {word}".strip())
    renamed = [*lines[:head], "\t".join(named) + "\n", *lines[head + 1 :]]
    way = _QUALISYS_WAY
    if not ("Time" in named or reading.time_unit or reading.columns):
        with suppress(ValueError):
            way = way.with_(reading_of(rate=plain_number("".join(about.get("FREQUENCY", ())))))
    layout = _layout_of_rows(renamed, way.with_(reading), path)
    return replace(layout, has_own_unit=way is not _QUALISYS_WAY)


def _short(name: str) -> str:
    """An object's name, without its segment's if that is the same."""
    plain = _ABOUT.sub("", name, count=1)
    subject, _, segment = plain.partition(":")
    return subject if segment in ("", subject) else plain


def _separator_after(word: str, line: str) -> str:
    """The separator of a line that begins with ``word``; a comma if uncertain."""
    mark = line.strip('" \r\n\ufeff')[len(word) :].lstrip('" ')[:1]
    return mark if mark in (";", "\t") else ","


def _has_names(line: str) -> bool:
    """Whether a line has at least as many ``name=number`` pairs as a pose has values."""
    values = flattened({name: _values_in(value) for name, value in _PAIR.findall(line)}).values()
    return sum(are_numbers([value]) for value in values) >= LEAST_OF_POSE


def _json_layout(lines: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout of lines with JSON objects or pairs."""
    rows = list[dict[str, str]]()
    for line in lines:
        try:
            rows += _fields_in(line) if line.strip() and not _COMMENT.match(line) else []
        except ValueError as error:
            if not _JSON.match(line):
                raise UnreadableRecording(str(error)) from None
            if not rows:
                raise UnreadableRecording(
                    "its first line is no JSON object: one a line is read, as jq -c '.[]' writes an array"
                ) from None
    return _layout_of_fields(rows[:FIRST_ROWS], reading, path, kind="JSON")


def _layout_of_fields(
    rows: Sequence[Mapping[str, str]], reading: TableReading, path: str, **form: Any
) -> TableLayout:
    """The layout of rows of named values, by all names in these first rows, with ``form`` of the file."""
    names = list(dict.fromkeys(chain.from_iterable(rows)))
    cells = [[row.get(name, "") for name in names] for row in rows if row]
    return replace(layout_of_names(names, reading, path, rows=lambda: cells), names=tuple(names), **form)


def _layout_of_rows(lines: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout by the first line with names of columns of poses, which may be a comment, else by the first
    row of numbers."""
    first = next((line for line in lines if line.strip()), "")
    stated = _SEPARATOR_LINE.fullmatch(first)
    rows = [i for i, line in enumerate(lines) if line.strip() and not _COMMENT.match(line)]
    rows = rows[1:] if stated else rows
    if not rows:
        raise UnreadableRecording(f"its first {len(lines)} lines are empty or comments: leave them out")
    comments = [rows[0] - 1] if rows[0] and _COMMENT.match(lines[rows[0] - 1]) else []
    errors = dict[tuple[bool, int], Exception]()
    """The first error by whether it has a proposal, and by the number of names; -1 stands for comments."""
    tried = 0
    for i in [*comments, *rows]:
        after = [row for row in rows if row > i]
        following = [lines[row] for row in after]
        separator = stated[1] if stated else _separator(following[0] if i in comments else lines[i])
        if not stated and following and separator and separator not in following[0]:  # in a name
            of_values = _separator(following[0])
            separator = of_values if of_values and of_values in lines[i] else separator
        line = lines[i].lstrip("#%/; ") if i in comments else lines[i]
        names = [name.strip(f",{BLANKS}") for name in _cells_of(line, separator)]
        if i in comments and len(names) != len(_cells_of(following[0], separator)):
            continue
        if _are_values(names) or any(not isinstance(_values_in(name), str) for name in names):
            break  # the rows have begun
        tried += len(names)
        if tried > _MOST_TRIED:
            break
        units = _units(following, separator)
        text_rows = takewhile(lambda line: not re.search(r"\d", line), following[bool(units) :])
        head_rows = bool(units) + len(list(text_rows))
        skip, values = [i, *after][head_rows] + 1, following[head_rows:]
        if separator is None and values and len(values[0].split()) == len(names) + 1:
            names = ["", *names]  # of the rows, as R writes them
        heads = [names, *_table_of(following[bool(units) : head_rows], separator)]
        is_stacked = i not in comments and len(heads) > 1 and {*map(len, heads)} == {len(names)}
        for named in map(_numbered, [_stacked(heads), names] if is_stacked else [names]):
            try:
                if _has_groups(values[:1], len(named), separator):
                    fields = [row for line in values for row in _fields_in(line, named, separator)]
                    layout = _layout_of_fields(fields, reading, path, heads=tuple(named))
                else:
                    cells_of = partial(_table_of, values, separator)
                    layout = layout_of_names(named, reading, path, units, cells_of)
                break
            except (UnreadableRecording, ChoiceError) as error:
                count = -1 if i in comments else len(names)
                errors.setdefault((isinstance(error, ProposedReading), count), error)
        else:
            continue
        if values and not layout.heads:
            _check_widths(values, layout, separator, len(names))
        elif not values and len(lines) < FIRST_ROWS:
            raise UnreadableRecording("it has a header but no rows")
        return replace(layout, separator=separator, skip=skip)
    begin = next((k for k, i in enumerate(rows) if _are_values(_cells_of(lines[i], _separator(lines[i])))), 0)
    width = len(_cells_of(lines[rows[begin]], _separator(lines[rows[begin]])))
    is_named = any(is_proposed or abs(count - width) < 2 for is_proposed, count in errors)
    if begin and not is_named and not any(_OF_COLUMNS.search(lines[i]) for i in rows[:begin]):
        return _layout_without_names(lines, rows[begin:], reading, path)  # below other text
    if errors and max(errors)[1] >= 0:
        if not max(errors)[0] and not any(map(_may_be_row, lines)):
            raise UnreadableRecording("it is text without rows of numbers, not a table of poses")
        raise errors[max(errors)]
    try:
        return _layout_without_names(lines, rows, reading, path)
    except UnreadableRecording as error:
        raise next(iter(errors.values()), error) from None


def _layout_without_names(
    lines: Sequence[str], rows: Sequence[int], reading: TableReading, path: str
) -> TableLayout:
    """The layout of the lines with these numbers, by their values."""
    separator = _separator(lines[rows[0]])
    table = [[value.strip(BLANKS) for value in _cells_of(lines[i], separator)] for i in rows]
    if [cell for cell in table[0] if cell] == [str(i) for i in range(len(table[0]) - (not table[0][0]))]:
        rows, table = rows[1:], table[1:]  # numbers of columns, as by pandas
    _refuse_blocks(table, os.path.basename(path))
    is_tum = separator is None and len(table[0]) == 1 + len(_TUM) and may_be_trajectory(table)
    if is_tum and not (reading.kind or reading.columns):
        body = Body("", _TUM, LENGTHS_M[reading.unit or "m"])
        return TableLayout(0, reading.time_ns, (body,), "TUM", None, rows[0], turn=_TURN_OF_TUM)
    width = Counter(map(len, table)).most_common(1)[0][0]
    table = [row for row in table if len(row) == width]
    return replace(layout_without_names(table, reading, path), separator=separator, skip=rows[0])


def _numbered(names: Sequence[str]) -> list[str]:
    """Names of columns of which each occurs once: ``x`` and ``x.1``, as by pandas, and ``c0`` without one."""
    named, times = list[str](), Counter[str]()
    for name in (name or f"{UNNAMED}{place}" for place, name in enumerate(names)):
        named.append(f"{name}.{times[name]}" if times[name] else name)
        times[name] += 1
    return named


def _stacked(heads: Sequence[Sequence[str]]) -> list[str]:
    """Names of columns that are in several rows; blanks are of cells that are merged, but in the last row."""
    filled = [[*row] for row in heads]
    for row in filled[:-1]:
        for place in range(2, len(row)):
            row[place] = row[place] or row[place - 1]
    return [".".join(filter(None, cells)) for cells in zip(*filled, strict=True)]


def _may_be_row(line: str) -> bool:
    """Whether a line of text has mostly numbers, or as many as a pose."""
    return _are_values(_cells_of(line, _separator(line))) or len(_NUMBER.findall(line)) >= LEAST_OF_POSE


def _refuse_blocks(table: Sequence[Sequence[str]], name: str) -> None:
    """Raise UnreadableRecording if a pose is in several lines, possibly below one that numbers it."""
    first, *others = table
    for rows, widths in ((table, (3, 4)), (others, (1, 3))):
        matrix = np.array([numbers(row[:3]) for row in rows[:3] if len(row) in (3, 4)])
        is_rotation = matrix.shape == (3, 3) and np.allclose(matrix @ matrix.T, np.eye(3), rtol=0, atol=0.01)
        if not is_rotation or len(first) not in widths or len(table) < 4:
            continue
        about, load = "", f"numpy.loadtxt({name!r})"
        shape = f"-1, {4 if numbers(table[3])[-1:] == 1.0 else 3}, {len(first)}"
        if rows is others:
            about, shape = ", below one that numbers it", "-1, 4, 4"
            of_lines = f"line.split() for line in open({name!r}) if len(line.split()) == 4"
            load = f"numpy.array([{of_lines}], float)"
        raise UnreadableRecording(
            f"a pose is in several lines{about}: numpy.save('poses.npy', {load}.reshape({shape})) makes a "
            "file that is read"
        )


def _has_groups(rows: Sequence[str], names: int, separator: str | None) -> bool:
    """Whether cells of the first row have several values, below as many names, or one less."""
    cells = [_values_in(cell) for row in rows for cell in _cells_of(row, separator)]
    return any(not isinstance(cell, str) for cell in cells) and len(cells) - names in (0, 1)


def _units(following: Sequence[str], separator: str | None) -> list[str]:
    """The units of the columns, if the row after the names has them; else empty."""
    cells = _cells_of(following[0], separator) if following else []
    cells = [cell.strip(f"[](){BLANKS}").lower() for cell in cells]
    return cells if any(cells) and all(cell in _UNITS for cell in cells if cell) else []


def _separator(line: str) -> str | None:
    """The separator of values in a line; None for white space."""
    words = line.split()
    is_tum = len(words) == 1 + len(_TUM) and are_numbers(words) and not any(word[-1] == "," for word in words)
    if is_tum and len(line.split("\t")) < 1 + len(_TUM):
        return None  # white space, with commas as decimal points
    return next((mark for mark in _MARKS if mark in line), None)


def _check_widths(rows: Sequence[str], layout: TableLayout, separator: str | None, names: int) -> None:
    """Raise UnreadableRecording if rows have more values than there are names, so that their assignment is
    ambiguous, or if the first row lacks values of the pose, as it has another separator."""
    widths = [len(_cells_of(row.rstrip(f"\r\n{separator or ''}"), separator)) for row in rows]
    if separator is not None and max(widths) > names:
        raise UnreadableRecording(
            f"rows have {max(widths)} values under {names} names: name all columns, and where these are "
            "decimal commas, write points, or separate values by semicolons"
        )
    count = len(_cells_of(rows[0], separator))
    if count <= max(layout.places):
        raise UnreadableRecording(
            f"row 1 has {count} {'value' if count == 1 else 'values'}, the header has {names}: separate the "
            f"values of all rows by {SEPARATORS[separator or ' ']}, as the names in the header"
        )


_FORMATS: Final[Sequence[tuple[Callable[[str], bool], Callable[..., TableLayout]]]] = (
    (lambda line: line.lstrip('\ufeff"').lower().startswith("format version"), _motive_layout),
    (lambda line: line.strip(f",;{BLANKS}").lower() in (*_SECTIONS, *_OTHER_SECTIONS), _vicon_layout),
    (lambda line: bool(_JSON.match(line)) or _has_names(line), _json_layout),
    (lambda line: line.startswith(_QUALISYS), _qualisys_layout),
)
"""Known formats: a test of the first line, and the layout; other files have rows with or without names."""
