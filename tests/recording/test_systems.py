"""The commands in docs/systems.md on files as the systems write them."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from contact_tracker.cli.main import build_parser
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from mcap_logs import smooth_poses

PAGE = Path(__file__).resolve().parents[2] / "docs" / "systems.md"
POSES = smooth_poses(60)
T = (POSES.stamp_ns - POSES.stamp_ns[0]) * 1e-9
P, Q, TURN = POSES.position_m, POSES.quat_xyzw, POSES.rotation
REAL_FIRST = np.roll(Q, 1, axis=1)
FOUR = np.tile(np.eye(4), (len(T), 1, 1))
FOUR[:, :3, :3], FOUR[:, :3, 3] = TURN, P


def by_rotation(kind: str, *given: Any) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return np.asarray(getattr(Rotation.from_quat(Q), f"as_{kind}")(*given))


def text(names: str, *columns: Any) -> Callable[[Path], None]:
    rows = np.column_stack(columns)
    return lambda path: np.savetxt(path, rows, "%.12g", ",", header=names, comments="")


def numbered(name: str, count: int) -> str:
    return ",".join(f"{name}{i}" for i in range(count))


def lerobot(path: Path) -> None:
    state = pyarrow.array(np.c_[P, Q].tolist(), pyarrow.list_(pyarrow.float64(), 7))
    parquet.write_table(pyarrow.table({"observation.state": state, "timestamp": T}), path)


SYSTEMS: dict[str, Callable[[Path], None]] = {
    "ART DTrack": text(f"time,x,y,z,{numbered('b', 9)}", T, 1e3 * P, TURN.transpose(0, 2, 1).reshape(-1, 9)),
    "Vive, OpenVR": text(f"time,{numbered('m', 12)}", T, FOUR[:, :3].reshape(-1, 12)),
    "UR": text(f"timestamp,{numbered('actual_TCP_pose_', 6)}", T, P, by_rotation("rotvec")),
    "Franka": text(
        "time," + ",".join(f"O_T_EE[{i}]" for i in range(16)), T, FOUR.transpose(0, 2, 1).reshape(-1, 16)
    ),
    "FANUC": text("time,X,Y,Z,W,P,R", T, 1e3 * P, by_rotation("euler", "xyz", True)),
    "OpenSim": lambda path: np.savetxt(
        path,
        np.column_stack([T, P, by_rotation("euler", "XYZ", True)]),
        "%.12g",
        "\t",
        header="Kinematics\nnRows=60\ninDegrees=yes\nendheader\n"
        + "\t".join(["time", *(f"cup_{name}" for name in ("X", "Y", "Z", "Ox", "Oy", "Oz"))]),
        comments="",
    ),
    "Unity": lambda path: path.write_text(
        "Time,Position,Rotation\n"
        + "".join(
            f'{t!r},"{tuple(p)}","{tuple(q)}"\n'
            for t, p, q in zip(*(x.tolist() for x in (T, P, Q)), strict=True)
        )
    ),
    "KUKA": text("time,X,Y,Z,A,B,C", T, 1e3 * P, by_rotation("euler", "ZYX", True)),
    "ABB": text("time,X,Y,Z,q1,q2,q3,q4", T, 1e3 * P, REAL_FIRST),
    "FoundationPose without ROS": lambda path: np.save(path, FOUR),
    "MuJoCo": lambda path: np.savez(path, time=T, qpos=np.c_[P, REAL_FIRST]),
    "Isaac Lab": lambda path: np.savez(path, time=T, pos=P, quat=REAL_FIRST),
    "LeRobot": lerobot,
}


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_command_of_a_system_reads_its_export(tmp_path: Path, system: str) -> None:
    row = next(line for line in PAGE.read_text().splitlines() if line.startswith(f"| {system} |"))
    found = re.search(r"`contact-tracker (segment [^`]+)`", row)
    assert found is not None
    words = shlex.split(found[1])
    path = tmp_path / words[1]
    SYSTEMS[system](path)
    args = build_parser().parse_args(words)
    poses = Poses.collect(open_log(str(path), table=args.table))
    np.testing.assert_allclose(poses.position_m, P, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.abs(np.sum(poses.quat_xyzw * Q, axis=1)), 1.0, rtol=0, atol=1e-9)
    if system != "FoundationPose without ROS":  # whose poses have no times, but a rate
        np.testing.assert_allclose((poses.stamp_ns - poses.stamp_ns[0]) * 1e-9, T, rtol=0, atol=1e-6)
