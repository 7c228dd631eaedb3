"""Recordings with little information: few poses, no motion, slow or interrupted streams."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.cli import info
from contact_tracker.cli.main import run
from contact_tracker.motion.poses import Poses
from contact_tracker.states import STATES
from mcap_logs import poses_topic, smooth_poses, write_log
from smooth_motion import exact_transfers

NAMES = {state.value for state in STATES}


def held(poses: Poses) -> Poses:
    """The first pose repeated."""
    first = np.zeros(len(poses), int)
    return Poses(poses.stamp_ns, poses.position_m[first], poses.quat_xyzw[first])


def only_moving(poses: Poses) -> Poses:
    return Poses(poses.stamp_ns, poses.position_m, held(poses).quat_xyzw)


def only_turning(poses: Poses) -> Poses:
    return Poses(poses.stamp_ns, held(poses).position_m, poses.quat_xyzw)


def with_gaps_every(poses: Poses, every: int, gap_s: float) -> Poses:
    """A gap after every ``every`` poses."""
    gaps_ns = np.arange(len(poses)) // every * round(gap_s * 1e9)
    return Poses(poses.stamp_ns + gaps_ns, poses.position_m, poses.quat_xyzw)


def far_away(poses: Poses) -> Poses:
    return Poses(poses.stamp_ns, poses.position_m + 9e5, poses.quat_xyzw)


MOTIONS: dict[str, Callable[[], Poses]] = {
    "one pose": lambda: smooth_poses(1),
    "two poses": lambda: smooth_poses(2),
    "four poses": lambda: smooth_poses(4),
    "a tick and a pose": lambda: smooth_poses(21),
    "held, longer than a window of the paper": lambda: held(smooth_poses(520)),
    "at the origin": lambda: Poses(
        smooth_poses(120).stamp_ns, np.zeros((120, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (120, 1))
    ),
    "only moving": lambda: only_moving(smooth_poses(150)),
    "only turning": lambda: only_turning(smooth_poses(150)),
    "far away": lambda: far_away(smooth_poses(100)),
    "10 kHz": lambda: smooth_poses(300, 10_000.0),
    "1 Hz": lambda: smooth_poses(4, 1.0),
    "a pose per hour": lambda: smooth_poses(2, 1 / 3600),
    "a gap of 5 s": lambda: with_gaps_every(smooth_poses(60), 30, 5.0),
}


def refuse(name: str) -> float:
    raise AssertionError(f"{name} is no JSON")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("make", MOTIONS.values(), ids=MOTIONS.keys())
def test_little_motion_is_segmented(make: Callable[[], Poses], tmp_path: Path, capsys: Any) -> None:
    poses = make()
    log, out = write_log(tmp_path / "a.mcap", [poses_topic(poses)]), tmp_path / "out.jsonl"
    assert run(["segment", str(log), "-o", str(out)]) == 0
    beliefs = [json.loads(line, parse_constant=refuse) for line in out.read_text().splitlines()]
    assert beliefs[-1]["stamp_ns"] == poses.stamp_ns[-1]
    assert all(b["onset_ns"] <= b["stamp_ns"] and b["contact"] in NAMES for b in beliefs)
    assert all(math.isclose(sum(b["probability"].values()), 1.0, rel_tol=1e-9) for b in beliefs)
    lines = [line.removeprefix("contact-tracker: ") for line in capsys.readouterr().err.splitlines()]
    assert sum(line.startswith(f"{len(poses)} poses, ") for line in lines) == 1
    assert sum(line.startswith("noise ") for line in lines) == 1
    rest = [line for line in lines if not line.startswith((f"{len(poses)} poses, ", "noise ", "wrote "))]
    assert all(line.startswith("warning: ") for line in rest)
    assert run(["live", str(log), "--json"]) == 0
    online = [json.loads(line, parse_constant=refuse) for line in capsys.readouterr().out.splitlines()]
    assert [b["stamp_ns"] for b in online] == [b["stamp_ns"] for b in beliefs]
    if len(poses) <= 2:
        assert run(["info", str(log)]) == 0
        assert f"poses     {len(poses)}\n" in capsys.readouterr().out
        assert run(["segment", str(log)]) == 0
        assert capsys.readouterr().out.splitlines()[1].split()[2] in NAMES
        assert run(["view", str(log), "--save", str(tmp_path / "a.rrd")]) == 0


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("command", ["live", "view", "info"])
def test_nan_poses_are_counted(
    command: str, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    poses = smooth_poses(30)
    nothing = Poses(poses.stamp_ns, np.full((30, 3), np.nan), poses.quat_xyzw)
    log = write_log(tmp_path / "a.mcap", [poses_topic(nothing)])
    code = run([command, str(log)])
    captured = capsys.readouterr()
    assert "nonfinite 30" in captured.out + captured.err
    if command != "info":
        assert (code, captured.out) == (1, "")
        assert "no pose that can be used" in captured.err


def after_rest(poses: Poses, rest: int) -> Poses:
    """With ``rest`` poses before that repeat the first one bit for bit, as a robot's at rest."""
    period_ns = int(poses.stamp_ns[1] - poses.stamp_ns[0])
    before_ns = poses.stamp_ns[0] - period_ns * np.arange(rest, 0, -1)
    still = Poses(before_ns, poses.position_m[:1].repeat(rest, 0), poses.quat_xyzw[:1].repeat(rest, 0))
    return Poses.join([still, poses])


