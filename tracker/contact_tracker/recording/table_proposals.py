"""Layouts of tables with names and without; if the layout is ambiguous, the command that reads the table,
proposed from known systems, numbers of columns and values."""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain, islice, product, takewhile
from operator import eq
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.config.quantities import ANGLE_UNITS
from contact_tracker.config.table_reading import (
    ANGLES,
    AS_NAMED,
    GROUPS,
    MATRIX,
    POSITION,
    QUATERNION,
    REST,
    TIME,
    TableReading,
    reading_of,
)
from contact_tracker.errors import ChoiceError, UnreadableRecording
from contact_tracker.motion.pose_validation import NORM_TOLERANCE
from contact_tracker.recording.table_bodies import with_body
from contact_tracker.recording.table_layouts import (
    BY_ROW,
    CAN_BE_GIVEN,
    DIGITS_OF_STAMP,
    FRAME,
    MATRIX_SHAPES,
    MOST_COLUMNS,
    NAMED_VECTOR,
    NEEDED,
    NUMBERED,
    POSE_ROLES,
    UNNAMED,
    Columns,
    FirstRows,
    OpenReading,
    ProposedReading,
    TableLayout,
    are_named_angles,
    are_numbers,
    layout,
    numbers,
)
from contact_tracker.recording.table_times import stamp_of_date, unit_of_dates
from contact_tracker.recording.table_units import FARTHEST_M, are_no_radians, in_unit, reach_of

