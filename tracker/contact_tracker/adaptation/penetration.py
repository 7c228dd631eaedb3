"""Whether what the user knows contradicts the poses: known vertices of the object deep inside known faces."""

from typing import Final, NamedTuple

import numpy as np

from contact_tracker.geometry.elements import Plane, Point
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.landmarks.prior_map import PriorMap
from contact_tracker.motion.poses import Poses

LEAST_M: Final = 0.005
"""Rounded edges and compliance explain less."""
SIGMAS: Final = 10.0
"""So many deviations of what is known are no accident."""
ENOUGH: Final = 3
"""Single poses may be wrong."""


class Penetration(NamedTuple):
    """``poses`` in which a vertex was inside a face by more than what is known allows, how ``deep_m`` at
    most, and which ``vertex`` in which ``face``."""

    poses: int
    deep_m: float
    vertex: str
    face: str


NO_PENETRATION: Final = Penetration(0, 0.0, "", "")


def advance(found: Penetration, knowledge: PriorMap, poses: Poses) -> Penetration:
    """Take in poses."""
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
        beyond = deep > allowed
        if not beyond.any():
            continue
        deepest = int(np.where(beyond, deep, 0.0).max(axis=0).argmax())
        deep_m = float(deep[:, deepest].max())
        count = found.poses + int(beyond.any(axis=1).sum())
        found = found._replace(poses=count)
        if deep_m > found.deep_m:
            found = Penetration(count, deep_m, points[deepest][0], name)
    return found


def findings(found: Penetration) -> tuple[Finding, ...]:
    """What is to be said."""
    if found.poses < ENOUGH:
        return ()
    text = (
        f"what is given does not fit the poses: {found.vertex} of the object is up to "
        f"{1e3 * found.deep_m:.0f} mm inside {found.face}: check --known (place, size, frames)"
    )
    return (Finding("knowledge", text, True),)


def _spread_m(element: Plane | Point) -> float:
    """Deviation of its place."""
    covariance = element.covariance
    if covariance is None:
        return 0.0
    return float(np.sqrt(covariance[-1, -1] if isinstance(element, Plane) else np.diag(covariance).max()))
