"""Poses in frames other than the published one: chains of transforms, and relative to other bodies."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.errors import AmbiguousSource, ChoiceError
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording import PoseSource, open_log
from contact_tracker.recording.transforms import TransformTree
from mcap_logs import START_NS, TF, Topic, joined, poses_topic, smooth_poses, tf_topic, transform, write_log
from traced_memory import memory_below

MOUNT = Pose(START_NS, (0.1, -0.2, 0.3), tuple(Rotation.from_euler("xyz", [0.3, -0.5, 0.7]).as_quat()))


def matrix(position: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """The 4 x 4 matrix of a pose, by the formula of quaternions."""
    x, y, z, w = quat / np.sqrt(quat @ quat)
    turn = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.block([[np.array(turn), np.reshape(position, (3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])


def interpolated(poses: Poses, stamp_ns: int) -> np.ndarray:
    """The 4 x 4 matrix at ``stamp_ns``: position linear, quaternion along the shortest arc."""
    i = min(int(np.searchsorted(poses.stamp_ns, stamp_ns, side="right")) - 1, len(poses) - 2)
    share = float(stamp_ns - poses.stamp_ns[i]) / float(poses.stamp_ns[i + 1] - poses.stamp_ns[i])
    a, b = poses.quat_xyzw[i], poses.quat_xyzw[i + 1]
    b = b if a @ b > 0 else -b
    angle = np.arccos(min(1.0, a @ b))
    quat = a if angle < 1e-12 else (np.sin((1 - share) * angle) * a + np.sin(share * angle) * b)
    return matrix((1 - share) * poses.position_m[i] + share * poses.position_m[i + 1], quat)


def assert_is(result: Poses, stamps_ns: np.ndarray, expected: Callable[[int, int], np.ndarray]) -> None:
    """Compare poses with ``expected(index, stamp_ns)``, to 1e-9."""
    np.testing.assert_array_equal(result.stamp_ns, stamps_ns)
    for i, stamp_ns in enumerate(stamps_ns.tolist()):
        got = matrix(result.position_m[i], result.quat_xyzw[i])
        np.testing.assert_allclose(got, expected(i, stamp_ns), rtol=0, atol=1e-9)


def faster(count: int, rate_hz: float, seed: int, start_ns: int = START_NS) -> Poses:
    """More motion from sample to sample than ``smooth_poses`` has."""
    poses = smooth_poses(count, 20, seed)
    return Poses(start_ns + np.round(np.arange(count) / rate_hz * 1e9).astype(int), *poses.columns[1:])


def by(poses: Poses) -> list[np.ndarray]:
    return [matrix(p, q) for p, q in zip(poses.position_m, poses.quat_xyzw, strict=True)]


FLANGE = faster(400, 97.0, 1)
OBJECT = faster(100, 31.0, 2, START_NS + 50_000_000)


def write_arm(path: Path, **options: int) -> Path:
    """world -> flange moves, flange -> camera is mounted, camera -> object moves."""
    arm = joined(tf_topic(FLANGE, "world", "flange"), tf_topic(OBJECT, "camera", "object"))
    static = tf_topic([MOUNT], "flange", "camera", "/tf_static")
    return write_log(path, [arm, static], **options)


@pytest.mark.parametrize("chunk_size", [500, 2**20])
@pytest.mark.parametrize("in_columns", [False, True])
def test_a_chain_whose_parent_moves(tmp_path: Path, chunk_size: int, in_columns: bool) -> None:
    path = write_arm(tmp_path / "a.mcap", chunk_size=chunk_size)
    log = open_log(str(path), frame="world->object")
    result = Poses.join(list(log.batches())) if in_columns else Poses.collect(log)
    mount = matrix(np.array(MOUNT.position_m), np.array(MOUNT.quat_xyzw))
    seen = by(OBJECT)
    assert_is(result, OBJECT.stamp_ns, lambda i, stamp: interpolated(FLANGE, stamp) @ mount @ seen[i])
    assert (log.source.topic, log.source.frames) == ("/tf", "world->object")
    assert log.counts == {}


def test_a_chain_up_and_down_the_tree(tmp_path: Path) -> None:
    """From one branch to another; the transforms of the first are inverted."""
    source = faster(300, 80.0, 7)
    topics = joined(
        tf_topic(FLANGE, "world", "flange"),
        tf_topic(OBJECT, "flange", "object"),
        tf_topic(source, "world", "tool"),
    )
    path = write_log(tmp_path / "a.mcap", [topics])
    result = Poses.collect(open_log(str(path), frame="tool->object"))
    seen = by(OBJECT)
    assert_is(
        result,
        OBJECT.stamp_ns,
        lambda i, t: np.linalg.inv(interpolated(source, t)) @ interpolated(FLANGE, t) @ seen[i],
    )


def test_relative_to_a_frame(tmp_path: Path) -> None:
    """A PoseStamped in the camera's frame is transformed to the world."""
    topics = [
        tf_topic(FLANGE, "world", "flange"),
        tf_topic([MOUNT], "flange", "camera", "/tf_static"),
        poses_topic(OBJECT, frame="camera"),
    ]
    path = str(write_log(tmp_path / "a.mcap", topics))
    log = open_log(path, topic="/object/pose", relative_to="world")
    mount, seen = matrix(np.array(MOUNT.position_m), np.array(MOUNT.quat_xyzw)), by(OBJECT)
    assert_is(Poses.collect(log), OBJECT.stamp_ns, lambda i, t: interpolated(FLANGE, t) @ mount @ seen[i])
    assert str(log.source) == "/object/pose world (geometry_msgs/msg/PoseStamped)"
    assert not log.source.read_as.frame_moves


