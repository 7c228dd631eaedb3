"""Wrenches of a recording: their frame, and dropped messages."""

from pathlib import Path

import numpy as np
import pytest
from support.mcap_logs import Topic, poses_topic, smooth_poses, wrench_stamped, write_log
from support.pressed_objects import pressed

from contact_tracker.cli.main import run
from contact_tracker.config.loading import load_model
from contact_tracker.errors import InputError, UsageError
from contact_tracker.map.map import EMPTY_MAP
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import WRENCH_TYPE, WrenchLog, open_log, read_wrenches, write_recording
from contact_tracker.recording.wrenches import recorded_evidence
from contact_tracker.states import Contact


def wrenches_topic(poses: Poses, frame: str = "object", name: str = "/wrench") -> Topic:
    values = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    messages = [(int(stamp), wrench_stamped(int(stamp), values, frame)) for stamp in poses.stamp_ns]
    return Topic(name, WRENCH_TYPE, messages)


def read(path: Path, topic: str = "/wrench") -> WrenchLog:
    log = open_log(str(path))
    return read_wrenches(str(path), topic, log.source, Poses.collect(log))


def test_frames_that_change_are_refused(tmp_path: Path) -> None:
    poses = smooth_poses()
    both = wrenches_topic(poses)
    both.messages = [*both.messages[:5], *wrenches_topic(poses, "flange").messages[5:]]
    with pytest.raises(UsageError, match="changes its frame"):
        read(write_log(tmp_path / "log.mcap", [poses_topic(poses), both]))


def test_unusable_wrenches_are_dropped_and_counted(tmp_path: Path) -> None:
    poses = smooth_poses()
    topic = wrenches_topic(poses)
    messages = list(topic.messages)
    stamp = int(poses.stamp_ns[3])
    messages[3] = (stamp, wrench_stamped(stamp, [np.nan, 0, 0, 0, 0, 0]))
    messages[4] = (stamp, wrench_stamped(stamp, [0, 0, 0, 0, np.inf, 0]))
    messages[5] = (stamp, wrench_stamped(0, [0.0] * 6))
    topic.messages = messages
    found = read(write_log(tmp_path / "log.mcap", [poses_topic(poses), topic]))
    assert found.dropped == 3
    assert len(found.wrenches) == len(poses) - 3


def test_undecodable_wrenches_are_an_error_in_one_line(tmp_path: Path) -> None:
    poses = smooth_poses()
    topic = Topic("/wrench", WRENCH_TYPE, [(int(stamp), b"\x00\x01\x00\x00??") for stamp in poses.stamp_ns])
    with pytest.raises(InputError, match="can be used"):
        read(write_log(tmp_path / "log.mcap", [poses_topic(poses), topic]))


def test_a_missing_topic_lists_the_existing_ones(tmp_path: Path) -> None:
    poses = smooth_poses()
    path = write_log(tmp_path / "log.mcap", [poses_topic(poses), wrenches_topic(poses)])
    with pytest.raises(UsageError, match=r"no topic /other.*/wrench"):
        read(path, "/other")
    with pytest.raises(UsageError, match="PoseStamped"):
        read(path, "/object/pose")


def test_wrenches_without_free_motion_are_not_used(tmp_path: Path) -> None:
    """They are constant, at any pose: that is said in a line, and motion decides."""
    poses = smooth_poses(400)
    path = str(write_log(tmp_path / "log.mcap", [poses_topic(poses), wrenches_topic(poses)]))
    found = recorded_evidence(path, "/wrench", open_log(path), load_model(), EMPTY_MAP)
    assert found is not None
    assert found.evidence is None
    assert found.text.startswith("/wrench is not used: ")
    assert found.warnings == (found.text,)


def test_info_reports_the_wrench_topic(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = smooth_poses(400)
    path = str(write_log(tmp_path / "log.mcap", [poses_topic(poses), wrenches_topic(poses)]))
    assert run(["info", path]) == 0
    assert "--wrench /wrench" in capsys.readouterr().out


@pytest.mark.parametrize("words", ["--mass 2", "--wrench /none", "--wrench /wrench --mass=-1"])
def test_wrong_usage_is_reported(tmp_path: Path, words: str) -> None:
    poses = smooth_poses(400)
    path = str(write_log(tmp_path / "log.mcap", [poses_topic(poses), wrenches_topic(poses)]))
    assert run(["segment", path, *words.split()]) == 2


def test_a_mass_that_is_overruled_is_a_warning(tmp_path: Path) -> None:
    shown = pressed(Contact.VF, seed=3, noise=True, seconds=6.0)
    write_recording(str(tmp_path / "a.mcap"), shown.poses, None, {}, wrenches=shown.wrenches)
    path = str(tmp_path / "a.mcap")
    found = recorded_evidence(path, "/object/wrench", open_log(path), load_model(), EMPTY_MAP, mass_kg=5.0)
    assert found is not None
    (doubt,) = found.warnings
    assert doubt.startswith("the mass that is given, 5 kg, does not fit the wrenches in free motion: 2.00")
