"""Wrenches of a recording: in the frame of a sensor, whose pose is on /tf and /tf_static, or unusable.

Expected values are computed independently: a wrench is a skew 4 x 4 matrix, sum of ``x f^T - f x^T`` over
forces at points in homogeneous coordinates, and a change of frame is a product with 4 x 4 matrices.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import IndexType
from scipy.spatial.transform import Rotation

from contact_tracker.cli.main import run
from contact_tracker.config.loading import load_model
from contact_tracker.errors import InputError, UsageError
from contact_tracker.map.map import EMPTY_MAP
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording import WRENCH_TYPE, WrenchLog, open_log, read_wrenches
from contact_tracker.segmenting import recorded_evidence
from contact_tracker.states import Contact
from contact_tracker.wrenches.wrenches import Wrenches
from mcap_logs import (
    TF,
    Topic,
    pose_stamped,
    poses_topic,
    smooth_poses,
    transform,
    wrench_stamped,
    write_log,
)
from moving_frames import START_NS, TABLE, Frame, by_name, moving, static
from pressed_objects import pressed

PRESSED = pressed(Contact.VF, seed=3, noise=True, seconds=3.0)
BODY = Frame.of("world", "object", PRESSED.poses)


def carried(wrenches: Wrenches, frames: np.ndarray) -> Wrenches:
    """The wrenches transformed from ``frames`` (N, 4, 4) to their parent."""
    skew = np.zeros((len(wrenches), 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        skew[:, i, j], skew[:, j, i] = wrenches.moment_nm[:, k], -wrenches.moment_nm[:, k]
    skew[:, :3, 3], skew[:, 3, :3] = -wrenches.force_n, wrenches.force_n
    result = frames @ skew @ frames.swapaxes(1, 2)
    moment = np.column_stack([result[:, 1, 2], result[:, 2, 0], result[:, 0, 1]])
    return Wrenches(wrenches.stamp_ns, result[:, 3, :3], moment)


def wrench_topic(wrenches: Wrenches, frame: str) -> Topic:
    numbers = np.concatenate([wrenches.force_n, wrenches.moment_nm], axis=1)
    rows = zip(wrenches.stamp_ns.tolist(), numbers, strict=True)
    return Topic("/wrench", WRENCH_TYPE, [(at, wrench_stamped(at, row, frame)) for at, row in rows])


IN_WORLD = carried(PRESSED.wrenches, BODY.at(BODY.stamps_ns))


def in_frame(*frames: Frame) -> Wrenches:
    """The wrenches in the frame at the end of a chain from the world. The chain may contain ``BODY``, which
    has all stamps."""
    along = np.eye(4)[None]
    for frame in frames:
        along = along @ frame.at(IN_WORLD.stamp_ns)
    return carried(IN_WORLD, np.linalg.inv(along))


def named_poses() -> Topic:
    """On a topic of their own, with the name of the body."""
    rows = [(p.stamp_ns, transform(*p, frame="world", child="object")) for p in PRESSED.poses]
    return Topic("/object/pose", "geometry_msgs/msg/TransformStamped", rows)


def unnamed_poses(frame: str = "world") -> Topic:
    rows = [(p.stamp_ns, pose_stamped(*p, frame=frame)) for p in PRESSED.poses]
    return Topic("/object/pose", "geometry_msgs/msg/PoseStamped", rows)


def write(path: Path, wrenches: Topic, *frames: Frame, poses: Topic | None = None, **options: Any) -> Path:
    topics = [poses or named_poses(), wrenches, *by_name(frame.topic for frame in frames)]
    return write_log(path, topics, **options)


def read(path: Path, wrenches: str = "/wrench", **choice: str) -> WrenchLog:
    log = open_log(str(path), **choice)
    return read_wrenches(str(path), wrenches, log.source, Poses.collect(log))


def assert_are(result: Wrenches, expected: Wrenches, tolerance: float = 1e-9) -> None:
    np.testing.assert_array_equal(result.stamp_ns, expected.stamp_ns)
    np.testing.assert_allclose(result.force_n, expected.force_n, atol=tolerance)
    np.testing.assert_allclose(result.moment_nm, expected.moment_nm, atol=tolerance)


CHAINS: dict[str, list[Frame]] = {
    "in the frame of the poses": [],
    "on the body": [BODY, static("object", "ft")],
    "on the body, by steps": [BODY, static("object", "gripper"), static("gripper", "ft", TABLE)],
    "in the world": [static("world", "table", TABLE), static("table", "ft")],
    "on a flange": [moving("world", "flange"), static("flange", "ft")],
    "on an arm": [static("world", "base", TABLE), moving("base", "tool0"), moving("tool0", "ft", 6, 41.0)],
}


@pytest.mark.parametrize("poses", [named_poses(), unnamed_poses()], ids=["named", "unnamed"])
@pytest.mark.parametrize("name", CHAINS)
def test_wrenches_of_a_sensor_are_those_of_the_world(tmp_path: Path, name: str, poses: Topic) -> None:
    frames = CHAINS[name]
    published = [frame for frame in frames if frame is not BODY]
    if poses.type.endswith("PoseStamped") and len(published) < len(frames):
        published.append(BODY)  # otherwise the frame of the body is unknown
    path = write(
        tmp_path / "log.mcap",
        wrench_topic(in_frame(*frames), "ft" if frames else "world"),
        *published,
        poses=poses,
    )
    result = read(path, topic="/object/pose")
    assert (result.dropped, result.unplaced, result.bad_transforms) == (0, 0, 0)
    assert_are(result.wrenches, PRESSED.wrenches)


def test_wrenches_that_are_logged_late_and_in_another_order(tmp_path: Path) -> None:
    frames = CHAINS["on a flange"]
    topic, delay_ns = (
        wrench_topic(in_frame(*frames), "ft"),
        np.random.default_rng(2).integers(0, 2 * 10**9, 9999),
    )
    late = [(at + int(by), data) for (at, data), by in zip(topic.messages, delay_ns, strict=False)]
    result = read(write(tmp_path / "log.mcap", replace(topic, messages=late), *frames), topic="/object/pose")
    assert (result.dropped, result.unplaced) == (0, 0)
    assert_are(result.wrenches, PRESSED.wrenches)


def test_transforms_are_found_without_an_index_and_however_late(tmp_path: Path) -> None:
    rest = static("world", "base", TABLE)
    late = replace(rest, stamps_ns=rest.stamps_ns + 5 * 10**9)
    frames = [late, *CHAINS["on an arm"][1:]]
    options = {"index_types": IndexType.NONE, "use_statistics": False, "repeat_channels": False}
    path = write(tmp_path / "log.mcap", wrench_topic(in_frame(*frames), "ft"), *frames, **options)
    assert read(path, topic="/object/pose").unplaced == 0


@pytest.mark.parametrize("choice", [{"frame": "base->object"}, {"topic": "/pose"}])
def test_poses_that_are_composed_themselves(tmp_path: Path, choice: dict[str, str]) -> None:
    """An arm carries sensor and object; the chain between them is static."""
    arm, mount = moving("base", "flange", hz=200.0), static("flange", "object", TABLE)
    poses = Poses.collect(
        Pose(int(at), tuple(place[:3, 3]), tuple(Rotation.from_matrix(place[:3, :3]).as_quat()))
        for at, place in zip(arm.stamps_ns, arm.at(arm.stamps_ns) @ mount.at(arm.stamps_ns), strict=True)
    )
    rows = [(p.stamp_ns, pose_stamped(*p, frame="base")) for p in poses]
    direct = Topic("/pose", "geometry_msgs/msg/PoseStamped", rows)
    sensor = static("flange", "ft")
    to_object = np.linalg.inv(mount.at(IN_WORLD.stamp_ns)) @ sensor.at(IN_WORLD.stamp_ns)
    path = write(tmp_path / "log.mcap", wrench_topic(IN_WORLD, "ft"), arm, mount, sensor, poses=direct)
    expected = carried(IN_WORLD, to_object)
    result = read(path, **choice)
    # without a child frame the chain goes through the interpolated arm and back by the nearest pose
    tolerance = 1e-9 if "frame" in choice else 0.3
    assert_are(result.wrenches, expected, tolerance)


def test_poses_that_are_relative_to_another_body(tmp_path: Path) -> None:
    """The frame of the wrenches, the world, is then the parent of the other body's poses."""
    other = moving("world", "", hz=200.0)
    rows = zip(other.stamps_ns.tolist(), other.position_m, other.rotation.as_quat(), strict=True)
    table = Topic("/table/pose", "geometry_msgs/msg/PoseStamped", [(r[0], pose_stamped(*r)) for r in rows])
    topics = [unnamed_poses(), table, wrench_topic(IN_WORLD, "world")]
    result = read(write_log(tmp_path / "log.mcap", topics), topic="/object/pose", relative_to="/table/pose")
    assert_are(result.wrenches, PRESSED.wrenches)