def test_a_chain_on_a_clock_that_starts_at_zero(tmp_path: Path) -> None:
    """The clock of a simulation: zero is no missing stamp there."""
    pair = faster(100, 31.0, 1), faster(100, 31.0, 2)
    ticking = tuple(replace(poses, stamp_ns=poses.stamp_ns - START_NS) for poses in pair)
    topic = tf_topic(ticking[0], "world", "flange", beside=[(ticking[1], "flange", "object")])
    path = write_log(
        tmp_path / "a.mcap", [replace(topic, messages=[(ns + START_NS, body) for ns, body in topic.messages])]
    )
    log = open_log(str(path), frame="world->object")
    first, second = map(by, pair)
    assert_is(Poses.collect(log), pair[0].stamp_ns - START_NS, lambda i, t: first[i] @ second[i])
    assert log.counts == {}


def test_relative_to_another_body(tmp_path: Path) -> None:
    topics = [poses_topic(FLANGE, "/tray"), poses_topic(OBJECT, "/cup")]
    path = str(write_log(tmp_path / "a.mcap", topics))
    seen = by(OBJECT)
    log = open_log(path, topic="/cup", relative_to="/tray")
    assert log.source.read_as.frame_moves
    result = Poses.collect(log)
    assert_is(result, OBJECT.stamp_ns, lambda i, t: np.linalg.inv(interpolated(FLANGE, t)) @ seen[i])


def test_poses_without_interpolation_are_counted(tmp_path: Path) -> None:
    kept = np.r_[20:100, 250:350]  # from 0.2 to 1.0 s and from 2.6 to 3.6 s
    parent = FLANGE[kept]
    topics = joined(tf_topic(parent, "world", "flange"), tf_topic(OBJECT, "flange", "object"))
    log = open_log(str(write_log(tmp_path / "a.mcap", [topics])), frame="world->object")
    result = Poses.collect(log)
    stamps = OBJECT.stamp_ns
    outside = (stamps < parent.stamp_ns[0]) | (stamps > parent.stamp_ns[-1])
    inside = (stamps > FLANGE.stamp_ns[99]) & (stamps < FLANGE.stamp_ns[250])
    assert outside.any()
    assert inside.any()
    assert log.counts == {"no_parent": outside.sum(), "parent_gap": inside.sum(), "gap": 1}
    np.testing.assert_array_equal(result.stamp_ns, stamps[~outside & ~inside])


def test_a_parent_that_rests_is_known_between_rare_messages(tmp_path: Path) -> None:
    rare = [MOUNT._replace(stamp_ns=START_NS + i * 2_000_000_000) for i in range(3)]
    topics = joined(tf_topic(rare, "world", "base"), tf_topic(OBJECT, "base", "object"))
    log = open_log(str(write_log(tmp_path / "a.mcap", [topics])), frame="world->object")
    assert len(Poses.collect(log)) == len(OBJECT)


