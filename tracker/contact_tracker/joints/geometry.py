"""Geometry of a joint: its elements in the body and in the world."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Element, Line, Origins, Point, by_foot, shifted
from contact_tracker.geometry.task_frame import TaskFrame, joint_frame
from contact_tracker.joints.evidence import FittedJoint
from contact_tracker.joints.models import BODY_POINT, BODY_TURN, PITCH, WORLD_POINT, WORLD_TURN, JointKind

Array = NDArray[np.float64]

_FREE: Final = {JointKind.SLIDER: "vz", JointKind.BALL: "wx wy wz"}
"""Coordinates of the twist in the joint's frame; of others the turn about the axis."""


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint as whose motion the object moves.

    Parameters
    ----------
    kind, probability : kind of the joint and its probability.
    object, environment : its axis in the body frame and in the world frame; of a ball joint its centre in
        both. A slider's axis is the line along which the body's origin moves.
    pitch_m_per_rad : translation along the axis per radian about it; zero for hinges, None for sliders and
        ball joints. ``pitch_sd_m_per_rad`` is its standard deviation, for screws.
    """

    kind: JointKind
    probability: float
    object: Element
    environment: Element
    pitch_m_per_rad: float | None
    pitch_sd_m_per_rad: float | None

    @property
    def task_frame(self) -> TaskFrame:
        """The frame in which it constrains the object's twist: on the axis, with z along it."""
        assert isinstance(self.environment, (Line, Point))
        free, pitch_m = _FREE.get(self.kind, "wz"), self.pitch_m_per_rad or 0.0
        return joint_frame(self.kind, self.environment, free, pitch_m)

    def to_json(self) -> dict[str, Any]:
        """The JSON object of key ``joint``."""
        return {
            "kind": self.kind.value,
            "probability": float(self.probability),
            "object": self.object.to_json(),
            "environment": self.environment.to_json(),
            "pitch_m_per_rad": self.pitch_m_per_rad,
            "pitch_sd_m_per_rad": self.pitch_sd_m_per_rad,
            "task_frame": self.task_frame.to_json(),
        }


def joint_of(fitted: FittedJoint, probability: float, near_m: Array, origins: Origins) -> Joint:
    """The joint with its elements in the user's frames.

    Parameters
    ----------
    near_m : (3,) mean position of the body's origin; the world axis is given by its nearest point.
    origins : of the ticks' coordinates.
    """
    frames, kind = fitted.frames, fitted.model.kind
    whole = np.zeros((PITCH + 1, PITCH + 1))
    whole[np.ix_(fitted.model.free, fitted.model.free)] = fitted.covariance
    body = _element(kind, frames.body_axes, frames.body_point_m, _block(whole, BODY_TURN, BODY_POINT))
    world = _element(kind, frames.world_axes, frames.world_point_m, _block(whole, WORLD_TURN, WORLD_POINT))
    pitch = {JointKind.HINGE: 0.0, JointKind.SCREW: frames.pitch_m}.get(kind)
    deviation = float(np.sqrt(whole[PITCH, PITCH])) if kind is JointKind.SCREW else None
    if kind is JointKind.SLIDER:  # lines of any point: that of the body's origin
        body = shifted(body, -origins.body_m)
        world = shifted(world, -frames.world_axes @ frames.body_axes.T @ origins.body_m)
    return Joint(
        kind,
        probability,
        by_foot(shifted(body, origins.body_m), np.zeros(3)),
        shifted(by_foot(world, near_m), origins.world_m),
        pitch,
        deviation,
    )


def _block(whole: Array, turn: NDArray[np.int64], point: NDArray[np.int64]) -> Array:
    """Covariance (6, 6) of a frame's turns about and shifts along its own axes."""
    some = np.concatenate([turn, point])
    return np.asarray(whole[np.ix_(some, some)])


def _element(kind: JointKind, axes: Array, point_m: Array, covariance: Array) -> Element:
    if kind is JointKind.BALL:
        return Point(point_m, axes @ covariance[3:, 3:] @ axes.T)
    by_frame = np.zeros((6, 6))
    by_frame[0, 1], by_frame[1, 0] = 1.0, -1.0  # how the axis moves as the frame turns
    by_frame[3, 3] = by_frame[4, 4] = 1.0  # along itself a line does not move
    by_frame = np.kron(np.eye(2), axes) @ by_frame
    return Line(axes[:, 2], point_m, by_frame @ covariance @ by_frame.T)