_LIKE_TIME: Final = re.compile(
    r".*(?:time|stamp|date|zeit|temps|tiempo|clock|ticks)|(?:.*[_ .])?(?:ts|epoch|utc)", re.IGNORECASE
)
"""Names of columns that are probably times."""
_PREFIX: Final = re.compile(r".+[._/: -]")
"""Prefix of the names of a system's columns, as ``rist_`` or ``tool.``."""
_SUFFIX: Final = re.compile(r"[^._/: -]+([._/: -].+)")
"""Suffix of the names of a system's columns, as ``_rist``."""
_COMMANDED: Final = re.compile(
    r"(?<![^\W_])(?i:r?sol|ref(?:erence)?|cmd|command(?:ed)?|des(?:ired)?|set(?:_?points?)?|target|goal|nominal"
    r"|plan(?:ned)?)(?![a-z])"
)
"""Names of poses that a robot was to have, which are proposed after those that it had."""
_MOST_GROUPS: Final = 12
"""Largest number of groups of numbered columns that are tried, alone and in pairs, and of prefixes."""
_NO_POSES: Final = re.compile(r"(?i:joint|vel|acc|force|torque|wrench|gripper|cov|action)")
"""Groups of columns that are no poses, whatever their values."""
_OF_JOINTS: Final = re.compile("position|velocity|effort")
"""Groups of columns beside those of efforts, as in JointState."""
_FEW_STEPS: Final = 2
"""Number of steps in which columns of other things than a time also rise."""
_A_RATE: Final = "100Hz"
_ORDERS: Final = (
    "Orders are those of scipy: xyz about fixed axes, XYZ about the body's; deg or rad; rx, ry, rz (or "
    "rotation) are the columns of the angles about x, y, z"
)
_UNIT_NORM: Final = 0.002
"""Largest deviation of a quaternion's norm from 1, and of a matrix from a rotation, in rounded values."""
FIRST_ROWS: Final = 64
"""Number of first rows whose values may be looked at."""
_AXIS_ANGLE: Final = "an axis and an angle (in degrees if the name ends with _deg)"
_NAMED_ORDERS: Final = {
    re.compile(r".*_o[xyz]\b", re.IGNORECASE): "XYZ",  # OpenSim
    re.compile(r".*euler_?angles", re.IGNORECASE): "zxy",  # Unity
}
"""Orders of angles by the names of their columns."""
KNOWN: Final[Sequence[tuple[str, tuple[str, ...], TableReading]]] = (
    (
        "UR's RTDE",
        ("actual_tcp_pose[0]", "actual_tcp_pose[5]"),
        reading_of("position=actual_TCP_pose[0:3],rotation=actual_TCP_pose[3:6]", rotation_vector=True),
    ),
    ("Qualisys", ("x", "rot[0]", "rot[8]"), reading_of("matrix=Rot", matrix="columns", unit="mm")),
    ("PX4", ("timestamp_sample", "position[2]", "q[3]"), reading_of("position=position,wxyz=q")),
    ("PX4", ("timestamp_sample", "x", "q[3]"), reading_of("wxyz=q")),
    ("NDI", ("frame", "state", "tx", "rz"), reading_of(unit="mm", euler="xyz:deg")),
    (
        "BOP, at 30 frames a second",
        ("im_id", "r[8]", "t[2]"),
        reading_of("time=im_id,position=t,matrix=R", matrix="rows", unit="mm", time_unit="30Hz"),
    ),
    ("KUKA", ("x", "a", "b", "c"), reading_of("rz=A,ry=B,rx=C", euler="ZYX:deg", unit="mm")),
    ("FANUC", ("x", "w", "p", "r"), reading_of("rx=W,ry=P,rz=R", euler="xyz:deg", unit="mm")),
    ("Polhemus", ("x", "az", "el", "roll"), reading_of("rz=Az,ry=El,rx=Roll", euler="ZYX:deg", unit="cm")),
    (_AXIS_ANGLE, ("rx", "ry", "rz", "angle"), reading_of(rotation_vector=True)),
    (_AXIS_ANGLE, ("axis_x", "axis_z", "angle"), reading_of(rotation_vector=True)),
    (_AXIS_ANGLE, ("rot_axis_x", "rot_angle"), reading_of(rotation_vector=True)),
    (_AXIS_ANGLE, ("ax", "ay", "az", "angle"), reading_of("rx=ax,ry=ay,rz=az", rotation_vector=True)),
    (_AXIS_ANGLE, ("ux", "uy", "uz", "theta"), reading_of("rx=ux,ry=uy,rz=uz", rotation_vector=True)),
    ("a position and a quaternion", ("x", "x[1]", "w"), reading_of("qx=x[1],qy=y[1],qz=z[1],qw=w")),
    ("ABB", ("x", "q1", "q2", "q3", "q4"), reading_of("qw=Q1,qx=Q2,qy=Q3,qz=Q4", unit="mm")),
    ("ABB's EGM", ("x", "u0", "u1", "u2", "u3"), reading_of("qw=u0,qx=u1,qy=u2,qz=u3", unit="mm")),
    ("quaternions with the real part first", ("q0", "q3"), reading_of("qw=q0,qx=q1,qy=q2,qz=q3")),
    ("matrices by row and column", ("r11", "r33"), reading_of(matrix="rows")),
)
"""Known systems: name; names of columns by which the system is recognised (``_plainly``); the reading."""
_NO_PLACE: Final = re.compile(
    r"(?:[adfgmsvw]|.*(?:vel|acc|gyr|mag|force|torque|std|err|scale|size)[a-z]*)[._/: -]*[xyz]"
)
"""Names of vectors that are no positions, and no rotations beside these."""
_TURNING: Final = re.compile("rot|rvec|axis|rpy|euler|angle|orient|rodrigues", re.IGNORECASE)
"""Names of groups of three columns that are a rotation."""


def layout_of_names(
    names: Sequence[str],
    reading: TableReading,
    path: str = "FILE",
    units: Sequence[str] = (),
    rows: FirstRows = tuple,
) -> TableLayout:
    """The layout of a table with named columns; ``units`` may be those of a separate row. The first ``rows``
    decide which units may be proposed.

    Raises UnreadableRecording, with the command that reads the columns if there is one, if they have no poses
    or their meaning is not known; and ChoiceError if a column that the reading names is not there.
    """
    if len(names) > MOST_COLUMNS:
        raise UnreadableRecording(f"its {len(names)} columns are too many: needed are {NEEDED}")
    columns = Columns(names, units, rows)
    try:
        return with_body(layout(columns, reading), columns)
    except UnreadableRecording as error:
        proposal = _Proposal(columns, reading, path).text()
        if proposal is not None:
            raise ProposedReading(proposal) from error
        if isinstance(error, OpenReading):
            raise UnreadableRecording(f"it is not known how its columns {error} are meant") from error
        raise


