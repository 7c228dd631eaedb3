"""Text tables whose last line is cut off inside a row, as when writing stopped or a copy was interrupted."""

import csv
import os
from typing import Final

from contact_tracker.recording.table_layouts import BLANKS, are_numbers

_TAIL_BYTES: Final = 2**19
"""Room for two of the longest rows that are read."""
CUT_OFF: Final = (
    "its last line is cut off inside a row and left out: if more was recorded, copy the file again"
)


def is_cut_off(path: str, separator: str | None) -> bool:
    """Whether a text table ends inside a row; a whole row without a line break is no damage.

    The last line has no line break then, and lacks values that the row before it has, or its last value is
    part of a number. A number cut to a shorter one cannot be told from a whole one.
    """
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _TAIL_BYTES))
        tail = file.read()
    if tail.endswith((b"\n", b"\r")):
        return False
    lines = [line for line in tail.decode("utf-8", errors="replace").splitlines() if line.strip()]
    if len(lines) < 2 or lines[-1].startswith("#"):
        return False
    before, last = (_cells(line, separator) for line in lines[-2:])
    if len(last) != len(before):
        return len(last) < len(before)
    is_value_lost = not last[-1] and any(last[-2:-1])  # more than one is missing of a body that is hidden
    return are_numbers(before[-1:]) and (is_value_lost or (bool(last[-1]) and not _is_number(last[-1])))


def _is_number(cell: str) -> bool:
    return are_numbers([cell])


def _cells(line: str, separator: str | None) -> list[str]:
    """The values in a line; a quote that is open at its end is part of the last one."""
    cells = line.split() if separator is None else next(csv.reader([line], delimiter=separator), [])
    return [cell.strip(BLANKS) for cell in cells]
