"""The commands in docs/systems.md on files as the systems write them."""

import re
import shlex
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from test_field_exports import EXPORTS
from test_table_readings import PROPOSALS

from pose_tables import MATRICES, REAL_FIRST, WHOLE, P, T, assert_read, numbered, rows, write

PAGE = Path(__file__).resolve().parents[2] / "docs" / "systems.md"


def as_proposed(name: str, path: Path) -> Path:
    """The columns for which a command is also proposed."""
    names, lines, _ = PROPOSALS[name]
    return write(path, [names], lines)


PARTS = "tx", "ty", "tz", "qx", "qy", "qz", "qw"
SYSTEMS: dict[str, Callable[[Path], object]] = {
    **{name: partial(as_proposed, name) for name in ("UR", "FANUC", "KUKA", "ABB")},
    "Franka": partial(as_proposed, "libfranka"),
    "OpenSim": partial(as_proposed, "OpenSim's kinematics"),
    "Unity": partial(as_proposed, 'cells with several values "({})", '),
    "ART DTrack": lambda path: write(
        path, [f"time,x,y,z,{numbered('b{}', 9)}"], rows(T, 1e3 * P, MATRICES.transpose(0, 2, 1))
    ),
    "Vive, OpenVR": lambda path: write(path, [f"time,{numbered('m{}', 12)}"], rows(T, WHOLE[:, :3])),
    "FoundationPose without ROS": lambda path: np.save(path, WHOLE),
    "BOP": EXPORTS["bop.json"],
    "MuJoCo": lambda path: np.savez(path, time=T, qpos=np.c_[P, REAL_FIRST]),
    "Isaac Lab": lambda path: np.savez(path, time=T, pos=P, quat=REAL_FIRST),
    "LeRobot": EXPORTS["lists of seven.parquet"],
    "Project Aria, HOT3D": lambda path: write(
        path,
        ["tracking_timestamp_us," + ",".join(f"{part}_world_device" for part in PARTS)],
        rows(1e6 * T, P, REAL_FIRST[:, [1, 2, 3, 0]]),
    ),
    "PX4": lambda path: write(
        path,
        [f"timestamp,timestamp_sample,{numbered('position[{}]', 3)},{numbered('q[{}]', 4)}"],
        rows(1e6 * T, 1e6 * T, P, REAL_FIRST),
    ),
}


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_command_of_a_system_reads_its_export(tmp_path: Path, system: str) -> None:
    row = next(line for line in PAGE.read_text().splitlines() if line.startswith(f"| {system} |"))
    match = re.search(r"`contact-tracker (segment [^`]+)`", row)
    _, name, *options = shlex.split(match[1])
    SYSTEMS[system](tmp_path / name)
    assert_read(tmp_path / name, *(option.replace("30Hz", "200Hz") for option in options))
