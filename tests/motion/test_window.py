"""The window's estimate of the motion in its newest tick."""

import numpy as np
import pytest

from contact_tracker.motion.lifted_pose import lift
from contact_tracker.motion.window import Window

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


def test_predictable_motion_is_displacement() -> None:
    smooth = window(0.0, 0.01, 0.02)
    assert smooth.motion_ratio.max() == 0.0
    assert smooth.displacement_ratio == pytest.approx(1.0, abs=0.05)


def test_only_the_newest_tick_counts() -> None:
    assert window(0.0, 0.5, 0.5).displacement_ratio == 0.0
    assert window(0.0, 0.0, 0.5).displacement_ratio > 0.99


def test_a_displacement_as_large_as_the_noise_is_half_a_motion() -> None:
    """Per axis, so over three axes by a factor of the square root of three."""
    assert window(0.0, np.sqrt(3.0) * SIGMA_M).displacement_ratio == pytest.approx(0.5)
    assert window(0.0, 0.0, turn_rad=np.sqrt(3.0) * SIGMA_RAD).displacement_ratio == pytest.approx(
        0.5, abs=1e-3
    )


def test_a_window_of_one_tick_has_not_moved() -> None:
    assert window(1.0).displacement_ratio == 0.0
