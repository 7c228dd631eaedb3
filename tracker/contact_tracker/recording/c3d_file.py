"""C3D files with rigid bodies: matrices of the data type ROTATION, as Theia3D and Visual3D write them.

The file has a header, groups of parameters, and data in blocks of 512 bytes (https://www.c3d.org); the group
ROTATION says where its matrices are: 16 floats by columns and one of reliability, negative where there is
none (https://www.c-motion.com/v3dwiki/index.php?title=ROTATION_DATA_TYPE). It is read here, as the library
ezc3d ends the process at damaged files.
"""

import os
import struct
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from contact_tracker.config.table_reading import TableReading, reading_of
from contact_tracker.errors import ChoiceError, UnreadableRecording, printable
from contact_tracker.recording.bytestream import WorkBudget
from contact_tracker.recording.items import ROWS_AT_ONCE
from contact_tracker.recording.table_layouts import LENGTHS_M, Body, TableLayout

_BLOCK: Final = 512
_INTEL: Final = 84
_VALUES: Final = 17
_POSE: Final = 12
"""Values of a pose: the columns of the matrix and the position, without the last row."""
_KINDS: Final = {-1: "S1", 1: "i1", 2: "<i2", 4: "<f4"}
_SHOWN: Final = 5
_SUFFIX: Final = "_4x4"
_NO_BODIES: Final = (
    "it is C3D with markers ({names}), not bodies: export bodies (6D) as text; or points = "
    "ezc3d.c3d({name!r})['data']['points'] (4, markers, N), of which scipy's Rotation.align_vectors finds "
    "rotations; contact_tracker.Trajectory.from_arrays(t, p, q) takes times, positions and rotations"
)


class C3DTable:
    """The bodies of a C3D file in columns, some frames after others; after iteration ``damage`` says what is
    missing.

    Raises
    ------
    UnreadableRecording
        It is damaged, or has no bodies.
    ChoiceError
        The user says of its columns what the file says itself.
    """

    def __init__(self, path: str, reading: TableReading, budget: WorkBudget) -> None:
        self.damage: tuple[str, ...] = ()
        if reading != reading_of(unit=reading.unit):
            raise ChoiceError(f"{path}: C3D says what its rotations and times are: leave out all but --unit")
        try:
            with open(path, "rb") as file:
                head = file.read(_BLOCK)
                file.seek((head[0] - 1) * _BLOCK)
                blocks = file.read(4)
                if blocks[3] != _INTEL:
                    raise UnreadableRecording("its numbers are not those of a PC: write it for Intel")
                found = _parameters(file.read(blocks[2] * _BLOCK))
            self.layout = self._layout(found, path, reading)
            first, last = struct.unpack_from("<HH", head, 6)
            ratio = int(found.get("ROTATION:RATIO", [1])[0])
            rows = (last - first + 1) * ratio
            self._place = (path, (int(found["ROTATION:DATA_START"][0]) % 2**16 - 1) * _BLOCK)
        except (LookupError, ValueError, TypeError, struct.error, OSError) as error:
            raise UnreadableRecording(f"it is damaged: its parameters cannot be read ({error})") from error
        there = max(os.path.getsize(path) - self._place[1], 0) // (4 * _VALUES * len(self.layout.bodies))
        self._rows = there if last == 2**16 - 1 else min(rows, there)  # longer ones do not fit
        if self._rows < rows:
            self.damage = (
                f"it ends after {self._rows} of {rows} frames: if more was recorded, copy it again",
            )

    def _layout(self, found: dict[str, Any], path: str, reading: TableReading) -> TableLayout:
        names = [name for key in sorted(found) if key.startswith("ROTATION:LABELS") for name in found[key]]
        names = names[: int(found.get("ROTATION:USED", [0])[0])]
        if not names:
            markers = found.get("POINT:LABELS", [])
            shown = ", ".join(map(printable, markers[:_SHOWN])) + (", ..." if len(markers) > _SHOWN else "")
            raise UnreadableRecording(_NO_BODIES.format(names=shown or "none", name=os.path.basename(path)))
        unit = str([*found.get("ROTATION:UNITS", []), *found.get("POINT:UNITS", []), "mm"][0]).lower()
        metres = LENGTHS_M[reading.unit or unit]
        ratio = float(found.get("ROTATION:RATIO", [1])[0])
        rate = float(
            found["ROTATION:RATE"][0] if "ROTATION:RATE" in found else found["POINT:RATE"][0] * ratio
        )
        bodies = tuple(
            Body(
                name[: -len(_SUFFIX)] if name.lower().endswith(_SUFFIX) else name,
                tuple(_POSE * i + place for place in (9, 10, 11, 0, 3, 6, 1, 4, 7, 2, 5, 8)),
                metres,
                "matrix",
            )
            for i, name in enumerate(names)
        )
        if not 0.0 < rate < 1e6:
            raise ValueError(f"a rate of {rate:g} Hz")
        return TableLayout("C3D", None, 0, -1, 1e9 / rate, bodies, has_own_unit=True)

    def __iter__(self) -> Iterator[dict[int, Any]]:
        (path, start), bodies = self._place, len(self.layout.bodies)
        for begin in range(0, self._rows, ROWS_AT_ONCE):
            count = min(ROWS_AT_ONCE, self._rows - begin)
            values = np.fromfile(
                path, "<f4", count * bodies * _VALUES, offset=start + 4 * begin * bodies * _VALUES
            )
            matrices = values.reshape(count, bodies, _VALUES).astype(np.float64)
            matrices[matrices[:, :, -1] < 0.0] = np.nan
            poses = matrices[:, :, :16].reshape(count, bodies, 4, 4)[..., :3].reshape(count, -1)
            yield {-1: list(map(str, range(begin, begin + count))), **dict(enumerate(poses.T))}


def _parameters(data: bytes) -> dict[str, Any]:
    """The parameters as ``GROUP:NAME``; raises LookupError, ValueError or struct.error."""
    groups, found, at = dict[int, str](), list[tuple[int, str, Any]](), 0
    while at < len(data) and data[at]:
        size, group = struct.unpack_from("bb", data, at)
        name = data[at + 2 : at + 2 + abs(size)].decode("latin-1").upper()
        at += 2 + abs(size)
        (step,) = struct.unpack_from("<H", data, at)
        if group < 0:
            groups[-group] = name
        else:
            kind, rank = struct.unpack_from("bB", data, at + 2)
            shape = tuple(data[at + 4 : at + 4 + rank])
            count = int(np.prod(shape, dtype=int))
            values = np.frombuffer(data, _KINDS[kind], count, at + 4 + rank)
            found.append((group, name, _texts(values, shape) if kind == -1 else values))
        if not step:
            break
        at += step
    return {f"{groups.get(group, '')}:{name}": values for group, name, values in found}


def _texts(values: Any, shape: tuple[int, ...]) -> list[str]:
    rows = values.tobytes().decode("latin-1")
    width = shape[0] if shape else 1
    return [rows[i : i + width].strip(" \0") for i in range(0, len(rows), max(width, 1))]
