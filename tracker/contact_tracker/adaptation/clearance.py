"""Test of the prior map against the poses: depth of known vertices of the object inside known faces of the
surroundings, and least distance from them."""

from math import inf
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.geometry.elements import Plane, Point
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.landmarks.prior_map import PriorMap
from contact_tracker.motion.poses import Poses

LEAST_M: Final = 0.005
"""Depth that rounded edges and compliance do not explain."""
SIGMAS: Final = 10.0
"""Depth, in standard deviations of the prior map, that is significant."""
LEAST_POSES: Final = 3
"""Number of poses that are needed, since single ones may be wrong."""


class Clearance(NamedTuple):
    """Number of ``poses`` with a vertex inside a face by more than the accuracy of the prior map; the largest
    depth ``deep_m`` with its ``vertex`` and ``face``; the ``nearest`` face and its least distance ``gap_m``
    beyond that accuracy."""

    poses: int = 0
    deep_m: float = 0.0
    vertex: str = ""
    face: str = ""
    gap_m: float = inf
    nearest: str = ""


def advance(found: Clearance, knowledge: PriorMap, poses: Poses) -> Clearance:
    """Advance by poses."""
    vertices = [(known.name, known.element) for known in knowledge.object]
    points = [(name, element) for name, element in vertices if isinstance(element, Point)]
    faces = [(known.name, known.element) for known in knowledge.environment]
    if not points or not len(poses):
        return found
    place = np.array([point.point_m for _, point in points])
    spread = np.array([_spread_m(point) for _, point in points])
    world = np.einsum("nij,vj->nvi", poses.rotation, place) + poses.position_m[:, None]
    for name, plane in faces:
        if not isinstance(plane, Plane):
            continue
        deep = plane.offset_m - world @ plane.normal
        allowed = np.maximum(LEAST_M, SIGMAS * np.hypot(spread, _spread_m(plane)))
        gap_m = float((-deep - allowed).min())
        if gap_m < found.gap_m:
            found = found._replace(gap_m=gap_m, nearest=name)
        beyond = deep > allowed
        if not beyond.any():
            continue
        deepest = int(np.where(beyond, deep, 0.0).max(axis=0).argmax())
        deep_m = float(deep[:, deepest].max())
        found = found._replace(poses=found.poses + int(beyond.any(axis=1).sum()))
        if deep_m > found.deep_m:
            found = found._replace(deep_m=deep_m, vertex=points[deepest][0], face=name)
    return found


def findings(found: Clearance) -> tuple[Finding, ...]:
    """Findings while poses come in."""
    if found.poses < LEAST_POSES:
        return ()
    text = (
        f"what is given does not fit the poses: {found.vertex} of the object is up to "
        f"{1e3 * found.deep_m:.0f} mm inside {found.face}: check --known (place, size, frames)"
    )
    return (Finding("knowledge", text, True),)


def final_findings(found: Clearance, knowledge: PriorMap) -> tuple[Finding, ...]:
    """Findings at the end of the stream: the object came near none of the known faces.

    Empty if not all vertices of the object are known.
    """
    if not knowledge.object_complete or not 0.0 < found.gap_m < inf:
        return ()
    text = (
        f"the object as given stays more than {1e3 * found.gap_m:.0f} mm off {found.nearest}, the nearest "
        "face that is given: if it touched one, check --known (place, size, frames)"
    )
    return (Finding("knowledge", text, False),)


def _spread_m(element: Plane | Point) -> float:
    """Standard deviation of the offset of a plane, or the largest of the coordinates of a point."""
    covariance = element.covariance
    if covariance is None:
        return 0.0
    return float(np.sqrt(covariance[-1, -1] if isinstance(element, Plane) else np.diag(covariance).max()))
