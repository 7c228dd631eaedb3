"""Rests: found to the tick, and neither in slow motion nor in gaps."""

import numpy as np
import pytest

from contact_tracker.motion.lifted_pose import lift
from contact_tracker.motion.rests import at_rest, rest_ticks, rests_now
from contact_tracker.motion.window import SlidingWindow, Window

TICK_S, SIGMA_M = 0.1, 1e-4
TICKS = 60


def ticks(position_m: np.ndarray, frames: np.ndarray | None = None) -> SlidingWindow:
    """Ticks at these positions (N, 3) and with noise, all with frames by default."""
    count = len(position_m)
    noisy = position_m + np.random.default_rng(3).normal(size=(count, 3)) * SIGMA_M
    rows = np.tile([SIGMA_M**2, 1e-6], (count, 1))
    zeta = lift(np.tile(np.eye(3), (count, 1, 1)), noisy)
    return SlidingWindow(
        Window(np.arange(count), zeta, rows, np.zeros((count, 2))),
        np.ones(count) if frames is None else frames,
    )


def along(way_m: np.ndarray) -> np.ndarray:
    return np.outer(way_m, [0.6, 0.0, 0.8])


def test_a_rest_ends_where_motion_begins() -> None:
    """Motion with 0.5 m/s^2 after 3 s of rest and before 2 s of it."""
    way_m = 0.25 * np.square(np.clip((np.arange(TICKS) - 29) * TICK_S, 0.0, 1.0))
    resting = at_rest(ticks(along(way_m)), TICK_S)
    edges = np.flatnonzero(np.diff(resting))
    np.testing.assert_allclose(edges, [29, 39], atol=1)
    assert [rests_now(ticks(along(way_m[:end])), TICK_S) for end in (5, 29, 35, 60)] == [
        False,
        True,
        False,
        True,
    ]


@pytest.mark.parametrize("speed_m_s", [0.002, 0.02])
def test_steady_motion_is_no_rest(speed_m_s: float) -> None:
    assert not at_rest(ticks(along(speed_m_s * TICK_S * np.arange(TICKS))), TICK_S).any()


def test_a_gap_is_no_rest_but_may_lie_within_one() -> None:
    place, frames = along(np.zeros(TICKS)), np.ones(TICKS)
    frames[20:40] = 0.0
    assert at_rest(ticks(place, frames), TICK_S).all()
    frames[5:55] = 0.0
    assert at_rest(ticks(place, frames), TICK_S).all()  # ten ticks with frames about it
    frames[4] = 0.0
    assert not at_rest(ticks(place, frames), TICK_S).any()
    assert not rests_now(ticks(place, np.zeros(TICKS)), TICK_S)


def test_slow_streams_need_some_ticks_too() -> None:
    assert (rest_ticks(0.1), rest_ticks(0.5), rest_ticks(3.0)) == (10, 4, 4)
