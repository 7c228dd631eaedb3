"""Gaps in a stream: each is tracked for some seconds, tick by tick, in little time and memory."""

import tracemalloc

import numpy as np

import as_values
from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import EMPTY_PER_TICK, EMPTY_TICKS, TickGrid
from contact_tracker.tracking.belief import Detail
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
    ticks = TickGrid(MODEL).add(poses)
    filled, used = sum(not tick.count for tick in ticks), sum(tick.count > 0 for tick in ticks)
    assert used == count // 2 - 1
    assert EMPTY_TICKS < filled <= EMPTY_TICKS + EMPTY_PER_TICK * used
    whole = TickGrid(MODEL).add(poses[:40])
    assert sum(not tick.count for tick in whole) == 19 * 49  # the gaps of an ordinary recording are filled
    grid, one_by_one = TickGrid(MODEL), list[int]()
    for row in range(count):
        one_by_one += [tick.stamp_ns for tick in grid.add(poses[row : row + 1])]
    assert one_by_one == [tick.stamp_ns for tick in ticks]


def test_trackers_side_by_side_take_little_memory_in_gaps():
    """Poses of one batch close up to 50 ticks each, in several trackers."""
    poses = with_gaps(130, 5.0, steady=14)
    state, _ = as_values.advance(as_values.start(MODEL), poses[:80])
    assert len(state.filters.filters) > 3
    tracemalloc.start()
    as_values.advance(state, poses[80:], Detail.WEIGHTS)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 100e6
