"""Two bodies in one stream: poses that go back and forth, again and again.

A pose *returns* if it is far from the last one and close to another of the few before it. An outlier makes
one pose return, a swapped marker one a burst; bodies that take turns make every pose return, those that come
in random order every second one.
"""

from math import log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.motion.excursions import ARM_M, FAR_M_PER_S2
from contact_tracker.motion.poses import Poses

Array = NDArray[np.float64]

BACK: Final = 8
"""How many poses back a return is looked for."""
FAR_M: Final = 0.01
FAR_STEPS: Final = 8.0
CLOSE: Final = 0.25
"""Largest distance from the pose returned to, as a share of the step."""
# Page's test: with returns in 13 % of the poses the sum drifts down, with 40 % it rises; the chance of a
# false alarm is about exp(-ALARM) a pose.
RETURN: Final = log(0.40 / 0.13)
NO_RETURN: Final = log(0.60 / 0.87)
ALARM: Final = 25.0


def returned(poses: Poses, interval_s: float) -> NDArray[np.bool_]:
    """(n,) which poses from the BACKth on are far from the last one and close to another of the last few."""
    position, quat = poses.position_m, poses.quat_xyzw
    step = _distance(position[BACK:], quat[BACK:], position[BACK - 1 : -1], quat[BACK - 1 : -1])
    far = step > max(FAR_M, FAR_M_PER_S2 * interval_s**2)  # slower alternation is motion
    if not far.any():
        return far
    rows = np.arange(len(poses) - BACK)[:, None] + np.arange(BACK)
    distance = _distance(position[BACK:, None], quat[BACK:, None], position[rows], quat[rows])
    nearest = distance.min(axis=1)
    far &= step > FAR_STEPS * np.median(nearest)
    return np.asarray(far & (nearest < CLOSE * step) & (nearest > 0.0))


def page_sum(page: float, returns: NDArray[np.bool_]) -> tuple[float, bool]:
    """Page's cumulative sum (never below zero) after these poses, and whether it reached the alarm."""
    if not page and not returns.any():
        return 0.0, False
    path = np.append(page, np.where(returns, RETURN, NO_RETURN)).cumsum()
    above = path - np.minimum(np.minimum.accumulate(path), 0.0)
    return float(above[-1]), bool(above.max() > ALARM)


def _distance(position: Array, quat: Array, other_position: Array, other_quat: Array) -> Array:
    """Distances in metres, rotations by their path on the lever arm."""
    path, cosine = other_position - position, (other_quat * quat).sum(axis=-1)
    turn_sq = 8.0 * np.maximum(1.0 - np.abs(cosine), 0.0)
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", path, path) + ARM_M**2 * turn_sq))
