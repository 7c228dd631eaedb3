"""How poses lie in a text file or table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from contact_tracker.errors import UnreadableRecording

LENGTHS_M: Final[Mapping[str, float]] = {
    **dict.fromkeys(("m", "meters", "metres", "meter"), 1.0),
    **dict.fromkeys(("cm", "centimeters", "centimetres"), 1e-2),
    **dict.fromkeys(("mm", "millimeters", "millimetres"), 1e-3),
}

BLANKS: Final = '" \t\r\n'
"""What may stand around a value in its cell."""


@dataclass(frozen=True)
class Body:
    """A rigid body: the places of its seven columns, position first and then the quaternion ``xyzw``."""

    name: str
    columns: tuple[int, ...]
    metres: float


@dataclass(frozen=True)
class TableLayout:
    """How poses lie in a table.

    Parameters
    ----------
    kind : of file, for people.
    separator : of the values in a line; None where it is any white space.
    skip : lines before the first row.
    is_ragged : whether rows may lack their last values, and have nothing but numbers.
    time : the column of the time.
    time_ns : one unit of the time in nanoseconds; None where only the times tell.
    has_own_unit : whether the format itself says the unit of its times.
    """

    kind: str
    separator: str | None
    skip: int
    time: int
    time_ns: float | None
    bodies: tuple[Body, ...]
    is_ragged: bool = False
    has_own_unit: bool = False


def are_numbers(values: Sequence[str]) -> bool:
    """Whether there are numbers among some values, and nothing else; commas are decimal points."""
    try:
        return len([number(value) for value in values if value.strip(BLANKS)]) > 0
    except ValueError:
        return False


def number(value: str) -> float:
    """The number in a cell, in quotes or with a decimal comma as it may be; raises ValueError."""
    return float(value.strip(BLANKS).replace(",", "."))


def separator_after(word: str, line: str) -> str:
    """What separates the values of a line that begins with ``word``, a comma where that is not certain."""
    mark = line.strip('" \r\n\ufeff').removeprefix(word).lstrip('" ')[:1]
    return mark if mark in (";", "\t") else ","


def metres(unit: str) -> float:
    """A unit of length in metres; raises UnreadableRecording."""
    try:
        return LENGTHS_M[unit.lower()]
    except KeyError:
        raise UnreadableRecording(f"its unit of length is {unit}: export metres or millimetres") from None
