"""Which columns of a text file or table are poses: TUM, named columns, Motive and Vicon exports.

All that is decided here is decided by the first lines, or by the names of the columns.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from contact_tracker.errors import UnreadableRecording

_UNITS: Final[Mapping[str, float]] = {
    **dict.fromkeys(("m", "meters", "metres", "meter"), 1.0),
    **dict.fromkeys(("cm", "centimeters", "centimetres"), 1e-2),
    **dict.fromkeys(("mm", "millimeters", "millimetres"), 1e-3),
}
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
    rows : so many, where others follow; None for all.
    time : the column of the time; after it that of nanoseconds or of sub-frames, if there is one.
    time_ns : one unit of the time in nanoseconds; None where its size tells.
    """

    kind: str
    separator: str | None
    skip: int
    time: int
    time_ns: float | None
    bodies: tuple[Body, ...]
    rows: int | None = None


def layout_of_text(lines: Sequence[str]) -> TableLayout:
    """The layout of a text file by its first lines; raises UnreadableRecording, which says what it lacks."""
    first = next((line for line in lines if line.strip()), "")
    if first.startswith("Format Version"):
        return _motive(lines)
    if first.strip().strip(",;\t") in ("Objects", "Segments", "Trajectories", "Model Outputs", "Devices"):
        return _vicon(lines)
    skip = _comments(lines)
    data = next((line for line in lines[skip:] if line.strip()), "")
    separator = next((mark for mark in (",", ";", "\t") if mark in data), None)
    if separator == "\t" and len(data.split("\t")) < len(data.split()) == _TUM_NAMES:
        separator = None  # blanks and tabs as they came
    values = data.split(separator)
    names = _header(lines[skip - 1] if skip else "", separator, len(values))
    if _are_numbers(values):
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
    time, time_ns = _time_column(names)
    found: dict[str, dict[str, tuple[int, float]]] = {}
    for place, name in enumerate(names):
        plain, unit = _split_unit(name)
        axis = _axis(plain)
        if axis is not None and place != time:
            body, role = axis
            found.setdefault(body, {}).setdefault(role, (place, _UNITS.get(unit, 1.0)))
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


def _are_numbers(values: Sequence[str]) -> bool:
    try:
        return len([float(value) for value in values if value.strip()]) > 0
    except ValueError:
        return False


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


def _motive(lines: Sequence[str]) -> TableLayout:
    """OptiTrack Motive: names and kinds of columns stand in rows above them."""
    cells = [[cell.strip().strip('"') for cell in line.rstrip("\r\n").split(",")] for line in lines]
    first = next(row for row in cells if row[0])
    about = dict(zip(first[::2], first[1::2], strict=False))
    rotation = about.get("Rotation Type", "Quaternion")
    if rotation != "Quaternion":
        raise UnreadableRecording(f"its rotations are {rotation}: export it from Motive with quaternions")
    head = next((i for i, row in enumerate(cells) if row[0] == "Frame"), None)
    rows = cells[1:head] if head is not None else []
    kinds = next((row for row in rows if {"Rigid Body", "Bone"} & set(row)), None)
    names = next((row for row in rows if "Name" in row[:2]), None)
    values = rows[-1] if rows else []
    if head is None or kinds is None or names is None or "Rotation" not in values:
        raise UnreadableRecording(
            "no rigid body with Rotation and Position in its header: export it from Motive with rigid bodies"
        )
    metres = _metres(about.get("Length Units", about.get("Units", "Meters")))
    found: dict[str, dict[str, int]] = {}
    for place, (kind, name, value, axis) in enumerate(zip(kinds, names, values, cells[head], strict=False)):
        if kind in ("Rigid Body", "Bone") and value in ("Rotation", "Position"):
            found.setdefault(name, {})[f"{value[0]}{axis}"] = place
    roles = ("PX", "PY", "PZ", "RX", "RY", "RZ", "RW")
    bodies = tuple(
        Body(name, tuple(places[role] for role in roles), metres)
        for name, places in found.items()
        if places.keys() >= set(roles)
    )
    if not bodies:
        raise UnreadableRecording("no rigid body has both position and quaternion: export it with both")
    return TableLayout("Motive", ",", head + 1, 1, 10.0**9, bodies)


def _vicon(lines: Sequence[str]) -> TableLayout:
    """Vicon Nexus and Tracker: a section with its rate, the names of bodies, of columns, and units."""
    begin = next(i for i, line in enumerate(lines) if line.strip())
    cells = [[c.strip().strip('"') for c in line.rstrip("\r\n").split(",")] for line in lines[begin:]]
    section = cells[0][0]
    if section not in ("Objects", "Segments") or len(cells) < 5 or not _are_numbers(cells[1][:1]):
        raise UnreadableRecording(f"its section is {section}: export Objects or Segments from Vicon")
    names, axes, units = cells[2], cells[3], cells[4]
    starts = [i for i, name in enumerate(names) if name] + [len(axes)]
    bodies = list[Body]()
    for start, end in pairwise(starts):
        places = {axis: start + i for i, axis in enumerate(axes[start:end])}
        if "RW" not in places and "RX" in places:
            raise UnreadableRecording(
                f"rotations of {names[start]} are three angles, and the file does not say which: export "
                "quaternions from Vicon"
            )
        roles = ("TX", "TY", "TZ", "RX", "RY", "RZ", "RW")
        if places.keys() >= set(roles):
            unit = units[places["TX"]] if places["TX"] < len(units) else "mm"
            subject, _, segment = names[start].removeprefix("Global Angle ").partition(":")
            name = subject if segment in ("", subject) else f"{subject}:{segment}"
            bodies.append(Body(name, tuple(places[role] for role in roles), _metres(unit or "mm")))
    if not bodies:
        raise UnreadableRecording("no object with TX to TZ and RX to RW: export quaternions from Vicon")
    return TableLayout("Vicon", ",", begin + 5, 0, 1e9 / float(cells[1][0]), tuple(bodies))


def _metres(unit: str) -> float:
    try:
        return _UNITS[unit.lower()]
    except KeyError:
        raise UnreadableRecording(f"its unit of length is {unit}: export metres or millimetres") from None
