"""Text tables: their lines, and their layout by the first ones: a header of names, a known format, or rows
without names.

Motive writes rows of types, names, IDs (not always), parents (since format 1.25) and values above that of the
axes, before format 1.23 without row labels; rotations are quaternions or angles. Vicon Tracker and Nexus
write sections, each with its rate and the names of bodies, columns and units; three columns of rotation are
angles or a helical vector, which most exports do not distinguish. Names are read in any case.
"""

import csv
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice, pairwise
from typing import Final

from contact_tracker.config.table_reading import TableReading, reading_of
from contact_tracker.errors import ChoiceError, UnreadableRecording
from contact_tracker.recording.bytestream import encoding_of
from contact_tracker.recording.table_layouts import (
    ANGLE_UNITS,
    BLANKS,
    LENGTHS_M,
    MOST_COLUMNS,
    NAMED_NS,
    SEPARATORS,
    UNNAMED,
    Body,
    OpenReading,
    TableLayout,
    are_numbers,
    bodies_of,
    layout_of_names,
    number,
)

_LINE: Final = 2**18
"""Longest line (characters); the rest of a longer one is a line of its own."""
HEAD_LINES: Final = 64
_LONGEST_CELL: Final = 64
"""Texts of numbers and times are cut to this length (characters) in long lines."""
_EMPTY: Final = f",;{BLANKS}"
COMMENT: Final = "#"
_RIGID_BODY: Final = "rigid body"
_BONE: Final = "bone"
_SECTIONS: Final = ("objects", "segments")
_OTHER_SECTIONS: Final = ("trajectories", "model outputs", "devices", "joints", "events")
_ROUNDED_S: Final = 0.00051
_ORDER: Final = re.compile(r"([xyz]{3})", re.IGNORECASE)
_ABOUT: Final = re.compile(r"Global Angle\s*(?:\(([^)]*)\))?\s*")
_TUM: Final = (1, 2, 3, 4, 5, 6, 7)
_MARKS: Final = (";", "\t", ",")
"""Separators of values; a comma may also be the decimal point."""
_SEPARATOR_LINE: Final = re.compile(r'"?sep=(.)"?\s*', re.IGNORECASE)
_QUALISYS: Final = "NO_OF_FRAMES"
_MATRICES: Final = reading_of("matrix=Rot", matrix="columns", unit="mm")
"""How Qualisys writes the columns of a body."""
_UNITS: Final = frozenset({*LENGTHS_M, *ANGLE_UNITS, *NAMED_NS})
_POSE: Final = 7
_NANOSECONDS: Final = 10


def head_of(path: str, begin: bytes) -> list[str]:
    """The first lines of a file that begins with these bytes."""
    with open(path, encoding=encoding_of(begin), errors="replace") as file:
        return list(islice(iter(lambda: file.readline(_LINE), ""), HEAD_LINES))


