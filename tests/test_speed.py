"""The speed benchmark: long logs are correct, and targets are compared."""

import numpy as np
import pytest

import growth
import speed
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth, write_recording
from contact_tracker.states import Contact
from mcap_logs import START_NS, smooth_poses
from speeds import growing
from speeds.figures import Setup
from speeds.long_logs import write_long_log


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
    assert table.count("short: poses") == 4
    assert "reading: peak memory" in table


def test_later_minutes_have_the_poses_of_the_first(log):
    early, late, between = growth.minutes(log, 3.0, 0.5)
    assert len(early) == len(late) == 50
    assert len(between) == 2 * 59 * 3  # whole repetitions, nearest to the requested time
    np.testing.assert_array_equal(early.position_m, late.position_m)
    np.testing.assert_array_equal(early.quat_xyzw, late.quat_xyzw)
    assert late.stamp_ns[0] - between.stamp_ns[-1] == early.stamp_ns[1] - early.stamp_ns[0]


def test_growth_is_reported_for_cost_and_hypotheses(log, capsys):
    assert growth.main(["--log", str(log), "--after", "1", "--seconds", "0.5", "--turns", "1"]) == 0
    head, first, later = capsys.readouterr().out.splitlines()
    assert head.split() == ["minute", "ms", "per", "tick", "x", "hypotheses", "x"]
    assert (first.split()[0], first.split()[2], first.split()[4]) == ("first", "1.00", "1.00")
    assert later.startswith("after 1 s")


def test_growth_is_a_row_of_the_table(log):
    figures = growing.measure(Setup(log, log, "default", 1, (1, 2), log.parent))
    assert [(f.what.split(": ")[1], f.unit, f.target) for f in figures] == [
        ("a tick", "x", "<= 1.1"),
        ("hypotheses", "x", ""),
    ]
    assert all(f.what.startswith("after 2 s") and 0.1 < f.value < 10.0 for f in figures)
