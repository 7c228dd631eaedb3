"""Layouts of poses in text files and tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from contact_tracker.errors import UnreadableRecording

LENGTHS_M: Final[Mapping[str, float]] = {
    **dict.fromkeys(("m", "meters", "metres", "meter", "metre"), 1.0),
    **dict.fromkeys(("cm", "centimeters", "centimetres", "centimeter", "centimetre"), 1e-2),
    **dict.fromkeys(("mm", "millimeters", "millimetres", "millimeter", "millimetre"), 1e-3),
    **dict.fromkeys(("um", "\u00b5m", "\u03bcm", "micrometers", "micrometres"), 1e-6),
}

BLANKS: Final = '" \t\r\n'
"""Characters that may surround a value in its cell."""


@dataclass(frozen=True)
class Body:
    """A rigid body: indices of its seven columns, position and quaternion ``xyzw``."""

    name: str
    columns: tuple[int, ...]
    metres: float


@dataclass(frozen=True)
class TableLayout:
    """Layout of poses in a table.

    Parameters
    ----------
    kind : description of the format.
    separator : of the values in a line; None for white space.
    skip : lines before the first row.
    is_ragged : whether rows may lack their last values, and have nothing but numbers.
    time : index of the time column.
    time_ns : unit of the time in nanoseconds; None if it has to be guessed from the values.
    has_own_unit : whether the format itself defines the unit of its times.
    """

    kind: str
    separator: str | None
    skip: int
    time: int
    time_ns: float | None
    bodies: tuple[Body, ...]
    is_ragged: bool = False
    has_own_unit: bool = False


SEPARATORS: Final[Mapping[str, str]] = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "blanks"}
"""Characters that separate values, and what messages call them."""


def are_numbers(values: Sequence[str]) -> bool:
    """Whether values are numbers and empty cells, with at least one number; commas are decimal points."""
    try:
        return len([number(value) for value in values if value.strip(BLANKS)]) > 0
    except ValueError:
        return False


def number(value: str) -> float:
    """The number in a cell, which may have quotes or a decimal comma; raises ValueError."""
    return float(value.strip(BLANKS).replace(",", "."))


def separator_after(word: str, line: str) -> str:
    """The separator of a line that begins with ``word``; a comma where uncertain."""
    mark = line.strip('" \r\n\ufeff').removeprefix(word).lstrip('" ')[:1]
    return mark if mark in (";", "\t") else ","


def metres(unit: str) -> float:
    """The factor from a unit of length to metres; raises UnreadableRecording."""
    try:
        return LENGTHS_M[unit.lower()]
    except KeyError:
        raise UnreadableRecording(f"its unit of length is {unit}: export metres or millimetres") from None
