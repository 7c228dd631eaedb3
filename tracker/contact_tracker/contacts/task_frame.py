"""The constraints of a contact or joint at a pose, as hybrid control of force and motion needs them."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.geometry.elements import (
    Array,
    ContactGeometry,
    Element,
    Line,
    Plane,
    Point,
    nearest,
    numbers,
    of_numbers,
)
from contact_tracker.geometry.linalg import PARALLEL, STEP
from contact_tracker.states import Contact

TWIST: Final = ("vx", "vy", "vz", "wx", "wy", "wz")
"""Coordinates of a twist: velocities and angular velocities."""
_CONSTRAINED: Final = {3: (2, 3, 4), 2: (2, 4), 1: (2,)}
"""Indices (in ``TWIST``) of the constrained coordinates in the task frame, by the contact's codimension."""
_NAMES: Final = {
    "f-f": "planar",
    "e-f": "line on plane",
    "f-e": "plane on line",
    "v-f": "point on plane",
    "f-v": "plane on point",
    "e-e": "line on line",
    "hinge": "revolute",
    "slider": "prismatic",
    "screw": "helical",
    "ball": "spherical",
}


@dataclass(frozen=True, eq=False)
class TaskFrame:
    """The frame in which a contact or joint constrains single coordinates of the object's twist.

    For a contact the origin is where the elements touch, z the common normal (of unknown sense), x the
    direction of the touching edge (e-e: of the object's), in the face; without an edge any direction in the
    face. For a joint z is the axis, and the origin is on it.

    Parameters
    ----------
    contact : the contact, or the kind of joint.
    T_world_task : (4, 4) pose of the frame in the world (m).
    is_constrained : (6,) whether each coordinate of the object's twist in the task frame is zero (velocity
        along x, y, z and angular velocity about x, y, z) or free. Without friction, the contact transmits the
        constrained coordinates of the wrench only.
    covariance : (6, 6) of shifts of the origin along x, y, z (m), and of turns of the frame about x, y, z
        (rad), from the covariances of the elements (docs/theory.md, T51); None if one of these is unknown, or
        the edges are nearly parallel.
    pitch_m_per_rad : of a screw: velocity along z over angular velocity about z.
    """

    contact: StrEnum
    T_world_task: Array
    is_constrained: NDArray[np.bool_]
    covariance: Array | None = None
    pitch_m_per_rad: float = 0.0

    @property
    def name(self) -> str:
        """The name of the constraint in kinematics, such as ``line on plane`` or ``revolute``."""
        return _NAMES[self.contact]

    @property
    def quat_xyzw(self) -> Array:
        """Rotation (4,) from the task frame to the world."""
        return np.asarray(Rotation.from_matrix(self.T_world_task[:3, :3]).as_quat(), float)

    @property
    def sd(self) -> list[float] | None:
        """Standard deviations (6,) of ``covariance``, in m and rad."""
        if self.covariance is None:
            return None
        return [float(sd) for sd in np.sqrt(np.maximum(np.diag(self.covariance), 0.0))]

    def to_json(self) -> dict[str, Any]:
        """The entry ``task_frame`` of a segment or joint."""
        return {
            "name": self.name,
            "origin_m": self.T_world_task[:3, 3].tolist(),
            "quat_xyzw": self.quat_xyzw.tolist(),
            "constrained": [
                name for name, is_zero in zip(TWIST, self.is_constrained, strict=True) if is_zero
            ],
            "covariance": None if self.covariance is None else self.covariance.tolist(),
        }

    @property
    def selection(self) -> Array:
        """Projector (6, 6) on the constrained twists, in the task frame."""
        return np.eye(6) - self.free_selection

    @property
    def free_selection(self) -> Array:
        """Projector (6, 6) on the free twists, in the task frame."""
        free = np.diag(~self.is_constrained).astype(float)
        free[2, 5] = self.pitch_m_per_rad
        return free

    @property
    def world_projectors(self) -> tuple[Array, Array]:
        """``selection`` and ``free_selection`` (6, 6) for twists in the world frame (as ``free_twists``)."""
        R, o = self.T_world_task[:3, :3], self.T_world_task[:3, 3]
        to_world = np.kron(np.eye(2), R)
        to_world[:3, 3:] = np.cross(o, R, axisb=0).T
        inverse = np.linalg.inv(to_world)
        return to_world @ self.selection @ inverse, to_world @ self.free_selection @ inverse

    @property
    def wrenches(self) -> Array:
        """Wrenches (c, 6) that the contact can transmit without friction, in the world frame: force, and
        moment about the world's origin (m per unit of force)."""
        wrenches = np.concatenate([self._lines, self._couples])
        wrenches[2] -= self.pitch_m_per_rad * wrenches[5]
        return wrenches[self.is_constrained]

    @property
    def free_twists(self) -> Array:
        """Twists (6 - c, 6) that the contact leaves free, in the world frame: velocity of the body's point at
        the world's origin, and angular velocity. Their power with each of the ``wrenches`` is zero."""
        screws = np.concatenate([self._couples, self._lines])  # shifts along the axes, turns about them
        screws[5] += self.pitch_m_per_rad * screws[2]
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


def contact_frame(contact: Contact, geometry: ContactGeometry, pose: Array) -> Array | None:
    """``T_world_task`` (4, 4) of a contact at a ``pose`` (4, 4) of the body; None for parallel edges."""
    return _frame_at(contact, geometry, pose)(geometry.object, geometry.environment)


