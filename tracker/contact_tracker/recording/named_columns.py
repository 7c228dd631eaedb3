"""Pose columns of text files and tables by their names; and TUM trajectories.

Layouts are determined by the first lines or the column names alone.
"""

import csv
import re
from collections.abc import Sequence
from typing import Final

from contact_tracker.config.quantities import TIMES_NS
from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.mocap_exports import is_motive, is_vicon, motive_layout, vicon_layout
from contact_tracker.recording.table_layouts import (
    BLANKS,
    LENGTHS_M,
    SEPARATORS,
    Body,
    TableLayout,
    are_numbers,
)
from contact_tracker.recording.time_units import NAMED_NS

_UNIT: Final = re.compile(r"[\s_]*[\[(]([^\])]*)[\])]\s*$|_(mm|cm|um|m|s|ms|us|ns)$")
_TIME: Final = re.compile(r"(?:.*[./ ])?(?:rosbag)?_?(?:t|time|times|time_?stamp|stamp)")
_ELAPSED: Final = re.compile(r"elapsed|elapsed_?time|secs?|seconds")
"""Names of a time if no other column is one."""
_REST_OF_SECOND: Final = re.compile(r"(?:.*[./ _])?(?:nano_?|n)sec(?:s|onds)?")
_CLOCKS: Final = frozenset({"", "unix", "utc", "epoch", "posix"})
"""Texts in brackets after a time that leave its unit open."""
_QUATERNION: Final = re.compile(
    r"(.*?)[._/: -]*(?<![a-z])(?:q|quat|quaternion|orientation|ori|rotation|rot|q_\w+)[._/: -]*([xyzw])"
)
_POSITION: Final = re.compile(
    r"(.*?)[._/: -]*(?:(?<![a-z])(?:p|t|pos|position|trans|translation|p_\w+)[._/: -]*)?(?<![a-z])([xyz])"
)
_PREFIXED: Final = re.compile(r"(.*?)[._/: -]*(?<![a-z])[pt]([xyz])")
_ANGLE: Final = re.compile(
    r"(?:.*[./: _-])?(?:roll|pitch|yaw|(?:r|rot|rotation|euler|angle|rotvec|axis_?angle)[._/: -]*[xyz])"
    r"(?:_(?:deg|rad))?"
)
"""Names of one of three numbers of a rotation."""
_GENERIC: Final = {"", "pose", "field", "transform", "data", "msg", "message", "state"}
_TUM_NAMES: Final = 8
_ROLES: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
_NEEDED: Final = "a time, x, y, z in metres, and qx, qy, qz, qw"
_EXAMPLE: Final = "time [s],x [m],y [m],z [m],qx,qy,qz,qw"
_SHOWN: Final = 12
_ANY_SEPARATOR: Final = re.compile(r" *[;,\t] *| +")
_MARKS: Final = (";", "\t", ",")
"""Separators of values; a comma may also be the decimal point."""
MOST_COLUMNS: Final = 5000
_LONGEST_NAME: Final = 200


def layout_of_text(lines: Sequence[str]) -> TableLayout:
    """The layout of a text file by its first lines; raises UnreadableRecording, which names what is
    missing."""
    first = next((line for line in lines if line.strip()), "")
    if is_motive(first):
        return motive_layout(lines)
    if is_vicon(first):
        return vicon_layout(lines)
    skip = _comments(lines)
    data = next((line for line in lines[skip:] if line.strip() and not line.startswith("#")), None)
    if data is None:
        raise UnreadableRecording(f"its first {len(lines)} lines are empty or comments: leave them out")
    separator = _separator(data)
    values = _cells(data, separator)
    names = _header(lines[skip - 1] if skip else "", separator, len(values))
    if names is None:
        _refuse_other_tum(data, separator)
    if are_numbers(values):
        if names is None and separator is None and len(values) == _TUM_NAMES:
            return TableLayout("TUM", None, skip, 0, None, (Body("", (1, 2, 3, 4, 5, 6, 7), 1.0),))
        if names is None:
            raise UnreadableRecording(
                f"its {len(values)} columns have no names: needed are {_NEEDED}, or the eight of TUM, "
                "separated by blanks"
            )
    else:
        names, skip = values, lines.index(data) + 1
    _refuse_wider(lines[skip:], separator, len(names))
    layout = layout_of_names(names, "table", separator, skip)
    _refuse_narrow(lines[skip:], layout, len(names))
    return layout


