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
    time : the column of the time; after it that of nanoseconds or of sub-frames, if there is one.
    time_ns : one unit of the time in nanoseconds; None where its size tells.
    """

    kind: str
    separator: str | None
    skip: int
    time: int
    time_ns: float | None
    bodies: tuple[Body, ...]
    is_ragged: bool = False


def are_numbers(values: Sequence[str]) -> bool:
    """Whether there are numbers among some values, and nothing else."""
    try:
        return len([float(value) for value in values if value.strip()]) > 0
    except ValueError:
        return False


def metres(unit: str) -> float:
    """A unit of length in metres; raises UnreadableRecording."""
    try:
        return LENGTHS_M[unit.lower()]
    except KeyError:
        raise UnreadableRecording(f"its unit of length is {unit}: export metres or millimetres") from None
