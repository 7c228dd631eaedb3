"""Where things stand: which part of an endless plane or line is worth drawing, and from where to look."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.geometry.elements import Array, ContactGeometry, Element, Plane
from contact_tracker.motion.poses import Poses
from contact_tracker.tracking.belief import Segment
from contact_tracker.viewer.shapes import Mesh, body, joined, uncertainty

_ENOUGH_POSES: Final = 200


@dataclass(frozen=True, eq=False)
class Extent:
    """How large the object is: ``centre_m`` (3,) in the body frame, ``radius_m`` about it."""

    centre_m: Array
    radius_m: float


UNKNOWN_EXTENT: Final = Extent(np.zeros(3), 0.1)


class Drawing(NamedTuple):
    """A touching pair.

    Parameters
    ----------
    meshes : the object's element and its uncertainty in the body frame, the surroundings' in the world frame.
    label_m : (3,) where to name it, in the world frame.
    """

    meshes: tuple[Mesh, Mesh, Mesh, Mesh]
    label_m: Array


class Ground(NamedTuple):
    """The surroundings' plane that was touched longest, and for how long."""

    plane: Plane | None = None
    touched_ns: int = -1

    def or_longer(self, segments: Iterable[Segment]) -> "Ground":
        """What it is after these segments; the first of equals."""
        touched = (
            Ground(s.geometry.environment, s.end_ns - s.start_ns)
            for s in segments
            if s.geometry is not None and isinstance(s.geometry.environment, Plane)
        )
        return max([self, *touched], key=lambda ground: ground.touched_ns)


class Viewpoint(NamedTuple):
    eye_m: Array
    target_m: Array
    up: Array


def draw_all(geometries: Sequence[ContactGeometry], poses: Poses, extent: Extent) -> Drawing | None:
    """Draw the pairs that touch at the same time, the first of which is named; None without any."""
    if not geometries:
        return None
    drawings = [draw(geometry, poses, extent) for geometry in geometries]
    object, object_spread, world, world_spread = (
        joined(meshes) for meshes in zip(*(one.meshes for one in drawings), strict=True)
    )
    return Drawing((object, object_spread, world, world_spread), drawings[0].label_m)


def draw(geometry: ContactGeometry, poses: Poses, extent: Extent) -> Drawing:
    """Draw the pair where ``poses`` bring it together: as large as the object, and all of the way it slid.

    Parameters
    ----------
    poses : of the time in which the contact was seen, at least one.
    """
    poses = poses[:: 1 + len(poses) // _ENOUGH_POSES]
    rotation, position = poses.rotation, poses.position_m
    of_object, of_environment = _place(geometry.object), _place(geometry.environment)
    on_object = extent.centre_m if of_object is None else of_object
    touched = rotation @ on_object + position
    touching = on_object[None] if of_environment is None else _into_body(rotation, position, of_environment)
    return Drawing(
        (
            *_meshes(geometry.object, touching, extent.radius_m),
            *_meshes(geometry.environment, touched, extent.radius_m),
        ),
        _centre(geometry.environment, touched),
    )


def _place(element: Element) -> Array | None:
    """Where an element touches, if it says so itself."""
    return None if isinstance(element, Plane) else element.point_m


def _into_body(rotation: Array, position: Array, point: Array) -> Array:
    inside: Array = np.einsum("nij,ni->nj", rotation, point - position)
    return inside


def _meshes(element: Element, partner: Array, radius_m: float) -> tuple[Mesh, Mesh]:
    centre = _centre(element, partner)
    reach = float(np.max(np.linalg.norm(partner - centre, axis=1))) if isinstance(element, Plane) else 0.0
    half_m = radius_m + min(reach, 3.0 * radius_m)
    return body(element, centre, half_m), uncertainty(element, centre, half_m)


def _centre(element: Element, partner: Array) -> Array:
    """The middle of what is drawn, for a ``partner`` that was at (N, 3) in the element's frame."""
    if not isinstance(element, Plane):
        return element.point_m
    middle = partner.mean(axis=0)
    centre: Array = middle + (element.offset_m - middle @ element.normal) * element.normal
    return centre


def viewpoint(poses: Poses, plane: Plane | None, extent: Extent) -> Viewpoint:
    """Look from the side on the whole motion, upright on a ``plane`` of the surroundings."""
    centres = poses.rotation @ extent.centre_m + poses.position_m
    target = np.median(centres, axis=0)
    spread = centres - target
    up = _up(plane, target)
    level = spread - np.outer(spread @ up, up)
    narrow = np.linalg.svd(np.vstack([level, 1e-6 * _level_axes(up)]), full_matrices=False)[2][1]
    distance = 1.8 * (extent.radius_m + float(np.quantile(np.linalg.norm(spread, axis=1), 0.95)))
    return Viewpoint(target + distance * (0.87 * narrow + 0.5 * up), target, up)


def _level_axes(up: Array) -> Array:
    return np.eye(3) - np.outer(up, up)


def _up(plane: Plane | None, target: Array) -> Array:
    """The normal of the plane towards the object; else z."""
    if plane is None:
        return np.array([0.0, 0.0, 1.0])
    up: Array = plane.normal * (1.0 if target @ plane.normal >= plane.offset_m else -1.0)
    return up
