"""Known vertices of the object and known faces of its surroundings, as arrays."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from contact_tracker.geometry.elements import Array, Plane, Point
from contact_tracker.landmarks.prior_map import PriorMap
from contact_tracker.motion.poses import Poses


class Vertices(NamedTuple):
    """V vertices in the body frame."""

    names: tuple[str, ...]
    place_m: Array
    """(V, 3)"""
    spread_m: Array
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
    spread_m: Array
    """(F,) standard deviations of the offsets."""


@lru_cache(maxsize=8)
def vertices_of(knowledge: PriorMap) -> Vertices:
    """The known vertices of the object."""
    known = [(one.name, one.element) for one in knowledge.object if isinstance(one.element, Point)]
    place_m = np.array([point.point_m for _, point in known]).reshape(-1, 3)
    spread_m = np.array([_spread_m(point) for _, point in known])
    return Vertices(tuple(name for name, _ in known), place_m, spread_m)


@lru_cache(maxsize=8)
def faces_by_body(knowledge: PriorMap) -> tuple[Faces, ...]:
    """The known faces of the surroundings."""
    known = [(one, one.element) for one in knowledge.environment if isinstance(one.element, Plane)]
    found = list[Faces]()
    for body in dict.fromkeys(one.solid for one, _ in known):
        own = [(one.name, plane) for one, plane in known if one.solid == body]
        normals = np.array([plane.normal for _, plane in own])
        offsets_m = np.array([plane.offset_m for _, plane in own])
        spread_m = np.array([_spread_m(plane) for _, plane in own])
        found.append(Faces(body is not None, tuple(name for name, _ in own), normals, offsets_m, spread_m))
    return tuple(found)


def _spread_m(element: Plane | Point) -> float:
    """Standard deviation of the offset of a plane, or the largest of the coordinates of a point."""
    covariance = element.covariance
    if covariance is None:
        return 0.0
    return float(np.sqrt(covariance[-1, -1] if isinstance(element, Plane) else np.diag(covariance).max()))