def test_a_frame_that_is_not_connected_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "log.mcap", wrench_topic(IN_WORLD, "ft"), static("tool0", "ft"))
    with pytest.raises(UsageError, match=r"frame ft, and no transforms .* object \(object\) or of its poses"):
        read(path)
    assert run(["segment", str(path), "--topic", "/object/pose", "--wrench", "/wrench"]) == 2
    assert "record them too, or transform the wrenches first" in capsys.readouterr().err


def test_an_unknown_frame_is_the_objects_if_the_object_has_no_name(tmp_path: Path) -> None:
    """Unless transforms name it: then it is another frame, at an unknown pose."""
    unnamed = unnamed_poses()
    result = read(write(tmp_path / "a.mcap", wrench_topic(PRESSED.wrenches, "o"), poses=unnamed))
    np.testing.assert_array_equal(result.wrenches.force_n, PRESSED.wrenches.force_n)
    assert result.taken == "in the frame o, which no transform names: taken as the object's"
    with pytest.raises(UsageError, match="no transforms"):
        read(
            write(tmp_path / "b.mcap", wrench_topic(IN_WORLD, "o"), static("tool0", "o"), poses=unnamed),
            topic="/object/pose",
        )


@pytest.mark.parametrize("poses", [named_poses(), unnamed_poses()], ids=["named", "unnamed"])
def test_an_empty_frame_id_is_the_objects(tmp_path: Path, poses: Topic) -> None:
    result = read(write(tmp_path / "log.mcap", wrench_topic(PRESSED.wrenches, ""), poses=poses))
    np.testing.assert_array_equal(result.wrenches.moment_nm, PRESSED.wrenches.moment_nm)
    assert result.taken == "in no frame that is named: taken as the object's"


