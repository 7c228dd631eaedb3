"""Exports of OptiTrack Motive and of Vicon, whose columns have names, kinds and units in rows above.

Motive writes rows of types, names, IDs (not always), parents (since format 1.25) and values above that of the
axes, before format 1.23 without row labels; rotations are quaternions or angles. Vicon Tracker and Nexus
write sections, each with its rate and the names of bodies, columns and units; three columns of rotation are
angles or a helical vector, which most exports do not distinguish.
"""

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, pairwise
from typing import Final

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.table_layouts import (
    BLANKS,
    Body,
    TableLayout,
    are_numbers,
    metres,
    number,
    separator_after,
)

_ROLES: Final = ("PX", "PY", "PZ", "RX", "RY", "RZ", "RW")
_RIGID_BODY: Final = "Rigid Body"
_BONE: Final = "Bone"
_SECTIONS: Final = ("Objects", "Segments")
_OTHER_SECTIONS: Final = ("Trajectories", "Model Outputs", "Devices", "Joints", "Events")
_ROUNDED_S: Final = 0.00051
_ABOUT: Final = re.compile(r"Global Angle\s*(?:\(([^)]*)\))?\s*")


def is_motive(first: str) -> bool:
    """Whether a file with this first line is an export of Motive."""
    return first.lstrip('\ufeff"').startswith("Format Version")


def is_vicon(first: str) -> bool:
    """Whether a file with this first line is an export of Vicon."""
    return first.strip().strip(',;\t"') in (*_SECTIONS, *_OTHER_SECTIONS)


def motive_layout(lines: Sequence[str]) -> TableLayout:
    """The layout of an export of Motive, formats 1.2 to 1.25; raises UnreadableRecording."""
    separator = separator_after("Format Version", next(line for line in lines if line.strip()))
    cells = _cells(lines, separator)
    first = next(row for row in cells if row[0])
    if len(first) < 2:
        raise UnreadableRecording(
            "its columns are separated by nothing known: export it from Motive with commas"
        )
    about = dict(zip(first[::2], first[1::2], strict=False))
    rotation = about.get("Rotation Type", "Quaternion")
    if rotation != "Quaternion":
        raise UnreadableRecording(f"its rotations are {rotation}: export it from Motive with quaternions")
    head = next((i for i, row in enumerate(cells) if row[0] == "Frame"), 0)
    kind_row = next((i for i, row in enumerate(cells[1:head], 1) if {_RIGID_BODY, _BONE} & set(row)), None)
    if kind_row is None or head - kind_row < 3 or "Rotation" not in cells[head - 1]:
        raise UnreadableRecording(
            "no rigid body with Rotation and Position in its header: export it from Motive with rigid bodies"
        )
    is_local = about.get("Coordinate Space", "Global") != "Global"
    columns = zip(cells[kind_row], cells[kind_row + 1], cells[head - 1], cells[head], strict=False)
    found = dict[tuple[str, str], dict[str, int]]()
    for place, (kind, name, value, axis) in enumerate(columns):
        if value in ("Rotation", "Position") and (kind == _RIGID_BODY or (kind == _BONE and not is_local)):
            _note(found, (kind, name), f"{value[0]}{axis}", place)
    bodies = _bodies(found, metres(about.get("Length Units", about.get("Units", "Meters"))))
    if not bodies:
        raise UnreadableRecording(
            "no rigid body has both position and quaternion, in global coordinates: export it with both"
        )
    time, time_ns = _motive_times(about, cells[head + 1 :])
    return TableLayout(
        "Motive", separator, head + 1, time, time_ns, bodies, is_ragged=True, has_own_unit=True
    )


def _motive_times(about: Mapping[str, str], rows: Sequence[Sequence[str]]) -> tuple[int, float]:
    """The time column and its unit in nanoseconds: frame numbers where the times are those of the frames
    rounded to milliseconds, as Motive 2.3 and 3 write them; else seconds."""
    try:
        rate = number(about.get("Export Frame Rate", ""))
        times = [(number(row[0]), number(row[1])) for row in rows if len(row) > 1]
    except ValueError:
        return 1, 1e9
    fits = rate > 0 and all(abs(frame / rate - time) <= _ROUNDED_S for frame, time in times)
    return (0, 1e9 / rate) if times and fits else (1, 1e9)