def layout_of_names(names: Sequence[str], kind: str, separator: str | None, skip: int) -> TableLayout:
    """The layout of a table with named columns; raises UnreadableRecording."""
    if len(names) > MOST_COLUMNS:
        raise UnreadableRecording(f"its {len(names)} columns are too many: needed are {_NEEDED}")
    names = [name[:_LONGEST_NAME] for name in names]
    time, time_ns = _time_column(names)
    found: dict[str, dict[str, int]] = {}
    for place, name in enumerate(names):
        axis = _axis(_split_unit(name)[0])
        if axis is not None and place != time:
            body, role = axis
            found.setdefault(body, {}).setdefault(role, place)
    complete = {
        name: tuple(columns[role] for role in _ROLES)
        for name, columns in found.items()
        if columns.keys() >= set(_ROLES)
    }
    if time is None or not complete:
        most = max(found.values(), key=len, default={})
        raise UnreadableRecording(_lacking(names, time is not None, _ROLES if complete else tuple(most)))
    bodies = [
        Body(name, places, metres_of([names[place] for place in places[:3]]))
        for name, places in complete.items()
    ]
    return TableLayout(kind, separator, skip, time, time_ns, tuple(bodies))


def metres_of(names: Sequence[str]) -> float:
    """The factor to metres of the columns x, y and z, by the unit in their names; metres without one.

    Raises
    ------
    UnreadableRecording
        A unit is unknown, or they differ.
    """
    units = [_split_unit(name)[1] for name in names]
    for name, unit in zip(names, units, strict=True):
        if unit and unit not in LENGTHS_M:
            raise UnreadableRecording(_unknown(unit, name, "m, cm, mm, um"))
    factors = {LENGTHS_M.get(unit, 1.0) for unit in units}
    if len(factors) > 1:
        raise UnreadableRecording(
            f"the units of the columns {', '.join(names)} differ: give all three in one"
        )
    return factors.pop()


def time_ns_of(name: str) -> int | None:
    """The unit of a time column in nanoseconds, if its name has one.

    Raises
    ------
    UnreadableRecording
        The unit is unknown.
    """
    plain, unit = _split_unit(name)
    if unit in _CLOCKS:
        return NAMED_NS.get(plain)
    if unit not in NAMED_NS:
        raise UnreadableRecording(_unknown(unit, name, ", ".join(TIMES_NS)))
    return NAMED_NS[unit]


def _unknown(unit: str, name: str, known: str) -> str:
    return f"the unit '{unit}' of column '{name.strip()}' is not known: {known}"


def _separator(data: str) -> str | None:
    """The separator of values in a line; None for white space."""
    words = data.split()
    is_tum = len(words) == _TUM_NAMES and are_numbers(words) and not any(word[-1] == "," for word in words)
    if is_tum and len(data.split("\t")) < _TUM_NAMES:
        return None  # white space, with commas as decimal points
    return next((mark for mark in _MARKS if mark in data), None)


def _cells(line: str, separator: str | None) -> list[str]:
    """The values in a line, without quotes."""
    if separator is None:
        return line.split()
    return [value.strip(BLANKS) for value in next(csv.reader([line], delimiter=separator), [])]


def _refuse_other_tum(row: str, separator: str | None) -> None:
    """Raise UnreadableRecording if a row without names has the values of TUM, but not by white space."""
    words = _ANY_SEPARATOR.split(row.strip())
    if separator is None or len(words) != _TUM_NAMES or not are_numbers(words):
        return
    marks = {part.strip(" ") or part for part in _ANY_SEPARATOR.findall(row.strip())}
    *most, last = [name for mark, name in SEPARATORS.items() if any(mark in part for part in marks)]
    named = f"{', '.join(most)} and {last}" if most else last
    raise UnreadableRecording(
        f"its first row has the eight values of TUM, but separated by {named}: separate all by blanks"
    )


