"""Known vertices of the object and known faces of its surroundings, as arrays."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from contact_tracker.geometry.elements import Array, Plane, Point
from contact_tracker.map.map import Map
from contact_tracker.motion.poses import Poses


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
        by = np.concatenate([points_m, -np.ones_like(points_m[..., :1])], axis=-1)
        variance = np.einsum("nvi,fij,nvj->nvf", by, self.covariance, by)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@lru_cache(maxsize=8)
def vertices_of(known_map: Map) -> Vertices:
    """The known vertices of the object."""
    known = [(one.name, one.element) for one in known_map.object if isinstance(one.element, Point)]
    place_m = np.array([point.point_m for _, point in known]).reshape(-1, 3)
    sigma_m = [0.0 if p.covariance is None else float(p.covariance.diagonal().max()) ** 0.5 for _, p in known]
    return Vertices(tuple(name for name, _ in known), place_m, np.array(sigma_m))


@lru_cache(maxsize=8)
def faces_by_body(known_map: Map) -> tuple[Faces, ...]:
    """The known faces of the surroundings; without those of hulls, in which there may be room."""
    known = [
        (one, one.element)
        for one in known_map.environment
        if isinstance(one.element, Plane) and not one.is_hull
    ]
    found = list[Faces]()
    for body in dict.fromkeys(one.solid for one, _ in known):
        own = [(one.name, plane) for one, plane in known if one.solid == body]
        normals = np.array([plane.normal for _, plane in own])
        offsets_m = np.array([plane.offset_m for _, plane in own])
        covariance = [np.zeros((4, 4)) if p.covariance is None else p.covariance for _, p in own]
        names = tuple(name for name, _ in own)
        found.append(Faces(body is not None, names, normals, offsets_m, np.array(covariance)))
    return tuple(found)