def layout_without_names(rows: Sequence[Sequence[str]], reading: TableReading, path: str) -> TableLayout:
    """The layout of columns without names; raises UnreadableRecording, with proposals by the values of the
    first rows if there are any, where the reading does not state the columns."""
    names = [f"{UNNAMED}{i}" for i in range(len(rows[0]) if rows else 0)]
    if reading.columns:
        return layout_of_names(names, reading, path, rows=lambda: rows)
    fault = f"its {len(names)} columns have no names"
    if (text := _Proposal(Columns(names, rows=lambda: rows), reading, path).text()) is not None:
        text = text.replace("its columns are", "they are", 1).replace("its rotations", "if its rotations", 1)
        raise ProposedReading(f"{fault}: {text}")
    how = f"say which they are, by number from 0 on, as in --columns time={UNNAMED}0,x={UNNAMED}1"
    raise UnreadableRecording(f"{fault}: {how}")


def _plainly(name: str) -> str:
    """A name in lower case, with the number of an element as in ``q[3]`` for ``q_3`` and ``q.3``."""
    return re.sub(r"[\[_.](\d+)\]?$", r"[\1]", name.lower())


def _is_commanded(name: str) -> bool:
    return _COMMANDED.search(name) is not None


def _clock(values: Array, taken: Collection[int]) -> tuple[int | None, bool]:
    """The column of the first rows (N, k), outside of ``taken`` ones, that may be the time, as it rises: if
    there are several, the first that does not rise by ones, as numbers of frames do; and whether it does."""
    frames = None
    for place in range(values.shape[1]):
        steps = np.diff(values[np.isfinite(values[:, place]), place])
        if place not in taken and steps[_FEW_STEPS:].any() and (steps >= 0.0).all():
            if not (steps == 1.0).all():
                return place, False
            frames = place if frames is None else frames
    return frames, True


@np.errstate(over="ignore", invalid="ignore")
def may_be_trajectory(rows: Sequence[Sequence[str]]) -> bool:
    """Whether rows of eight values may be of a time and a pose: their last four values have mostly the same
    norm, as scaled quaternions have and angles that change have not; and no other ones are a quaternion."""
    table = np.array([numbers(row) for row in rows if len(row) == 8]).reshape(-1, 8)
    ends = _present(table[:, -4:])
    if not len(ends):
        return True
    if _begin_of_quaternion(table) not in (None, 4):
        return False
    norms = np.linalg.norm(ends, axis=1)
    rounding = 1.0 if (ends == np.rint(ends)).all() else 0.0  # for four integers, half a unit each
    is_near = np.abs(norms - np.median(norms)) <= NORM_TOLERANCE * np.median(norms) + rounding
    return bool(2 * np.count_nonzero(is_near) >= len(norms))


def _begin_of_quaternion(rows: Array) -> int | None:
    """The first column of rows (N, k) at which a unit quaternion may begin that has a position before or
    after it, preferably one that changes; None without one."""
    constant = None
    for begin in range(rows.shape[1] - len(QUATERNION) + 1):
        quats = rows[:, begin : begin + len(QUATERNION)]
        if _are_unit(quats) and (begin >= 3 or begin + len(POSE_ROLES) <= rows.shape[1]):
            if (_present(quats) != _present(quats)[0]).any():
                return begin
            constant = begin if constant is None else constant
    return constant


def _are_unit(quats: Array) -> bool:
    """Whether values (N, 4) are unit quaternions where they are not lost."""
    norms = np.linalg.norm(_present(quats), axis=1)
    return len(norms) > 0 and bool((np.abs(norms - 1.0) < _UNIT_NORM).all())


