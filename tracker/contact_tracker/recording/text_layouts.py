"""The layout of a text file by its first lines: a header of names, a known format, or rows without names."""

import re
from collections.abc import Sequence
from typing import Final

from contact_tracker.config.table_reading import TableReading, reading_of
from contact_tracker.errors import ChoiceError, UnreadableRecording
from contact_tracker.recording.mocap_exports import is_motive, is_vicon, motive_layout, vicon_layout
from contact_tracker.recording.named_columns import MOST_COLUMNS, UNNAMED, layout_of_names
from contact_tracker.recording.table_layouts import (
    ANGLES,
    BLANKS,
    LENGTHS_M,
    SEPARATORS,
    Body,
    TableLayout,
    are_numbers,
)
from contact_tracker.recording.text_rows import COMMENT, HEAD_LINES, cells_of, fields_of
from contact_tracker.recording.time_units import NAMED_NS

_TUM: Final = (1, 2, 3, 4, 5, 6, 7)
_MARKS: Final = (";", "\t", ",")
"""Separators of values; a comma may also be the decimal point."""
_SEPARATOR_LINE: Final = re.compile(r'"?sep=(.)"?\s*', re.IGNORECASE)
_QUALISYS: Final = "NO_OF_FRAMES"
_MATRICES: Final = reading_of("matrix=Rot", matrix="columns", unit="mm")
"""How Qualisys writes the columns of a body."""
_UNITS: Final = frozenset({*LENGTHS_M, *ANGLES, *NAMED_NS})
_POSE: Final = 7
_NANOSECONDS: Final = 10


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
            layout = layout_of_names(names, reading, path, "table", separator, i + 1 + bool(units), units)
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
        how = (
            f"say which they are, by number from 0 on, as in --columns time={UNNAMED}0,x={UNNAMED}1"
            if meant is None
            else f"if they are meant so, read them by {meant.with_(reading).command(path)}"
        )
        raise UnreadableRecording(f"its {len(values)} columns have no names: {how}")
    return layout_of_names(names, reading, path, kind, separator, skip)


def _meaning(values: Sequence[str]) -> TableReading | None:
    """What rows without names usually are: TUM, messages of ``ros2 topic echo --csv``, KITTI's matrices."""

    def named(first: int, **stated: str) -> TableReading:
        pose = zip(("x", "y", "z", "qx", "qy", "qz", "qw"), range(first, first + _POSE), strict=True)
        return reading_of({**stated, **{role: f"{UNNAMED}{i}" for role, i in pose}})

    numbers = [are_numbers([value]) for value in values]
    if len(values) == 12 and all(numbers):
        return reading_of(f"matrix={UNNAMED}", matrix="rows", time_unit="10Hz")
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
