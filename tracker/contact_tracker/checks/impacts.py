"""Detection of impacts: contacts shorter than the usual ticks, of an object with known elements.

A body that falls on another, or is thrown against it, changes the speed of the touching vertex within
milliseconds. A hand or robot that moves as fast in the free slows down before it touches.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from contact_tracker.checks.check import MIXED_UP, Check, Stream, has_doubts
from contact_tracker.checks.clearance import Faces, faces_by_body, vertices_of
from contact_tracker.geometry.elements import Array
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.motion.poses import NO_POSES, Poses

LONGEST_TICK_S: Final = 0.05
"""Ticks up to this are short enough for impacts."""
IMPACT_M_PER_S: Final = 0.85
"""Change of speed in an impact. Of 57 tosses of a cube the least has 0.93; of 32 recordings of objects that
are moved by hand one has more than 0.78 (1.0, a short and fast one)."""
NEAR_M: Final = 0.015
"""Distance of a vertex from a face at which it may touch it."""
SPAN_S: Final = 0.02
"""Time over which speeds are taken, before and after an impact."""
MOST_POSES: Final = 50
"""Most poses in this time; of faster ones it is shorter."""
ROUND: Final = 2
"""Number of poses before and after each over which distances are smoothed."""
LONGEST: Final = 1.5
"""Speeds over longer times than this, relative to the usual, are across a gap."""
AHEAD_S: Final = 0.5
"""An impact is near if a vertex reaches a face within this time at its speed."""


@dataclass(frozen=True, eq=False)
class Impacts(Check):
    """State of the detection.

    Parameters
    ----------
    top_m_per_s : largest change of speed of a known vertex at a known face.
    is_near : whether a vertex moves towards a face at such a speed, and will soon reach it.
    recent : the latest poses, some 100 at most.
    """

    top_m_per_s: float = 0.0
    is_near: bool = False
    recent: Poses = NO_POSES

    def update(self, poses: Poses, stream: Stream) -> "Impacts":
        vertices, bodies = vertices_of(stream.map), faces_by_body(stream.map)
        if not vertices.names or not bodies or not len(poses):
            return self
        window = Poses.join([self.recent, poses])
        if len(window) < 2:
            return replace(self, recent=window)
        time_s = 1e-9 * (window.stamp_ns - window.stamp_ns[0])
        interval_s = float(np.median(np.diff(time_s)))
        step = min(max(1, round(SPAN_S / interval_s)), MOST_POSES)
        recent = window[-(2 * step + 1 + 2 * ROUND) :]
        if len(window) < 2 * step + 2 + 2 * ROUND:
            return replace(self, recent=window)
        off_m, time_s = _smoothed(_distances_m(bodies, vertices.in_world(window))), time_s[ROUND:-ROUND]
        speed = (off_m[step:] - off_m[:-step]) / (time_s[step:] - time_s[:-step])[:, None, None]
        # an impact falls between two poses: speeds end at one and begin at the next
        least_m = np.minimum(np.abs(off_m[step : -step - 1]), np.abs(off_m[step + 1 : -step]))
        passed_s = time_s[2 * step + 1 :] - time_s[: -2 * step - 1]
        may_touch = (least_m < NEAR_M) & (speed[: -step - 1] < 0.0)
        may_touch &= (passed_s < LONGEST * (2 * step + 1) * interval_s)[:, None, None]
        change = np.where(may_touch, speed[step + 1 :] - speed[: -step - 1], 0.0)
        reached_s = off_m[-1] / np.maximum(-speed[-1], IMPACT_M_PER_S)
        is_near = (speed[-1] < -IMPACT_M_PER_S) & (off_m[-1] > -NEAR_M) & (reached_s < AHEAD_S)
        return Impacts(max(self.top_m_per_s, float(change.max(initial=0.0))), bool(is_near.any()), recent)

    def is_likely(self, stream: Stream) -> bool:
        if stream.model.tick_s <= LONGEST_TICK_S:
            return False
        is_too_early = bool(stream.map.object and stream.map.environment) and not stream.inspection.blocks
        return is_too_early or self.is_near

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        tick_s = stream.model.tick_s
        if self.top_m_per_s < IMPACT_M_PER_S or tick_s <= LONGEST_TICK_S or has_doubts(earlier, *MIXED_UP):
            return []
        text = (
            f"the object hits what is known (its speed changes by {self.top_m_per_s:.1f} m/s), and contacts "
            f"may be shorter than the ticks of {tick_s:g} s; what is known suffices for shorter ones: take "
            "--model impacts"
        )
        return [Finding("impacts", text, True)]


def _distances_m(bodies: Sequence[Faces], world: Array) -> Array:
    """Distances (N, V, B) of vertices in the world (N, V, 3) in front of each single face, and of bodies as
    far as their faces show."""
    found = list[Array]()
    for faces in bodies:
        off_m = faces.in_front_m(world)
        found.append(off_m.max(axis=-1, keepdims=True) if faces.is_solid else off_m)
    return np.concatenate(found, axis=-1)


def _smoothed(off_m: Array) -> Array:
    """Medians (N - 2 ROUND, V, B), without outliers of up to two poses."""
    count = len(off_m) - 2 * ROUND
    return np.asarray(np.median([off_m[i : i + count] for i in range(2 * ROUND + 1)], axis=0))