def _refuse_wider(rows: Sequence[str], separator: str | None, names: int) -> None:
    """Raise UnreadableRecording if rows have more values than ``names``: their assignment is ambiguous."""
    for row in rows if separator is not None else ():
        values = _cells(row, separator)
        many = max((i for i, value in enumerate(values, 1) if value), default=0)
        if many > names:
            raise UnreadableRecording(
                f"rows have {many} values under {names} names: name all columns, and where these are decimal "
                "commas, write points, or separate values by semicolons"
            )


def _refuse_narrow(rows: Sequence[str], layout: TableLayout, names: int) -> None:
    """Raise UnreadableRecording if the first row lacks values that are needed: it is separated otherwise."""
    row = next((row for row in rows if row.strip() and not row.startswith("#")), None)
    many = len(_cells(row, layout.separator)) if row is not None else names
    if many <= max(layout.time, *(place for body in layout.bodies for place in body.columns)):
        raise UnreadableRecording(
            f"row 1 has {many} {'value' if many == 1 else 'values'}, the header has {names}: separate the "
            "values of all rows as the names in the header"
        )


def _lacking(names: Sequence[str], has_time: bool, roles: Sequence[str]) -> str:
    """The message on columns that are missing beside those of these roles."""
    shown = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
    angles = [name for name in names if _ANGLE.fullmatch(_split_unit(name)[0])]
    missing = [role for role in _ROLES if role not in roles]
    if not missing:
        return f"no column of times among {shown}: rename it, as in: {_EXAMPLE}"
    if len(angles) < 3:
        missing = missing if has_time else ["a time", *missing]
        return (
            f"no columns of a pose among {shown}: missing {'is' if len(missing) == 1 else 'are'} "
            f"{', '.join(missing)}: rename columns, as in: {_EXAMPLE}"
        )
    return (
        f"its rotations are three numbers, {', '.join(angles[:3])}, of a convention that it does not say: "
        "needed are qx, qy, qz, qw; scipy's Rotation.from_euler('xyz', angles, degrees=True).as_quat() makes "
        "them, with the order and unit of your angles, or Rotation.from_rotvec of rotation vectors"
    )


def _comments(lines: Sequence[str]) -> int:
    """Number of lines before the first one that is not a comment."""
    return next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), 0)


def _header(comment: str, separator: str | None, count: int) -> list[str] | None:
    """The names of ``count`` columns in a comment, if it has them."""
    names = _cells(comment.lstrip("# ").strip(), separator) if comment.strip() else []
    has_axes = {"x", "y", "z"} <= {(_axis(_split_unit(name)[0]) or ("", ""))[1] for name in names}
    return names if len(names) == count and has_axes else None


def _split_unit(name: str) -> tuple[str, str]:
    """A column's name in lower case, and its unit."""
    plain = name.strip().lstrip("#").strip().lower()
    unit = _UNIT.search(plain)
    if unit is None:
        return plain, ""
    return plain[: unit.start()], (unit[1] if unit[1] is not None else unit[2]).strip()


def _time_column(names: Sequence[str]) -> tuple[int | None, float | None]:
    """The index of the time column, and its unit in nanoseconds if the name has one."""
    plain = [_split_unit(name)[0] for name in names]
    for pattern in (_TIME, _ELAPSED):
        place = next((i for i, name in enumerate(plain) if pattern.fullmatch(name)), None)
        if place is not None and not (pattern is _ELAPSED and any(map(_REST_OF_SECOND.fullmatch, plain))):
            return place, time_ns_of(names[place])
    return None, None


def _axis(plain: str) -> tuple[str, str] | None:
    """The body and the role of a column: ``x`` to ``z`` and ``qx`` to ``qw``."""
    if match := _QUATERNION.fullmatch(plain):
        return _body(match[1]), f"q{match[2]}"
    if match := _PREFIXED.fullmatch(plain) or _POSITION.fullmatch(plain):
        return _body(match[1]), match[2]
    return None


def _body(prefix: str) -> str:
    words = [word for word in re.split(r"[./: ]+", prefix) if word not in _GENERIC]
    return "/".join(words).strip("_-")