def test_wrenches_before_the_first_transform_are_left_out_and_counted(tmp_path: Path) -> None:
    flange = moving("world", "ft", start_s=1.0)
    path = write(tmp_path / "log.mcap", wrench_topic(in_frame(flange), "ft"), flange)
    result = read(path, topic="/object/pose")
    early = PRESSED.wrenches.stamp_ns < flange.stamps_ns[0]
    assert result.unplaced == early.sum()
    assert_are(result.wrenches, PRESSED.wrenches.at(np.flatnonzero(~early)))
    assert f"left out {early.sum()} at times at which the pose of ft is not known" in result.noted


def test_transforms_of_another_time_are_an_error_in_one_line(tmp_path: Path) -> None:
    flange = moving("world", "ft", start_s=6.1)
    path = write(tmp_path / "log.mcap", wrench_topic(IN_WORLD, "ft"), flange)
    with pytest.raises(InputError, match=r"pose in world is not known .* on /wrench and /tf of one clock"):
        read(path, topic="/object/pose")


def test_invalid_transforms_are_left_out_and_counted(tmp_path: Path) -> None:
    flange = moving("world", "ft")
    topic = flange.topic
    at = START_NS + 2 * 10**9 + 1
    bad = (at, {"transforms": [transform(at, [0, 0, 0], [0, 0, 0, 0], "world", "ft")]})
    topics = [named_poses(), wrench_topic(in_frame(flange), "ft"), Topic("/tf", TF, [*topic.messages, bad])]
    result = read(write_log(tmp_path / "log.mcap", topics), topic="/object/pose")
    assert (result.bad_transforms, result.unplaced) == (1, 0)
    np.testing.assert_allclose(result.wrenches.force_n, PRESSED.wrenches.force_n, atol=1e-9)


POSES = smooth_poses(400)
CONSTANT = [(at, wrench_stamped(at, [1.0, 2.0, 3.0, 0.1, 0.2, 0.3])) for at in POSES.stamp_ns.tolist()]


def log_with(folder: Path, messages: list[tuple[int, Any]]) -> Path:
    return write_log(folder / "a.mcap", [poses_topic(POSES), Topic("/wrench", WRENCH_TYPE, messages)])


def test_frames_that_change_are_refused(tmp_path: Path) -> None:
    mixed = [*CONSTANT[:5], *((at, wrench_stamped(at, [1.0] * 6, "flange")) for at, _ in CONSTANT[5:])]
    with pytest.raises(UsageError, match="changes its frame"):
        read(log_with(tmp_path, mixed))


def test_unusable_wrenches_are_dropped_and_counted(tmp_path: Path) -> None:
    stamp, messages = CONSTANT[3][0], list(CONSTANT)
    messages[3] = (stamp, wrench_stamped(stamp, [np.nan, 0, 0, 0, 0, 0]))
    messages[4] = (stamp, wrench_stamped(stamp, [0, 0, 0, 0, np.inf, 0]))
    messages[5] = (stamp, wrench_stamped(0, [0.0] * 6))
    result = read(log_with(tmp_path, messages))
    assert result.dropped == 3
    assert len(result.wrenches) == len(POSES) - 3


def test_undecodable_wrenches_are_an_error_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="can be used"):
        read(log_with(tmp_path, [(at, b"\x00\x01\x00\x00??") for at, _ in CONSTANT]))


def test_a_missing_topic_lists_the_existing_ones(tmp_path: Path) -> None:
    path = log_with(tmp_path, CONSTANT)
    with pytest.raises(UsageError, match=r"no topic /other.*/wrench"):
        read(path, "/other")
    with pytest.raises(UsageError, match="PoseStamped"):
        read(path, "/object/pose")


def test_wrenches_without_free_motion_are_not_used(tmp_path: Path) -> None:
    """They are constant, at any pose: that is said in a line, and motion decides."""
    path = str(log_with(tmp_path, CONSTANT))
    evidence, notice, (warning,) = recorded_evidence(path, "/wrench", open_log(path), load_model(), EMPTY_MAP)
    assert evidence is None
    assert warning.startswith("/wrench is not used: ")
    assert notice == ""


def test_info_reports_the_wrench_topic(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(log_with(tmp_path, CONSTANT))
    assert run(["info", path]) == 0
    assert "--wrench /wrench" in capsys.readouterr().out


def test_wrong_usage_is_reported(tmp_path: Path) -> None:
    path = str(log_with(tmp_path, CONSTANT))
    assert run(["segment", path, "--wrench", "/none"]) == 2
