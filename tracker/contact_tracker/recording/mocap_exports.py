"""Exports of OptiTrack Motive and of Vicon, whose columns have names, kinds and units in rows above.

Motive writes rows of types, names, IDs (not always), parents (since format 1.25) and values above that of the
axes, before format 1.23 without row labels; rotations are quaternions or angles. Vicon Tracker and Nexus
write sections, each with its rate and the names of bodies, columns and units; three columns of rotation are
angles or a helical vector, which most exports do not distinguish. Names are read in any case.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, pairwise
from typing import Final

from contact_tracker.config.table_reading import TableReading, reading_of
from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.table_layouts import (
    BLANKS,
    OpenReading,
    TableLayout,
    are_numbers,
    bodies_of,
    number,
)
from contact_tracker.recording.text_rows import cells_of

_RIGID_BODY: Final = "rigid body"
_BONE: Final = "bone"
_SECTIONS: Final = ("objects", "segments")
_OTHER_SECTIONS: Final = ("trajectories", "model outputs", "devices", "joints", "events")
_ROUNDED_S: Final = 0.00051
_ORDER: Final = re.compile(r"([xyz]{3})", re.IGNORECASE)
_ABOUT: Final = re.compile(r"Global Angle\s*(?:\(([^)]*)\))?\s*")


def is_motive(first: str) -> bool:
    """Whether a file with this first line is an export of Motive."""
    return first.lstrip('\ufeff"').lower().startswith("format version")


def is_vicon(first: str) -> bool:
    """Whether a file with this first line is an export of Vicon."""
    return first.strip().strip(',;\t"').lower() in (*_SECTIONS, *_OTHER_SECTIONS)


def motive_layout(lines: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout of an export of Motive, formats 1.2 to 1.25; raises UnreadableRecording."""
    separator = _separator_after("format version", next(line for line in lines if line.strip()))
    cells = _cells(lines, separator)
    first = next(row for row in cells if row[0])
    if len(first) < 2:
        raise UnreadableRecording(
            "its columns are separated by nothing known: export it from Motive with commas"
        )
    about = {name.lower(): value for name, value in zip(first[::2], first[1::2], strict=False)}
    rotation = about.get("rotation type", "Quaternion")
    lower = [[cell.lower() for cell in row] for row in cells]
    head = next((i for i, row in enumerate(lower) if row[0] == "frame"), 0)
    kind_row = next((i for i, row in enumerate(lower[1:head], 1) if {_RIGID_BODY, _BONE} & set(row)), None)
    if kind_row is None or head - kind_row < 3 or "rotation" not in lower[head - 1]:
        raise UnreadableRecording(
            "no rigid body with Rotation and Position in its header: export it from Motive with rigid bodies"
        )
    is_local = about.get("coordinate space", "Global").lower() != "global"
    columns = zip(lower[kind_row], cells[kind_row + 1], lower[head - 1], lower[head], strict=False)
    found = dict[tuple[str, str], dict[str, int]]()
    turn = "q" if rotation.lower() == "quaternion" else "r"
    for place, (kind, name, value, axis) in enumerate(columns):
        if value in ("rotation", "position") and (kind == _RIGID_BODY or (kind == _BONE and not is_local)):
            _note(found, (kind, name), axis if value == "position" else turn + axis, place)
    unit = reading.unit or about.get("length units", about.get("units", "Meters"))
    try:
        bodies = bodies_of(_named(found), [(name, "") for name in cells[head]], reading, unit)
    except OpenReading:
        stated = reading.with_(reading_of(euler=f"{rotation}:deg")).command(path)
        raise UnreadableRecording(
            f"its rotations are {rotation}: export it from Motive with quaternions, or read them as Motive's "
            f"angles by {stated}"
        ) from None
    if not bodies:
        raise UnreadableRecording(
            "no rigid body has both position and quaternion, in global coordinates: export it with both"
        )
    time, time_ns = _motive_times(about, cells[head + 1 :])
    return TableLayout("Motive", separator, head + 1, time, time_ns, bodies, has_own_unit=True)


