"""Where most poses are dropped, the first message gives the likely cause, and the exit code is 3."""

import sys
from pathlib import Path

import numpy as np
import pytest

import contact_tracker
from contact_tracker import Tracker, Trajectory
from contact_tracker.cli.main import run
from contact_tracker.errors import DAMAGED, DONE
from contact_tracker.motion.losses import remark_on_loss
from mcap_logs import Topic, pose_stamped, smooth_poses, write_log

POSES = smooth_poses(400)


def scaled(quat_xyzw: np.ndarray) -> np.ndarray:
    """Integers that stand for fractions."""
    return np.round(quat_xyzw * 10_000)


def doubled(quat_xyzw: np.ndarray) -> np.ndarray:
    """The column z twice."""
    return np.column_stack([quat_xyzw[:, :2], np.full((len(quat_xyzw), 2), 0.9)])


FAULTS = {
    "scaled": (scaled, "not 1: if these are integers that stand for fractions"),
    "doubled": (doubled, "and w equals z: is one column taken for both?"),
    "zero": (lambda quat_xyzw: 0.0 * quat_xyzw, "the quaternions are zero"),
}


def recorded(path: Path, fault: str, share: float) -> Path:
    """A recording whose first part is sound."""
    quat_xyzw = np.array(POSES.quat_xyzw)
    first = round((1 - share) * len(POSES))
    quat_xyzw[first:] = FAULTS[fault][0](quat_xyzw[first:])
    rows = zip(POSES.stamp_ns.tolist(), POSES.position_m.tolist(), quat_xyzw.tolist(), strict=True)
    messages = [(stamp, pose_stamped(stamp, position, quat)) for stamp, position, quat in rows]
    return write_log(path, [Topic("/a", "geometry_msgs/msg/PoseStamped", messages)])


@pytest.mark.parametrize("fault", FAULTS)
def test_the_cause_is_the_first_line(
    fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    recorded(tmp_path / "a.mcap", fault, 0.6)
    others = (
        ("live a.mcap", "segment a.mcap", "view a.mcap --save a.rrd") if fault == next(iter(FAULTS)) else ()
    )
    for command in ("info a.mcap", *others):
        assert run(command.split()) == DAMAGED
        first = capsys.readouterr().err.splitlines()[0]
        assert "240 of 400 poses are left out, 240 of them as bad_quaternion" in first, command
        assert FAULTS[fault][1] in first
    result = contact_tracker.segment("a.mcap")
    assert FAULTS[fault][1] in result.warnings[0]
    recorded(tmp_path / "b.mcap", fault, 0.4)
    assert run(["info", "b.mcap"]) == DONE
    recorded(tmp_path / "c.mcap", fault, 1.0)
    assert run(["segment", "c.mcap"]) == 1
    assert FAULTS[fault][1] in capsys.readouterr().err


def test_it_comes_before_the_results_or_as_soon_as_it_is_seen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    log = str(recorded(tmp_path / "a.mcap", "scaled", 0.95))
    monkeypatch.setattr(sys, "stderr", sys.stdout)  # as on a terminal
    assert run(["segment", log]) == DAMAGED
    assert "380 of 400 poses are left out" in capsys.readouterr().out.splitlines()[0]
    assert run(["live", log]) == DAMAGED
    lines = capsys.readouterr().out.splitlines()
    assert ["80 of 100 poses are left out" in line for line in lines if "left out" in line] == [True]
    assert any("noted: bad_quaternion 380" in line for line in lines)


def test_from_arrays_and_online() -> None:
    quat_xyzw = scaled(POSES.quat_xyzw)
    quat_xyzw[:100] = POSES.quat_xyzw[:100]
    trajectory = Trajectory.from_arrays(POSES.stamp_ns, POSES.position_m, quat_xyzw, unit="ns")
    assert "300 of 400 poses" in trajectory.damage
    tracker = Tracker()
    for stamp, position, quat in zip(POSES.stamp_ns.tolist(), POSES.position_m, quat_xyzw, strict=True):
        tracker.update(stamp, position, quat)
    assert "300 of 400 poses" in tracker.warnings[0]


@pytest.mark.parametrize(
    ("counts", "total", "words"),
    [
        ({"repeated_stamp": 550}, 1000, None),
        ({"repeated_stamp": 650}, 1000, "more digits"),
        ({"repeated_stamp": 500, "nonfinite": 251}, 1000, "251 of 500 poses"),
        ({"nonfinite": 500}, 1000, None),
        ({"nonfinite": 300, "default_pose": 201}, 1000, "300 of them as nonfinite"),
        ({"undecodable": 501}, 500, "do not match their definition"),
        ({"no_parent": 601}, 600, "601 of 1201 poses"),
        ({"parent_gap": 400, "no_parent": 300}, 800, None),
        ({"backward_stamp": 600, "clock_reset": 30}, 1000, None),
    ],
)
def test_what_is_a_loss(counts: dict[str, int], total: int, words: str | None) -> None:
    remark = remark_on_loss(counts, total)
    assert (remark is None) if words is None else (words in str(remark))
