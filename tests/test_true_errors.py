"""The error model of the oracle in the field benchmark agrees with the distortions."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from distortions import DISTORTIONS
from true_errors import KNOWN, SPOILED, measured_poses, true_model

PAPER = str(Path(__file__).parents[1] / "recordings" / "paper_experiment.mcap")


@pytest.fixture(scope="module")
def clean() -> Poses:
    return Poses.collect(open_log(PAPER))[:3000]


@pytest.mark.parametrize("distortion", sorted(SPOILED))
def test_spoiled_poses_are_left_out_and_no_others(distortion: str, clean: Poses) -> None:
    distorted = DISTORTIONS[distortion](clean, np.random.default_rng(1))
    good = measured_poses(distortion, clean, distorted)
    assert 0.8 * len(clean) < len(good) < 0.97 * len(clean)
    same = np.isin(clean.stamp_ns, good.stamp_ns)
    np.testing.assert_array_equal(good.position_m, clean.position_m[same])
    np.testing.assert_allclose(good.quat_xyzw, clean.quat_xyzw[same], atol=1e-12)
    left_out = distorted.position_m[~same], distorted.quat_xyzw[~same]
    assert (left_out[0] != clean.position_m[~same]).any(axis=1).all() or (
        (left_out[1] != clean.quat_xyzw[~same]).any(axis=1).all()
    )


def test_noise_and_correlated_errors_are_those_of_the_recording(clean: Poses) -> None:
    model = load_model("default")
    wanders = true_model("slow_wander", PAPER, clean, model)
    assert not wanders.noise.estimated
    assert wanders.noise.sigma_position_m == pytest.approx(3e-4)
    assert wanders.noise.sigma_rotation_rad == pytest.approx(np.radians(0.15))
    rng = np.random.default_rng(2)
    long = Poses(
        np.arange(200_000) * 50_000_000, np.zeros((200_000, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (200_000, 1))
    )
    error = DISTORTIONS["slow_wander"](long, rng).position_m
    assert error.std() == pytest.approx(wanders.noise.wander_position_m, rel=0.05)
    later = round(wanders.noise.wander_s / 0.05)
    correlation = np.mean(error[later:] * error[:-later]) / np.mean(error**2)
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.06)
    white = true_model("dropouts_50pct", PAPER, clean, model)
    assert white == replace(
        wanders, noise=replace(wanders.noise, wander_position_m=0.0, wander_rotation_rad=0.0)
    )
    assert set(KNOWN) <= set(DISTORTIONS)
