"""Layouts of poses in text files and tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.table_reading import POSITION, TableReading
from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.rotation_kinds import ROTATIONS, quaternions

LENGTHS_M: Final[Mapping[str, float]] = {
    **dict.fromkeys(("m", "meters", "metres", "meter", "metre"), 1.0),
    **dict.fromkeys(("cm", "centimeters", "centimetres", "centimeter", "centimetre"), 1e-2),
    **dict.fromkeys(("mm", "millimeters", "millimetres", "millimeter", "millimetre"), 1e-3),
    **dict.fromkeys(("um", "\u00b5m", "\u03bcm", "micrometers", "micrometres"), 1e-6),
}
ANGLES: Final[Mapping[str, str]] = {
    **dict.fromkeys(("deg", "degs", "degree", "degrees", "\u00b0"), "deg"),
    **dict.fromkeys(("rad", "rads", "radian", "radians"), "rad"),
}

BLANKS: Final = '" \t\r\n'
"""Characters that may surround a value in its cell."""


class OpenReading(UnreadableRecording):
    """Columns of a rotation, of these names, may be meant in several ways."""

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__(", ".join(names[:3]))


@dataclass(frozen=True)
class Body:
    """A rigid body: indices of the columns of its position and rotation, and how these are meant.

    Parameters
    ----------
    metres : factor of the position.
    kind : of the rotation, a key of ``table_readings.ROTATIONS``.
    how : order and unit of angles.
    """

    name: str
    columns: tuple[int, ...]
    metres: float
    kind: str = "quaternion"
    how: str = ""

    def poses(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions (m) and quaternions ``xyzw`` (N, 7) of the values of its columns (N, k)."""
        return np.hstack([values[:, :3] * self.metres, quaternions(self.kind, values[:, 3:], self.how)])


@dataclass(frozen=True)
class TableLayout:
    """Layout of poses in a table.

    Parameters
    ----------
    kind : description of the format.
    separator : of the values in a line; None for white space.
    skip : lines before the first row.
    time : index of the time column.
    time_ns : unit of the time in nanoseconds; None if it has to be guessed from the values.
    rest : index of a column with the nanoseconds of the second.
    has_own_unit : whether the format itself defines the unit of its times.
    names : of the values of JSON lines.
    """

    kind: str
    separator: str | None
    skip: int
    time: int
    time_ns: float | None
    bodies: tuple[Body, ...]
    rest: int | None = None
    has_own_unit: bool = False
    names: tuple[str, ...] = ()

    @property
    def places(self) -> list[int]:
        """Indices of the columns that are read, the time first."""
        times = [self.time] if self.rest is None else [self.time, self.rest]
        return list(dict.fromkeys([*times, *(place for body in self.bodies for place in body.columns)]))


SEPARATORS: Final[Mapping[str, str]] = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "blanks"}
"""Characters that separate values, and what messages call them."""


def bodies_of(
    found: Mapping[str, Mapping[str, int]],
    columns: Sequence[tuple[str, str]],
    reading: TableReading,
    unit: str = "",
) -> tuple[Body, ...]:
    """The bodies with a position and a rotation.

    Parameters
    ----------
    found : indices of columns by body and role.
    columns : name and unit of each column, the unit empty where unknown; ``unit`` is that of positions then.

    Raises
    ------
    OpenReading
        What the rotation of a body is, or the unit of its angles, is not known.
    UnreadableRecording
        A unit is unknown, or those of x, y and z differ.
    """
    bodies, open_names = list[Body](), list[str]()
    for name, places in found.items():
        kinds = [kind for kind, rotation in ROTATIONS.items() if places.keys() >= set(rotation.roles)]
        if not kinds or not places.keys() >= set(POSITION):
            continue
        kind = reading.kind or "quaternion"
        if kind not in kinds:
            if reading.kind is None:
                open_names = open_names or [columns[places[r]][0] for r in ROTATIONS[kinds[0]].roles]
            continue
        roles = ROTATIONS[kind].roles
        own = [
            (label, reading.unit or named or unit) for label, named in (columns[places[r]] for r in POSITION)
        ]
        how = _how(reading, [columns[places[role]] for role in roles])
        bodies.append(Body(name, tuple(places[r] for r in (*POSITION, *roles)), metres_of(own), kind, how))
    if open_names and not bodies:
        raise OpenReading(open_names)
    return tuple(bodies)


def _how(reading: TableReading, columns: Sequence[tuple[str, str]]) -> str:
    """Order and unit of angles: as stated, else by the names; rotation vectors are usually in radians."""
    units = {ANGLES.get(unit, "") for _, unit in columns}
    if reading.euler is None:
        return "deg" if units == {"deg"} else "rad"
    if ":" in reading.euler:
        return reading.euler
    if len(units) > 1 or "" in units:
        raise OpenReading([name for name, _ in columns])
    return f"{reading.euler}:{units.pop()}"


def metres_of(columns: Sequence[tuple[str, str]]) -> float:
    """The factor to metres of x, y and z by their names and units; metres without a unit.

    Raises
    ------
    UnreadableRecording
        A unit is unknown, or they differ.
    """
    for name, unit in columns:
        if unit and unit.lower() not in LENGTHS_M:
            raise UnreadableRecording(unknown_unit(unit, name, "m, cm, mm, um"))
    factors = {LENGTHS_M[unit.lower()] if unit else 1.0 for _, unit in columns}
    if len(factors) > 1:
        names = ", ".join(name for name, _ in columns)
        raise UnreadableRecording(f"the units of the columns {names} differ: give all three in one")
    return factors.pop()


def unknown_unit(unit: str, name: str, known: str) -> str:
    """The message on a unit that is not read."""
    return f"the unit '{unit}' of column '{name.strip()}' is not known: {known}"


def are_numbers(values: Sequence[str]) -> bool:
    """Whether values are numbers and empty cells, with at least one number; commas are decimal points."""
    try:
        return len([number(value) for value in values if value.strip(BLANKS)]) > 0
    except ValueError:
        return False


def number(value: str) -> float:
    """The number in a cell, which may have quotes or a decimal comma; raises ValueError."""
    return float(value.strip(BLANKS).replace(",", "."))