def _pose_in(values: Array) -> tuple[int, dict[str, int], str | None] | None:
    """Where neighbouring columns of rows (N, k) are a pose by their values: the first of them, the number of
    columns by role in order, and the order of matrices; None if none are."""
    count = values.shape[1]
    for roles in ({"matrix": 16}, {"matrix": 12}, {"position": 3, "matrix": 9}, {"matrix": 9, "position": 3}):
        before = 3 if next(iter(roles)) == "position" else 0
        for begin in range(count - sum(roles.values()) + 1):
            matrices = values[:, begin + before : begin + before + roles["matrix"]]
            if (order := _order_of_matrices(matrices)) is not None:
                return begin, roles, order
    turn = _begin_of_quaternion(values)
    if turn is None:
        return None
    place, steps = turn - 3, np.diff(values[:, 0])
    if place >= 3 and _are_angles_of(values[:, place:turn], values[:, turn : turn + 4]):
        return place - 3, {"position": 3, "": 3, "quaternion": 4}, None
    is_of_time = place == 0 and steps.size and 0 < steps.max() <= 2 * np.median(steps) and steps.min() > 0
    if place < 0 or (is_of_time and turn + len(POSE_ROLES) <= count):
        return turn, {"quaternion": 4, "position": 3}, None
    return place, {"position": 3, "quaternion": 4}, None


def _are_angles_of(angles: Array, quats: Array) -> bool:
    """Whether values (N, 3) are roll, pitch and yaw of quaternions (N, 4)."""
    is_there = np.isfinite(np.c_[angles, quats]).all(axis=1) & quats.any(axis=1)
    expected = Rotation.from_quat(quats[is_there]).as_euler("xyz")
    units = (1.0, 180.0 / np.pi)
    return any(np.allclose(angles[is_there], unit * expected, atol=1e-3 * unit) for unit in units)


def _present(rows: Array) -> Array:
    """The rows of poses that are not lost: finite, and the last four values not all zero."""
    return rows[np.isfinite(rows).all(axis=1) & rows[:, -4:].any(axis=1)]


def _order_of_matrices(values: Array) -> str | None:
    """Whether the matrices of poses with the values (N, 16) or (N, 12) are written by rows or columns; None
    if they are no poses. Rotations (N, 9) count as written by rows."""
    if values.shape[1] == 9:
        values = np.pad(values.reshape(-1, 3, 3), ((0, 0), (0, 0), (0, 1))).reshape(-1, 12)
    matrices = _present(values).reshape(-1, values.shape[1] // 4, 4)
    turned = {"rows": matrices, "columns": matrices.transpose(0, 2, 1)}
    for order in turned if values.shape[1] == 16 else ("rows",):
        rotation = turned[order][:, :3, :3]
        errors = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3))
        are_rotations = len(errors) and (errors < _UNIT_NORM).all() and (np.linalg.det(rotation) > 0).all()
        if are_rotations and not turned[order][:, 3:, :3].any():
            return order
    return None