def test_bad_poses_of_the_parent_are_left_out(tmp_path: Path) -> None:
    bad = Pose(int(FLANGE.stamp_ns[50]) + 1000, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    topics = joined(
        tf_topic(FLANGE, "world", "flange"),
        tf_topic([bad], "world", "flange"),
        tf_topic(OBJECT, "flange", "o"),
    )
    log = open_log(str(write_log(tmp_path / "a.mcap", [topics])), frame="world->o")
    assert len(Poses.collect(log)) == len(OBJECT)
    assert log.counts == {"bad_parent": 1}


@pytest.mark.parametrize("which", [{"frame": "object"}, {"topic": "/p"}])
def test_a_frame_that_may_move_is_named(tmp_path: Path, which: dict[str, str]) -> None:
    path = write_log(
        tmp_path / "a.mcap",
        [
            joined(tf_topic(FLANGE, "world", "flange"), tf_topic(OBJECT, "camera", "object")),
            tf_topic([MOUNT], "flange", "camera", "/tf_static"),
            poses_topic(OBJECT, "/p", "camera"),
        ],
    )
    note = open_log(str(path), **which).note
    assert note.startswith("poses are in camera, which may move in world: contacts are with camera")
    assert ("--frame 'world->object'" if "frame" in which else "--relative-to world") in note


def test_static_and_selected_frames_are_not_reported(tmp_path: Path) -> None:
    path = str(write_arm(tmp_path / "a.mcap"))
    assert open_log(path, frame="camera->object").note is None
    assert open_log(path, frame="flange").note is None
    topics = [tf_topic(OBJECT, "camera", "object"), tf_topic([MOUNT], "world", "camera", "/tf_static")]
    assert open_log(str(write_log(tmp_path / "b.mcap", topics))).note is None


def test_missing_chains_are_refused(tmp_path: Path) -> None:
    path = str(write_arm(tmp_path / "a.mcap"))
    with pytest.raises(
        ChoiceError, match=r"no pose source has the frame world->cup; there is .*camera->object"
    ):
        open_log(path, frame="world->cup")
    with pytest.raises(ChoiceError, match="leads to moon"):
        open_log(path, frame="object", relative_to="moon")
    with pytest.raises(AmbiguousSource, match="is the body itself"):
        open_log(path, frame="object", relative_to="object")
    with pytest.raises(AmbiguousSource, match="choose by --topic or --frame"):
        open_log(path, relative_to="world")


@pytest.mark.parametrize("follow", [False, True])
def test_a_pose_with_a_leading_stamp_does_not_delay_others(tmp_path: Path, follow: bool) -> None:
    from contact_tracker.recording import Follow

    parent, body = faster(1200, 100.0, 1), faster(900, 100.0, 2)
    early = body.stamp_ns[100]
    lead = transform(early + 3600 * 10**9, [0, 0, 0], [0, 0, 0, 1], "f", "o")
    leading = Topic("/tf", TF, [(early + 1, {"transforms": [lead]})])
    topic = joined(tf_topic(parent, "world", "f"), tf_topic(body, "f", "o"), leading)
    path = write_log(tmp_path / "a.mcap", [topic], chunk_size=5000)
    log = open_log(str(path), frame="world->o", follow=Follow() if follow else None)
    assert len(Poses.collect(log)) == len(body)
    assert log.counts == {"no_parent": 1}


def test_ambiguous_sources_come_with_a_hint_on_composition(tmp_path: Path) -> None:
    poses = smooth_poses(40)
    topic = tf_topic(poses, "world", "arm", beside=[(poses, "arm", "cup")])
    path = write_log(tmp_path / "a.mcap", [topic])
    with pytest.raises(AmbiguousSource, match="or compose them by --frame 'world->cup': /tf arm->cup"):
        open_log(str(path))


def test_a_long_line_of_frames_takes_little_memory() -> None:
    names = [f"frame_{i:05}" for i in range(20_000)]
    sources = [PoseSource("/tf", TF, a, b) for a, b in pairwise(names)]
    tree = TransformTree(sources)
    with memory_below(50 * 2**20):
        steps = tree.chain(names[0], names[-1])
    assert [step.source for step in steps] == sources
    assert tree.chain(names[0], "nowhere") is None
    assert tree.chain(names[3], names[3]) == ()


def test_misspelt_topics_and_frames_are_named(tmp_path: Path) -> None:
    topics = [
        tf_topic(FLANGE, "world", "flange"),
        tf_topic([MOUNT], "flange", "camera", "/tf_static"),
        poses_topic(OBJECT, frame="camera"),
    ]
    path = str(write_log(tmp_path / "a.mcap", topics))
    for which, proposal in (
        ({"topic": "/objct/pose"}, "/object/pose"),
        ({"topic": "object/pose"}, "/object/pose"),
        ({"frame": "Flange"}, "flange"),
        ({"frame": "world->flagne"}, "world->flange"),
        ({"frame": "fla"}, "flange"),
        ({"topic": "/object/pose", "relative_to": "wrold"}, "world"),
    ):
        with pytest.raises(ChoiceError, match=rf"; did you mean {proposal}\?$"):
            open_log(path, **which)
    with pytest.raises(ChoiceError, match=r"no topic /x; there is /tf, /tf_static, /object/pose$"):
        open_log(path, topic="/x")
