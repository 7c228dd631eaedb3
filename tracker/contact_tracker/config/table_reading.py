"""How to read poses if names and types do not say it: the user's statements about columns and fields."""

import re
import shlex
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any, Final

from contact_tracker.config.quantities import LENGTHS, TIMES_NS
from contact_tracker.errors import shown

POSITION: Final = ("x", "y", "z")
QUATERNION: Final = ("qx", "qy", "qz", "qw")
ANGLES: Final = ("rx", "ry", "rz")
MATRIX: Final = tuple(f"r{row}{column}" for row in "123" for column in "123")
TIME, REST = "time", "nanoseconds"
"""Roles of a time, and of its nanoseconds within the second if these have a column of their own."""
GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "position": POSITION,
    "quaternion": QUATERNION,
    "wxyz": ("qw", "qx", "qy", "qz"),
    "rotation": ANGLES,
    "matrix": MATRIX,
}
"""Names of groups of roles, for numbered columns or the values of a list."""
ANGLE: Final = "angle"
"""Role of a rotation angle whose axis is a unit vector in other columns."""
ROLES: Final = (TIME, REST, *POSITION, *QUATERNION, *ANGLES, *MATRIX, ANGLE)
TICK, DAY = "100ns", "days"
TIME_UNITS_NS: Final[Mapping[str, int]] = TIMES_NS | {TICK: 100, DAY: 86_400 * 10**9}
_RATE: Final = re.compile(r"([0-9]+(?:\.[0-9]+)?) ?Hz", re.IGNORECASE)
_EULER: Final = re.compile(r"(?!.?(.)\1)([xyz]{3}|[XYZ]{3})(?::(deg|rad))?")
"""Three letters, of which no two neighbours are equal."""
_FIELD: Final = re.compile(r"\.|[A-Za-z]\w*(\[\d+\])?(\.[A-Za-z]\w*(\[\d+\])?)*")
PYTHON: Final = "python"
"""First word of ``given`` if poses are read from Python; the other words are then arguments."""
NO_TABLE: Final = "it is no table: leave out --unit, --time-unit and what else is said of columns"
FRAMES: Final = "frames"
"""Value of ``time_unit`` for times that are frame numbers, whose rate is given separately."""
TIME_UNIT_HELP: Final = "s, ms, us, ns, 100ns, days, or the rate of frame numbers, as 200Hz"


