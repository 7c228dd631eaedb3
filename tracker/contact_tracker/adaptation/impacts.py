"""Detection of impacts: contacts shorter than the usual ticks, of an object with known elements.

A body that falls on another, or is thrown against it, changes the speed of the touching vertex within
milliseconds. A hand or robot that moves as fast in the free slows down before it touches.
"""

from typing import Final, NamedTuple

import numpy as np

from contact_tracker.adaptation.known_vertices import faces_by_body, vertices_of
from contact_tracker.geometry.elements import Array
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.landmarks.prior_map import PriorMap
from contact_tracker.motion.poses import NO_POSES, Poses

LONGEST_TICK_S: Final = 0.05
"""Ticks up to this are short enough for impacts."""
IMPACT_M_PER_S: Final = 0.9
"""Change of speed in an impact. Of 57 tosses of a cube the least has 1.0; of 32 recordings of objects that
are moved by hand one has more than 0.78 (1.0, a short and fast one)."""
NEAR_M: Final = 0.015
"""Distance of a vertex from a face at which it may touch it."""
SPAN_S: Final = 0.02
"""Time over which speeds are taken, before and after an impact."""
AHEAD_S: Final = 0.5
"""An impact is near if a vertex reaches a face within this time at its speed."""


class Impacts(NamedTuple):
    """State of the detection.

    Parameters
    ----------
    top_m_per_s : largest change of speed of a known vertex at a known face.
    is_near : whether a vertex moves towards a face at such a speed, and will soon reach it.
    recent : the latest poses.
    """

    top_m_per_s: float = 0.0
    is_near: bool = False
    recent: Poses = NO_POSES


def advance(found: Impacts, knowledge: PriorMap, poses: Poses) -> Impacts:
    """Advance by poses."""
    vertices, bodies = vertices_of(knowledge), faces_by_body(knowledge)
    if not vertices.names or not bodies or not len(poses):
        return found
    window = Poses.join([found.recent, poses])
    if len(window) < 2:
        return found._replace(recent=window)
    time_s = 1e-9 * (window.stamp_ns - window.stamp_ns[0])
    step = max(1, round(SPAN_S / float(np.median(np.diff(time_s)))))
    recent = window[-(2 * step + 3) :]
    if len(window) < 2 * step + 4:
        return found._replace(recent=window)
    world = vertices.in_world(window)
    off_m = np.concatenate([world @ faces.normals.T - faces.offsets_m for faces in bodies], axis=-1)
    smooth_m = np.median([off_m[:-2], off_m[1:-1], off_m[2:]], axis=0)  # without single outliers
    passed_s = time_s[1 + step : -1] - time_s[1 : -1 - step]
    speed = (smooth_m[step:] - smooth_m[:-step]) / passed_s[:, None, None]
    # an impact falls between two poses: speeds end at one and begin at the next
    least_m = np.minimum(np.abs(smooth_m[step : -step - 1]), np.abs(smooth_m[step + 1 : -step]))
    top = max(found.top_m_per_s, _largest_change(least_m, speed[: -step - 1], speed[step + 1 :]))
    reached_s = smooth_m[-1] / np.maximum(-speed[-1], IMPACT_M_PER_S)
    is_near = (speed[-1] < -IMPACT_M_PER_S) & (smooth_m[-1] > -NEAR_M) & (reached_s < AHEAD_S)
    return Impacts(top, bool(is_near.any()), recent)


def _largest_change(distance_m: Array, before: Array, after: Array) -> float:
    """Largest change of a speed (m/s) from towards a face, where the distance is small."""
    may_touch = (distance_m < NEAR_M) & (before < 0.0)
    return float(np.where(may_touch, after - before, 0.0).max(initial=0.0))


def findings(found: Impacts, tick_s: float) -> tuple[Finding, ...]:
    """Findings while poses come in, for ticks of this duration."""
    if found.top_m_per_s < IMPACT_M_PER_S or tick_s <= LONGEST_TICK_S:
        return ()
    text = (
        f"the object hits what is known (its speed changes by {found.top_m_per_s:.1f} m/s), and contacts "
        f"may be shorter than the ticks of {tick_s:g} s; what is known suffices for shorter ones: take "
        "--model impacts"
    )
    return (Finding("impacts", text, True),)