def cells_of(line: str, separator: str | None) -> list[str]:
    """The values in a line, perhaps between blanks; a quote that is open is part of the last one."""
    if separator is None or '"' not in line:
        return line.split(separator)
    try:
        return [cell.strip(BLANKS) for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return [line[:_LONGEST_CELL]]


def fields_of(line: str) -> dict[str, str]:
    """The numbers and texts in a JSON object by their names, as ``pose.position.x`` and ``state[0]``; raises
    ValueError."""
    try:
        given = json.loads(line, parse_float=str, parse_int=str)
    except RecursionError as error:
        raise ValueError("it is too deep") from error
    if not isinstance(given, dict):
        raise ValueError("it is no object")
    found, waiting = dict[str, str](), list(given.items())[::-1]
    while waiting:
        name, value = waiting.pop()
        if isinstance(value, dict):
            waiting += [(f"{name}.{key}", one) for key, one in value.items()][::-1]
        elif isinstance(value, list):
            waiting += [(f"{name}[{i}]", one) for i, one in enumerate(value)][::-1]
        elif isinstance(value, str):
            found[name] = value
    return found


class TextRows:
    """The values of some columns in the rows of a text table; empty lines and comments are left out.

    Iterate once; then ``is_cut`` says whether the last line is cut off inside a row, and left out.
    """

    def __init__(self, path: str, begin: bytes, layout: TableLayout) -> None:
        self._path = path
        self._begin = begin
        self._layout = layout
        self.is_cut = False

    def __iter__(self) -> Iterator[list[str]]:
        layout, number = self._layout, 0
        places, last, width = layout.places, list[str](), max(layout.places) + 1
        with open(self._path, encoding=encoding_of(self._begin), errors="replace") as file:
            for _ in islice(iter(lambda: file.readline(_LINE), ""), layout.skip):
                pass
            while line := file.readline(_LINE):
                if line.startswith(COMMENT):
                    continue
                if not line.strip(_EMPTY):
                    if layout.kind == "Vicon":
                        return  # the end of a section
                    continue
                cells = self._cells(line)
                if line[-1] != "\n" and len(line) < _LINE and last and _is_cut(last, cells):
                    self.is_cut = True
                    return
                last = cells
                if len(cells) < width:
                    cells = cells + [""] * (width - len(cells))
                row = [cells[place] for place in places]
                if layout.time < 0:
                    row[0] = str(number)
                if len(line) > _LONGEST_CELL * width:
                    row = [cell[:_LONGEST_CELL] for cell in row]
                if any(map(str.strip, row)):
                    number += 1
                    yield row

    def _cells(self, line: str) -> list[str]:
        if not self._layout.names:
            return cells_of(line, self._layout.separator)
        try:
            fields = fields_of(line)
        except ValueError:
            return [line] * len(self._layout.names)  # none of them is a number
        return [fields.get(name, "") for name in self._layout.names]


def _is_cut(before: Sequence[str], last: Sequence[str]) -> bool:
    """Whether a last line without a line break is part of a row; a whole row is no damage.

    It lacks values that the row before it has, or its last value is part of a number. A number cut to a
    shorter one cannot be told from a whole one.
    """
    before, last = ([cell.strip(BLANKS) for cell in cells] for cells in (before, last))
    if len(last) != len(before):
        return len(last) < len(before)
    is_value_lost = not last[-1] and any(last[-2:-1])  # more than one is missing of a body that is hidden
    return are_numbers(before[-1:]) and (is_value_lost or (bool(last[-1]) and not are_numbers(last[-1:])))


def is_motive(first: str) -> bool:
    """Whether a file with this first line is an export of Motive."""
    return first.lstrip('\ufeff"').lower().startswith("format version")


def is_vicon(first: str) -> bool:
    """Whether a file with this first line is an export of Vicon."""
    return first.strip().strip(',;\t"').lower() in (*_SECTIONS, *_OTHER_SECTIONS)


def motive_layout(lines: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout of an export of Motive, formats 1.2 to 1.25; raises UnreadableRecording."""
    separator = _separator_after("format version", next(line for line in lines if line.strip()))
    cells = _cells(lines, separator)
    first = next(row for row in cells if row[0])
    if len(first) < 2:
        raise UnreadableRecording(
            "its columns are separated by nothing known: export it from Motive with commas"
        )
    about = {name.lower(): value for name, value in zip(first[::2], first[1::2], strict=False)}
    rotation = about.get("rotation type", "Quaternion")
    lower = [[cell.lower() for cell in row] for row in cells]
    head = next((i for i, row in enumerate(lower) if row[0] == "frame"), 0)
    kind_row = next((i for i, row in enumerate(lower[1:head], 1) if {_RIGID_BODY, _BONE} & set(row)), None)
    if kind_row is None or head - kind_row < 3 or "rotation" not in lower[head - 1]:
        raise UnreadableRecording(
            "no rigid body with Rotation and Position in its header: export it from Motive with rigid bodies"
        )
    is_local = about.get("coordinate space", "Global").lower() != "global"
    columns = zip(lower[kind_row], cells[kind_row + 1], lower[head - 1], lower[head], strict=False)
    found = dict[tuple[str, str], dict[str, int]]()
    turn = "q" if rotation.lower() == "quaternion" else "r"
    for place, (kind, name, value, axis) in enumerate(columns):
        if value in ("rotation", "position") and (kind == _RIGID_BODY or (kind == _BONE and not is_local)):
            _note(found, (kind, name), axis if value == "position" else turn + axis, place)
    unit = reading.unit or about.get("length units", about.get("units", "Meters"))
    try:
        bodies = bodies_of(_named(found), [(name, "") for name in cells[head]], reading, unit)
    except OpenReading:
        stated = reading.with_(reading_of(euler=f"{rotation}:deg")).command(path)
        raise UnreadableRecording(
            f"its rotations are {rotation}: export it from Motive with quaternions, or read them as Motive's "
            f"angles by {stated}"
        ) from None
    if not bodies:
        raise UnreadableRecording(
            "no rigid body has both position and quaternion, in global coordinates: export it with both"
        )
    time, time_ns = _motive_times(about, cells[head + 1 :])
    return TableLayout("Motive", separator, head + 1, time, time_ns, bodies, has_own_unit=True)


def _motive_times(about: Mapping[str, str], rows: Sequence[Sequence[str]]) -> tuple[int, float]:
    """The time column and its unit in nanoseconds: frame numbers where the times are those of the frames
    rounded to milliseconds, as Motive 2.3 and 3 write them; else seconds."""
    try:
        rate = number(about.get("export frame rate", ""))
        times = [(number(row[0]), number(row[1])) for row in rows if len(row) > 1]
    except ValueError:
        return 1, 1e9
    fits = rate > 0 and all(abs(frame / rate - time) <= _ROUNDED_S for frame, time in times)
    return (0, 1e9 / rate) if times and fits else (1, 1e9)


def _note(found: dict[tuple[str, str], dict[str, int]], body: tuple[str, str], role: str, place: int) -> None:
    """Note one column of a body; another body of the same kind and name gets a number."""
    kind, name = body
    numbered = chain([body], ((kind, f"{name} {i}") for i in range(2, 1000)))
    free = next((one for one in numbered if role not in found.get(one, ())), None)
    if free is not None:
        found.setdefault(free, {})[role] = place


def _named(found: dict[tuple[str, str], dict[str, int]]) -> dict[str, dict[str, int]]:
    """The bodies by name, without bones that share the name of a rigid body."""
    return {
        name: places
        for (kind, name), places in found.items()
        if kind == _RIGID_BODY or (_RIGID_BODY, name) not in found
    }


def vicon_layout(lines: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout of the first section of an export of Vicon; raises UnreadableRecording."""
    begin = next(i for i, line in enumerate(lines) if line.strip())
    head = next((line for line in lines[begin:] if line.strip(BLANKS).lower().startswith("frame")), "")
    separator = _separator_after("frame", head)
    cells = _cells(lines[begin:], separator)
    section = cells[0][0]
    if section.lower() not in _SECTIONS:
        raise UnreadableRecording(
            f"its section is {section}: export Objects or Segments from Vicon, as the first section"
        )
    if len(cells) < 5 or not are_numbers(cells[1][:1]) or not number(cells[1][0]) > 0:
        raise UnreadableRecording(f"its section {section} lacks rate, names, columns or units above its rows")
    names, axes, units = cells[2], [axis.lower() for axis in cells[3]], cells[4]
    found = dict[str, dict[str, int]]()
    for start, end in pairwise([*(i for i, name in enumerate(names) if name), len(axes)]):
        turn = "q" if "rw" in axes[start:end] else "r"
        roles = {f"r{axis}": turn + axis for axis in "xyzw"} | {f"t{axis}": axis for axis in "xyz"}
        places = {roles[axis]: start + i for i, axis in enumerate(axes[start:end]) if axis in roles}
        found.setdefault(_short(names[start]), places)
    columns = [(axis, units[i].lower() if i < len(units) else "") for i, axis in enumerate(axes)]
    try:
        bodies = bodies_of(found, columns, reading, "mm")
    except OpenReading:
        raise UnreadableRecording(_refused(next(filter(None, names)), reading, path)) from None
    if not bodies:
        raise UnreadableRecording("no object with TX to TZ and RX to RW: export quaternions from Vicon")
    frame_ns = 1e9 / number(cells[1][0])
    return TableLayout("Vicon", separator, begin + 5, 0, frame_ns, bodies, has_own_unit=True)


def _refused(name: str, reading: TableReading, path: str) -> str:
    """The message on three columns of rotation, with the commands that read them."""
    about = _ABOUT.match(name)
    kind = about[1] if about is not None else None
    order = _ORDER.search(kind or "")
    ways = [reading_of(rotation_vector=True)] if order is None else [reading_of(euler=order[1].upper())]
    if not kind:
        ways.append(reading_of(euler="XYZ"))
    how = (
        f"of the kind {kind}" if kind else "three angles or a helical vector, and the file does not say which"
    )
    commands = " or ".join(reading.with_(way).command(path) for way in ways)
    return f"rotations of {_short(name)} are {how}: export quaternions from Vicon, or read them by {commands}"


def _short(name: str) -> str:
    """An object's name, without its segment's if that is the same."""
    plain = _ABOUT.sub("", name, count=1)
    subject, _, segment = plain.partition(":")
    return subject if segment in ("", subject) else plain


def _separator_after(word: str, line: str) -> str:
    """The separator of a line that begins with ``word``; a comma where uncertain."""
    mark = line.strip('" \r\n\ufeff')[len(word) :].lstrip('" ')[:1]
    return mark if mark in (";", "\t") else ","


def _cells(lines: Iterable[str], separator: str) -> list[list[str]]:
    """The cells of each line; an empty line has one empty cell."""
    rows = (cells_of(line.replace("\0", ""), separator) or [""] for line in lines)
    return [[cell.strip() for cell in row] for row in rows]


def layout_of_text(lines: Sequence[str], reading: TableReading, path: str = "FILE") -> TableLayout:
    """The layout of a text file by its first lines.

    Raises
    ------
    UnreadableRecording
        It is no table of poses, or it is not known how its columns are meant.
    ChoiceError
        A column that the reading names is not there.
    """
    if any(line.count(mark) >= MOST_COLUMNS for line in lines for mark in ",;\t "):
        raise UnreadableRecording(f"its rows have {MOST_COLUMNS} values or more: leave out those of no body")
    first = next((line for line in lines if line.strip()), "")
    if is_motive(first):
        return motive_layout(lines, reading, path)
    if is_vicon(first):
        return vicon_layout(lines, reading, path)
    if first.lstrip().startswith("{"):
        return _layout_of_json(lines, reading, path)
    if first.startswith(_QUALISYS) and reading.kind is None:
        reading = _MATRICES.with_(reading)
    stated = _SEPARATOR_LINE.fullmatch(first)
    rows = [i for i, line in enumerate(lines) if line.strip() and not line.startswith(COMMENT)]
    rows = rows[1:] if stated else rows
    if not rows:
        raise UnreadableRecording(f"its first {len(lines)} lines are empty or comments: leave them out")
    comments = [rows[0] - 1] if rows[0] and lines[rows[0] - 1].startswith(COMMENT) else []
    errors = dict[int, Exception]()
    """The first of each number of names; of comments at -1."""
    for i in [*comments, *rows]:
        names_line = lines[i].lstrip("# ") if i in comments else lines[i]
        following = [lines[row] for row in rows if row > i]
        separator = stated[1] if stated else _separator(following[0] if i in comments else lines[i])
        names = [name.strip(BLANKS) for name in cells_of(names_line, separator)]
        if i in comments and len(names) != len(cells_of(following[0], separator)):
            continue
        if 2 * sum(are_numbers([name]) for name in names) > len(names):
            break  # the rows have begun
        units = _units(following, separator)
        try:
            named = [name or f"{UNNAMED}{place}" for place, name in enumerate(names)]
            layout = layout_of_names(named, reading, path, "table", separator, i + 1 + bool(units), units)
        except (UnreadableRecording, ChoiceError) as error:
            errors.setdefault(-1 if i in comments else len(names), error)
            continue
        _refuse_other_widths(following[bool(units) :], layout, len(names))
        if len(lines) < HEAD_LINES and len(following) <= bool(units):
            raise UnreadableRecording("it has a header but no rows")
        return layout
    if max(errors, default=-1) >= 0:
        raise errors[max(errors)]
    separator = _separator(lines[rows[0]])
    values = [value.strip(BLANKS) for value in cells_of(lines[rows[0]], separator)]
    if separator is None and len(values) == 1 + _POSE and reading == reading_of(**reading.units):
        body = Body("", _TUM, LENGTHS_M[reading.unit or "m"])
        return TableLayout("TUM", None, rows[0], 0, reading.time_ns, (body,))
    try:
        return layout_without_names(values, reading, path, "table", separator, rows[0])
    except UnreadableRecording as error:
        raise errors.get(-1, error) from None


def _units(following: Sequence[str], separator: str | None) -> list[str]:
    """The units of the columns, where the row after the names has them."""
    cells = (
        [cell.strip(f"[](){BLANKS}").lower() for cell in cells_of(following[0], separator)]
        if following
        else []
    )
    named = [cell for cell in cells if cell]
    return cells if named and all(cell in _UNITS or cell in ("-", "1") for cell in named) else []


def layout_without_names(
    values: Sequence[str],
    reading: TableReading,
    path: str,
    kind: str,
    separator: str | None = None,
    skip: int = 0,
) -> TableLayout:
    """The layout of columns that have no names, by the values of the first row.

    Raises
    ------
    UnreadableRecording
        The reading does not say which columns are what.
    """
    names = [f"{UNNAMED}{i}" for i in range(len(values))]
    if not reading.columns:
        meant = _meaning(values)
        how = f"say which they are, by number from 0 on, as in --columns time={UNNAMED}0,x={UNNAMED}1"
        if meant is not None:
            how = f"if they are meant so, read them by {meant.with_(reading).command(path)}"
            if meant.has_frame_numbers and not reading.has_frame_numbers:
                how += f", with the rate of your poses instead of {meant.time_unit}"
        raise UnreadableRecording(f"its {len(values)} columns have no names: {how}")
    return layout_of_names(names, reading, path, kind, separator, skip)


def _meaning(values: Sequence[str]) -> TableReading | None:
    """What rows without names usually are: TUM, messages of ``ros2 topic echo --csv``, poses without times
    and matrices, as KITTI's."""

    def named(first: int, **stated: str) -> TableReading:
        pose = zip(("x", "y", "z", "qx", "qy", "qz", "qw"), range(first, first + _POSE), strict=True)
        return reading_of({**stated, **{role: f"{UNNAMED}{i}" for role, i in pose}})

    numbers = [are_numbers([value]) for value in values]
    if len(values) in (12, 16) and all(numbers):
        return reading_of(f"matrix={UNNAMED}", matrix="rows", time_unit="10Hz")
    if len(values) == _POSE and all(numbers):
        return named(0).with_(reading_of(time_unit="10Hz"))
    if len(values) == 1 + _POSE and all(numbers):
        return named(1, time=f"{UNNAMED}0")
    texts = [i for i, is_number in enumerate(numbers) if not is_number]
    is_stamp = (
        len(values) > 2 and values[0].isdigit() and values[1].isdigit() and len(values[1]) < _NANOSECONDS
    )
    if is_stamp and texts and texts[0] == 2 and len(values) >= texts[-1] + 1 + _POSE:
        return named(texts[-1] + 1, time=f"{UNNAMED}0", nanoseconds=f"{UNNAMED}1")
    return None


def _layout_of_json(lines: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout of lines with a JSON object each, with the names of all that are in the first ones."""
    names = dict[str, None]()
    for line in lines:
        try:
            names.update(dict.fromkeys(fields_of(line)))
        except ValueError:
            if not names:
                raise UnreadableRecording(
                    "its first line is no JSON object: one a line is read, as jq -c '.[]' writes an array"
                ) from None
    layout = layout_of_names(list(names), reading, path, "JSON")
    return TableLayout(
        "JSON", None, 0, layout.time, layout.time_ns, layout.bodies, layout.rest, names=tuple(names)
    )


def _separator(line: str) -> str | None:
    """The separator of values in a line; None for white space."""
    words = line.split()
    is_tum = len(words) == 1 + _POSE and are_numbers(words) and not any(word[-1] == "," for word in words)
    if is_tum and len(line.split("\t")) < 1 + _POSE:
        return None  # white space, with commas as decimal points
    return next((mark for mark in _MARKS if mark in line), None)


def _refuse_other_widths(rows: Sequence[str], layout: TableLayout, names: int) -> None:
    """Raise UnreadableRecording if rows have more values than there are names, whose assignment is ambiguous
    then, or the first lacks values that are needed: it is separated otherwise."""
    widths = [len(cells_of(row.rstrip(f"\r\n{layout.separator or ''}"), layout.separator)) for row in rows]
    if layout.separator is not None and max(widths, default=0) > names:
        raise UnreadableRecording(
            f"rows have {max(widths)} values under {names} names: name all columns, and where these are "
            "decimal commas, write points, or separate values by semicolons"
        )
    many = len(cells_of(rows[0], layout.separator)) if rows else names
    if many <= max(layout.places):
        raise UnreadableRecording(
            f"row 1 has {many} {'value' if many == 1 else 'values'}, the header has {names}: separate the "
            f"values of all rows by {SEPARATORS[layout.separator or ' ']}, as the names in the header"
        )