@dataclass(frozen=True)
class TableReading:
    """Meaning of a table's columns, and place of poses in messages; None where names and types say it.

    Parameters
    ----------
    unit : of positions, a key of ``config.quantities.LENGTHS``.
    time_unit : ``s``, ``ms``, ``us``, ``ns``, ``100ns``, or a rate, as ``200Hz``, if times are frame numbers.
    euler : rotations are Euler angles in this order, in scipy's letters (``xyz`` about fixed axes, ``XYZ``
        about those of the body), with ``:deg`` or ``:rad`` if the names do not say it. ``rx``, ``ry``, ``rz``
        are the angles about these axes; if a letter occurs twice, the first, second and third.
    rotation_vector : rotations are vectors along the axis, as long as the angle, if that has no column.
    matrix : rotations are matrices whose numbered values go along ``rows`` or ``columns``.
    columns : names of columns by role, one of ``ROLES`` or ``GROUPS``; columns without names are
        ``c0``, ``c1``, ... ``state[3:7]`` are values 3 to 6 of a list, or of columns ``state_0``, ...
    field : path to the poses in messages, as ``tracked.pose`` or ``detections[0].pose``; ``.`` for the
        message itself. The numbers of an array there have the names of columns, ``data[0]``, ... A table has
        none.
    given : the words of the user's command without the options of this reading, or ``PYTHON`` and the
        arguments in Python, for proposed commands and calls; empty without them.

    Raises
    ------
    ValueError
        A value is not allowed.
    """

    unit: str | None = None
    time_unit: str | None = None
    euler: str | None = None
    rotation_vector: bool = False
    matrix: str | None = None
    columns: tuple[tuple[str, str], ...] = ()
    given: tuple[str, ...] = field(default=(), compare=False)
    field: str | None = None

    def __post_init__(self) -> None:
        for name in ("unit", "time_unit", "euler", "field"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, str):
                raise ValueError(f"{name} is text, not {shown(value)}")
        if self.unit is not None and self.unit not in LENGTHS:
            hint = f"; a time has time_unit={self.unit!r}" if self.unit in TIME_UNITS_NS else ""
            raise ValueError(f"unit is {', '.join(LENGTHS)}, not {shown(self.unit)}{hint}")
        if self.time_unit is not None:
            _ = self.time_ns
        if self.euler is not None and not _EULER.fullmatch(self.euler):
            letters = (
                "three of the letters xyz or XYZ, no two neighbours alike, then :deg or :rad, as in XYZ:deg"
            )
            raise ValueError(f"euler is {letters}, not {shown(self.euler)}")
        if self.matrix not in (None, "rows", "columns"):
            raise ValueError(f"matrix is rows or columns, not {shown(self.matrix)}")
        if self.field is not None and not _FIELD.fullmatch(self.field):
            raise ValueError(f"field is names of fields, as in tracked.pose, not {shown(self.field)}")
        for role, _ in self.columns:
            if role not in ROLES and role not in GROUPS:
                raise ValueError(
                    f"a column is {', '.join((*ROLES[:9], *ANGLES, *GROUPS))}, not {shown(role)}"
                )
        if sum((self.euler is not None, self.rotation_vector, self.matrix is not None)) > 1:
            raise ValueError("a rotation is one of Euler angles, a rotation vector and a matrix")

    @property
    def time_ns(self) -> float | None:
        """The unit of times in nanoseconds."""
        if self.time_unit is None or self.time_unit in TIME_UNITS_NS:
            return None if self.time_unit is None else TIME_UNITS_NS[self.time_unit]
        rate = _RATE.fullmatch(self.time_unit)
        if rate is None or not 1e-3 <= float(rate[1]) <= 1e6:
            raise ValueError(f"time_unit is {TIME_UNIT_HELP}, not {shown(self.time_unit)}")
        return 1e9 / float(rate[1])

    @property
    def has_frame_numbers(self) -> bool:
        """Whether times are numbers of frames."""
        return self.time_unit is not None and self.time_unit not in TIME_UNITS_NS

    @property
    def kind(self) -> str | None:
        """The kind of rotation, a key of ``ROTATIONS``."""
        if self.euler is not None:
            return "euler"
        return "rotation_vector" if self.rotation_vector else "matrix" if self.matrix is not None else None

    @property
    def is_of_table(self) -> bool:
        """Whether anything is stated about the columns of a table."""
        return self != TableReading(field=self.field)

    def words(self) -> list[str]:
        """The options of the command line."""
        words = list[str]()
        for option in _options():
            value, name = getattr(self, option.name), f"--{option.name.replace('_', '-')}"
            if option.name == "columns" and value:
                words += [name, ",".join(f"{role}={column}" for role, column in value)]
            elif value:
                words += [name] if value is True else [name, value]
        return words

    def command(self, path: str, *words: str) -> str:
        """A command that reads a file in this way: the user's own, or else ``segment``, with this reading and
        with ``words``, an option and its value, unless the user has given this option. If poses are read from
        Python, or without a path and a command, a call."""
        if self.given[:1] == (PYTHON,) or not (path or self.given):
            values = {option.name: getattr(self, option.name) for option in _options()}
            values["columns"] = dict(self.columns)
            stated = [f"{name}={value!r}" for name, value in values.items() if value]
            topic = [f"{words[0].strip('-')}={words[1]!r}"] if words else []
            call = f"contact_tracker.read({path!r}" if path else "Trajectory.from_dataframe(table"
            return f"{', '.join([call, *self.given[1:], *topic, *stated])})"
        has_option = any(word.partition("=")[0] in words[:1] for word in self.given)
        added = [] if has_option else words
        verb, *typed = self.given or ("segment", path)
        place = typed.index("--") if "--" in typed else len(typed)  # all later words are files
        return shlex.join(["contact-tracker", verb, *typed[:place], *added, *self.words(), *typed[place:]])

    def with_(self, reading: "TableReading") -> "TableReading":
        """This reading, with the statements of ``reading`` added or in place of its own."""
        stated = {f.name: value for f in _options() if (value := getattr(reading, f.name))}
        stated["given"] = reading.given or self.given
        if reading.euler and ":" not in reading.euler and self.euler and ":" in self.euler:
            stated["euler"] = f"{reading.euler}:{self.euler.partition(':')[2]}"
        if reading.columns:
            stated["columns"] = tuple({**dict(self.columns), **dict(reading.columns)}.items())
        base = replace(self, euler=None, rotation_vector=False, matrix=None) if reading.kind else self
        return replace(base, **stated)


def _options() -> "list[Field[Any]]":
    return [option for option in fields(TableReading) if option.compare]


AS_NAMED: Final = TableReading()


def reading_of(
    columns: Mapping[str, str] | str | None = None, rate: Any = None, **stated: Any
) -> TableReading:
    """The reading that arguments in Python, or values of options, state; raises ValueError.

    ``rate``: rate of frame numbers (Hz); 200 is the ``time_unit`` ``200Hz``.
    """
    if rate is not None:
        if stated.get("time_unit") not in (None, FRAMES):
            raise ValueError(f"rate is for time_unit={FRAMES!r}, not {shown(stated['time_unit'])}")
        stated["time_unit"] = f"{rate if isinstance(rate, str) else shown(rate)}Hz"
    if isinstance(columns, str):
        parts = [part.partition("=") for part in columns.split(",") if part.strip()]
        if not all(equals and name.strip() for _, equals, name in parts):
            raise ValueError(f"columns are given as time=t,x=px, not {shown(columns)}")
        columns = {role.strip(): name.strip() for role, _, name in parts}
    if columns is not None and not isinstance(columns, Mapping):
        raise ValueError(f"columns are names by role, as {{'time': 't'}}, not {shown(columns)}")
    pairs = tuple((str(role), str(name)) for role, name in (columns or {}).items())
    return TableReading(columns=pairs, **stated)
