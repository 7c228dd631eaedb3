"""Tests of the map against the poses: known vertices of the object inside the surroundings, and impacts.

A vertex is inside a known convex body if it is behind all of its faces. The extent of a face that is listed
by itself is not known: parts of the object are behind it if they hang over its edge or stand beside a step.
Only an object that never has a vertex in front of any such face contradicts them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.checks.check import MIXED_UP, Check, Stream, has_doubts
from contact_tracker.geometry.elements import Array, Plane, Point
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.elements import covariance_of
from contact_tracker.map.map import Map
from contact_tracker.motion.poses import NO_POSES, Poses


class Vertices(NamedTuple):
    """V vertices in the body frame."""

    names: tuple[str, ...]
    place_m: Array
    """(V, 3)"""
    sigma_m: Array
    """(V,) largest standard deviation of the coordinates."""

    def in_world(self, poses: Poses) -> Array:
        """Places (N, V, 3) in the world."""
        turned = np.einsum("nij,vj->nvi", poses.rotation, self.place_m)
        return np.asarray(turned + poses.position_m[:, None])


class Faces(NamedTuple):
    """F faces of one convex body (``is_solid``), or those that are listed by themselves."""

    is_solid: bool
    names: tuple[str, ...]
    normals: Array
    """(F, 3)"""
    offsets_m: Array
    """(F,)"""
    covariance: Array
    """(F, 4, 4) of normal and offset."""

    def in_front_m(self, points_m: Array) -> Array:
        """Distances (N, V, F) of points (N, V, 3) in front of each face."""
        return np.asarray(points_m @ self.normals.T - self.offsets_m)

    def sigma_m(self, points_m: Array) -> Array:
        """Standard deviations (N, V, F) of these distances due to the faces."""
        gradient = np.concatenate([points_m, -np.ones_like(points_m[..., :1])], axis=-1)
        variance = np.einsum("nvi,fij,nvj->nvf", gradient, self.covariance, gradient)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@lru_cache(maxsize=8)
def vertices_of(known_map: Map) -> Vertices:
    """The known vertices of the object."""
    listed = ((named.name, named.element) for named in known_map.listed_object)
    points = [(name, point) for name, point in listed if isinstance(point, Point)]
    place_m = np.array([point.point_m for _, point in points]).reshape(-1, 3)
    variance = np.array([covariance_of(point).diagonal().max() for _, point in points])
    return Vertices(tuple(name for name, _ in points), place_m, np.sqrt(variance))


@lru_cache(maxsize=8)
def faces_by_body(known_map: Map) -> tuple[Faces, ...]:
    """The known faces of the surroundings by body, without hulls, whose inside may be empty."""
    listed = ((named, named.element) for named in known_map.listed_environment if not named.is_hull)
    planes = [(named, plane) for named, plane in listed if isinstance(plane, Plane)]
    bodies = list[Faces]()
    for body in dict.fromkeys(named.solid for named, _ in planes):
        of_body = [
            (named.name, p.normal, p.offset_m, covariance_of(p)) for named, p in planes if named.solid == body
        ]
        names, *columns = zip(*of_body, strict=True)
        bodies.append(Faces(body is not None, names, *map(np.array, columns)))
    return tuple(bodies)


LEAST_M: Final = 0.005
"""Depth (m) up to which rounded edges and compliance explain it."""
SIGMAS: Final = 10.0
"""Least significant depth, in standard deviations of the map."""
LEAST_POSES: Final = 3
"""Least number of poses, since single ones may be wrong."""
CHECK: Final = "check --known (place, size, frames)"
"""Remedy for a map that does not fit."""


@dataclass(frozen=True, eq=False)
class Clearance(Check):
    """Vertices of the object inside the surroundings, by more than the accuracy of the map.

    Parameters
    ----------
    inside : number of poses with a vertex inside a convex body.
    deepest : the largest depth (m), its vertex, and the nearest face in front of this vertex.
    is_behind : whether all vertices were behind all faces that are listed by themselves.
    behind : number of poses in which this was compared.
    """

    inside: int = 0
    deepest: tuple[float, str, str] = (0.0, "", "")
    is_behind: bool = True
    behind: int = 0

    def update(self, poses: Poses, stream: Stream) -> "Clearance":
        vertices = vertices_of(stream.map)
        if not vertices.names or not len(poses):
            return self
        world, is_inside = vertices.in_world(poses), np.zeros(len(poses), bool)
        deepest, is_behind, behind = self.deepest, self.is_behind, self.behind
        for faces in faces_by_body(stream.map):
            depth_m = -faces.in_front_m(world)
            sigma_m = np.hypot(vertices.sigma_m[:, None], faces.sigma_m(world))
            allowed_m = np.maximum(LEAST_M, SIGMAS * sigma_m)
            inside = np.asarray((depth_m > allowed_m).all(axis=-1))
            if faces.is_solid:
                is_inside |= inside.any(axis=1)
                inside_m = np.where(inside, depth_m.min(axis=-1), 0.0)
                pose, vertex = divmod(int(inside_m.argmax()), inside_m.shape[1])
                face = faces.names[int(depth_m[pose, vertex].argmin())]
                deep = float(inside_m[pose, vertex]), vertices.names[vertex], face
                deepest = max(deepest, deep, key=lambda depth: depth[0])
            else:
                is_behind, behind = is_behind and bool(inside.all()), behind + len(poses)
        return Clearance(self.inside + int(is_inside.sum()), deepest, is_behind, behind)

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        misfits = list[str]()
        if self.inside >= LEAST_POSES:
            deep_m, vertex, face = self.deepest
            misfits.append(f"{vertex} of the object is up to {1e3 * deep_m:.0f} mm inside {face}")
        if self.is_behind and self.behind >= LEAST_POSES:
            behind = "behind every face (normals must point to the free side)"
            misfits.append(f"all vertices given of the object are {behind}")
        fault = "what is given does not fit the poses"
        return [Finding("knowledge", f"{fault}: {misfit}: {CHECK}", True) for misfit in misfits]


LONGEST_TICK_S: Final = 0.05
"""Longest tick (s) that resolves impacts."""
IMPACT_M_PER_S: Final = 0.85
"""Least change of speed (m/s) in an impact. In 57 tosses of a cube it is at least 0.93; of 32 recordings of
objects moved by hand one has more than 0.78 (1.0, a short and fast one)."""
NEAR_M: Final = 0.015
"""Largest distance (m) from a face of a vertex that may touch it."""
SPAN_S: Final = 0.02
"""Time (s) over which speeds are averaged before and after an impact."""
MOST_POSES: Final = 50
"""Largest number of poses in this time, which is shorter at higher rates."""
ROUND: Final = 2
"""Number of poses on either side over which distances are smoothed."""
LONGEST: Final = 1.5
"""Ratio of the time span to the usual one above which a speed is across a gap."""
AHEAD_S: Final = 0.5
"""An impact is near if a vertex will reach a face within this time (s) at its speed."""


@dataclass(frozen=True, eq=False)
class Impacts(Check):
    """State of the detection.

    Parameters
    ----------
    top_m_per_s : largest change of speed of a known vertex at a known face.
    is_near : whether a vertex moves towards a face at the speed of an impact, and will soon reach it.
    recent : the latest poses, about 100 at most.
    """

    suspicion = "the object may hit what is known, with contacts shorter than a tick"

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
        off_m, time_s = _distances_m(bodies, vertices.in_world(window)), time_s[ROUND:-ROUND]
        # medians, without outliers of up to two poses
        off_m = np.median([off_m[i : i + len(time_s)] for i in range(2 * ROUND + 1)], axis=0)
        speed = (off_m[step:] - off_m[:-step]) / (time_s[step:] - time_s[:-step])[:, None, None]
        # an impact is between two poses: one speed ends at the first, the other begins at the second
        least_m = np.minimum(np.abs(off_m[step : -step - 1]), np.abs(off_m[step + 1 : -step]))
        passed_s = time_s[2 * step + 1 :] - time_s[: -2 * step - 1]
        may_touch = (least_m < NEAR_M) & (speed[: -step - 1] < 0.0)
        may_touch &= (passed_s < LONGEST * (2 * step + 1) * interval_s)[:, None, None]
        change = np.where(may_touch, speed[step + 1 :] - speed[: -step - 1], 0.0)
        reached_s = off_m[-1] / np.maximum(-speed[-1], IMPACT_M_PER_S)
        is_near = (speed[-1] < -IMPACT_M_PER_S) & (off_m[-1] > -NEAR_M) & (reached_s < AHEAD_S)
        return Impacts(max(self.top_m_per_s, float(change.max(initial=0.0))), bool(is_near.any()), recent)

    def is_likely(self, stream: Stream) -> bool:
        if stream.model.tick_s <= LONGEST_TICK_S or stream.is_end:
            return False
        may_touch = stream.map.shows_touch
        return self.is_near or (may_touch and not stream.inspection.blocks)  # before the first inspection

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
    """Distances (N, V, B) of vertices (N, V, 3) in front of single faces, and lower bounds of those from
    bodies."""
    pairs = ((body, body.in_front_m(world)) for body in bodies)
    off_m = [m.max(axis=-1, keepdims=True) if body.is_solid else m for body, m in pairs]
    return np.concatenate(off_m, axis=-1)
