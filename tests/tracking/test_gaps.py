"""Gaps in a stream: each is tracked for some seconds, tick by tick, in little time and memory."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from contact_tracker.adaptation import online
from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hypotheses import bank_update
from contact_tracker.hypotheses.tick_update import LiveHypotheses
from contact_tracker.map.file import map_from
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import empty_tick
from contact_tracker.motion.tick_grid import EMPTY_PER_TICK, EMPTY_TICKS
from contact_tracker.motion.window import EMPTY_WINDOW, advance_window, advance_windows
from contact_tracker.saved_state import is_same
from contact_tracker.tracking import tracker
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.forward_pass import forward
from contact_tracker.tracking.state import scales_of
from short_recordings import FACE_TO_EDGE, recorded

MODEL = load_model()
SECOND = 1_000_000_000


def with_gaps(count: int, gap_s: float, steady: int = 0) -> Poses:
    """Poses with a gap before each except the first ``steady`` ones."""
    poses = recorded(FACE_TO_EDGE).poses[: 10 * count : 10]
    periods_ns = np.where(np.arange(count) < steady, SECOND // 20, int(gap_s * SECOND))
    return Poses(np.cumsum(periods_ns), poses.position_m, poses.quat_xyzw)


def test_thousands_of_gaps_are_not_all_filled() -> None:
    """A pair of poses every 5 s: a file of hours, nearly all of whose ticks are empty."""
    count = 600
    stamp_ns = (np.arange(count) // 2 * 5 * SECOND) + np.arange(count) % 2 * (SECOND // 50)
    position_m = 1e-3 * np.cumsum(np.random.default_rng(1).normal(size=(count, 3)), axis=0)
    poses = Poses(stamp_ns, position_m, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))
    state, ticks = tracker.accumulate_poses(tracker.start(MODEL), poses)
    filled, used = sum(not tick.count for tick in ticks), sum(tick.count > 0 for tick in ticks)
    assert used == count // 2 - 1
    assert EMPTY_TICKS < filled <= EMPTY_TICKS + EMPTY_PER_TICK * used
    _, whole = tracker.accumulate_poses(tracker.start(MODEL), poses[:40])
    assert sum(not tick.count for tick in whole) == 19 * 49  # the gaps of an ordinary recording are filled
    state, one_by_one = tracker.start(MODEL), list[int]()
    for pose in poses:
        state, closed = tracker.accumulate_pose(state, pose)
        one_by_one += [tick.stamp_ns for tick in closed]
    assert one_by_one == [tick.stamp_ns for tick in ticks]


@pytest.mark.parametrize("window_s", [1.0, 3.0, 30.0])
def test_windows_of_a_gap_are_those_of_tick_after_tick(window_s):
    model = replace(MODEL, search=replace(MODEL.search, window_s=window_s))
    _, ticks = tracker.accumulate_poses(tracker.start(model), with_gaps(12, 1.5))
    assert sum(not tick.count for tick in ticks) > 100
    sliding = EMPTY_WINDOW
    for number, (tick, found) in enumerate(
        zip(ticks, advance_windows(EMPTY_WINDOW, 0, ticks, model), strict=True)
    ):
        sliding = advance_window(sliding, number, tick, model)
        assert is_same(found, sliding)
        for name in ("inverse", "displacement_variance"):
            np.testing.assert_array_equal(getattr(found.window, name), getattr(sliding.window, name))


def test_the_evidence_of_a_tick_without_motion_is_zero():
    """So ticks of a gap need no evaluation when they leave the window."""
    seen = list(forward(with_gaps(30, 1.0), MODEL, detail=Detail.WEIGHTS))[-1].state
    empty = np.flatnonzero(~seen.window.innovation_excess.any(axis=1))
    assert len(empty) > 100
    settled = 0
    for bank, contact in zip(seen.banks, CONTACT_MODELS, strict=True):
        for row in empty[:5]:
            oldest = seen.window.cut(int(row), int(row) + 1)
            after = bank_update.marginalise_expired_ticks(bank, contact, oldest, scales_of(MODEL))
            np.testing.assert_array_equal(after.words, bank.words)
            settled += after is not bank
    assert settled


def test_live_hypotheses_in_gaps_equal_those_of_the_banks():
    waiting = 0
    for seen in forward(with_gaps(12, 1.5), MODEL, detail=Detail.WEIGHTS):
        expected = LiveHypotheses.of(seen.state.banks, seen.state.ticks - 1)
        assert is_same(seen.state.live_hypotheses, expected)
        waiting += not seen.state.hazard_exposure
    assert waiting > 100


@pytest.mark.parametrize("count", [1, 2, 40, 299, 300, 301, 1000])
def test_a_gap_in_one_step_is_the_same_as_tick_by_tick(count):
    poses = with_gaps(20, 0.15)
    state, ticks = tracker.accumulate_poses(tracker.start(MODEL), poses)
    empty = [
        empty_tick(ticks[-1], ticks[-1].stamp_ns + i * SECOND // 10, ticks[-1].stamp_ns + i * SECOND // 10)
        for i in range(1, count + 4)
    ]
    expected = [state for state, _ in tracker.update_each(state, [*ticks, *empty], Detail.WEIGHTS)]
    before = expected[-count - 1]
    assert before.window.innovation_excess.any()
    assert tracker.can_hold(before)
    held, last = tracker.hold(before, count), expected[-1]
    assert last.deferred_exposure == pytest.approx(held.deferred_exposure)
    for one, other in zip(held.banks, last.banks, strict=True):  # sums in another order
        np.testing.assert_allclose(one.words, other.words, rtol=1e-9, atol=1e-9)
    other_fields = {"banks": (), "belief": None, "deferred_exposure": 0.0}
    assert is_same(held._replace(**other_fields), last._replace(**other_fields))
    for name in ("inverse", "displacement_variance"):
        np.testing.assert_array_equal(getattr(held.window, name), getattr(last.window, name))


def test_neither_with_a_lag_nor_with_known_elements_is_a_gap_passed_in_one_step():
    given = map_from({"environment": {"plane": [{"normal": [0, 0, 1], "offset_m": 0.0}]}})
    poses = with_gaps(20, 0.15)
    for start in (tracker.start(MODEL, lag_s=0.5), tracker.start(MODEL, known_map=given)):
        state, ticks = tracker.accumulate_poses(start, poses)
        assert len(ticks)
        for after, _ in tracker.update_each(state, ticks):
            assert not tracker.can_hold(after)


def test_trackers_side_by_side_take_little_memory_in_gaps():
    """Poses of one batch close up to 50 ticks each, in several trackers."""
    poses = with_gaps(130, 5.0, steady=14)
    state, _ = online.advance(online.start(MODEL), poses[:80])
    assert len(state.trackers.trackers) > 3
    tracemalloc.start()
    online.advance(state, poses[80:], Detail.WEIGHTS)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 100e6