def task_frame(contact: Contact, geometry: ContactGeometry, pose: Array) -> TaskFrame | None:
    """The task frame of a contact at a ``pose`` (4, 4) of the body; None for parallel edges."""
    frame = contact_frame(contact, geometry, pose)
    if frame is None:
        return None
    covariance = _covariance(_frame_at(contact, geometry, pose), geometry.object, geometry.environment)
    if geometry.has_open_offset[1] and covariance is not None:
        assert geometry.environment.covariance is not None
        covariance[2, 2] += geometry.environment.covariance[3, 3]
    is_constrained = np.zeros(6, bool)
    is_constrained[list(_CONSTRAINED[contact.codimension])] = True
    return TaskFrame(contact, frame, is_constrained, covariance)


def joint_frame(kind: StrEnum, axis: Line | Point, free: str, pitch_m_per_rad: float = 0.0) -> TaskFrame:
    """The task frame of a joint with an ``axis`` or centre in the world; ``free`` has the names (of
    ``TWIST``) of its free coordinates."""
    along = np.eye(3)[np.argmin(np.abs(axis.direction))] if isinstance(axis, Line) else np.eye(3)[0]

    def build(axis: Element) -> Array:
        z = axis.direction if isinstance(axis, Line) else np.eye(3)[2]
        assert not isinstance(axis, Plane)
        return _frame(axis.point_m, z, along)

    is_constrained = np.array([name not in free.split() for name in TWIST])
    return TaskFrame(kind, build(axis), is_constrained, _covariance(build, axis), pitch_m_per_rad)


def _frame_at(
    contact: Contact, geometry: ContactGeometry, pose: Array
) -> Callable[[Element, Element], Array | None]:
    """The task frame (4, 4) as a function of the elements of object and environment near ``geometry``. The
    axis of x is the same for all faces without an edge."""
    across, is_open = _across(geometry, pose), geometry.has_open_offset[1]

    def build(object: Element, environment: Element) -> Array | None:
        match _in_world(object, pose), environment:
            case Plane(), Plane() as face:
                origin_m = pose[:3, 3] if is_open else nearest(face, pose[:3, 3])
                return _frame(origin_m, face.normal, across)
            case (Line(direction, point_m), Plane() as face) | (Plane() as face, Line(direction, point_m)):
                return _frame(nearest(face, point_m), face.normal, direction)
            case (Point(point_m), Plane() as face) | (Plane() as face, Point(point_m)):
                return _frame(point_m, face.normal, across)
            case Line() as edge, Line() as environment_edge:
                return _at_crossing(edge, environment_edge)
        raise ValueError(f"{contact.value} has no such elements")

    return build


def _across(geometry: ContactGeometry, pose: Array) -> Array:
    """The axis of the world (3,) that is most nearly in the touching face."""
    for element in (geometry.environment, _in_world(geometry.object, pose)):
        if isinstance(element, Plane):
            return np.asarray(np.eye(3)[np.argmin(np.abs(element.normal))])
    return np.array([1.0, 0.0, 0.0])


def _covariance(build: Callable[..., Array | None], *elements: Element) -> Array | None:
    """Covariance (6, 6) of the frame that is built of independent ``elements``, to first order (T51); None
    if the covariance of an element is unknown, or a step makes edges parallel."""
    frame = build(*elements)
    assert frame is not None
    total = np.zeros((6, 6))
    for i, element in enumerate(elements):
        if element.covariance is None:
            return None
        values = numbers(element)
        changes = np.empty((6, len(values)))
        for k in range(len(values)):
            step = STEP * (np.arange(len(values)) == k)
            changed = (of_numbers(type(element), values + change) for change in (step, -step))
            moved = [build(*elements[:i], element, *elements[i + 1 :]) for element in changed]
            if moved[0] is None or moved[1] is None:
                return None
            changes[:3, k] = frame[:3, :3].T @ (moved[0] - moved[1])[:3, 3]
            turn = frame[:3, :3].T @ (moved[0] - moved[1])[:3, :3]
            changes[3:, k] = turn[2, 1], turn[0, 2], turn[1, 0]
        changes /= 2.0 * STEP
        total += changes @ element.covariance @ changes.T
    return total


def _in_world(element: Element, pose: Array) -> Element:
    """An element of the body in the world at a ``pose`` (4, 4), without its covariance."""
    turn, shift_m = pose[:3, :3], pose[:3, 3]
    match element:
        case Plane(normal, offset_m):
            world = turn @ normal
            return Plane(world, float(offset_m + world @ shift_m))
        case Line(direction, point_m):
            return Line(turn @ direction, turn @ point_m + shift_m)
        case Point(point_m):
            return Point(turn @ point_m + shift_m)


def _at_crossing(edge: Line, environment_edge: Line) -> Array | None:
    """The frame (4, 4) midway between the nearest points of two lines; None if the lines are parallel."""
    normal = np.cross(edge.direction, environment_edge.direction)
    sine = float(np.linalg.norm(normal))
    if sine < PARALLEL:
        return None
    between_m = environment_edge.point_m - edge.point_m
    points_m = [
        line.point_m + np.cross(between_m, crossing.direction) @ normal / sine**2 * line.direction
        for line, crossing in ((edge, environment_edge), (environment_edge, edge))
    ]
    return _frame(np.mean(points_m, axis=0), normal / sine, edge.direction)


def _frame(origin_m: Array, z: Array, along: Array) -> Array:
    """The frame (4, 4) at an origin with an axis z and x in the plane of z and ``along``."""
    z = z / np.linalg.norm(z)
    x = along - z * (z @ along)
    x = x / np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    frame[:3, 3] = origin_m
    return frame
