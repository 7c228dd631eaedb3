"""Pose columns of text files and tables by their names; and TUM trajectories.

Layouts are determined by the first lines or the column names alone.
"""

import csv
import re
from collections.abc import Sequence
from typing import Final

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.mocap_exports import is_motive, is_vicon, motive_layout, vicon_layout
from contact_tracker.recording.table_layouts import BLANKS, LENGTHS_M, Body, TableLayout, are_numbers
from contact_tracker.recording.time_units import NAMED_NS

_UNIT: Final = re.compile(r"[\s_]*[\[(]([^\])]*)[\])]\s*$|_(mm|cm|m|s|ms|us|ns)$")
_TIME: Final = re.compile(r"(?:.*[./ ])?(?:rosbag)?_?(?:t|time|times|time_?stamp|stamp)")
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
_NEEDED: Final = "a time, x, y, z in metres, and qx, qy, qz, qw"
_SHOWN: Final = 12
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
    if are_numbers(values):
        if names is None and separator is None and len(values) == _TUM_NAMES:
            return TableLayout("TUM", None, skip, 0, None, (Body("", (1, 2, 3, 4, 5, 6, 7), 1.0),))
        if names is None:
            raise UnreadableRecording(
                f"its {len(values)} columns have no names: needed are {_NEEDED}, or the eight of TUM"
            )
    else:
        names, skip = values, lines.index(data) + 1
    _refuse_wider(lines[skip:], separator, len(names))
    return layout_of_names(names, "table", separator, skip)


def layout_of_names(names: Sequence[str], kind: str, separator: str | None, skip: int) -> TableLayout:
    """The layout of a table with named columns; raises UnreadableRecording."""
    if len(names) > MOST_COLUMNS:
        raise UnreadableRecording(f"its {len(names)} columns are too many: needed are {_NEEDED}")
    names = [name[:_LONGEST_NAME] for name in names]
    time, time_ns = _time_column(names)
    found: dict[str, dict[str, tuple[int, float]]] = {}
    for place, name in enumerate(names):
        plain, unit = _split_unit(name)
        axis = _axis(plain)
        if axis is not None and place != time:
            body, role = axis
            found.setdefault(body, {}).setdefault(role, (place, LENGTHS_M.get(unit, 1.0)))
    roles = ("x", "y", "z", "qx", "qy", "qz", "qw")
    bodies = [
        Body(name, tuple(columns[role][0] for role in roles), columns["x"][1])
        for name, columns in found.items()
        if columns.keys() >= set(roles)
    ]
    if time is None or not bodies:
        raise UnreadableRecording(_lacking(names, bool(bodies)))
    return TableLayout(kind, separator, skip, time, time_ns, tuple(bodies))


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


def _lacking(names: Sequence[str], has_pose: bool) -> str:
    """The message on columns that are missing."""
    shown = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
    lacking = "no column of times" if has_pose else "no columns of a pose"
    angles = [name for name in names if _ANGLE.fullmatch(_split_unit(name)[0])]
    if has_pose or len(angles) < 3:
        return f"{lacking} among {shown}: needed are {_NEEDED}"
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
    for place, name in enumerate(names):
        plain, unit = _split_unit(name)
        if _TIME.fullmatch(plain):
            return place, NAMED_NS.get(unit)
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
