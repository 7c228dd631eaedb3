"""Which columns of a text file or table are poses, by their names; and TUM trajectories.

All that is decided here is decided by the first lines, or by the names of the columns.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Final

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.mocap_exports import is_motive, is_vicon, motive_layout, vicon_layout
from contact_tracker.recording.table_layouts import LENGTHS_M, Body, TableLayout, are_numbers

_TIME_UNITS: Final[Mapping[str, int]] = {
    **dict.fromkeys(("s", "sec", "secs", "seconds"), 10**9),
    **dict.fromkeys(("ms", "milliseconds"), 10**6),
    **dict.fromkeys(("us", "microseconds"), 10**3),
    **dict.fromkeys(("ns", "nsec", "nanoseconds"), 1),
}
_UNIT: Final = re.compile(r"[\s_]*[\[(]([^\])]*)[\])]\s*$|_(mm|cm|m|s|ms|us|ns)$")
_TIME: Final = re.compile(r"(?:.*[./ ])?(?:rosbag)?_?(?:t|time|times|time_?stamp|stamp)")
_QUATERNION: Final = re.compile(
    r"(.*?)[._/: -]*(?<![a-z])(?:q|quat|quaternion|orientation|ori|rotation|rot|q_\w+)[._/: -]*([xyzw])"
)
_POSITION: Final = re.compile(
    r"(.*?)[._/: -]*(?:(?<![a-z])(?:p|t|pos|position|trans|translation|p_\w+)[._/: -]*)?(?<![a-z])([xyz])"
)
_PREFIXED: Final = re.compile(r"(.*?)[._/: -]*(?<![a-z])[pt]([xyz])")
_GENERIC: Final = {"", "pose", "field", "transform", "data", "msg", "message", "state"}
_TUM_NAMES: Final = 8
_NEEDED: Final = "a time, x, y, z in metres, and qx, qy, qz, qw"
_SHOWN: Final = 12
MOST_COLUMNS: Final = 5000
_LONGEST_NAME: Final = 200


def layout_of_text(lines: Sequence[str]) -> TableLayout:
    """The layout of a text file by its first lines; raises UnreadableRecording, which says what it lacks."""
    first = next((line for line in lines if line.strip()), "")
    if is_motive(first):
        return motive_layout(lines)
    if is_vicon(first):
        return vicon_layout(lines)
    skip = _comments(lines)
    data = next((line for line in lines[skip:] if line.strip() and not line.startswith("#")), None)
    if data is None:
        raise UnreadableRecording(f"its first {len(lines)} lines are empty or comments: leave them out")
    separator = next((mark for mark in (",", ";", "\t") if mark in data), None)
    if separator == "\t" and len(data.split("\t")) < len(data.split()) == _TUM_NAMES:
        separator = None  # blanks and tabs as they came
    values = data.split(separator)
    names = _header(lines[skip - 1] if skip else "", separator, len(values))
    if are_numbers(values):
        if names is None and separator is None and len(values) == _TUM_NAMES:
            return TableLayout("TUM", None, skip, 0, None, (Body("", (1, 2, 3, 4, 5, 6, 7), 1.0),))
        if names is None:
            raise UnreadableRecording(
                f"its {len(values)} columns have no names: needed are {_NEEDED}, or the eight of TUM"
            )
    else:
        names, skip = [value.strip().strip('"') for value in values], lines.index(data) + 1
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
        shown = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
        lacking = "no column of times" if bodies else "no columns of a pose"
        raise UnreadableRecording(f"{lacking} among {shown}: needed are {_NEEDED}")
    return TableLayout(kind, separator, skip, time, time_ns, tuple(bodies))


def _comments(lines: Sequence[str]) -> int:
    """How many lines stand before the first that is no comment."""
    return next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), 0)


def _header(comment: str, separator: str | None, count: int) -> list[str] | None:
    """The names that a comment gives to so many columns."""
    names = [name.strip() for name in comment.lstrip("# ").strip().split(separator)]
    has_axes = {"x", "y", "z"} <= {(_axis(_split_unit(name)[0]) or ("", ""))[1] for name in names}
    return names if len(names) == count and has_axes else None


def _split_unit(name: str) -> tuple[str, str]:
    """A column's name in small letters, and its unit."""
    plain = name.strip().lstrip("#").strip().lower()
    unit = _UNIT.search(plain)
    if unit is None:
        return plain, ""
    return plain[: unit.start()], (unit[1] if unit[1] is not None else unit[2]).strip()


def _time_column(names: Sequence[str]) -> tuple[int | None, float | None]:
    """Where the time is, and its unit in nanoseconds if the name says so."""
    for place, name in enumerate(names):
        plain, unit = _split_unit(name)
        if _TIME.fullmatch(plain):
            return place, _TIME_UNITS.get(unit)
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
