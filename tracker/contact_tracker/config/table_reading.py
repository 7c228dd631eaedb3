"""How poses are read where names and types do not say it: what users state of columns and of fields."""

import re
import shlex
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any, Final

from contact_tracker.config.quantities import LENGTHS, TIMES_NS

POSITION: Final = ("x", "y", "z")
QUATERNION: Final = ("qx", "qy", "qz", "qw")
ANGLES: Final = ("rx", "ry", "rz")
MATRIX: Final = tuple(f"r{row}{column}" for row in "123" for column in "123")
TIME, REST = "time", "nanoseconds"
"""The roles of a time, and of the nanoseconds of its second where these have a column of their own."""
GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "position": POSITION,
    "quaternion": QUATERNION,
    "wxyz": ("qw", "qx", "qy", "qz"),
    "rotation": ANGLES,
    "matrix": MATRIX,
}
"""Roles of numbered columns, or of the values of a list, by a name for all of them."""
ANGLE: Final = "angle"
"""The role of the angle of a rotation vector whose other columns are a unit vector."""
ROLES: Final = (TIME, REST, *POSITION, *QUATERNION, *ANGLES, *MATRIX, ANGLE)
TICK, DAY = "100ns", "days"
TIME_UNITS_NS: Final[Mapping[str, int]] = TIMES_NS | {TICK: 100, DAY: 86_400 * 10**9}
_RATE: Final = re.compile(r"([0-9]+(?:\.[0-9]+)?) ?Hz", re.IGNORECASE)
_EULER: Final = re.compile(r"([xyz]{3}|[XYZ]{3})(?::(deg|rad))?")
_FIELD: Final = re.compile(r"\.|[A-Za-z]\w*(\[\d+\])?(\.[A-Za-z]\w*(\[\d+\])?)*")
PYTHON: Final = "python"
"""Stands for the word of a command where poses are read from Python; other words are arguments then."""
NO_TABLE: Final = "it is no table: leave out --unit, --time-unit and what else is said of columns"
FRAMES: Final = "frames"
"""What times are called that are numbers of frames, beside their rate."""
TIME_UNIT_HELP: Final = "s, ms, us, ns, 100ns, days, or the rate of frame numbers, as 200Hz"


@dataclass(frozen=True)
class TableReading:
    """What the columns of a table are, and where poses are in messages; None where names and types say it.

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
        message itself. A table has none.
    given : the words of the user's command without those of this reading, or the arguments from Python after
        ``PYTHON``, for commands and calls that are proposed; empty where there are none.

    Raises
    ------
    ValueError
        A value is none of these.
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
                raise ValueError(f"{name} is text, not {value!r}")
        if self.unit is not None and self.unit not in LENGTHS:
            meant = f"; a time has time_unit={self.unit!r}" if self.unit in TIME_UNITS_NS else ""
            raise ValueError(f"unit is {', '.join(LENGTHS)}, not {self.unit!r}{meant}")
        if self.time_unit is not None:
            _ = self.time_ns
        if self.euler is not None and not _EULER.fullmatch(self.euler):
            letters = "three of the letters xyz or XYZ, then :deg or :rad, as in XYZ:deg"
            raise ValueError(f"euler is {letters}, not {self.euler!r}")
        if self.matrix not in (None, "rows", "columns"):
            raise ValueError(f"matrix is rows or columns, not {self.matrix!r}")
        if self.field is not None and not _FIELD.fullmatch(self.field):
            raise ValueError(f"field is names of fields, as in tracked.pose, not {self.field!r}")
        for role, _ in self.columns:
            if role not in ROLES and role not in GROUPS:
                raise ValueError(f"a column is {', '.join((*ROLES[:9], *ANGLES, *GROUPS))}, not {role!r}")
        if sum((self.euler is not None, self.rotation_vector, self.matrix is not None)) > 1:
            raise ValueError("a rotation is one of Euler angles, a rotation vector and a matrix")

    @property
    def time_ns(self) -> float | None:
        """The unit of times in nanoseconds."""
        if self.time_unit is None or self.time_unit in TIME_UNITS_NS:
            return None if self.time_unit is None else TIME_UNITS_NS[self.time_unit]
        rate = _RATE.fullmatch(self.time_unit)
        if rate is None or not 1e-3 <= float(rate[1]) <= 1e6:
            raise ValueError(f"time_unit is {TIME_UNIT_HELP}, not {self.time_unit!r}")
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
        """Whether it says something of the columns of a table."""
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
        """A whole command that reads a file in this way: the user's own, or else ``segment``, with this
        reading, and with an option and its value as ``words`` where the user has not given that; from Python,
        or without a path and a command, the call."""
        if self.given[:1] == (PYTHON,) or not (path or self.given):
            own = {option.name: getattr(self, option.name) for option in _options()}
            own["columns"] = dict(self.columns)
            given = [f"{name}={value!r}" for name, value in own.items() if value]
            topic = [f"{words[0].strip('-')}={words[1]!r}"] if words else []
            call = f"contact_tracker.read({path!r}" if path else "Trajectory.from_dataframe(table"
            return f"{', '.join([call, *self.given[1:], *topic, *given])})"
        has_option = any(word.partition("=")[0] in words[:1] for word in self.given)
        more = [] if has_option else words
        verb, *rest = self.given or ("segment", path)
        place = rest.index("--") if "--" in rest else len(rest)  # after it all words are files
        return shlex.join(["contact-tracker", verb, *rest[:place], *more, *self.words(), *rest[place:]])

    def with_(self, other: "TableReading") -> "TableReading":
        """This reading, with what another one states in addition or instead."""
        stated = {f.name: value for f in _options() if (value := getattr(other, f.name))}
        stated["given"] = other.given or self.given
        if other.columns:
            stated["columns"] = tuple({**dict(self.columns), **dict(other.columns)}.items())
        own = replace(self, euler=None, rotation_vector=False, matrix=None) if other.kind else self
        return replace(own, **stated)


def _options() -> "list[Field[Any]]":
    return [option for option in fields(TableReading) if option.compare]


AS_NAMED: Final = TableReading()


def reading_of(
    columns: Mapping[str, str] | str | None = None, rate: Any = None, **stated: Any
) -> TableReading:
    """A reading by the arguments of Python, or the values of options; raises ValueError.

    ``rate`` is that of frame numbers (Hz): 200 is the ``time_unit`` ``200Hz``.
    """
    if rate is not None:
        if stated.get("time_unit") not in (None, FRAMES):
            raise ValueError(f"rate is for time_unit={FRAMES!r}, not {stated['time_unit']!r}")
        stated["time_unit"] = f"{rate}Hz"
    if isinstance(columns, str):
        parts = [part.partition("=") for part in columns.split(",") if part.strip()]
        if not all(equals and name.strip() for _, equals, name in parts):
            raise ValueError(f"columns are given as time=t,x=px, not {columns!r}")
        columns = {role.strip(): name.strip() for role, _, name in parts}
    if columns is not None and not isinstance(columns, Mapping):
        raise ValueError(f"columns are names by role, as {{'time': 't'}}, not {columns!r}")
    pairs = tuple((str(role), str(name)) for role, name in (columns or {}).items())
    return TableReading(columns=pairs, **stated)
