"""Poses that jump away from the motion and back are dropped; other jumps are kept."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from contact_tracker.motion.excursions import MOST_WAITING
from contact_tracker.motion.losses import remark_on_excursions
from contact_tracker.motion.pose_validation import LONGEST_WAIT_NS, PoseGate, gate
from contact_tracker.motion.poses import Poses
from distortions import turned
from smooth_motion import moving

Array = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)


def gated(poses: Poses) -> tuple[Poses, dict[str, int]]:
    """The poses that the gate passes on."""
    counts = Counter[str]()
    return gate(poses, counts), dict(counts)


def shifted(poses: Poses, away: NDArray[np.bool_], shift_m: Array, turn_rad: float) -> Poses:
    turn = np.where(away[:, None], [turn_rad, 0.0, 0.0], 0.0)
    position = poses.position_m + np.where(away[:, None], shift_m, 0.0)
    return replace(poses, position_m=position, quat_xyzw=turned(poses, turn))


def hand(seed: int, seconds: float = 4.0, rate_hz: float = 200.0) -> Poses:
    return moving(np.random.default_rng(seed), seconds, rate_hz, 3e-4, 3e-3)


@pytest.mark.parametrize("frames", [1, 3, 20, 60])
@pytest.mark.parametrize(("shift_m", "turn_rad"), [((0.0, 0.03, 0.0), 0.0), ((0.0, 0.0, 0.0), 0.2)])
@settings(max_examples=3, deadline=None)
@given(seed=seeds)
def test_poses_that_jump_away_and_back_are_dropped(
    frames: int, shift_m: tuple[float, ...], turn_rad: float, seed: int
) -> None:
    clean = hand(seed % 1000)
    away = (np.arange(800) >= 400) & (np.arange(800) < 400 + frames)
    kept, counts = gated(shifted(clean, away, np.array(shift_m), turn_rad))
    np.testing.assert_array_equal(kept.stamp_ns, clean.stamp_ns[~away])
    assert counts == {"excursion": frames}


@pytest.mark.parametrize(("shift_m", "waits_s"), [(0.03, 2.0), (0.011, 2.0), (0.009, 0.0)])
def test_poses_wait_for_two_seconds_at_most_and_ticks_for_a_tenth(shift_m: float, waits_s: float) -> None:
    clean = hand(2, 6.0)
    gate, longest_ns = PoseGate(), 0
    for pose in shifted(clean, np.arange(1200) >= 400, np.array([0.0, shift_m, 0.0]), 0.0):
        poses, time_ns, next_ns = gate.arrive(pose)
        assert next_ns is None or time_ns is None or next_ns >= time_ns - LONGEST_WAIT_NS
        longest_ns = max([longest_ns, *(pose.stamp_ns - p.stamp_ns for p in poses)])
    assert longest_ns * 1e-9 == pytest.approx(waits_s, abs=0.02)
    assert dict(gate.counts) == {}


@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
def test_another_body_in_the_place_of_this_one_is_left_out_and_named(rate_hz: float) -> None:
    """For up to 1.6 s at a time, while the object moves on; the other one is at rest, with noise."""
    clean, rng = hand(7, 12.0, rate_hz), np.random.default_rng(7)
    time_s = (clean.stamp_ns - clean.stamp_ns[0]) * 1e-9
    away = np.any(
        [(time_s > start) & (time_s < start + 0.7 + 0.1 * start) for start in (2.0, 5.0, 9.0)], axis=0
    )
    other = np.array([0.5, -0.3, 0.2]) + rng.normal(0.0, 3e-4, (len(clean), 3))
    seen = replace(
        clean,
        position_m=np.where(away[:, None], other, clean.position_m),
        quat_xyzw=np.where(away[:, None], [1.0, 0.0, 0.0, 0.0], clean.quat_xyzw),
    )
    kept, counts = gated(seen)
    np.testing.assert_array_equal(kept.stamp_ns, clean.stamp_ns[~away])
    assert counts == {"excursion": away.sum(), "long_excursion": 3}
    assert "the poses jump to another place" in (remark_on_excursions(counts) or "")


def test_a_sudden_turn_is_motion_at_once() -> None:
    """A cube that bounces starts to turn, and turns more slowly already in the next frame."""
    rest = moving(np.random.default_rng(3), 4.0, 148.0, 3e-4, 3e-3, rms_m=0.0, rms_rad=0.0)
    turn = np.zeros((len(rest), 3))
    turn[300:, 0] = np.cumsum([0.09, *[0.04] * (len(rest) - 301)])
    poses, gate = replace(rest, quat_xyzw=turned(rest, turn)), PoseGate()
    passed = [len(gate.admit(pose)) for pose in poses]
    assert passed[300:302] == [0, 2]
    assert sum(passed) == len(rest)


def test_missing_and_repeated_frames_in_motion_are_no_jump() -> None:
    clean = hand(8)
    fast = replace(clean, position_m=clean.position_m + np.outer(np.arange(800) * 0.012, [1.0, 0.0, 0.0]))
    stuck = replace(fast, position_m=fast.position_m.copy(), quat_xyzw=fast.quat_xyzw.copy())
    stuck.position_m[400:420], stuck.quat_xyzw[400:420] = fast.position_m[399], fast.quat_xyzw[399]
    for poses in (fast[np.r_[0:400, 404:800]], stuck):
        gate = PoseGate()
        assert sum(len(gate.admit(pose)) for pose in poses[:3]) == 3
        assert {len(gate.admit(pose)) for pose in poses[3:]} == {1}


@pytest.mark.parametrize("speed_m_s", [0.5, 3.0, 10.0])
def test_an_impact_is_motion(speed_m_s: float) -> None:
    """From rest to this speed within one frame, and back."""
    rest = moving(np.random.default_rng(3), 4.0, 200.0, 3e-4, 3e-3, rms_m=0.0, rms_rad=0.0)
    since_s = np.clip((np.arange(800) - 400) / 200.0, 0.0, 1.0)
    way = speed_m_s * np.minimum(since_s, 1.0 - since_s)
    kept, counts = gated(replace(rest, position_m=rest.position_m + np.outer(way, [1.0, 0.0, 0.0])))
    np.testing.assert_array_equal(kept.stamp_ns, rest.stamp_ns)
    assert counts == {}


@pytest.mark.parametrize("every", [2, 3])
def test_frequent_excursions_to_one_place_are_kept(every: int) -> None:
    clean = hand(4)
    away = (np.arange(800) >= 200) & (np.arange(800) % every == 0)
    kept, counts = gated(shifted(clean, away, np.array([0.0, 0.1, 0.0]), 0.3))
    assert counts["excursion"] < 10
    np.testing.assert_array_equal(kept.stamp_ns[-500:], clean.stamp_ns[-500:])


@pytest.mark.parametrize("frames", [2, 3, 4])
def test_wrong_poses_in_a_row_at_different_places_are_dropped(frames: int) -> None:
    clean, away = hand(6, 4.0, 30.0), np.zeros(120, np.bool_)
    away[60 : 60 + frames] = True
    shift_m = np.zeros((120, 3))
    shift_m[60:64] = [(0.05, 0.0, 0.0), (0.0, 0.06, 0.0), (0.0, 0.0, -0.06), (-0.05, 0.0, 0.0)]
    kept, counts = gated(shifted(clean, away, shift_m, 0.0))
    np.testing.assert_array_equal(kept.stamp_ns, clean.stamp_ns[~away])
    assert counts == {"excursion": frames}


def test_one_pose_that_stays_bit_for_bit_is_dropped_until_the_motion_is_seen_again() -> None:
    """Though the step back is no longer than the time without new poses allows."""
    clean, away = hand(9), (np.arange(800) >= 400) & (np.arange(800) < 600)
    position, quat = clean.position_m.copy(), clean.quat_xyzw.copy()
    position[away], quat[away] = (0.9, -0.5, 0.4), (0.5, -0.5, 0.5, 0.5)
    kept, counts = gated(replace(clean, position_m=position, quat_xyzw=quat))
    np.testing.assert_array_equal(kept.stamp_ns, clean.stamp_ns[~away])
    assert counts == {"excursion": 200, "long_excursion": 1}


def test_the_number_of_held_poses_is_bounded() -> None:
    clean = hand(10, 20.0)
    poses = shifted(clean, np.arange(4000) >= 400, np.array([0.0, 0.5, 0.0]), 0.0)
    poses, gate = replace(poses, stamp_ns=np.arange(4000)), PoseGate()
    passed = np.cumsum([len(gate.admit(pose)) for pose in poses])
    assert passed[400 + MOST_WAITING - 2] == 400
    assert passed[400 + MOST_WAITING - 1] == 400 + MOST_WAITING
