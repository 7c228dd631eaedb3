"""Poses in arrays of numbers in messages: states of robots, and lists in JSON."""

import json
import re
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.config.table_reading import TableReading, reading_of
from contact_tracker.errors import ChoiceError, InputError, NoPoses
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording import open_log, summarise
from mcap_logs import smooth_poses
from pose_files import write_raw

POSES = smooth_poses(60)
RULE = "=" * 80 + "\n"
FRANKA = (
    "std_msgs/Header header\nfloat64[7] q\nfloat64[16] F_T_EE\nfloat64[16] O_T_EE\n"
    f"{RULE}MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
)
MULTI_ARRAY = (
    f"std_msgs/MultiArrayLayout layout\nfloat64[] data\n{RULE}MSG: std_msgs/MultiArrayLayout\n"
    f"std_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n{RULE}"
    "MSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n"
)


def quaternion(pose: Pose) -> list[float]:
    return [*pose.position_m, *pose.quat_xyzw]


def real_part_first(pose: Pose) -> list[float]:
    return [*pose.position_m, *np.roll(pose.quat_xyzw, 1)]


def in_mm_and_deg(pose: Pose) -> list[float]:
    angles = Rotation.from_quat(pose.quat_xyzw).as_euler("ZYX", degrees=True)
    return [*(1e3 * np.array(pose.position_m)), *angles[::-1]]


def write_states(path: Path) -> Path:
    """States of a robot in ROS 1 with a matrix along columns, in the frame ``base``."""

    def message(number: int, pose: Pose) -> bytes:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(pose.quat_xyzw).as_matrix(), pose.position_m
        head = struct.pack("<4I", number, *divmod(pose.stamp_ns, 10**9), 4) + b"base"
        return head + struct.pack("<39d", *[0.1] * 7, *np.eye(4).ravel(), *matrix.T.ravel())

    rows = [(pose.stamp_ns + 5, message(number, pose)) for number, pose in enumerate(POSES)]
    return write_raw(path, "franka_msgs/FrankaState", "ros1", "ros1msg", FRANKA.encode(), rows)


def write_arrays(path: Path, values: Callable[[Pose], Sequence[float]]) -> Path:
    """Arrays of ROS 2, which have no stamp."""
    rows = []
    for pose in POSES:
        numbers = values(pose)
        head = b"\0\1\0\0" + struct.pack("<4I", 0, 0, len(numbers), 0)
        rows.append((pose.stamp_ns, head + struct.pack(f"<{len(numbers)}d", *numbers)))
    return write_raw(path, "std_msgs/msg/Float64MultiArray", "cdr", "ros2msg", MULTI_ARRAY.encode(), rows)


def assert_read(path: Path, reading: TableReading) -> None:
    poses = Poses.collect(open_log(str(path), table=reading))
    np.testing.assert_array_equal(poses.stamp_ns, POSES.stamp_ns)
    np.testing.assert_allclose(poses.position_m, POSES.position_m, atol=1e-12)
    np.testing.assert_allclose(np.abs((poses.quat_xyzw * POSES.quat_xyzw).sum(axis=1)), 1.0, atol=1e-12)


@pytest.mark.parametrize("columns", [None, "matrix=O_T_EE"])
def test_a_matrix_in_a_state_of_a_robot(tmp_path: Path, columns: str | None) -> None:
    path = write_states(tmp_path / "a.mcap")
    reading = reading_of(columns, field="O_T_EE", matrix="columns")
    assert_read(path, reading)
    (source,) = (entry.source for entry in summarise(str(path), reading).sources)
    assert source.frame_id == "base"


