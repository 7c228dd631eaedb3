"""Poses that jump away from the motion and back are dropped; other jumps are kept."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Poses
from distortions import turned
from smooth_motion import moving

Array = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)


def gated(poses: Poses, batch: int | None = None) -> tuple[Poses, dict[str, int]]:
    """The poses that the gate passes on, one by one or in batches if these need no further checks."""
    gate, kept = PoseGate(), list[Poses]()
    for first in range(0, len(poses), batch or 1):
        some = poses[first : first + (batch or 1)]
        whole = gate.admit_all(some) if batch else None
        kept.append(Poses.collect([p for pose in some for p in gate.admit(pose)]) if whole is None else whole)
    kept.append(Poses.collect(gate.finish()))
    return Poses.join([part for part in kept if len(part)]), dict(gate.counts)


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


def test_an_object_that_stays_where_it_jumped_to_loses_nothing() -> None:
    clean = hand(1)
    kept, counts = gated(shifted(clean, np.arange(800) >= 400, np.array([0.0, 0.5, 0.0]), 0.3))
    np.testing.assert_array_equal(kept.stamp_ns, clean.stamp_ns)
    assert counts == {}


def test_poses_wait_for_half_a_second_at_most() -> None:
    clean = hand(2)
    gate = PoseGate()
    passed = [
        len(gate.admit(p)) for p in shifted(clean, np.arange(800) >= 400, np.array([0.0, 0.5, 0.0]), 0.0)
    ]
    assert sum(passed[:400]) == 400
    assert sum(passed[400:500]) == 0
    assert passed[500:503] == [102, 1, 1] or sum(passed[:503]) == 503


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


def test_single_poses_that_jump_anywhere_are_dropped_however_many() -> None:
    clean, rng = hand(5), np.random.default_rng(5)
    away = (np.arange(800) >= 200) & (np.arange(800) % 3 == 0)
    shift_m = 0.1 * rng.normal(size=(800, 3))
    shift_m += 0.05 * np.sign(shift_m)
    kept, counts = gated(shifted(clean, away, shift_m, 0.0))
    np.testing.assert_array_equal(kept.stamp_ns, clean.stamp_ns[~away])
    assert counts == {"excursion": 200}


@settings(max_examples=10, deadline=None)
@given(seed=seeds, batch=st.integers(2, 300))
def test_batches_pass_as_single_poses_do(seed: int, batch: int) -> None:
    rng = np.random.default_rng(seed)
    clean = hand(seed % 1000, 3.0)
    away = np.zeros(600, bool)
    for first in rng.integers(20, 600, 4):
        away[first : first + rng.integers(1, 40)] = True
    poses = shifted(clean, away, np.array([0.02, 0.0, 0.01]), 0.1)
    (one_by_one, counts), (together, same) = gated(poses), gated(poses, batch)
    np.testing.assert_array_equal(one_by_one.stamp_ns, together.stamp_ns)
    assert counts == same
