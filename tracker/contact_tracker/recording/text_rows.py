"""Lines of text files, and the values in them, in bounded memory."""

import csv
import json
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Final

from contact_tracker.recording.table_layouts import BLANKS, TableLayout, are_numbers

_LINE: Final = 2**18
"""Longest line (characters); the rest of a longer one is a line of its own."""
HEAD_LINES: Final = 64
_LONGEST_CELL: Final = 64
"""Texts of numbers and times are cut to this length (characters) in long lines."""
_UTF_16: Final = (b"\xff\xfe", b"\xfe\xff")
_EMPTY: Final = f",;{BLANKS}"
COMMENT: Final = "#"


def encoding_of(begin: bytes) -> str:
    """The encoding of text with these first bytes."""
    if begin.startswith(_UTF_16):
        return "utf-16"
    try:
        begin[:-4].decode()
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


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