def _note(found: dict[tuple[str, str], dict[str, int]], body: tuple[str, str], role: str, place: int) -> None:
    """Note one column of a body; another body of the same kind and name gets a number."""
    kind, name = body
    numbered = chain([body], ((kind, f"{name} {i}") for i in range(2, 1000)))
    free = next((one for one in numbered if role not in found.get(one, ())), None)
    if free is not None:
        found.setdefault(free, {})[role] = place


def _bodies(found: dict[tuple[str, str], dict[str, int]], unit_m: float) -> tuple[Body, ...]:
    """The bodies with all columns, without bones that share the name of a rigid body."""
    whole = {body: places for body, places in found.items() if places.keys() >= set(_ROLES)}
    return tuple(
        Body(name, tuple(places[role] for role in _ROLES), unit_m)
        for (kind, name), places in whole.items()
        if kind == _RIGID_BODY or (_RIGID_BODY, name) not in whole
    )


def vicon_layout(lines: Sequence[str]) -> TableLayout:
    """The layout of the first section of an export of Vicon; raises UnreadableRecording."""
    begin = next(i for i, line in enumerate(lines) if line.strip())
    head = next((line for line in lines[begin:] if line.strip(BLANKS).startswith("Frame")), "")
    separator = separator_after("Frame", head)
    cells = _cells(lines[begin:], separator)
    section = cells[0][0]
    if section not in _SECTIONS:
        raise UnreadableRecording(
            f"its section is {section}: export Objects or Segments from Vicon, as the first section"
        )
    if len(cells) < 5 or not are_numbers(cells[1][:1]) or not number(cells[1][0]) > 0:
        raise UnreadableRecording(f"its section {section} lacks rate, names, columns or units above its rows")
    names, axes, units = cells[2], cells[3], cells[4]
    bodies, angles = list[Body](), list[str]()
    for start, end in pairwise([*(i for i, name in enumerate(names) if name), len(axes)]):
        places = {axis: start + i for i, axis in enumerate(axes[start:end])}
        roles = [role.replace("P", "T") for role in _ROLES]
        if "RX" in places and "RW" not in places:
            angles.append(names[start])
        elif places.keys() >= set(roles):
            unit = units[places["TX"]] if places["TX"] < len(units) else ""
            chosen = tuple(places[role] for role in roles)
            bodies.append(Body(_short(names[start]), chosen, metres(unit or "mm")))
    if angles and not bodies:
        raise UnreadableRecording(_refused(angles[0]))
    if not bodies:
        raise UnreadableRecording("no object with TX to TZ and RX to RW: export quaternions from Vicon")
    frame_ns = 1e9 / number(cells[1][0])
    return TableLayout(
        "Vicon", separator, begin + 5, 0, frame_ns, tuple(bodies), is_ragged=True, has_own_unit=True
    )


def _refused(name: str) -> str:
    """The message on three columns of rotation, which are not read."""
    about = _ABOUT.match(name)
    kind = about[1] if about is not None else None
    unknown = "three angles or a helical vector, and the file does not say which"
    how = f"of the kind {kind}" if kind else unknown
    return f"rotations of {_short(name)} are {how}: export quaternions from Vicon"


def _short(name: str) -> str:
    """An object's name, without its segment's if that is the same."""
    plain = _ABOUT.sub("", name, count=1)
    subject, _, segment = plain.partition(":")
    return subject if segment in ("", subject) else plain


def _cells(lines: Iterable[str], separator: str) -> list[list[str]]:
    """The cells of each line; an empty line has one empty cell."""
    try:
        rows = [next(csv.reader([line.replace("\0", "")], delimiter=separator), []) for line in lines]
    except csv.Error as error:
        raise UnreadableRecording(f"the rows above its columns cannot be read: {error}") from error
    return [[cell.strip() for cell in row] or [""] for row in rows]
