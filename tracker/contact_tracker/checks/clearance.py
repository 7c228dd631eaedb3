"""Test of the prior map against the poses: depth of known vertices of the object inside the surroundings, and
least distance from them.

A vertex is inside a known convex body if it is behind all of its faces. How far a face extends that is listed
by itself is not known: parts of the object are behind it where they hang over its edge, or stand beside a
step. Only an object that never has a vertex in front of any such face contradicts them.
"""

from collections.abc import Sequence
from math import inf
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.checks.known_vertices import Faces, faces_by_body, vertices_of
from contact_tracker.geometry.elements import Array
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.map import PriorMap
from contact_tracker.motion.poses import Poses

LEAST_M: Final = 0.005
"""Depth that rounded edges and compliance do not explain."""
SIGMAS: Final = 10.0
"""Depth, in standard deviations of the prior map, that is significant."""
LEAST_POSES: Final = 3
"""Number of poses that are needed, since single ones may be wrong."""
CHECK: Final = "check --known (place, size, frames)"
"""The remedy for knowledge that does not fit."""


class Clearance(NamedTuple):
    """Vertices of the object inside the surroundings, by more than the accuracy of the prior map.

    Parameters
    ----------
    inside : number of poses with a vertex inside a convex body.
    deep_m : largest depth; ``vertex`` has it, behind the nearest ``face``.
    is_behind : whether all vertices were behind all faces that are listed by themselves, in the ``behind``
        poses that were compared with these.
    gap_m : least distance from any face that is listed by itself, the ``nearest``.
    """

    inside: int = 0
    deep_m: float = 0.0
    vertex: str = ""
    face: str = ""
    is_behind: bool = True
    behind: int = 0
    gap_m: float = inf
    nearest: str = ""


def advance(found: Clearance, knowledge: PriorMap, poses: Poses) -> Clearance:
    """Advance by poses."""
    vertices = vertices_of(knowledge)
    if not vertices.names or not len(poses):
        return found
    world, is_inside = vertices.in_world(poses), np.zeros(len(poses), bool)
    for faces in faces_by_body(knowledge):
        depth_m = -faces.in_front_m(world)
        sigma_m = np.hypot(vertices.sigma_m[:, None], faces.sigma_m(world))
        allowed_m = np.maximum(LEAST_M, SIGMAS * sigma_m)
        inside = np.asarray((depth_m > allowed_m).all(axis=-1))
        if faces.is_solid:
            is_inside |= inside.any(axis=1)
            found = _with_depth(
                found, vertices.names, faces, np.where(inside, depth_m.min(axis=-1), 0.0), depth_m
            )
        else:
            is_behind = found.is_behind and bool(inside.all())
            found = found._replace(is_behind=is_behind, behind=found.behind + len(poses))
            found = _with_distance(found, faces, -depth_m - allowed_m)
    return found._replace(inside=found.inside + int(is_inside.sum()))


def _with_distance(found: Clearance, faces: Faces, off_m: Array) -> Clearance:
    """Updated by the distances (N, V, F) in front of faces that are listed by themselves."""
    least = int(off_m.argmin())
    if off_m.flat[least] >= found.gap_m:
        return found
    return found._replace(gap_m=float(off_m.flat[least]), nearest=faces.names[least % len(faces.names)])


def _with_depth(
    found: Clearance, vertices: Sequence[str], faces: Faces, inside_m: Array, depth_m: Array
) -> Clearance:
    """Updated by the depths (N, V) inside, and those (N, V, F) behind each face."""
    pose, vertex = divmod(int(inside_m.argmax()), inside_m.shape[1])
    deep_m = float(inside_m[pose, vertex])
    if deep_m <= found.deep_m:
        return found
    face = faces.names[int(depth_m[pose, vertex].argmin())]
    return found._replace(deep_m=deep_m, vertex=vertices[vertex], face=face)


def findings(found: Clearance) -> tuple[Finding, ...]:
    """Findings while poses come in."""
    misfits = list[str]()
    if found.inside >= LEAST_POSES:
        misfits.append(
            f"{found.vertex} of the object is up to {1e3 * found.deep_m:.0f} mm inside {found.face}"
        )
    if found.is_behind and found.behind >= LEAST_POSES:
        misfits.append(
            "all vertices given of the object are behind every face (normals must point to the free side)"
        )
    return tuple(
        Finding("knowledge", f"what is given does not fit the poses: {misfit}: {CHECK}", True)
        for misfit in misfits
    )


def final_findings(found: Clearance, knowledge: PriorMap) -> tuple[Finding, ...]:
    """Findings at the end of the stream: the object came near none of the known faces.

    Empty if not all vertices of the object are known, or bodies are, whose edges and vertices it may touch.
    """
    bodies = any(one.solid is not None for one in knowledge.environment)
    if not knowledge.object_complete or bodies or not 0.0 < found.gap_m < inf:
        return ()
    text = (
        f"the object as given stays more than {1e3 * found.gap_m:.0f} mm off {found.nearest}, the nearest "
        f"face that is given: if it touched one, {CHECK}"
    )
    return (Finding("knowledge", text, False),)