@pytest.mark.parametrize(
    ("values", "columns", "how"),
    [
        (quaternion, "position=data[0:3],quaternion=data[3:7]", {}),
        (real_part_first, "position=data[0:3],wxyz=data[3:7]", {}),
        (in_mm_and_deg, "position=data[0:3],rotation=data[3:6]", {"unit": "mm", "euler": "xyz:deg"}),
    ],
)
def test_an_array_is_read_as_columns_are(
    tmp_path: Path, values: Callable[[Pose], Sequence[float]], columns: str, how: dict[str, str]
) -> None:
    """The command for it is named: first the field, then what its numbers are."""
    path = write_arrays(tmp_path / "a.mcap", values)
    with pytest.raises(NoPoses, match=r"numbers in data: if these are poses, .* --field data$"):
        open_log(str(path))
    given = reading_of(columns, field="data", **how)
    options = re.escape(" ".join(given.words()).replace(columns, f"'{columns}'").partition(" --field")[0])
    with pytest.raises(InputError, match=f"{options}.* --field data"):
        open_log(str(path), table=TableReading(field="data"))
    assert_read(path, given)


def test_a_list_in_json(tmp_path: Path) -> None:
    rows = [(pose.stamp_ns, json.dumps({"arm": {"tcp": quaternion(pose)}}).encode()) for pose in POSES]
    rows[30:30] = [(rows[30][0], b'{"arm": {"tcp": [1.0, 2.0]}}'), (rows[30][0], b'{"arm": {}}')]
    path = write_raw(tmp_path / "a.mcap", "State", "json", "jsonschema", b"{}", rows)
    columns = "position=tcp[0:3],quaternion=tcp[3:7]"
    assert_read(path, reading_of(columns, field="arm.tcp"))
    log = open_log(str(path), table=reading_of(columns, field="arm.tcp"))
    assert len(Poses.collect(log)) == len(POSES)
    assert log.counts == {"log_time_as_stamp": len(POSES), "undecodable": 2}


def test_rows_of_a_matrix_in_json_after_empty_ones(tmp_path: Path) -> None:
    def rows_of(pose: Pose) -> list[list[float]]:
        turn = Rotation.from_quat(pose.quat_xyzw).as_matrix()
        return np.column_stack([turn, pose.position_m]).tolist()

    rows = [(int(POSES.stamp_ns[0]) - 1, b'{"pose": []}')]
    rows += [(pose.stamp_ns, json.dumps({"pose": rows_of(pose)}).encode()) for pose in POSES]
    path = write_raw(tmp_path / "a.mcap", "State", "json", "jsonschema", b"{}", rows)
    assert_read(path, reading_of(field="pose", matrix="rows"))


def test_arrays_in_a_list_are_bodies_beside_messages_of_other_types(tmp_path: Path) -> None:
    """One that is empty for a while is counted neither as a pose nor as a mistake."""
    arms = [
        {
            "arms": [
                {"name": name, "tcp": quaternion(pose) if name == "left" else []}
                for name in ("left", "right")
            ]
        }
        for pose in POSES
    ]
    arms[30]["arms"][0]["tcp"] = []
    arms[40]["arms"][1]["tcp"] = quaternion([*POSES][40])
    rows = [(pose.stamp_ns, json.dumps(arm).encode()) for pose, arm in zip(POSES, arms, strict=True)]
    path = write_raw(tmp_path / "a.mcap", "State", "json", "jsonschema", b"{}", rows)
    reading = reading_of("position=tcp[0:3],quaternion=tcp[3:7]", field="arms.tcp")
    assert len(Poses.collect(open_log(str(path), frame="left", table=reading))) == len(POSES) - 1
    assert {entry.source.child_frame_id for entry in summarise(str(path), reading).sources} == {
        "left",
        "right",
    }


@pytest.mark.parametrize(
    ("columns", "how"),
    [("time=data[0],position=data[1:4],quaternion=data[4:8]", {}), (None, {"time_unit": "ms"})],
)
def test_times_of_arrays_are_the_stamps_of_their_messages(
    tmp_path: Path, columns: str | None, how: dict[str, str]
) -> None:
    path = write_arrays(tmp_path / "a.mcap", quaternion)
    with pytest.raises(ChoiceError, match="times of messages are their stamps"):
        open_log(str(path), table=reading_of(columns, field="data", **how))
