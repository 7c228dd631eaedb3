"""Poses in frames other than the published one: chains of transforms, and relative to other bodies."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.errors import AmbiguousSource, ChoiceError
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import Follow, PoseLog, PoseSource, open_log
from contact_tracker.recording.transforms import TransformTree
from mcap_logs import TF, Topic, poses_topic, smooth_poses, tf_topic, transform, write_log
from moving_frames import START_NS, Frame, by_name, matrices, moving, static
from traced_memory import memory_below

FLANGE = moving("world", "flange", 1, 97.0, 0.0, 4.1)
MOUNT = static("flange", "camera")
OBJECT = moving("camera", "object", 2, 31.0, 0.05, 3.3)
AT_NS = OBJECT.stamps_ns
POSES = OBJECT.poses


def assert_is(result: Poses, stamps_ns: np.ndarray, expected: np.ndarray) -> None:
    """Compare poses with matrices (N, 4, 4), to 1e-9."""
    np.testing.assert_array_equal(result.stamp_ns, stamps_ns)
    got = matrices(result.position_m, Rotation.from_quat(result.quat_xyzw))
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)


def write(path: Path, *frames: Frame, further: tuple[Topic, ...] = (), **options: int) -> str:
    return str(write_log(path, [*by_name(frame.topic for frame in frames), *further], **options))


def composed(path: Path, *frames: Frame, **which: object) -> PoseLog:
    """The log of the object in the world of these frames."""
    return open_log(write(path / "a.mcap", *frames), frame="world->object", **which)


@pytest.mark.parametrize("chunk_size", [500, 2**20])
@pytest.mark.parametrize("in_columns", [False, True])
def test_a_chain_whose_parent_moves(tmp_path: Path, chunk_size: int, in_columns: bool) -> None:
    path = write(tmp_path / "a.mcap", FLANGE, MOUNT, OBJECT, chunk_size=chunk_size)
    log = open_log(path, frame="world->object")
    result = Poses.join(list(log.batches())) if in_columns else Poses.collect(log)
    assert_is(result, AT_NS, FLANGE.at(AT_NS) @ MOUNT.at(AT_NS) @ OBJECT.at(AT_NS))
    assert (log.source.topic, log.source.frames) == ("/tf", "world->object")
    assert log.counts == {}


def test_a_chain_up_and_down_the_tree(tmp_path: Path) -> None:
    """From one branch to another; the transforms of the first are inverted."""
    tool = moving("world", "tool", 7, 80.0, 0.0, 3.7)
    path = write(tmp_path / "a.mcap", FLANGE, OBJECT.under("flange"), tool)
    result = Poses.collect(open_log(path, frame="tool->object"))
    assert_is(result, AT_NS, np.linalg.inv(tool.at(AT_NS)) @ FLANGE.at(AT_NS) @ OBJECT.at(AT_NS))


def test_composed_poses_of_a_type_without_definition_are_counted(tmp_path: Path) -> None:
    topics = [
        replace(topic, schema=b"") for topic in by_name(frame.topic for frame in (FLANGE, MOUNT, OBJECT))
    ]
    log = open_log(str(write_log(tmp_path / "a.mcap", topics)), frame="world->object")
    assert len(Poses.collect(log)) == len(AT_NS)
    assert log.counts == {"known_definition": len(AT_NS)}
    assert log.remarks[0].startswith(f"{len(AT_NS)} poses are read by the known definition of {TF}: the file")


def test_relative_to_a_frame(tmp_path: Path) -> None:
    """A PoseStamped in the camera's frame is transformed to the world."""
    path = write(tmp_path / "a.mcap", FLANGE, MOUNT, further=(poses_topic(POSES, frame="camera"),))
    log = open_log(path, topic="/object/pose", relative_to="world")
    assert_is(Poses.collect(log), AT_NS, FLANGE.at(AT_NS) @ MOUNT.at(AT_NS) @ OBJECT.at(AT_NS))
    assert str(log.source) == "/object/pose world (geometry_msgs/msg/PoseStamped)"
    assert not log.source.read_as.frame_moves


def test_a_chain_on_a_clock_that_starts_at_zero(tmp_path: Path) -> None:
    """The clock of a simulation: zero is no missing stamp there."""
    first, second = (replace(OBJECT, stamps_ns=AT_NS - AT_NS[0], parent=parent) for parent in ("world", "f"))
    (topic,) = by_name([replace(first, child="f").topic, second.topic])
    later = replace(topic, messages=[(ns + START_NS, body) for ns, body in topic.messages])
    log = open_log(str(write_log(tmp_path / "a.mcap", [later])), frame="world->object")
    assert_is(Poses.collect(log), first.stamps_ns, OBJECT.at(AT_NS) @ OBJECT.at(AT_NS))
    assert log.counts == {}


