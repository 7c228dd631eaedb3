"""Files in the format of exports of OptiTrack Motive."""

import csv
from pathlib import Path

from contact_tracker.motion.poses import Poses

_BODY = ["Rigid Body"] * 8 + ["Rigid Body Marker"] * 3 + ["Rigid Body"] * 7
VALUES = ["Rotation"] * 4 + ["Position"] * 3
_NAMES = [*["cup"] * 8, *['"cup:Marker, 1"'] * 3, *["table"] * 7]
ABOUT = (
    "Format Version,{version},Take Name,take,Capture Frame Rate,200.0,Export Frame Rate,200.0,"
    "Capture Start Time,2023-06-02 12.09.45 PM,Rotation Type,{rotation},Length Units,{units},"
    "Coordinate Space,Global"
)
HEADS = {
    "1.22": [["", "", *_BODY], ["", "", *_NAMES]],
    "1.23": [["", "Type", *_BODY], ["", "Name", *_NAMES], ["", "ID", *map(str, range(18))]],
    "1.25": [
        ["", "Type", *_BODY],
        ["", "Name", *_NAMES],
        ["", "ID", *map(str, range(18))],
        ["", "Parent", *["Root"] * 18],
    ],
}
"""The rows of names that formats of Motive 2 and 3 have, as in exports that others have published."""


def write_motive(
    path: Path,
    cup: Poses,
    table: Poses,
    rotation: str = "Quaternion",
    units: str = "Millimeters",
    version: str = "1.23",
    hidden: slice = slice(0),
) -> Path:
    """As Motive exports two rigid bodies and a marker, at 200 Hz; the cup is lost in ``hidden`` frames."""
    scale = 1e3 if units == "Millimeters" else 1.0
    with path.open("w", newline="", encoding="utf-8-sig") as file:
        file.write(ABOUT.format(version=version, rotation=rotation, units=units) + "\n\n")
        file.writelines(",".join(row) + "\n" for row in HEADS[version])
        file.write(",".join(["", "", *VALUES, "Mean Marker Error", *["Position"] * 3, *VALUES]) + "\n")
        file.write("Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,X,Y,Z,W,X,Y,Z\n")
        for i, (a, b) in enumerate(zip(cup, table, strict=True)):
            first = [*a.quat_xyzw, *(scale * v for v in a.position_m), 0.1]
            second = [*b.quat_xyzw, *(scale * v for v in b.position_m)]
            if i in range(*hidden.indices(len(cup))):
                first = [""] * 8
            csv.writer(file).writerow([i, f"{i / 200:.6f}", *first, 0, 0, 0, *second])
    return path
