"""Layouts of poses in tables: roles, units and rotations of columns, from their names or stated by users."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import chain, groupby
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.config.quantities import ANGLE_UNITS, LENGTHS_M, NAMED_NS, TIMES_NS
from contact_tracker.config.table_reading import (
    ANGLE,
    ANGLES,
    GROUPS,
    MATRIX,
    POSITION,
    QUATERNION,
    REST,
    TIME,
    TableReading,
)
from contact_tracker.errors import ChoiceError, UnreadableRecording
from contact_tracker.geometry.linalg import from_rotation_vectors
from contact_tracker.suggestions import suggestion

FirstRows = Callable[[], Sequence[Sequence[str]]]
"""Gives the first rows of a table."""
_PLAUSIBLE: Final = 0.1
"""Largest deviation from 1 of a rotation's determinant and of an axis's length."""
LOST_DEG: Final = 999.0
"""Least number in columns of angles that stands for a lost pose."""


def _from_euler(angles: Array, how: str) -> Array:
    order, _, unit = how.partition(":")
    if len(set(order)) == 3:  # by axis, else by place
        angles = angles[:, ["xyz".index(letter) for letter in order.lower()]]
    return np.asarray(Rotation.from_euler(order, angles, degrees=unit == "deg").as_quat())


def _from_vectors(vectors: Array, unit: str) -> Array:
    return from_rotation_vectors(np.radians(vectors) if unit == "deg" else vectors)


def _from_axes(values: Array, unit: str) -> Array:
    """Quaternions of unit vectors and angles; zero for an axis of another length with an angle."""
    axes, angles = values[:, :3], values[:, 3:]
    is_axis = np.abs(np.linalg.norm(axes, axis=1) - 1.0) < _PLAUSIBLE
    return np.where(is_axis[:, None] | (angles == 0.0), _from_vectors(axes * angles, unit), 0.0)


def _from_matrices(rows: Array, _: str) -> Array:
    """Quaternions of the rotations nearest to matrices; for other matrices zero, which the pose gate
    counts."""
    matrices = rows.reshape(-1, 3, 3)
    is_rotation = np.abs(np.linalg.det(matrices) - 1.0) < _PLAUSIBLE
    near = Rotation.from_matrix(np.where(is_rotation[:, None, None], matrices, np.eye(3))).as_quat()
    return np.where(is_rotation[:, None], near, 0.0)


ROTATIONS: Final[Mapping[str, tuple[tuple[str, ...], Callable[[Array, str], Array]]]] = {
    "quaternion": (QUATERNION, lambda values, _: values),
    "euler": (ANGLES, _from_euler),
    "rotation_vector": (ANGLES, _from_vectors),
    "axis_angle": ((*ANGLES, ANGLE), _from_axes),
    "matrix": (MATRIX, _from_matrices),
}
"""Kinds of rotation: the roles of their columns, and the function from their values (N, k) and their
convention (order and unit) to quaternions ``xyzw``."""


def quaternions(kind: str, values: Array, how: str) -> Array:
    """Quaternions (N, 4) ``xyzw`` of rotations of a kind; NaN if a value is not finite, or all stand for a
    lost pose."""
    are_alike = (values == values[:, :1]).all(axis=1)
    is_finite = np.isfinite(values).all(axis=1) & ~(are_alike & (np.abs(values[:, 0]) >= LOST_DEG))
    quats = np.full((len(values), 4), np.nan)
    if is_finite.any():
        quats[is_finite] = ROTATIONS[kind][1](values[is_finite], how)
    return quats


BLANKS: Final = '" \t\r\n'
"""Characters that may surround a value in its cell."""
DIGITS_OF_STAMP: Final = 10
"""Number of digits of the seconds since 1970; finer units have more."""
LONGEST_CELL: Final = 64
"""Length (characters) to which texts are cut: of cells in long lines, and in messages."""
SEPARATORS: Final = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars", " ": "blanks"}
"""Characters that separate values, and their names in messages."""


_EXPONENT: Final = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d+$)")
_MARKS: Final = {0x2212: "-", **dict.fromkeys(map(ord, "'\u2019\u00a0\u202f"))}
"""Characters in numbers that Python does not read: a minus sign, and marks of thousands, not kept."""
_THOUSANDS: Final = re.compile(r"[+-]?\d{1,3}(?:(?:,\d{3})+\.\d*|(?:\.\d{3})+,\d*)")


def plain_number(value: str) -> str:
    """The number in a cell in the notation of Python; the cell may have quotes, a decimal comma, marks of
    thousands, an exponent of Fortran, or a minus sign of typesetting."""
    plain = value.strip(BLANKS).translate(_MARKS)
    if _THOUSANDS.fullmatch(plain):
        plain = re.sub("[.,](?=.*[.,])", "", plain)
    return _EXPONENT.sub("e", plain.replace(",", "."))


def number(value: str) -> float:
    """The number in a cell; raises ValueError."""
    if "_" in value:  # which Python reads, as in 20260301_100000
        raise ValueError(f"{value} is no number")
    try:
        return float(value)
    except ValueError:
        return float(plain_number(value))


def _number_or_nan(value: str) -> float:
    try:
        return number(value)
    except ValueError:
        return np.nan


def numbers(cells: Sequence[str]) -> Array:
    """The numbers in cells; NaN for other text."""
    with suppress(ValueError):
        if "_" not in "".join(cells):
            return np.array(list(map(float, cells)), np.float64)
    return np.array(list(map(_number_or_nan, cells)), np.float64)


def are_numbers(values: Sequence[str]) -> bool:
    """Whether values are numbers and empty cells, with at least one number."""
    filled = [value for value in values if value.strip(BLANKS)]
    try:
        return bool(list(map(number, filled)))
    except ValueError:
        return False


class OpenReading(UnreadableRecording):
    """The convention of a rotation is ambiguous; the message has the names of its columns."""


class ProposedReading(UnreadableRecording):
    """The meaning of the columns is ambiguous; the message has the commands that read them."""


@dataclass(frozen=True)
class Body:
    """A rigid body: indices of the columns of its position and rotation, and how these are meant.

    Parameters
    ----------
    metres : factor of the position.
    kind : kind of the rotation, a key of ``ROTATIONS``.
    how : convention of the rotation: order and unit of angles.
    has_unit : whether the unit of the position is stated, by the user, the columns or the format.
    has_angle_unit : whether the names of columns state the unit of the angles.
    """

    name: str
    columns: tuple[int, ...]
    metres: float
    kind: str = "quaternion"
    how: str = ""
    has_unit: bool = False
    has_angle_unit: bool = False

    @property
    def assumed_angles(self) -> str:
        """The unit of angles, ``deg`` or ``rad``, if the names of columns do not state it; else empty."""
        is_assumed = self.kind in ("euler", "rotation_vector") and not self.has_angle_unit
        return self.how.rpartition(":")[2] if is_assumed else ""

    def poses(self, values: Array) -> Array:
        """Positions (m) and quaternions ``xyzw`` (N, 7) of the values of its columns (N, k)."""
        return np.hstack([values[:, :3] * self.metres, quaternions(self.kind, values[:, 3:], self.how)])


@dataclass(frozen=True)
class TableLayout:
    """Layout of poses in a table.

    Parameters
    ----------
    time : index of the time column; -1 if rows are numbered instead.
    time_ns : unit of the time in nanoseconds; None if it has to be guessed from the values.
    kind : description of the format.
    separator : separator of the values in a line; None for white space.
    skip : lines before the first row.
    rest : index of a column with the fraction of the second, in units of ``rest_ns``.
    has_own_unit : whether the format itself defines the unit of its times.
    names : names of the values in JSON lines, or in cells with several values, whose columns are ``heads``.
    turn : names of the columns of the only body's quaternion or angles, if users can state other columns.
    has_angles : whether the names of columns say that rotations are angles.
    note : one line on what is not read, or empty.
    body : index of the column with the name of the body of each row; None if all are of one.
    first_body : name of the body of the first rows, which others may follow (``begin_body``), or empty if
        the column may tell something else of them; None if the first rows are of several bodies.
    """

    time: int
    time_ns: float | None
    bodies: tuple[Body, ...]
    kind: str = "table"
    separator: str | None = None
    skip: int = 0
    rest: int | None = None
    rest_ns: float = 1.0
    has_own_unit: bool = False
    names: tuple[str, ...] = ()
    heads: tuple[str, ...] = ()
    turn: tuple[str, ...] = ()
    has_angles: bool = False
    note: str = ""
    body: int | None = None
    first_body: str | None = None

    @property
    def places(self) -> list[int]:
        """Indices of the columns that are read, the time first."""
        return list(dict.fromkeys([*self.texts, *(place for body in self.bodies for place in body.columns)]))

    @property
    def texts(self) -> list[int]:
        """Indices of the columns that are read as text: times and names of bodies."""
        return [place for place in (self.time, self.rest, self.body) if place is not None and place >= 0]


def bodies_of(
    by_body: Mapping[str, Mapping[str, int]],
    columns: Sequence[tuple[str, str]],
    reading: TableReading,
    unit: str = "",
) -> tuple[Body, ...]:
    """The bodies with a position and a rotation.

    Parameters
    ----------
    by_body : indices of columns by body and role.
    columns : name and unit of each column; if it is empty, ``unit`` is the unit of positions.

    Raises OpenReading if it is not known what the rotation of a body is, or the unit of its angles,
    ChoiceError if all rotations are of another kind than stated, and UnreadableRecording if a unit is
    unknown, or the units of x, y and z differ.
    """
    bodies, open_names, other = list[Body](), list[str](), ""
    for name, places in by_body.items():
        kinds = [kind for kind, (roles, _) in ROTATIONS.items() if places.keys() >= set(roles)]
        if not kinds or not places.keys() >= set(POSITION):
            continue
        kind = reading.kind or "quaternion"
        if kind == "rotation_vector" and "axis_angle" in kinds:
            kind = "axis_angle"
        if kind not in kinds:
            names = [columns[places[role]][0] for role in ROTATIONS[kinds[0]][0]]
            if reading.kind is None:
                open_names = open_names or names
            else:
                other = other or _of_another_kind(reading, kinds[0], names)
            continue
        roles, _ = ROTATIONS[kind]
        named = [columns[places[role]] for role in POSITION]
        position = [(label, (reading.unit or column_unit or unit).lower()) for label, column_unit in named]
        for (label, of_label), (_, column_unit) in zip(position, named, strict=True):
            if LENGTHS_M.get(column_unit.lower()) not in (None, LENGTHS_M.get(of_label)):
                raise UnreadableRecording(_contradicted(label, column_unit, of_label))
            if of_label and of_label not in LENGTHS_M:
                raise UnreadableRecording(_unknown_unit(of_label, label, "m, cm, mm, um"))
        metres, *differing = {LENGTHS_M.get(of_label, 1.0) for _, of_label in position}
        if differing:
            labels = ", ".join(label for label, _ in named)
            raise UnreadableRecording(f"the units of the columns {labels} differ: give all three in one")
        of_angles = [columns[places[role]] for role in roles[3:] or roles]
        how, has_angle_unit = _how(reading, of_angles), all(unit in ANGLE_UNITS for _, unit in of_angles)
        own_places = tuple(places[role] for role in (*POSITION, *roles))
        has_unit = all(reading.unit or column_unit or unit for _, column_unit in named)
        bodies.append(Body(name, own_places, metres, kind, how, has_unit, has_angle_unit))
    if open_names and not bodies:
        raise OpenReading(", ".join(open_names[:3]))
    if other and not bodies:
        raise ChoiceError(other)
    return tuple(bodies)


def _of_another_kind(reading: TableReading, kind: str, names: Sequence[str]) -> str:
    """What to do if the columns with these names are a rotation of another ``kind`` than stated."""
    stated = next(word for word in reading.words() if word in ("--euler", "--rotation-vector", "--matrix"))
    is_what = {"quaternion": "a quaternion", "matrix": "a matrix"}.get(kind, "angles or a vector")
    instead = {"quaternion": "", "matrix": "--matrix rows"}.get(kind, "--euler XYZ:deg or --rotation-vector")
    remedy = f"give {instead} instead of {stated}" if instead else f"leave out {stated}, which is not needed"
    return f"its rotation is {is_what} ({listed_briefly(names)}): {remedy}"


def _how(reading: TableReading, columns: Sequence[tuple[str, str]]) -> str:
    """Order and unit of angles: as stated, else by the names; rotation vectors are usually in radians."""
    units = {ANGLE_UNITS.get(unit, "") for _, unit in columns}
    if reading.euler is None:
        return "deg" if units == {"deg"} else "rad"
    if ":" in reading.euler:
        for name, unit in columns:
            if not reading.euler.endswith(ANGLE_UNITS.get(unit, "")):
                raise UnreadableRecording(_contradicted(name, unit, reading.euler.partition(":")[2]))
        return reading.euler
    if len(units) > 1 or "" in units:
        raise OpenReading(", ".join(name for name, _ in columns[:3]))
    return f"{reading.euler}:{units.pop()}"


def _contradicted(name: str, unit: str, stated: str) -> str:
    return f"column '{name.strip()}' states the unit {unit}, not {stated}: give none, or correct its name"


def _unknown_unit(unit: str, name: str, choices: str) -> str:
    return f"the unit '{unit}' of column '{name.strip()}' is not known: {choices}"


_WORDS: Final = (
    "mm|cm|[u\u00b5\u03bc]m|ms|us|ns|deg|rad|\u00b0"
    "|(?:milli|centi|micro)?met(?:er|re)s?|inch(?:es)?|degrees?|radians?"
)
_UNIT: Final = re.compile(
    rf"[\s_]*(?:[\[(](?!\d+\])([^\])]*)[\])]|[{{<]([^}}>]*)[}}>])\s*$|_({_WORDS}|m|s)$"
    rf"|(?:(?<=\w)\s*[/:]\s*|\s+in\s+)({_WORDS}|m|s)$|(?:\s|(?<=(?<![^\W_])[xyz]))({_WORDS})$"
)
"""A unit in brackets (which do not contain the number of an element), or after a mark: ``x_mm``, ``x/mm``."""
_LEVELS: Final = re.compile(r"^\('|', '|'\)$")
"""What is around the levels of a name of pandas, as in ``('pos', 'x')``."""
_CAMEL: Final = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z]{2})|(?<=[A-Z]{2})(?=[xyzw]$)")
"""Places at which a name in capitals and small letters is divided: ``posX``, ``HMDPosition``, ``POSx``."""
_TIME: Final = re.compile(r"(?:.*[./ ])?(?:rosbag)?_*(?:t|time|times|time_?stamp|stamp)")
_ELAPSED: Final = re.compile(r"(.*[./ _])?(?:elapsed|elapsed_?time|secs?|seconds)")
"""Names of a time if no other column is one."""
_REST: Final = re.compile(r"(.*[./ _])?(nano|n|micro|u|milli|m)_?sec(?:s|onds)?")
_REST_NS: Final = {"n": 1.0, "nano": 1.0, "u": 1e3, "micro": 1e3, "m": 1e6, "milli": 1e6}
FRAME: Final = re.compile(r"(?:.*[./ ])?(?:frame|frame_?(?:number|no|nr|index|idx|#)|sample)")
_CLOCKS: Final = frozenset({"", "unix", "utc", "epoch", "posix"})
"""Texts in brackets after a time that leave its unit open."""
_BODY: Final = r"(.*?)[._/: -]*"
_AFTER: Final = re.compile(
    r"(?:(?P<turn>q)|[pt]?)(?P<axis>(?(turn)[xyzw]|[xyz]))(?:[._/: -]+|(?=\d+$))(?P<body>.+)"
)
"""A role before the name or number of the body, as in ``qx_world_device`` and ``qx1``."""
_FRAMED: Final = re.compile(r"(?:(?P<turn>q)|t)_(?P<body>\w+)_(?P<axis>[wxyz])")
"""The frames of a transform between the parts of a role, as in ``t_wo_x`` and ``q_wo_x``."""
_NO_POSE: Final = re.compile(
    r"(?:.*[._/: -])?(?:std|stdev|sd|sigma|var|cov|err|error|vel|dot|acc|ref|cmd|des)"
)
"""Names after roles of deviations, derivatives and commanded poses."""
_RATE: Final = re.compile(r"(?:.*[._/: -])?(?:(?:lin|ang|free)?(?:acc|vel|gyr|mag)[a-z]*|[avw])")
"""Names of vectors that are no positions, though their columns end with x, y and z."""
_MARK_RUN: Final = re.compile(r"([._/: -])[._/: -]+")
_OF_ROTATION: Final = r"(?<![a-z])(?:(?:rotation|orientation|rot|ori)[._/: -]*)?"
"""Begins names such as ``rotation_euler_x``."""
_TURNS: Final = {
    **dict.fromkeys(("roll", "bank"), "x"),
    **dict.fromkeys(("pitch", "elevation"), "y"),
    **dict.fromkeys(("yaw", "heading", "azimuth"), "z"),
}
_AXES: Final = {"i": "x", "j": "y", "k": "z", "r": "w", "real": "w", **_TURNS}
_ROLES: Final[Sequence[tuple[re.Pattern[str], str]]] = tuple(
    (re.compile(_BODY + pattern), role)
    for pattern, role in (
        (
            rf"{_OF_ROTATION}(?:q|x?quat|quaternion|orientation|orient|ori|orn|rotation|rot|q_\w+)"
            r"[._/: -]*([xyzwijk]|r|real)",
            "q{0}",
        ),
        (r"(?<![a-z])[pt]([xyz])", "{0}"),
        (
            r"(?:(?<![a-z])(?:p|t|x?pos|position|trans(?:l|late|lation)?|tvec|loc|location|p_\w+)[._/: -]*)?"
            r"(?<![a-z])([xyz])",
            "{0}",
        ),
        (r"(?<![a-z])(?:q|quat)[._/: -]*0", "qw"),
        (rf"{_OF_ROTATION}({'|'.join(_TURNS)})", "r{0}"),
        (
            rf"{_OF_ROTATION}(?:r|rot|rotat(?:e|ion)|euler|(?:euler_?)?angles?|theta|rotvec|rvec|axis_?angle|(?:rot_?)?axis|o)"
            r"[._/: -]*([xyzw])",
            "r{0}",
        ),
        (r"(?<![a-z])(?:rot_?)?(?:angle|theta)", ANGLE),
        (r"(?<![a-z])(?:rot_?)?(?:r|rot|m|t)_?([123])_?([123])", "r{0}{1}"),
    )
)
"""Patterns of column names in lower case, after the name of the body, and their roles; only one of the first
three applies, and ``rotation_x`` may also be an angle."""
NUMBERED: Final = re.compile(r"(.*?)[\[_.]?(\d{1,4})\]?")
BY_ROW: Final = re.compile(r"(.*?)[\[_.](\d{1,2})\]?[\[_.](\d{1,2})\]?")
"""Numbers of the elements of a list, and of the rows and columns of a matrix, as in ``T_0_3``."""
_SLICE: Final = re.compile(r"(.*)\[(\d{1,4})(?::(\d{1,4}))?\]")
_GENERIC: Final = {"", "pose", "field", "transform", "data", "msg", "message", "state"}
MATRIX_SHAPES: Final = {9: (3, 3), 12: (3, 4), 16: (4, 4)}
NEEDED: Final = "a time, x, y, z in metres, and qx, qy, qz, qw"
_EXAMPLE: Final = "time [s],x [{0}],y [{0}],z [{0}],qx,qy,qz,qw"
_SHOWN: Final = 12
MOST_COLUMNS: Final = 5000
_NAMED_ANGLES: Final = re.compile("|".join((*_TURNS, "euler", "angle", "rpy")), re.IGNORECASE)
NAMED_VECTOR: Final = re.compile("rvec|rot_?vec|axis_?angle", re.IGNORECASE)
"""Names of columns of angles, and of a rotation vector."""
CAN_BE_GIVEN: Final = re.compile(r"[^,=]+").fullmatch
"""Whether ``--columns`` can state a name."""
NO_FRAMES: Final = (
    "not numbers of frames: leave out the rate, or name the frames' column by --columns time=frame"
)
UNNAMED: Final = "c"
"""Columns without names are ``c0``, ``c1``, ..."""
POSE_ROLES: Final = (*POSITION, *QUATERNION)


class Columns:
    """The columns of a table: names as written, ``plain`` names in lower case without units, and the
    units; ``rows`` gives the first rows."""

    def __init__(self, names: Sequence[str], units: Sequence[str] = (), rows: FirstRows = tuple) -> None:
        self.rows = cache(rows)
        self.names = [name.strip()[: 4 * LONGEST_CELL] for name in names]
        whole = (_LEVELS.sub(lambda mark: "." * (len(mark[0]) > 2), name) for name in self.names)
        self.plain = [_CAMEL.sub("_", name.lstrip("#").strip().rstrip(".")).lower() for name in whole]
        self.units = [*units, *[""] * len(names)][: len(names)]
        for place, plain in enumerate(self.plain):
            if (unit := _UNIT.search(plain)) is not None:
                self.plain[place] = plain[: unit.start()]
                self.units[place] = next(filter(None, unit.groups()), "").strip() or self.units[place]

    def values(self, places: Sequence[int]) -> Array:
        """The numbers (N, k) of the first rows in columns."""
        rows = (row for row in self.rows() if len(row) > max(places, default=0))
        return np.array([numbers([row[i] for i in places]) for row in rows]).reshape(-1, len(places))

    def cells(self, place: int) -> list[str]:
        """The cells of the first rows in a column, without blank ones."""
        return [row[place] for row in self.rows() if len(row) > place and row[place].strip(BLANKS)]

    def numbered(self, base: str) -> dict[int, int]:
        """Indices of the columns ``base[0]``, ``base_1``, ... by their number, and of ``base[0][0]``, ... row
        by row."""
        places = dict[tuple[int, ...], int]()
        for pattern in (NUMBERED, BY_ROW):
            for place, name in enumerate(self.names if not places else ()):
                match = pattern.fullmatch(name)
                if match is not None and match[1].lower() == base.lower():
                    places.setdefault(tuple(map(int, match.groups()[1:])), place)
        ordered = sorted(places.items())
        return {key[0] if len(key) == 1 else i: place for i, (key, place) in enumerate(ordered)}

    def places(self, name: str, is_group: bool) -> list[int]:
        """Indices of a column as users name it, or of a group of numbered ones: ``name`` or ``name[3:7]``;
        raises ChoiceError."""
        lower = name.lower()
        by_lower = [*map(str.lower, self.names)]
        for names, key in ((self.names, name), (by_lower, lower), (self.plain, lower)):
            if not is_group and key in names:
                return [names.index(key)]
        part = _SLICE.fullmatch(name)
        if part is not None and (part[3] is not None) == is_group:
            begin = int(part[2])
            numbered = self.numbered(part[1])
            wanted_numbers = range(begin, int(part[3] or begin + 1))
            if all(number in numbered for number in wanted_numbers):
                return [numbered[number] for number in wanted_numbers]
        elif is_group and (numbered := self.numbered(name)):
            return list(numbered.values())
        group = f"s {name}" if part is not None else f"s {name}[0], {name}[1], ..."
        missing = group if is_group else f" {name!r}"
        raise ChoiceError(
            f"no column{missing}{suggestion(name, self.names) or f'; there are {listed_briefly(self.names)}'}"
        )

    def find(self, reading: TableReading) -> dict[str, dict[str, int]]:
        """Indices of columns by body and role, as the reading states or by their names."""
        stated = dict(chain.from_iterable(self._stated(*column, reading) for column in reading.columns))
        by_body: dict[str, dict[str, int]] = {}
        # angles may have the names of a quaternion's parts, ``orient_x``, but not ``qx`` or ``quat_x``
        for place, name in sorted(enumerate(self.plain), key=lambda column: "q" not in column[1]):
            if place not in stated.values():
                for body, role in _roles(name, reading.matrix == "columns"):
                    by_body.setdefault(body, {}).setdefault(role, place)
        for roles in by_body.values():
            if roles.keys() >= {*ANGLES, "rw"} and not roles.keys() & {*QUATERNION}:
                roles |= {f"q{role[1]}": roles.pop(role) for role in (*ANGLES, "rw")}
        if not stated.keys() & {*POSE_ROLES}:
            self._add_with_frames(by_body)
        times = {role: stated.pop(role) for role in (TIME, REST) if role in stated}
        if stated:  # for the body without a name, or else the one with most columns
            main = "" if _is_pose(stated) else self._main(by_body, stated.values())
            by_body = {main: {**by_body.get(main, {}), **stated}}
        return {**by_body, TIME: times}

    def _main(self, by_body: Mapping[str, Mapping[str, int]], stated: Iterable[int]) -> str:
        """The body to which stated columns belong: one with a position whose name most of them begin with,
        else that without a name, or the one with most columns."""
        names = [_body(f"{self.plain[place]} ") for place in stated]

        def rank(body: str) -> tuple[int, bool, int]:
            shared = sum(bool(body) and name.startswith(body) for name in names)
            return shared * (by_body[body].keys() >= {*POSITION}), not body, len(by_body[body])

        bodies = (body for body in by_body if rank(body)[0] or not _RATE.fullmatch(body))
        return max(bodies, key=rank, default="")

    def _add_with_frames(self, by_body: dict[str, dict[str, int]]) -> None:
        """Add the columns with frames in their names: after the parts if no body has a position so far
        (``tx_world_device``), and between them if none has a pose (``t_wo_x``)."""
        for pattern, is_enough in ((_AFTER, lambda roles: roles.keys() >= {*POSITION}), (_FRAMED, _is_pose)):
            for place, name in enumerate(() if any(map(is_enough, by_body.values())) else self.plain):
                if (match := pattern.fullmatch(name)) is not None and not _NO_POSE.fullmatch(match["body"]):
                    role = (match["turn"] or "") + match["axis"]
                    by_body.setdefault(_body(match["body"]), {}).setdefault(role, place)

    def _stated(self, role: str, name: str, reading: TableReading) -> list[tuple[str, int]]:
        places = self.places(name, role in GROUPS)
        if role not in GROUPS:
            return [(role, places[0])]
        if role != "matrix":
            size, part = len(GROUPS[role]), f"{name.partition('[')[0]}[0:{len(GROUPS[role])}]"
            if len(places) != size:
                raise ChoiceError(f"{role} is {size} columns, as {part}, and {name} has {len(places)}")
            return list(zip(GROUPS[role], places, strict=True))
        if len(places) not in MATRIX_SHAPES:
            raise ChoiceError(f"a matrix has 9, 12 or 16 values, and {name} {len(places)}")
        shape = MATRIX_SHAPES[len(places)]
        order: Any = "F" if reading.matrix == "columns" else "C"
        values = np.reshape(places, shape, order=order)[:3].tolist()
        rotation = [(f"r{i + 1}{j + 1}", row[j]) for i, row in enumerate(values) for j in range(3)]
        return rotation + [(POSITION[i], row[3]) for i, row in enumerate(values) if len(row) > 3]

    def time(self, reading: TableReading, times: Mapping[str, int]) -> tuple[int | None, int | None]:
        """Indices of the columns of the time and of the fraction of its second; None without one."""
        if TIME in times:
            return times[TIME], times.get(REST)
        patterns = (FRAME, _TIME, _ELAPSED) if reading.has_frame_numbers else (_TIME, _ELAPSED)
        for pattern in patterns:
            matches = [(match, i) for i, match in enumerate(map(pattern.fullmatch, self.plain)) if match]
            if matches:  # not ``wait time``, nor whole seconds beside a finer time
                match, place = min(matches, key=lambda part: (" " in part[0][0], self._is_coarse(part[1])))
                return place, self._rest(match[1]) if pattern is _ELAPSED else None
        return (-1 if reading.has_frame_numbers else None), None

    def _is_coarse(self, place: int) -> bool:
        """Whether most of the first times in a column are those before them, and in others they are not."""
        times = [i for i, plain in enumerate(self.plain) if _TIME.fullmatch(plain)]
        counts = {i: len({row[i] for row in self.rows() if len(row) > i}) for i in times[1:] and times}
        return 2 * counts.get(place, 0) < max(counts.values(), default=0)

    def _rest(self, prefix: str | None) -> int | None:
        """Index of the column with the fraction of seconds whose name has this prefix: the finest one. As
        milliseconds may be of a duration (``latency_msec``), they need the same prefix."""
        matches = [(match, i) for i, match in enumerate(map(_REST.fullmatch, self.plain)) if match]
        rests = [
            (_REST_NS[match[2]], i) for match, i in matches if match[1] == prefix or _REST_NS[match[2]] < 1e6
        ]
        return min(rests, default=(0.0, None))[1]


def _roles(plain: str, by_columns: bool) -> Iterator[tuple[str, str]]:
    """Body and role of a column; ``rotation_x`` may have two roles."""
    is_placed, plain = False, _MARK_RUN.sub(r"\1", plain)  # in long runs patterns would take long
    for i, (pattern, role) in enumerate(_ROLES):
        if (match := pattern.fullmatch(plain)) and not (i < 3 and is_placed):
            is_placed |= i < 3
            axes = [_AXES.get(axis, axis) for axis in match.groups()[1:]]
            yield _body(match[1]), role.format(*(axes[::-1] if by_columns else axes))


def _body(prefix: str) -> str:
    words = [word for word in re.split(r"[./: ]+", prefix) if word not in _GENERIC]
    return "/".join(words).strip("_-")


def layout(columns: Columns, reading: TableReading) -> TableLayout:
    """The layout of columns; raises UnreadableRecording or ChoiceError."""
    by_body = columns.find(reading)
    time, rest = columns.time(reading, by_body.pop(TIME))
    time_ns, unit = reading.time_ns, "" if time is None or time < 0 else columns.units[time].lower()
    unit_ns = NAMED_NS.get(unit)
    if time is not None and not time_ns:
        if unit not in NAMED_NS and unit not in _CLOCKS:
            raise UnreadableRecording(_unknown_unit(unit, columns.names[time], "s, ms, us, ns"))
        time_ns = NAMED_NS.get(columns.plain[time]) if unit in _CLOCKS else unit_ns
    if reading.has_frame_numbers and unit_ns not in (None, TIMES_NS["s"]):  # whole seconds may be frames
        raise ChoiceError(f"the column {columns.names[time or 0]!r} has times, {NO_FRAMES}")
    by_body = {name: {r: i for r, i in places.items() if i != time} for name, places in by_body.items()}
    bodies = bodies_of(by_body, list(zip(columns.names, columns.units, strict=True)), reading)
    if time is None or not bodies:
        best = max(by_body.values(), key=len, default=())
        raise _lacking(columns, reading, time is not None, POSE_ROLES if bodies else best)
    turn = tuple(columns.names[place] for place in bodies[0].columns[3:])
    has_angles = are_named_angles(turn)
    is_named = bodies[0].kind in ("quaternion", "euler") and all(map(CAN_BE_GIVEN, turn))
    turn = turn if is_named and len(bodies) == 1 else ()
    time_ns = 1e9 if rest is not None else time_ns
    named_rest = _REST.fullmatch(columns.plain[rest]) if rest is not None else None
    rest_ns = 1.0 if named_rest is None else _REST_NS[named_rest[2]]
    return TableLayout(time, time_ns, bodies, rest=rest, rest_ns=rest_ns, turn=turn, has_angles=has_angles)


def are_named_angles(names: Sequence[str]) -> bool:
    """Whether the names of columns say that rotations are angles."""
    return any(_NAMED_ANGLES.search(name) and not NAMED_VECTOR.search(name) for name in names)


def _is_pose(roles: Mapping[str, int]) -> bool:
    """Whether columns have a position and a rotation."""
    of_rotations = (parts for parts, _ in ROTATIONS.values())
    return roles.keys() >= {*POSITION} and any(roles.keys() >= {*parts} for parts in of_rotations)


def _lacking(
    columns: Columns, reading: TableReading, has_time: bool, roles: Collection[str]
) -> UnreadableRecording:
    """The error if the table has only columns of these ``roles``."""
    missing, names = [role for role in POSE_ROLES if role not in roles], columns.names
    if not missing:
        return UnreadableRecording(
            f"no column of times among {listed_briefly(names)}: say which it is, as in --columns time=t, or, "
            "if none is, give the rate of the rows, as in --time-unit 200Hz"
        )
    if missing == [*QUATERNION] and {"w", *POSITION} <= {*columns.plain}:
        x, y, z, w = (names[columns.plain.index(axis)] for axis in (*POSITION, "w"))
        return UnreadableRecording(
            f"its {w}, {x}, {y}, {z} look like a quaternion without a position: contacts need both; if both "
            f"are there, say so, as in --columns x=a,y=b,z=c,qx={x},qy={y},qz={z},qw={w} or, with angles "
            f"beside the position {x}, {y}, {z}, as in --columns rx=a,ry=b,rz=c --euler xyz:deg"
        )
    angles = (
        ", or --columns rx=a,ry=b,rz=c --euler xyz:deg (or --rotation-vector)"
        if missing == [*QUATERNION]
        else ""
    )
    missing = missing if has_time else ["a time", *missing]
    unit = reading.unit or next(filter(LENGTHS_M.__contains__, columns.units), "m")
    return UnreadableRecording(
        f"no columns of a pose among {listed_briefly(names)}: missing {'is' if len(missing) == 1 else 'are'} "
        f"{', '.join(missing)}: say which columns they are, as in --columns time=t,x=px{angles}, or rename "
        f"columns, as in: {_EXAMPLE.format(unit)}"
    )


def listed_briefly(names: Sequence[str]) -> str:
    """The first names as text, with the elements of a list as ``qpos[0:14]``."""

    def run(place: int) -> tuple[str, int]:
        """The name of a list and the place of its element 0; for other columns name and place."""
        part = _SLICE.fullmatch(names[place])
        if part is None or not part[1] or part[3]:
            return names[place], place
        return part[1], int(part[2]) - place

    listed = list[str]()
    for (base, begin), group in groupby(range(len(names)), run):
        first, *rest = group
        listed.append(f"{base}[{begin + first}:{begin + rest[-1] + 1}]" if rest else names[first])
    return ", ".join(listed[:_SHOWN]) + (", ..." if len(listed) > _SHOWN else "")
