"""The speed benchmark: long logs are correct, and targets are compared."""

import numpy as np
import pytest

import speed
import speed_in_process
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth, write_recording
from contact_tracker.states import Contact
from long_logs import write_long_log
from mcap_logs import START_NS, smooth_poses


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "short.mcap"
    write_recording(str(path), smooth_poses(60, rate_hz=100.0), None, {})
    return path


def test_a_long_log_plays_forward_and_backward_at_the_same_rate(log, tmp_path):
    short = Poses.collect(open_log(str(log)))
    opened = open_log(str(write_long_log(log, 3.0, tmp_path / "long.mcap")))
    long = Poses.collect(opened)
    assert len(long) == 300
    assert not opened.counts
    assert set(np.diff(long.stamp_ns)) == {10_000_000}
    row = np.abs((np.arange(300) + 59) % 118 - 59)
    np.testing.assert_array_equal(long.position_m, short.position_m[row])
    np.testing.assert_array_equal(long.quat_xyzw, short.quat_xyzw[row])


def test_truth_is_repeated_with_the_poses(tmp_path):
    spans = (("f-f", 0, 200_000_000), ("free", 200_000_001, 590_000_000))
    truth = Truth(tuple(TruthInterval(START_NS + a, START_NS + b, Contact(label)) for label, a, b in spans))
    poses = smooth_poses(60, rate_hz=100.0)
    write_recording(str(tmp_path / "short.mcap"), poses, truth, {})
    long = write_long_log(tmp_path / "short.mcap", 3.0, tmp_path / "long.mcap")
    toured = read_truth(str(long)).intervals
    held = [
        toured[i].contact.value for i in Truth(toured).at(START_NS + np.array([1, 5, 8, 11, 13, 17]) * 10**8)
    ]
    assert held == ["f-f", "free", "free", "f-f", "f-f", "free"]
    assert toured[-1].end_ns >= START_NS + 3 * 10**9


def test_the_table_has_measurements_and_targets(log, capsys):
    assert speed.main(["--only", "reading", "--runs", "1", "--log", str(log), "--fast-log", str(log)]) == 0
    table = capsys.readouterr().out
    assert table.count("short: poses") == 2
    assert table.count("<= 15") == 2


def test_the_growth_compares_the_same_poses(log, tmp_path):
    early, late, between = speed_in_process.minutes(log, 3.0, 0.5, tmp_path)
    assert len(early) == len(late) == 50
    np.testing.assert_array_equal(early.position_m, late.position_m)
    np.testing.assert_array_equal(early.quat_xyzw, late.quat_xyzw)
    assert late.stamp_ns[0] - between.stamp_ns[-1] == early.stamp_ns[1] - early.stamp_ns[0]
    (figure,) = speed_in_process.growing(speed.Setup(log, log, "default", 1, (1, 2), tmp_path))
    assert (figure.unit, figure.target) == ("x", "<= 1.1")
    assert figure.what.startswith("after 2 s")
    assert 0.1 < figure.value < 10.0
