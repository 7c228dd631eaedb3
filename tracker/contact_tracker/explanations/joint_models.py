"""The joint models: residuals and their derivatives (docs/theory.md, T43).

A joint has a frame in the body and one in the world, with z along its axis. Up to the motion that the joint
allows, the two coincide: each joint keeps some of the same six coordinates at zero.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final, NamedTuple, Self

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.geometry.lifted_pose import R, T
from contact_tracker.geometry.linalg import (
    TINY,
    cross_matrix,
    from_rotation_vectors,
    matrices,
    sphere_tangent,
)

S_X, S_Y, S_Z, TILT_X, TILT_Y, ANGLE = range(6)
"""Coordinates of the joint's body frame in its world frame: origin (m), tilt of the axis, and angle about the
axis (rad)."""
BODY_TURN, BODY_POINT, WORLD_TURN, WORLD_POINT = np.arange(12).reshape(4, 3)
BODY, WORLD = np.arange(12).reshape(2, 6)
PITCH: Final = 12
"""Parameters of a joint: turns of both frames, shifts of their origins, and the pitch."""


class JointKind(StrEnum):
    """Kinds of joints."""

    HINGE = "hinge"
    SLIDER = "slider"
    SCREW = "screw"
    BALL = "ball"

    @property
    def constraints(self) -> int:
        """Number of constraints on the motion."""
        return 3 if self is JointKind.BALL else 5


class Residual(NamedTuple):
    """Residuals of W ticks and K constraints: ``value`` (W, K); ``by_pose`` (W, K, 6), derivatives by the
    pose (turns about the body's axes, shifts along the world's); ``by_x`` (W, K, P), derivatives by the
    parameters."""

    value: Array
    by_pose: Array
    by_x: Array


@dataclass(frozen=True, eq=False)
class JointFrames:
    """The frames of a joint: axes (columns of ``body_axes`` (3, 3) and ``world_axes`` (3, 3)) and origins
    (m), and the ``pitch_m``, the translation along the axis per radian."""

    body_axes: Array
    body_point_m: Array
    world_axes: Array
    world_point_m: Array
    pitch_m: float = 0.0

    def moved(self, step: Array, free: Ints) -> Self:
        """The frames after a ``step`` (P,) of the parameters ``free`` (P,): shifts along and turns about
        their own axes, and the pitch."""
        full = np.zeros(PITCH + 1)
        full[free] = step
        body_turn, world_turn = matrices(from_rotation_vectors(full[[BODY_TURN, WORLD_TURN]]))
        return replace(
            self,
            body_axes=self.body_axes @ body_turn,
            body_point_m=self.body_point_m + self.body_axes @ full[BODY_POINT],
            world_axes=self.world_axes @ world_turn,
            world_point_m=self.world_point_m + self.world_axes @ full[WORLD_POINT],
            pitch_m=self.pitch_m + float(full[PITCH]),
        )


@dataclass(frozen=True, eq=False)
class JointModel:
    """One ``kind`` of joint.

    ``rows``: the coordinates, of ``S_X`` to ``ANGLE``, that it keeps at zero; ``free``: its parameters
    among the 13 of ``JointFrames``.
    """

    kind: JointKind
    rows: tuple[int, ...]
    free: Ints
    start: Callable[[Array], JointFrames]

    def travelled(self, frames: JointFrames, zeta: Array) -> Array:
        """Way (W,) travelled by the joint: an angle (rad), for a slider a distance (m)."""
        return _coordinates(frames, zeta)[0][:, S_Z if self.kind is JointKind.SLIDER else ANGLE]

    @property
    def has_play(self) -> bool:
        """Whether errors may follow the motion, which then has one degree of freedom."""
        return self.kind is not JointKind.BALL

    def residual(self, frames: JointFrames, zeta: Array) -> Residual:
        """Residuals of ticks with mean lifted poses ``zeta`` (W, 25)."""
        value, by_pose, by_x = _coordinates(frames, zeta)
        if self.kind is JointKind.SCREW:  # the translation along the axis follows the angle
            value[:, S_Z] -= frames.pitch_m * value[:, ANGLE]
            by_pose[:, S_Z] -= frames.pitch_m * by_pose[:, ANGLE]
            by_x[:, S_Z] -= frames.pitch_m * by_x[:, ANGLE]
            by_x[:, S_Z, PITCH] -= value[:, ANGLE]
        rows = list(self.rows)
        return Residual(value[:, rows], by_pose[:, rows], by_x[:, rows][:, :, self.free])


def _coordinates(frames: JointFrames, zeta: Array) -> tuple[Array, Array, Array]:
    """The six coordinates (W, 6), and their derivatives by the pose (W, 6, 6) and all parameters (W, 6,
    13)."""
    rotation, position = zeta[:, R].reshape(-1, 3, 3), zeta[:, T]
    world, body, count = frames.world_axes.T, frames.body_axes, len(zeta)
    turned = world @ rotation
    d = turned @ body
    s = (rotation @ frames.body_point_m + position - frames.world_point_m) @ frames.world_axes
    value = np.empty((count, 6))
    value[:, :3], value[:, TILT_X], value[:, TILT_Y] = s, d[:, 0, 2], d[:, 1, 2]
    value[:, ANGLE] = np.unwrap(np.arctan2(d[:, 1, 0] - d[:, 0, 1], d[:, 0, 0] + d[:, 1, 1]))
    by_pose, by_x = np.zeros((count, 6, 6)), np.zeros((count, 6, PITCH + 1))
    by_pose[:, :3, :3] = -turned @ cross_matrix(frames.body_point_m)
    by_pose[:, :3, 3:] = world
    by_x[:, :3, BODY_POINT] = d
    by_x[:, :3, WORLD_POINT] = -np.eye(3)
    by_x[:, :3, WORLD_TURN] = cross_matrix(s)
    for row, number in ((0, TILT_X), (1, TILT_Y)):
        across = np.cross([0.0, 0.0, 1.0], d[:, row])  # e_z x D^T e_i
        by_pose[:, number, :3] = across @ body.T
        by_x[:, number, BODY_TURN] = across
        by_x[:, number, WORLD_TURN] = -np.cross(d[:, :, 2], np.eye(3)[row])
    by_pose[:, ANGLE, :3] = body[:, 2]
    by_x[:, ANGLE, BODY_TURN[2]], by_x[:, ANGLE, WORLD_TURN[2]] = 1.0, -1.0
    return value, by_pose, by_x


def _about(axis: Array) -> Array:
    """Axes (3, 3) whose z is ``axis``."""
    across = sphere_tangent(axis)
    axes = np.column_stack([across, axis])
    axes[:, 1] *= np.sign(np.linalg.det(axes))
    return axes


def _start_ball(zeta: Array) -> JointFrames:
    """The point that moves least."""
    body, world = _still_point(zeta, np.eye(3))
    return JointFrames(np.eye(3), body, np.eye(3), world)


def _still_point(zeta: Array, along: Array) -> tuple[Array, Array]:
    """The points of body and world with least mean squared distance in the directions ``along`` (K, 3),
    nearest to the origins if there are several."""
    rotation, position = zeta[:, R].reshape(-1, 3, 3), zeta[:, T]
    slopes = np.concatenate([along @ rotation, np.broadcast_to(-along, (len(zeta), *along.shape))], axis=2)
    points = np.linalg.lstsq(slopes.reshape(-1, 6), -(position @ along.T).ravel(), rcond=1e-6)[0]
    return points[:3], points[3:]


def _start_hinge(zeta: Array) -> JointFrames:
    """The direction that rotates least, and a point that moves least across it."""
    world_axes, _, body_axes = np.linalg.svd(zeta[:, R].mean(axis=0).reshape(3, 3))
    axis, body_axis = world_axes[:, 0], body_axes[0]
    across = sphere_tangent(axis)
    body, world = _still_point(zeta, across.T)
    body = body - body_axis * (body_axis @ body)
    rotation, position = zeta[:, R].reshape(-1, 3, 3), zeta[:, T]
    world = world + axis * float(((rotation @ body + position - world) @ axis).mean())
    frames = JointFrames(_about(body_axis), body, _about(axis), world)
    angle = _coordinates(frames, zeta)[0][:, ANGLE]
    return frames.moved(-angle.mean(), BODY_TURN[2])  # angles about zero, far from where they wrap


def _start_screw(zeta: Array) -> JointFrames:
    frames = _start_hinge(zeta)
    value = _coordinates(frames, zeta)[0]
    angle = value[:, ANGLE] - value[:, ANGLE].mean()
    return replace(frames, pitch_m=float(angle @ value[:, S_Z] / max(angle @ angle, TINY)))


def _start_slider(zeta: Array) -> JointFrames:
    """The mean orientation and position, and the direction in which the body moves most."""
    world_axes, _, body_axes = np.linalg.svd(zeta[:, R].mean(axis=0).reshape(3, 3))
    mean = world_axes @ np.diag([1.0, 1.0, np.linalg.det(world_axes @ body_axes)]) @ body_axes
    place = zeta[:, T].mean(axis=0)
    axis = np.linalg.svd(zeta[:, T] - place, full_matrices=False)[2][0]
    world = _about(axis)
    return JointFrames(mean.T @ world, np.zeros(3), world, place)


_AXES: Final = (*BODY_TURN[:2], *WORLD_TURN[:2])
_PLACES: Final = (*BODY_POINT[:2], *WORLD_POINT)
_BUT_ANGLE: Final = (S_X, S_Y, S_Z, TILT_X, TILT_Y)
SCREW: Final = JointModel(JointKind.SCREW, _BUT_ANGLE, np.array([*_PLACES, *_AXES, PITCH]), _start_screw)
JOINT_MODELS: Final = (
    JointModel(JointKind.HINGE, _BUT_ANGLE, np.array([*_PLACES, *_AXES]), _start_hinge),
    JointModel(
        JointKind.SLIDER,
        (S_X, S_Y, TILT_X, TILT_Y, ANGLE),
        np.array([*WORLD_POINT[:2], *BODY_TURN, *WORLD_TURN[:2]]),
        _start_slider,
    ),
    SCREW,
    JointModel(JointKind.BALL, (S_X, S_Y, S_Z), np.array([*BODY_POINT, *WORLD_POINT]), _start_ball),
)
"""Models in the order of ``JointKind``."""
CYLINDER: Final = JointModel(
    JointKind.HINGE,
    (S_X, S_Y, TILT_X, TILT_Y),
    np.array([*BODY_POINT[:2], *WORLD_POINT[:2], *_AXES]),
    _start_hinge,
)
"""An independent turn about and slide along one axis: a rival of all joints, not reported as one."""
