"""Rests: stretches in which the object stays where it is, as far as the noise shows."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.motion.free_motion import NOW_TICKS, STILL
from contact_tracker.motion.lifted_pose import R, T
from contact_tracker.motion.window import SlidingWindow, Window

Bools = NDArray[np.bool_]

REST_S: Final = 1.0
"""Shortest time in one place that is a rest."""
_POSE: Final = slice(T[-1] + 1)


def rest_ticks(tick_s: float) -> int:
    """Number of ticks of the shortest rest."""
    return max(round(REST_S / tick_s), NOW_TICKS + 1)


def at_rest(ticks: SlidingWindow, tick_s: float) -> Bools:
    """Which ticks (W,) belong to a rest: within ``REST_S`` their poses scatter like noise about their mean.

    The excess of single ticks does not show it: noise has some now and then, and steady motion has none. A
    tick without frames belongs to a rest if it lies within one.
    """
    count = rest_ticks(tick_s)
    resting, filled = np.zeros(len(ticks.window), bool), np.flatnonzero(ticks.frames)
    for first in np.flatnonzero(_still(ticks.window, filled, count)):
        resting[filled[first] : filled[first + count - 1] + 1] = True
    return resting


def _still(window: Window, filled: NDArray[np.intp], count: int) -> Bools:
    """In which spans of ``count`` consecutive ticks with frames, whose rows are ``filled``, the object stays
    where it is."""
    if len(filled) < count:
        return np.zeros(0, bool)
    pose, variance = window.zeta[filled, _POSE], window.variance[filled]
    spans = [slice(first, len(filled) - count + 1 + first) for first in range(count)]
    mean, of_noise = (np.sum([values[span] for span in spans], axis=0) / count for values in (pose, variance))
    scatter = np.sum([np.square(pose[span] - mean) for span in spans], axis=0) / (count - 1.0)
    still = scatter[:, T].sum(axis=1) / 3.0 <= STILL * of_noise[:, 0]
    return np.asarray(still & (scatter[:, R].sum(axis=1) / 6.0 <= STILL * of_noise[:, 1]))


def completes_rest(ticks: SlidingWindow, tick_s: float) -> bool:
    """Whether the newest tick completes the first ``REST_S`` of a rest."""
    count, newest = rest_ticks(tick_s), len(ticks.frames) - 1
    if not ticks.frames[newest]:
        return False
    filled = np.flatnonzero(ticks.frames)[-2 * count :]
    still = _still(ticks.window, filled, count)
    return bool(still[-1:].any() and not still[:-1].any())


def rests_now(ticks: SlidingWindow, tick_s: float) -> bool:
    """Whether the newest tick, which has frames, belongs to a rest."""
    filled = np.flatnonzero(ticks.frames)[-rest_ticks(tick_s) :]
    if not len(filled):
        return False
    latest = SlidingWindow(ticks.window.cut(int(filled[0]), None), ticks.frames[filled[0] :])
    return bool(at_rest(latest, tick_s)[-1])