def test_relative_to_another_body(tmp_path: Path) -> None:
    topics = [poses_topic(FLANGE.poses, "/tray"), poses_topic(POSES, "/cup")]
    path = str(write_log(tmp_path / "a.mcap", topics))
    log = open_log(path, topic="/cup", relative_to="/tray")
    assert log.source.read_as.frame_moves
    assert_is(Poses.collect(log), AT_NS, np.linalg.inv(FLANGE.at(AT_NS)) @ OBJECT.at(AT_NS))


def test_poses_without_interpolation_are_counted(tmp_path: Path) -> None:
    parent = FLANGE.only(np.r_[20:100, 250:350])  # from 0.2 to 1.0 s and from 2.6 to 3.6 s
    log = composed(tmp_path, parent, OBJECT.under("flange"))
    result = Poses.collect(log)
    stamps = POSES.stamp_ns
    outside = (stamps < parent.stamps_ns[0]) | (stamps > parent.stamps_ns[-1])
    inside = (stamps > FLANGE.stamps_ns[99]) & (stamps < FLANGE.stamps_ns[250])
    assert outside.any()
    assert inside.any()
    assert log.counts == {"no_parent": outside.sum(), "parent_gap": inside.sum(), "gap": 1}
    np.testing.assert_array_equal(result.stamp_ns, stamps[~outside & ~inside])


def test_a_parent_that_rests_is_known_between_rare_messages(tmp_path: Path) -> None:
    rare = replace(MOUNT.only(np.zeros(3, int)), stamps_ns=START_NS + 2 * 10**9 * np.arange(3))
    log = composed(tmp_path, replace(rare, parent="world", child="base"), OBJECT.under("base"))
    assert len(Poses.collect(log)) == len(POSES)


def test_bad_poses_of_the_parent_are_left_out(tmp_path: Path) -> None:
    at = int(FLANGE.stamps_ns[50]) + 1000
    bad = Topic("/tf", TF, [(at, {"transforms": [transform(at, [0] * 3, [0] * 4, "world", "flange")]})])
    topics = by_name([FLANGE.topic, bad, OBJECT.under("flange").topic])
    log = open_log(str(write_log(tmp_path / "a.mcap", topics)), frame="world->object")
    assert len(Poses.collect(log)) == len(POSES)
    assert log.counts == {"bad_parent": 1}


@pytest.mark.parametrize("which", [{"frame": "object"}, {"topic": "/p"}])
def test_a_frame_that_may_move_is_named(tmp_path: Path, which: dict[str, str]) -> None:
    path = write(tmp_path / "a.mcap", FLANGE, OBJECT, MOUNT, further=(poses_topic(POSES, "/p", "camera"),))
    note = open_log(path, **which).note
    assert note.startswith("poses are in camera, which may move in world: contacts are with camera")
    assert ("--frame 'world->object'" if "frame" in which else "--relative-to world") in note


def test_static_and_selected_frames_are_not_reported(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", FLANGE, MOUNT, OBJECT)
    assert open_log(path, frame="camera->object").note is None
    assert open_log(path, frame="flange").note is None
    assert open_log(write(tmp_path / "b.mcap", OBJECT, MOUNT.under("world"))).note is None


def test_missing_chains_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", FLANGE, MOUNT, OBJECT)
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
    """Also after ten seconds, for which transforms are kept."""
    parent, body = moving("world", "flange", 1, 100.0, 0.0, 12.0), moving("flange", "o", 2, 100.0, 0.0, 9.0)
    early = int(body.stamps_ns[100])
    lead = transform(early + 3600 * 10**9, [0, 0, 0], [0, 0, 0, 1], "flange", "o")
    leading = Topic("/tf", TF, [(early + 1, {"transforms": [lead]})])
    path = write_log(tmp_path / "a.mcap", by_name([parent.topic, body.topic, leading]), chunk_size=5000)
    log = open_log(str(path), frame="world->o", follow=Follow() if follow else None)
    assert len(Poses.collect(log)) == len(body.poses)
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
    path = write(tmp_path / "a.mcap", FLANGE, MOUNT, further=(poses_topic(POSES, frame="camera"),))
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
