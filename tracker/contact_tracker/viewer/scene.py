"""Drawing of a touching pair: the visible part of infinite planes and lines, and the label's position."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.geometry.elements import Array, ContactGeometry, Element, Plane, Point
from contact_tracker.motion.poses import Poses
from contact_tracker.viewer.shapes import (
    EMPTY,
    SIGMAS,
    SQUARE,
    Mesh,
    across,
    distance_sd_m,
    joined,
    needle,
    of_object,
    of_surroundings,
    uncertainty,
)

ENOUGH_POSES: Final = 200
_LARGEST_M: Final = 2.0
"""Largest radius (m) of an object of unknown size."""
_CUBE_ABOVE: Final = 0.25
_CORNER_LABEL: Final = 0.7
_WHEEL: Final = 0.65
"""Size relative to the sheet of the touched face."""
UP: Final = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Extent:
    """Size of the object: ``centre_m`` (3,) in the body frame, ``radius_m`` around it.

    ``vertices_m`` (V, 3) of its hull in the body frame; without any the extent is an estimate.
    """

    centre_m: Array
    radius_m: float
    vertices_m: Array | None = None

    def reaching(self, distance_m: float) -> "Extent":
        """The same; an estimated extent is enlarged to reach a contact at ``distance_m`` from the centre."""
        if self.vertices_m is not None or not self.radius_m < distance_m <= _LARGEST_M:
            return self
        return replace(self, radius_m=distance_m)


UNKNOWN_EXTENT: Final = Extent(np.zeros(3), 0.1)


class Drawing(NamedTuple):
    """The drawing of a touching pair.

    Parameters
    ----------
    meshes : the object's element and its uncertainty in the body frame, the surroundings' in the world frame.
    label_m : (3,) position of the label in the world frame.
    reach_m : distance of the contact from the object's centre.
    is_open : whether the position of two faces along their normal is unknown.
    """

    meshes: tuple[Mesh, Mesh, Mesh, Mesh]
    label_m: Array
    reach_m: float
    is_open: bool


def draw_all(
    geometries: Sequence[ContactGeometry], poses: Poses, extent: Extent, up: Array = UP
) -> Drawing | None:
    """Draw simultaneous touching pairs as ``draw`` does; None without any.

    Label, reach and ``is_open`` are those of the first.
    """
    if not geometries:
        return None
    drawings = [draw(geometry, poses, extent, up) for geometry in geometries]
    on_object, object_spread, on_world, world_spread = (
        joined(meshes) for meshes in zip(*(one.meshes for one in drawings), strict=True)
    )
    return drawings[0]._replace(meshes=(on_object, object_spread, on_world, world_spread))


def draw(geometry: ContactGeometry, poses: Poses, extent: Extent, up: Array = UP) -> Drawing:
    """Draw the pair where it touches during ``poses``: of the object's size, along the whole sliding path.

    Two faces of which only the distance is known are drawn at the lower end of the hull, their uncertainty as
    a needle along the normal.

    Parameters
    ----------
    poses : of the time of the contact, at least one.
    up : (3,) in the world.
    """
    poses = poses[:: 1 + len(poses) // ENOUGH_POSES]
    rotation, position = poses.rotation, poses.position_m
    centres = rotation @ extent.centre_m + position
    is_open = _is_open(geometry, centres, extent.radius_m)
    if is_open:
        geometry = _resting(geometry, rotation[len(rotation) // 2], extent, up)
    of_object_m, of_environment_m = _place(geometry.object), _place(geometry.environment)
    on_object = extent.centre_m if of_object_m is None else of_object_m
    touched = rotation @ on_object + position
    touching = (
        on_object[None] if of_environment_m is None else _into_body(rotation, position, of_environment_m)
    )
    middle, inner = _centre(geometry.environment, touched), _centre(geometry.object, touching)
    if of_environment_m is not None and of_object_m is None:
        reach_m = float(np.median(np.linalg.norm(touching - extent.centre_m, axis=1)))
    else:
        reach_m = float(np.linalg.norm(inner - extent.centre_m))
    radius_m = extent.reaching(reach_m).radius_m
    half_m = _half_m(geometry.environment, touched, middle, radius_m)
    object_m = _half_m(geometry.object, touching, inner, radius_m)
    object_m *= _WHEEL if isinstance(geometry.object, Plane) else 1.0
    if is_open:
        assert isinstance(geometry.environment, Plane)
        open_ways = EMPTY, needle(geometry.environment.normal, middle, radius_m)
    else:
        open_ways = (
            uncertainty(geometry.object, inner, object_m),
            uncertainty(geometry.environment, middle, half_m, SQUARE),
        )
    meshes = (
        of_object(geometry.object, inner, object_m),
        open_ways[0],
        of_surroundings(geometry.environment, middle, half_m),
        open_ways[1],
    )
    return Drawing(meshes, _label_position(geometry.environment, middle, half_m, up), reach_m, is_open)


def side(plane: Plane, points: Array, radius_m: float) -> float:
    """Side of ``points`` (N, 3): 1 in the direction of the normal of ``plane``, -1 opposite, 0 unknown."""
    if plane.covariance is not None:
        middle = np.median(points, axis=0)
        if not SIGMAS * float(distance_sd_m(plane, middle)) < radius_m:  # also for nan
            return 0.0
    return float(np.sign(np.median(points @ plane.normal) - plane.offset_m))


def _is_open(geometry: ContactGeometry, centres: Array, radius_m: float) -> bool:
    """Whether only the distance between two faces is known, not their position."""
    if not isinstance(geometry.object, Plane) or not isinstance(geometry.environment, Plane):
        return False
    if all(geometry.has_open_offset):
        return True
    sd = geometry.environment.covariance
    if sd is None:
        return False
    return SIGMAS * float(np.median(distance_sd_m(geometry.environment, centres))) > radius_m


def _resting(geometry: ContactGeometry, rotation: Array, extent: Extent, up: Array) -> ContactGeometry:
    """Both faces shifted along their normal to the lower end of the hull; their distance stays the same."""
    on_object, on_world = geometry.object, geometry.environment
    assert isinstance(on_object, Plane)
    assert isinstance(on_world, Plane)
    if extent.vertices_m is None:
        return geometry
    outward = rotation @ on_object.normal
    heights = extent.vertices_m @ on_object.normal
    lowest = float(heights.min() if outward @ up >= 0.0 else heights.max())
    shift = lowest - on_object.offset_m
    along = shift * float(np.sign(outward @ on_world.normal))
    return ContactGeometry(
        replace(on_object, offset_m=lowest), replace(on_world, offset_m=on_world.offset_m + along)
    )


def _place(element: Element) -> Array | None:
    """The position of an element, if it has one."""
    return None if isinstance(element, Plane) else element.point_m


def _into_body(rotation: Array, position: Array, point: Array) -> Array:
    inside: Array = np.einsum("nij,ni->nj", rotation, point - position)
    return inside


def _half_m(element: Element, partner: Array, centre: Array, radius_m: float) -> float:
    """Distance (m) from its ``centre`` to which an element is drawn."""
    reach = float(np.max(np.linalg.norm(partner - centre, axis=1))) if isinstance(element, Plane) else 0.0
    return radius_m + min(reach, 3.0 * radius_m)


def _centre(element: Element, partner: Array) -> Array:
    """The centre of a drawn element, for a ``partner`` at positions (N, 3) in the element's frame."""
    if not isinstance(element, Plane):
        return element.point_m
    middle = partner.mean(axis=0)
    centre: Array = middle + (element.offset_m - middle @ element.normal) * element.normal
    return centre


def _label_position(element: Element, centre: Array, half_m: float, up: Array) -> Array:
    """The label's position: a corner of a sheet, an end of a bar, or below a cube."""
    match element:
        case Plane(normal):
            away: Array = _CORNER_LABEL * across(normal)[:, 0]
        case Point():
            away = -_CUBE_ABOVE * up
        case _:
            away = element.direction if element.direction @ up < 0.0 else -element.direction
    return np.asarray(centre + half_m * away)
