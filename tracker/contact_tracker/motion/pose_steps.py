"""Steps between consecutive poses."""

from collections.abc import Collection
from math import radians, sin, sqrt
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.motion.poses import Array, Pose, Poses

NEAR_M: Final = 0.01
NEAR_TURN: Final = 2.0 * sin(radians(3.0) / 2.0)
"""A pose within both of the last one is near, whatever the motion."""


STEPS_KEPT: Final = 25
"""Number of steps that show what is usual."""


class Step(NamedTuple):
    """``turn`` is twice the sine of half the angle: of small angles as good as the angle in radians."""

    distance_m: float
    turn: float

    @property
    def is_near(self) -> bool:
        return self.distance_m <= NEAR_M and self.turn <= NEAR_TURN


class Steps(NamedTuple):
    """Steps from each pose to the next: distance, turn as in ``Step``, and cosine of half its angle."""

    distance_m: Array
    turn: Array
    cosine: Array

    @classmethod
    def between(cls, poses: Poses) -> "Steps":
        """Steps between ``poses``, with the same rounding as ``step_between``."""
        x, y, z = (poses.position_m[1:] - poses.position_m[:-1]).T
        a, b, c, d = (poses.quat_xyzw[1:] * poses.quat_xyzw[:-1]).T
        cosine = a + b + c + d
        turn = 2.0 * np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
        return cls(np.sqrt(x * x + y * y + z * z), turn, cosine)

    @property
    def are_near(self) -> bool:
        """Whether all of them are."""
        return bool(self.distance_m.max() <= NEAR_M and self.turn.max() <= NEAR_TURN)


def reach(steps: Collection[Step], times: float, quantile: float) -> Step:
    """How far a pose may be from the last one: ``times`` the usual step, at least near."""
    if not steps:
        return Step(NEAR_M, NEAR_TURN)
    rank = int(quantile * (len(steps) - 1))
    distance_m = sorted(step.distance_m for step in steps)[rank]
    turn = sorted(step.turn for step in steps)[rank]
    return Step(max(NEAR_M, times * distance_m), max(NEAR_TURN, times * turn))


def step_between(a: Pose, b: Pose) -> Step:
    """The step from pose ``a`` to pose ``b``."""
    (ax, ay, az), (bx, by, bz) = a.position_m, b.position_m
    x, y, z = bx - ax, by - ay, bz - az
    (ax, ay, az, aw), (bx, by, bz, bw) = a.quat_xyzw, b.quat_xyzw
    cosine = ax * bx + ay * by + az * bz + aw * bw
    return Step(sqrt(x * x + y * y + z * z), 2.0 * sqrt(max(1.0 - cosine * cosine, 0.0)))