def _motive_times(about: Mapping[str, str], rows: Sequence[Sequence[str]]) -> tuple[int, float]:
    """The time column and its unit in nanoseconds: frame numbers where the times are those of the frames
    rounded to milliseconds, as Motive 2.3 and 3 write them; else seconds."""
    try:
        rate = number(about.get("export frame rate", ""))
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


def _named(found: dict[tuple[str, str], dict[str, int]]) -> dict[str, dict[str, int]]:
    """The bodies by name, without bones that share the name of a rigid body."""
    return {
        name: places
        for (kind, name), places in found.items()
        if kind == _RIGID_BODY or (_RIGID_BODY, name) not in found
    }


def vicon_layout(lines: Sequence[str], reading: TableReading, path: str) -> TableLayout:
    """The layout of the first section of an export of Vicon; raises UnreadableRecording."""
    begin = next(i for i, line in enumerate(lines) if line.strip())
    head = next((line for line in lines[begin:] if line.strip(BLANKS).lower().startswith("frame")), "")
    separator = _separator_after("frame", head)
    cells = _cells(lines[begin:], separator)
    section = cells[0][0]
    if section.lower() not in _SECTIONS:
        raise UnreadableRecording(
            f"its section is {section}: export Objects or Segments from Vicon, as the first section"
        )
    if len(cells) < 5 or not are_numbers(cells[1][:1]) or not number(cells[1][0]) > 0:
        raise UnreadableRecording(f"its section {section} lacks rate, names, columns or units above its rows")
    names, axes, units = cells[2], [axis.lower() for axis in cells[3]], cells[4]
    found = dict[str, dict[str, int]]()
    for start, end in pairwise([*(i for i, name in enumerate(names) if name), len(axes)]):
        turn = "q" if "rw" in axes[start:end] else "r"
        roles = {f"r{axis}": turn + axis for axis in "xyzw"} | {f"t{axis}": axis for axis in "xyz"}
        places = {roles[axis]: start + i for i, axis in enumerate(axes[start:end]) if axis in roles}
        found.setdefault(_short(names[start]), places)
    columns = [(axis, units[i].lower() if i < len(units) else "") for i, axis in enumerate(axes)]
    try:
        bodies = bodies_of(found, columns, reading, "mm")
    except OpenReading:
        raise UnreadableRecording(_refused(next(filter(None, names)), reading, path)) from None
    if not bodies:
        raise UnreadableRecording("no object with TX to TZ and RX to RW: export quaternions from Vicon")
    frame_ns = 1e9 / number(cells[1][0])
    return TableLayout("Vicon", separator, begin + 5, 0, frame_ns, bodies, has_own_unit=True)


def _refused(name: str, reading: TableReading, path: str) -> str:
    """The message on three columns of rotation, with the commands that read them."""
    about = _ABOUT.match(name)
    kind = about[1] if about is not None else None
    order = _ORDER.search(kind or "")
    ways = [reading_of(rotation_vector=True)] if order is None else [reading_of(euler=order[1].upper())]
    if not kind:
        ways.append(reading_of(euler="XYZ"))
    how = (
        f"of the kind {kind}" if kind else "three angles or a helical vector, and the file does not say which"
    )
    commands = " or ".join(reading.with_(way).command(path) for way in ways)
    return f"rotations of {_short(name)} are {how}: export quaternions from Vicon, or read them by {commands}"


def _short(name: str) -> str:
    """An object's name, without its segment's if that is the same."""
    plain = _ABOUT.sub("", name, count=1)
    subject, _, segment = plain.partition(":")
    return subject if segment in ("", subject) else plain


def _separator_after(word: str, line: str) -> str:
    """The separator of a line that begins with ``word``; a comma where uncertain."""
    mark = line.strip('" \r\n\ufeff')[len(word) :].lstrip('" ')[:1]
    return mark if mark in (";", "\t") else ","


def _cells(lines: Iterable[str], separator: str) -> list[list[str]]:
    """The cells of each line; an empty line has one empty cell."""
    rows = (cells_of(line.replace("\0", ""), separator) or [""] for line in lines)
    return [[cell.strip() for cell in row] for row in rows]