@pytest.mark.parametrize("command", ["live", "info"])
@pytest.mark.parametrize(
    "rounding_rad", [pytest.param(0.0, marks=pytest.mark.long), 1e-5], ids=["exact", "rounded"]
)
def test_a_robot_that_rests_at_first_is_warned_of_nothing(
    command: str, rounding_rad: float, tmp_path: Path, capsys: Any
) -> None:
    """Its poses repeat at rest, and have no noise whose errors could be correlated, but rounding."""
    moves = exact_transfers(np.random.default_rng(3), 6.0, 500.0)
    if rounding_rad:
        turn = Rotation.from_quat(moves.quat_xyzw).as_rotvec()
        rounded = [np.round(part / rounding_rad) * rounding_rad for part in (moves.position_m, turn)]
        moves = Poses(moves.stamp_ns, rounded[0], Rotation.from_rotvec(rounded[1]).as_quat())
    log = write_log(tmp_path / "a.mcap", [poses_topic(after_rest(moves, 600))])
    assert run([command, str(log)]) == 0
    shown = capsys.readouterr()
    assert "warning" not in shown.out + shown.err


@pytest.mark.parametrize("rest", [600, 1800])
def test_what_has_not_changed_so_far_is_said_after_a_while(rest: int, tmp_path: Path, capsys: Any) -> None:
    """After 1.2 s of rest nothing, after 3 s that it has not changed in so many poses."""
    log = write_log(tmp_path / "a.mcap", [poses_topic(after_rest(smooth_poses(300, 500.0), rest))])
    assert run(["live", str(log)]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "never changes in 1500 poses" in line]
    assert len(lines) == (rest > 1500)


@pytest.mark.long
def test_info_says_of_which_part_it_says_that_nothing_changes(tmp_path: Path, capsys: Any) -> None:
    """It looks at the first 30 s; the orientation changes later."""
    poses = smooth_poses(700, 20.0)
    turned = np.where(np.arange(700)[:, None] < 650, poses.quat_xyzw[:1], poses.quat_xyzw)
    log = write_log(tmp_path / "a.mcap", [poses_topic(Poses(poses.stamp_ns, poses.position_m, turned))])
    assert run(["info", str(log)]) == 0
    shown = capsys.readouterr().out
    assert "the orientation does not change in the first " in shown
    assert "never changes" not in shown


def test_info_says_that_the_part_it_reads_is_too_short(tmp_path: Path, capsys: Any, monkeypatch: Any) -> None:
    """It looks at the first 30 s, in which the object rests; what follows may decide the noise."""
    monkeypatch.setattr(info, "MOST_UPDATES", 10**6)
    whole = after_rest(smooth_poses(5, 5.0), 155)
    for part, cause in ((whole, "too short a part was read"), (whole[:140], "there is too little motion")):
        log = write_log(tmp_path / "a.mcap", [poses_topic(part)])
        assert run(["info", str(log)]) == 0
        assert f"{cause} to estimate" in capsys.readouterr().out


def test_few_poses_in_a_tick_are_counted_by_their_stamps(tmp_path: Path, capsys: Any) -> None:
    """The rate falls from 30 to 10 Hz, too little for longer ticks."""
    fast, slow = smooth_poses(45, 30.0), smooth_poses(30, 10.0)
    late = Poses(
        fast.stamp_ns[-1] + 10**8 + slow.stamp_ns - slow.stamp_ns[0], slow.position_m, slow.quat_xyzw
    )
    for poses, count in ((Poses.join([fast, late]), 1), (Poses.join([fast, held(late)]), 1), (fast, 0)):
        log = write_log(tmp_path / "a.mcap", [poses_topic(poses)])
        for command in ("live", "segment"):
            assert run([command, str(log)]) == 0
            assert capsys.readouterr().err.count("few poses: 1 in a tick of 0.1 s") == count, command


def test_a_short_part_of_a_recording_is_segmented(tmp_path: Path, capsys: Any) -> None:
    log = write_log(tmp_path / "a.mcap", [poses_topic(smooth_poses(200))])
    assert run(["segment", str(log), "--start", "0.5", "--duration", "0.02"]) == 0
    captured = capsys.readouterr()
    _, line, doubt = captured.out.splitlines()
    assert line.split()[0] == "0.50"
    assert doubt == "The motion leaves the contact open for 0.02 of 0.02 s."
    assert "4 poses" in captured.err
    assert "no contact is decided: move the object in more directions" in captured.err
    assert run(["live", str(log), "--start", "0.5", "--duration", "0.02"]) == 0
    assert "4 poses" in capsys.readouterr().err
