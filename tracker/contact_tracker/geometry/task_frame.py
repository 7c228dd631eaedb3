"""What a contact constrains at a pose, as hybrid control of force and motion needs it."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.geometry.elements import Array, ContactGeometry, Element, Line, Plane, Point
from contact_tracker.states import Contact

PARALLEL: Final = 1e-6
"""Sine of the angle below which two directions are parallel, and their common normal is not defined."""
TWIST: Final = ("vx", "vy", "vz", "wx", "wy", "wz")
"""Coordinates of a twist: velocities and angular velocities."""
_CONSTRAINED: Final = {3: (2, 3, 4), 2: (2, 4), 1: (2,)}
"""Coordinates in the task frame that a contact with so many constraints takes: 0 to 2 shift, 3 to 5 turn."""


@dataclass(frozen=True, eq=False)
class TaskFrame:
    """The frame in which a contact constrains single coordinates of the object's twist.

    The origin is where the elements touch, z the common normal (of unknown sense), x the direction of the
    touching edge (e-e: of the object's), in the face; without an edge any direction in the face.

    Parameters
    ----------
    contact : which one.
    T_world_task : (4, 4) pose of the frame in the world (m).
    is_constrained : (6,) which coordinates of the object's twist in the task frame are zero: velocity along
        x, y, z and angular velocity about x, y, z. The others are free. Without friction, the contact
        transmits the same coordinates of the wrench, and all others are zero.
    normal_sd_rad, origin_sd_m : standard deviations of z, and of the origin along z; None if unknown.
    """

    contact: Contact
    T_world_task: Array
    is_constrained: NDArray[np.bool_]
    normal_sd_rad: float | None
    origin_sd_m: float | None

    @property
    def quat_xyzw(self) -> Array:
        """Rotation (4,) from the task frame to the world."""
        return np.asarray(Rotation.from_matrix(self.T_world_task[:3, :3]).as_quat(), float)

    def to_json(self) -> dict[str, Any]:
        """The entry ``task_frame`` of a segment."""
        return {
            "origin_m": self.T_world_task[:3, 3].tolist(),
            "quat_xyzw": self.quat_xyzw.tolist(),
            "constrained": [name for name, one in zip(TWIST, self.is_constrained, strict=True) if one],
            "normal_sd_rad": self.normal_sd_rad,
            "origin_sd_m": self.origin_sd_m,
        }

    @property
    def selection(self) -> Array:
        """Projector (6, 6) on the constrained coordinates, in the task frame; the identity less it is that on
        the free ones."""
        return np.diag(self.is_constrained.astype(float))

    @property
    def wrenches(self) -> Array:
        """Wrenches (c, 6) that the contact can transmit without friction, in the world frame: force, and
        moment about the world's origin (m per unit of force)."""
        return np.concatenate([self._lines, self._couples])[self.is_constrained]

    @property
    def free_twists(self) -> Array:
        """Twists (6 - c, 6) that the contact leaves free, in the world frame: velocity of the body's point at
        the world's origin, and angular velocity. Their power with each of the ``wrenches`` is zero."""
        screws = np.concatenate([self._couples, self._lines])  # shifts along the axes, turns about them
        return np.roll(screws[~self.is_constrained], 3, axis=1)

    @property
    def _lines(self) -> Array:
        """Unit vectors (3, 6) along the axes through the frame's origin, with their moments."""
        axes, origin_m = self.T_world_task[:3, :3].T, self.T_world_task[:3, 3]
        return np.hstack([axes, np.cross(origin_m, axes)])

    @property
    def _couples(self) -> Array:
        """Moments (3, 6) about the axes."""
        return np.hstack([np.zeros((3, 3)), self.T_world_task[:3, :3].T])


def T_world_body(position_m: ArrayLike, quat_xyzw: ArrayLike) -> Array:
    """The pose (4, 4) of a body (m)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(quat_xyzw).as_matrix(), position_m
    return pose


def task_frame(contact: Contact, geometry: ContactGeometry, pose: Array) -> TaskFrame | None:
    """The task frame of a contact of this ``geometry`` at a pose (4, 4); None for edges that are parallel."""
    ours, theirs = _in_world(geometry.object, pose), geometry.environment
    body_m = pose[:3, 3]
    frame: Array | None
    match ours, theirs:
        case Plane(), Plane():
            is_open = geometry.has_open_offset[1]
            frame = _at_face(body_m if is_open else _onto(body_m, theirs), theirs, None)
        case (Line(direction, point_m), Plane() as face) | (Plane() as face, Line(direction, point_m)):
            frame = _at_face(_onto(point_m, face), face, direction)
        case (Point(point_m), Plane() as face) | (Plane() as face, Point(point_m)):
            frame = _at_face(point_m, face, None)
        case Line(), Line():
            frame = _at_crossing(ours, theirs)
        case _:
            raise ValueError(f"{contact.value} has no such elements")
    if frame is None:
        return None
    is_constrained = np.zeros(6, bool)
    is_constrained[list(_CONSTRAINED[contact.codimension])] = True
    faces = [one for one in (theirs, ours) if isinstance(one, Plane)]
    deviations = _deviations(faces[0]) if faces else (None, None)
    return TaskFrame(contact, frame, is_constrained, *deviations)


def _in_world(element: Element, pose: Array) -> Element:
    """An element of the body at a pose; the covariance of a face stays in the body's axes."""
    turn, shift_m = pose[:3, :3], pose[:3, 3]
    match element:
        case Plane(normal, offset_m, covariance):
            world = turn @ normal
            return Plane(world, float(offset_m + world @ shift_m), covariance)
        case Line(direction, point_m):
            return Line(turn @ direction, turn @ point_m + shift_m)
        case Point(point_m):
            return Point(turn @ point_m + shift_m)


def _onto(point_m: Array, face: Plane) -> Array:
    return np.asarray(point_m + face.normal * (face.offset_m - face.normal @ point_m))


def _at_face(origin_m: Array, face: Plane, along: Array | None) -> Array:
    """The frame at a face with x ``along`` a direction (3,), by default the world's axis nearest to it."""
    if along is None:
        along = np.eye(3)[np.argmin(np.abs(face.normal))]
    return _frame(origin_m, face.normal, along)


def _at_crossing(ours: Line, theirs: Line) -> Array | None:
    """The frame midway between two lines where they are nearest; None if they are parallel."""
    normal = np.cross(ours.direction, theirs.direction)
    sine = float(np.linalg.norm(normal))
    if sine < PARALLEL:
        return None
    between_m = theirs.point_m - ours.point_m
    along = [float(np.cross(between_m, other.direction) @ normal) / sine**2 for other in (theirs, ours)]
    nearest = (one.point_m + s * one.direction for one, s in zip((ours, theirs), along, strict=True))
    return _frame(np.mean(list(nearest), axis=0), normal / sine, ours.direction)


def _frame(origin_m: Array, z: Array, along: Array) -> Array:
    x = along - z * (z @ along)
    x = x / np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    frame[:3, 3] = origin_m
    return frame


def _deviations(face: Plane) -> tuple[float | None, float | None]:
    """Standard deviations of a face's normal (rad) and of its offset (m)."""
    if face.covariance is None:
        return None, None
    largest = float(np.linalg.eigvalsh(face.covariance[:3, :3])[-1])
    return float(np.sqrt(max(largest, 0.0))), float(np.sqrt(max(face.covariance[3, 3], 0.0)))
