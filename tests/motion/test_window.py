"""The window's estimate of the motion in its newest tick, and rests, found to the tick."""

import numpy as np
import pytest

from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.motion.window import Window, at_rest, newest_rest, rest_ticks

SIGMA_M, SIGMA_RAD = 1e-3, 1e-2


def window(*x_m: float, turn_rad: float = 0.0) -> Window:
    """Ticks along x without innovation excess, the last one rotated about z."""
    count = len(x_m)
    position_m = np.zeros((count, 3))
    position_m[:, 0] = x_m
    rotation = np.broadcast_to(np.eye(3), (count, 3, 3)).copy()
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    rotation[-1] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    variance = np.tile([SIGMA_M**2, SIGMA_RAD**2], (count, 1))
    return Window(np.arange(count), lift(rotation, position_m), variance, np.zeros((count, 2)))


def test_the_displacement_of_the_newest_tick_is_relative_to_the_noise() -> None:
    """Also in predictable motion. Per axis, so over three axes by a factor of the square root of three."""
    smooth, three = window(0.0, 0.01, 0.02), np.sqrt(3.0)
    assert smooth.motion_ratio.max() == 0.0
    assert smooth.displacement_ratio == pytest.approx(1.0, abs=0.05)
    assert window(1.0).displacement_ratio == window(0.0, 0.5, 0.5).displacement_ratio == 0.0
    assert window(0.0, 0.0, 0.5).displacement_ratio > 0.99
    assert window(0.0, three * SIGMA_M).displacement_ratio == pytest.approx(0.5)
    turned = window(0.0, 0.0, turn_rad=three * SIGMA_RAD)
    assert turned.displacement_ratio == pytest.approx(0.5, abs=1e-3)


TICK_S, TICKS = 0.1, 60
QUIET_M = 1e-4


def ticks(position_m: np.ndarray, frames: np.ndarray | None = None) -> Window:
    """Ticks at these positions (N, 3) and with noise, all with frames by default."""
    count = len(position_m)
    noisy = position_m + np.random.default_rng(3).normal(size=(count, 3)) * QUIET_M
    rows = np.tile([QUIET_M**2, 1e-6], (count, 1))
    zeta = lift(np.tile(np.eye(3), (count, 1, 1)), noisy)
    frames = np.ones(count) if frames is None else frames
    return Window(np.arange(count), zeta, rows, np.zeros((count, 2)), frames=frames)


def along(way_m: np.ndarray) -> np.ndarray:
    return np.outer(way_m, [0.6, 0.0, 0.8])


def test_a_rest_ends_where_motion_begins() -> None:
    """Motion with 0.5 m/s^2 after 3 s of rest and before 2 s of it."""
    way_m = 0.25 * np.square(np.clip((np.arange(TICKS) - 29) * TICK_S, 0.0, 1.0))
    resting = at_rest(ticks(along(way_m)), TICK_S)
    edges = np.flatnonzero(np.diff(resting))
    np.testing.assert_allclose(edges, [29, 39], atol=1)
    assert [newest_rest(ticks(along(way_m[:end])), TICK_S).is_in_rest for end in (5, 29, 35, 60)] == [
        False,
        True,
        False,
        True,
    ]


@pytest.mark.parametrize("speed_m_s", [0.002, 0.02])
def test_steady_motion_is_no_rest(speed_m_s: float) -> None:
    assert not at_rest(ticks(along(speed_m_s * TICK_S * np.arange(TICKS))), TICK_S).any()


@pytest.mark.parametrize(("amplitude", "rests"), [(2.5, True), (20.0, False)])
def test_an_object_that_vibrates_rests_but_not_one_that_is_shaken(amplitude: float, rests: bool) -> None:
    """From tick to tick, in deviations of a tick of 20 poses by noise; the rest ends where motion begins."""
    way_m = along(np.concatenate([np.zeros(30), 0.02 * np.arange(1.0, 11.0)]))
    way_m[10:30] += amplitude * QUIET_M * np.random.default_rng(0).normal(size=(20, 3))
    resting = at_rest(ticks(way_m, np.full(40, 20.0)), TICK_S)
    assert (resting[15:30] == rests).all()
    assert not resting[31:].any()


def test_a_gap_is_no_rest_but_may_lie_within_one() -> None:
    place, frames = along(np.zeros(TICKS)), np.ones(TICKS)
    frames[20:40] = 0.0
    assert at_rest(ticks(place, frames), TICK_S).all()
    frames[5:55] = 0.0
    assert at_rest(ticks(place, frames), TICK_S).all()  # ten ticks with frames about it
    frames[4] = 0.0
    assert not at_rest(ticks(place, frames), TICK_S).any()
    assert not newest_rest(ticks(place, np.zeros(TICKS)), TICK_S).is_in_rest


def test_slow_streams_need_some_ticks_too() -> None:
    assert (rest_ticks(0.1), rest_ticks(0.5), rest_ticks(3.0)) == (10, 4, 4)
