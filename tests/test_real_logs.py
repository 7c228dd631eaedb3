"""Logs with real faults: adaptation and faults are reported, and wrong labels are not certain."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contact_tracker.cli.main import run
from contact_tracker.errors import UsageError
from contact_tracker.motion.poses import Poses
from contact_tracker.trajectory.arguments import model_from
from distortions import low_pass, thinned, turned
from mcap_logs import poses_topic, write_log
from short_recordings import SHIPPED, shipped


def raw(seconds: float) -> Poses:
    """The beginning of a recording, including motion."""
    return shipped("paper_experiment")[800 : 800 + round(200 * seconds)]


def millimetres(poses: Poses) -> Poses:
    return replace(poses, position_m=1000.0 * poses.position_m)


def beside(poses: Poses, from_pose: int) -> Poses:
    """After each pose from ``from_pose`` on, one of a second body soon after."""
    row = np.repeat(np.arange(len(poses)), 2)
    other = (np.arange(len(row)) % 2).astype(bool)
    both = poses[row]
    shifted = both.position_m + np.where(other[:, None], [0.2, 0.1, 0.0], 0.0)
    stamp_ns = both.stamp_ns + np.where(other, 1_000_000, 0)
    kept = ~other | (row >= from_pose)
    turn = np.where(other[:, None], [0.0, 0.4, 0.3], 0.0)
    return Poses(stamp_ns, shifted, turned(both, turn))[kept]


def unturned(poses: Poses) -> Poses:
    return replace(poses, quat_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (len(poses), 1)))


FAULTS: dict[str, tuple[str, Callable[[Poses], Poses]]] = {
    "millimetres": ("too noisy or too fast for metres", millimetres),
    "two bodies, late": ("two bodies on one topic?", lambda poses: beside(poses, 150)),
    "unturned": ("the orientation never changes", unturned),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_no_label_is_certain_while_the_stream_is_in_doubt(fault: str, tmp_path: Path, capsys: Any) -> None:
    text, distorted = FAULTS[fault]
    log = str(write_log(tmp_path / "a.mcap", [poses_topic(distorted(raw(4.5)))]))
    for command in ("live", "segment") if fault == "millimetres" else ("live",):
        out = tmp_path / f"{command}.jsonl"
        assert run([command, log, "-o", str(out)]) == 0
        lines = out.read_text().splitlines()
        posterior = np.array([list(json.loads(line)["probability"].values()) for line in lines])
        assert posterior.sum(axis=1) == pytest.approx(np.ones(len(posterior)))
        assert posterior[30:].max() <= 0.9
        warnings = [line for line in capsys.readouterr().err.splitlines() if "warning: " in line]
        assert sum(text in line for line in warnings) == 1
    if fault == "millimetres":  # as of the other commands
        assert run(["info", log]) == 0
        shown = capsys.readouterr().out.splitlines()
        assert any(line.startswith("  warning") and text in line for line in shown)


@pytest.mark.long
def test_the_choice_is_reported(tmp_path: Path, capsys: Any) -> None:
    filtered = str(write_log(tmp_path / "a.mcap", [poses_topic(low_pass(raw(16.0), 20.0))]))
    assert run(["info", filtered, "--json"]) == 0
    tracking = json.loads(capsys.readouterr().out)["sources"][0]["tracking"]
    assert tracking["noise_decided"]
    assert tracking["findings"] == ["filtered"]
    assert tracking["tick_sigma_position_m"] > 3.0 * tracking["sigma_position_m"] / np.sqrt(20.0)
    for command in (["segment", filtered], ["live", filtered]):
        assert run(command) == 0
        text = capsys.readouterr().err
        assert "a tick (chosen by the evidence; white noise would leave less)" in text
        assert "poses look filtered" in text
    slow = thinned(raw(12.0), 10.0, 0.0, np.random.default_rng(0))
    assert run(["segment", str(write_log(tmp_path / "b.mcap", [poses_topic(slow)]))]) == 0
    assert "ticks of 0.15 s instead of 0.1 s" in capsys.readouterr().err


def test_given_noise_is_used_and_reported(tmp_path: Path, capsys: Any) -> None:
    log = str(write_log(tmp_path / "a.mcap", [poses_topic(raw(1.0))]))
    for command, noise in ((["segment", log], "300um, 2.618mrad"), (["live", log], "0.3mm,0.15deg")):
        assert run([*command, "--noise", noise]) == 0
        assert "noise 0.3 mm 0.15 deg a pose (as given)" in capsys.readouterr().err


@pytest.mark.parametrize(
    "value", ["0.3", "0.3mm,0.15", "0.15deg,0.3mm", "0mm,0deg", "-1mm,1deg", "1mm,1deg,1deg", "0.11m,0.1deg"]
)
def test_deviations_without_units_or_sense_are_wrong_usage(value: str, capsys: Any) -> None:
    for option in ("--noise", "--accuracy")[: 1 if value == "0mm,0deg" else 2]:  # accuracies may be zero
        assert run(["segment", str(SHIPPED / "paper_experiment.mcap"), f"{option}={value}"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert value in line
        assert "0.3mm,0.15deg" in line or "at most 100 mm and 10 deg" in line


def test_python_takes_deviations_as_numbers_too() -> None:
    for option in ("noise", "accuracy"):
        for value in ("0.5mm,0.2rad", (0.5, 1e-3)):
            with pytest.raises(UsageError, match="at most 100 mm and 10 deg"):
                model_from("default", **{option: value})
    assert model_from("default", accuracy="100mm,10deg").systematic.position_m == 0.1
    assert model_from("default", accuracy="0.5mm,0deg").systematic.rotation_rad == 0.0
    assert model_from("default", accuracy=(1e-3, 2e-3)).systematic.rotation_rad == 2e-3