class _Proposal:
    """The probable meaning of the columns of a table, with the commands that read them so.

    Parameters
    ----------
    reading : what the user states; a time is added if no column is named as one.
    path : of the table, for the commands.
    """

    def __init__(self, columns: Columns, reading: TableReading, path: str) -> None:
        self._columns, self._path, self._stated = columns, path, reading
        self._reading, self._about_time, self._lacks_time = reading, "", False
        if columns.time(reading, columns.find(reading)[TIME])[0] is None:
            clock, self._about_time = self._time()
            self._lacks_time = clock is None
            rate = reading_of(time_unit=reading.time_unit or _A_RATE)
            self._reading = reading.with_(rate if clock is None else reading_of({TIME: clock}))

    def _time(self) -> tuple[str | None, str]:
        """The name of the column that seems to be the time, if any, and its description."""
        columns, has_frames = self._columns, any(map(FRAME.fullmatch, self._columns.plain))
        likes = [name for name in columns.names if _LIKE_TIME.match(name) and CAN_BE_GIVEN(name)]
        rising = chain(filter(self._rises, likes[:FIRST_ROWS]), filter(self._has_dates, columns.names))
        like = next(rising, next(iter(likes if not has_frames else ()), None))
        if like is None and has_frames:
            return None, "its times are numbers of frames"
        if like is None:
            taken = {place for places in columns.find(self._stated).values() for place in places.values()}
            bases = [match and match[1] for match in map(NUMBERED.fullmatch, columns.names)]
            sizes = Counter([*bases, *columns.names])  # single ones may be an index, or an array
            for place, (base, name) in enumerate(zip(bases, columns.names, strict=True)):
                if (base is not None and sizes[base] > 1) or not CAN_BE_GIVEN(name):
                    taken.add(place)
            width = min([len(columns.names), *map(len, self._columns.rows())])
            clock, is_frame = _clock(self._columns.values(range(width)), taken)
            if clock is None or is_frame:
                return None, "it has no times"
            like = columns.names[clock]
        shown = "its first column, which has no name," if like == f"{UNNAMED}0" else like
        return like, f"if {shown} is the time"

    def _rises(self, name: str) -> bool:
        """Whether the first values of a column rise as times do."""
        place = self._columns.names.index(name)
        return _clock(self._columns.values([place]), ())[0] is not None

    def _has_dates(self, name: str) -> bool:
        """Whether a column is of dates or times of a day that change."""
        cells = self._columns.cells(self._columns.names.index(name))
        return (len({*cells}) > 1 or len(cells) == 1) and stamp_of_date(cells[0]) is not None

    def _group(self, base: str) -> dict[int, int]:
        """Indices of a group of numbered columns by their number, without those of text at its ends."""
        group = self._columns.numbered(base)
        cells = {number: self._columns.cells(place) for number, place in group.items()}
        kept = [n for n in group if not cells[n] or any(are_numbers([cell]) for cell in cells[n])]
        return {n: place for n, place in group.items() if kept and kept[0] <= n <= kept[-1]}

    def commands(self, readings: Sequence[TableReading]) -> str:
        """The commands of readings, and of other ways of rotations; then what the user has to replace."""
        texts, about = list[str](), dict[str, None]()
        for reading in readings:
            if reading.has_frame_numbers and not self._stated.has_frame_numbers:
                about[f"the rate of your poses instead of {reading.time_unit}"] = None
            with suppress(UnreadableRecording, ChoiceError):
                table = layout(self._columns, reading)
                reading, of_unit = in_unit(
                    reading, table.bodies[0], self._columns.values(table.bodies[0].columns)
                )
                about |= {of_unit: None} if of_unit else {}
                if table.time >= 0 and not (table.time_ns or table.rest is not None):
                    unit = unit_of_dates(self._columns.values([table.time])[:, 0])
                    reading = reading.with_(reading_of(time_unit=unit))
            how, other = self._other_way(reading)
            is_named = "wxyz" in dict(reading.columns).get("quaternion", "").lower()
            texts.append((other if is_named else reading).command(self._path))
            if how and not is_named:
                texts[-1] += f" or, {how}, {other.command(self._path)}"
        orders = f". {_ORDERS}" if any(reading.euler for reading in readings) else ""
        return f"{' or '.join(texts)}{', with ' * bool(about)}{' and '.join(about)}{orders}"

    def _other_way(self, reading: TableReading) -> tuple[str, TableReading]:
        """Where names do not say it, the way in words, and the reading, of matrices along columns, or of
        quaternions with the real part at the other end."""
        columns = dict(reading.columns)
        if reading.matrix is not None and "matrix" in columns:
            is_square = len(self._columns.places(columns["matrix"], True)) == 9
            return "if it goes along columns" * is_square, replace(reading, matrix="columns")
        if reading.matrix is not None:
            swapped = {f"r{role[2]}{role[1]}" if role in MATRIX else role: columns[role] for role in columns}
            how = "if it goes along columns" * ("r11" in columns)
            return how, replace(reading, columns=tuple(swapped.items()))
        if (group := columns.pop("quaternion", None)) is not None:
            columns["wxyz"] = group
            return "with the real part first", replace(reading, columns=tuple(columns.items()))
        stated = [columns[role] for role in QUATERNION if role in columns]
        parts = sorted(stated, key=lambda name: self._columns.places(name, False))
        if len(parts) < len(QUATERNION) or parts[0][-1:].lower() == "w" or parts[-1][-1:].lower() == "w":
            return "", reading
        is_first = parts[0] == columns["qw"]
        columns |= zip(QUATERNION if is_first else GROUPS["wxyz"], parts, strict=True)
        how = f"with the real part {'last' if is_first else 'first'}"
        return how, replace(reading, columns=tuple(columns.items()))

    @np.errstate(over="ignore", invalid="ignore")  # numbers may be of any size
    def text(self) -> str | None:
        """The meaning with its commands; None if nothing fits."""
        for meaning, candidate in self._candidates():
            fault = _fault(self._columns, candidate)
            if fault is None:
                return f"{meaning} read them by {self.commands([candidate])}"
            if (text := self._of_rotation(fault, candidate)) is not None:
                return text
        return None

    def _candidates(self) -> Iterator[tuple[str, TableReading]]:
        """The meaning in words, and the reading: of known systems, of the columns as they are named, of
        groups of numbered columns, and of columns after a position."""
        columns = self._columns
        written = {_plainly(name): name for name in reversed(columns.names)}
        known = {*written, *map(_plainly, columns.plain)}
        lower = [*map(str.lower, columns.names)]
        prefixed = islice(filter(None, map(_PREFIX.match, sorted({*lower, *columns.plain}))), _MOST_GROUPS)
        suffixed = islice(filter(None, map(_SUFFIX.fullmatch, lower)), _MOST_GROUPS)
        affixes = ("", ""), *((match[0], "") for match in prefixed), *(("", match[1]) for match in suffixed)
        ordered = sorted(dict.fromkeys(affixes), key=lambda affix: _is_commanded("".join(affix)))
        for (system, names, meaning), (prefix, suffix) in product(KNOWN, ordered):
            if known.issuperset(_plainly(prefix + name + suffix) for name in names):
                place = tuple(zip(POSITION, POSITION, strict=True)) if suffix and names[0] == "x" else ()
                roles = ((role, prefix + name + suffix) for role, name in (*place, *meaning.columns))
                spelled = tuple((role, written.get(_plainly(name), name)) for role, name in roles)
                candidate = replace(meaning, columns=spelled).with_(self._reading)
                for way in self._with_units(candidate):
                    yield f"if its columns are those of {system},", way
        as_named = (f"{self._about_time}:", self._reading)
        if is_known := _fault(columns, self._reading) is None:
            yield as_named
        matches = [pattern.fullmatch(name) for name in columns.names for pattern in (NUMBERED, BY_ROW)]
        bases = [match[1] for match in matches if match is not None and CAN_BE_GIVEN(match[1])]
        sizes = Counter(match[1] for match in map(BY_ROW.fullmatch, columns.names) if match is not None)
        of_joints = {_OF_JOINTS.sub("", base) for base in bases if "effort" in base}

        def is_apart(base: str) -> bool:
            """Whether a group is no row of a matrix, not of joints, and no name that occurs twice."""
            row = NUMBERED.fullmatch(base)
            is_row = row is not None and sizes[row[1]] in MATRIX_SHAPES
            is_other = _NO_POSES.search(base) or _OF_JOINTS.sub("", base) in of_joints
            return not is_row and not is_other and base not in columns.names

        apart = filter(is_apart, dict.fromkeys(sorted(bases, key=_is_commanded)))
        meant = ((base, *self._meant(base)) for base in islice(apart, _MOST_GROUPS))
        parts = [(base, way, shows) for base, way, shows in meant if way is not None]
        places = [(base, way) for base, way, _ in parts if [*dict(way.columns)] == ["position"]]
        for shows in (True, False):
            alone = [(base, way) for base, way, is_shown in parts if is_shown == shows]
            pairs = list[tuple[TableReading, TableReading]]()
            for base, way in alone:
                near = sorted(places, key=lambda place: -sum(takewhile(bool, map(eq, place[0], base))))
                pairs += [(way, place) for _, place in near if way.columns != place.columns]
            for way, at in chain(((way, AS_NAMED) for _, way in alone), pairs):
                has_time = any(role == TIME for role, _ in way.columns)
                stated = self._stated if has_time else self._reading
                yield "if its columns are meant so,", way.with_(at.with_(stated))
            if shows and not is_known:
                yield as_named
        yield from self._after_position()

    def _after_position(self) -> Iterator[tuple[str, TableReading]]:
        """The candidates of the columns after a named position whose own names say nothing: of matrices or
        quaternions by their values, else of three numbers."""
        columns, by_body = self._columns, self._columns.find(self._stated).values()
        after = next((roles["z"] + 1 for roles in by_body if roles.keys() >= {*POSITION}), len(columns.names))
        has_w = any(re.fullmatch(r"(?:.*[._/: -])?w", plain) for plain in columns.plain)
        is_told = has_w or any({*QUATERNION} & {*roles} for roles in by_body)
        for roles, how in ((MATRIX, {"matrix": "rows"}), (QUATERNION, {}), (ANGLES, {})):
            names, plain = (part[after : after + len(roles)] for part in (columns.names, columns.plain))
            if is_told or len(names) < len(roles) or any(map(_NO_PLACE.fullmatch, plain[:3])):
                continue
            values = self._columns.values(range(after, after + len(roles)))
            is_turn = _order_of_matrices(values) if roles is MATRIX else _are_unit(values)
            if is_turn or (roles is ANGLES and np.isfinite(values).any()):
                stated = reading_of(dict(zip(roles, names, strict=True)), **how).with_(self._reading)
                yield "if its columns are meant so,", stated

    def _with_units(self, known: TableReading) -> list[TableReading]:
        """The reading of a known system, and without its units, which comes first if positions would be near
        zero: names of columns may state others."""
        order = (known.euler or "").partition(":")[0] or None
        ways = [known, replace(known, unit=self._stated.unit, euler=self._stated.euler or order)]
        with suppress(UnreadableRecording, ChoiceError):
            position = layout(self._columns, known).bodies[0].columns[:3]
            is_near = 0.0 < reach_of(self._columns.values(position)) <= FARTHEST_M and known.unit != "cm"
            ways = ways[::-1] if is_near and not self._stated.unit else ways
        return ways

    def _meant(self, base: str) -> tuple[TableReading | None, bool]:
        """The reading of numbered columns, and whether their first values show it: a rotation, with the
        position and the time beside it; else that of their number, or None if it is none of a pose."""
        group, whole = self._group(base), len(self._columns.numbered(base))
        if not group:
            return None, False
        values, count, first = self._columns.values(list(group.values())), len(group), min(group)

        def meaning(begin: int, how: Mapping[str, Any], **sizes: int) -> TableReading:
            """The reading of roles of these sizes, which begin at ``begin``."""
            columns, at = dict[str, str](), begin
            for role, size in sizes.items():
                start, at = first + at, at + size
                columns[role] = base if size == whole else f"{base}[{start}:{start + size}]"
            columns.pop("", None)
            if not self._lacks_time or whole == at - begin:
                return reading_of(columns, **how)
            clock, is_frame = _clock(values, range(begin, at))
            clock = begin - 1 if len(values) == 1 and begin else clock
            times = [] if clock is None else [self._columns.names[list(group.values())[clock]]]
            texts = self._columns.rows()[0][: begin and 2]
            if "".join(texts).isdigit() and len(texts[0]) == DIGITS_OF_STAMP > len(texts[1]):
                times, is_frame = [f"{UNNAMED}0", f"{UNNAMED}1"], False
            how = {**how, "time_unit": _A_RATE} if is_frame and times and len(values) > 1 else how
            return reading_of({**dict(zip((TIME, REST), times, strict=False)), **columns}, **how)

        if (found := _pose_in(values)) is not None:
            begin, sizes, order = found
            return meaning(begin, {} if order is None else {"matrix": order}, **sizes), True
        if count == 9 and _order_of_matrices(values) is not None:
            return meaning(0, {"matrix": "rows"}, matrix=9), True
        is_nameless, is_lost = base == UNNAMED, not len(_present(values))
        if count == 4 and (is_lost or _are_unit(values)):
            return meaning(0, {}, quaternion=4), not is_lost
        if count == 3:
            return meaning(0, {}, **{"rotation" if _TURNING.search(base) else "position": 3}), False
        if count == len(POSE_ROLES) and is_lost:
            return meaning(0, {}, position=3, quaternion=4), False
        if count in MATRIX_SHAPES and is_lost and not is_nameless:
            return meaning(0, {"matrix": "rows"}, matrix=count), False
        if count in (6, 7) and not (is_lost and is_nameless):
            return meaning(count - 6 if is_nameless else 0, {}, position=3, rotation=3), False
        return None, False

    def _of_rotation(self, fault: Exception, reading: TableReading) -> str | None:
        """The probable meaning of the three numbers of a rotation that a reading leaves open, with the
        commands; None if no reading fits."""
        if not isinstance(fault, OpenReading):
            return None
        description, ways = self._three_numbers(str(fault).split(", "), reading)
        candidates = [reading.with_(way) for way in ways]
        if candidates := [candidate for candidate in candidates if not _fault(self._columns, candidate)]:
            first = self._with_rotation_first(reading)
            also = f"; or, if the rotation comes first, by {self.commands([first])}" if first else ""
            return f"its rotations are {fault}, {description}: read them by {self.commands(candidates)}{also}"
        if description:
            return None
        unit = f"write its unit into the names, as in '{str(fault).partition(', ')[0]} [deg]'"
        return f"its rotation vector {fault} is longer than a turn in radians: {unit}"

    def _with_rotation_first(self, reading: TableReading) -> TableReading | None:
        """The reading of six columns without names as a rotation vector before a position, if one may be."""
        columns = dict(reading.columns)
        place, turn = columns.get("position", ""), columns.get("rotation", "")
        if not (place.startswith(f"{UNNAMED}[") and turn) or are_no_radians(
            self._columns.values(self._columns.places(place, True))
        ):
            return None
        columns |= {"position": turn, "rotation": place}
        return replace(reading, columns=tuple(columns.items())).with_(reading_of(rotation_vector=True))

    def _three_numbers(self, names: Sequence[str], reading: TableReading) -> tuple[str, list[TableReading]]:
        """The possible meaning, in words, and the readings of a rotation in three columns, by their names and
        first values: numbers in radians are no larger than a turn."""
        columns = self._columns
        places = [i for i, name in enumerate(columns.names) if name in names]
        units = [unit for i in places if (unit := ANGLE_UNITS.get(columns.units[i], ""))]
        values = self._columns.values(places)
        is_far = not units and are_no_radians(values)
        if not reading.euler and any(map(NAMED_VECTOR.search, names)):
            if is_far:
                return "", []
            return "a rotation vector", [reading_of(rotation_vector=True)]
        named = (order for pattern, order in _NAMED_ORDERS.items() if all(map(pattern.match, names)))
        order = reading.euler or next(named, "xyz")
        units = units[:1] or (["deg"] if is_far else ["deg", "rad"])
        angles = [reading_of(euler=f"{order}:{unit}") for unit in units]
        if reading.euler:
            return f"angles in the order {order} without their unit", angles
        if are_named_angles(names) or order != "xyz" or is_far:
            return "three angles", angles
        vector = reading_of(rotation_vector=True)
        description = "three numbers, angles or a rotation vector"
        if len(angles) > 1 and len(values):  # no larger than a turn in radians: hardly degrees
            return description, [vector, *angles[::-1]]
        return description, [angles[0], vector]


def _fault(columns: Columns, reading: TableReading) -> Exception | None:
    """The error if columns cannot be read so; else None."""
    try:
        layout(columns, reading)
    except (UnreadableRecording, ChoiceError) as error:
        return error
    return None
