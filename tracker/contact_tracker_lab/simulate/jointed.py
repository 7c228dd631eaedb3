"""An object in a joint of its surroundings: a hinge, a slider, a screw or a ball joint."""

import json
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.geometry.elements import Element, Line, Point
from contact_tracker.joints.models import JointKind
from contact_tracker_lab.simulate.chart import Rigid
from contact_tracker_lab.simulate.motion import band_limited
from contact_tracker_lab.simulate.scenarios import Scenario

Array = NDArray[np.float64]

_ARM_M: Final = {
    JointKind.HINGE: (0.1, 0.4),
    JointKind.SLIDER: (0.0, 0.1),
    JointKind.SCREW: (0.0, 0.1),
    JointKind.BALL: (0.05, 0.15),
}
"""How far the object's middle is from the axis, or from the centre."""
_PITCH_M: Final = (0.01, 0.04)
"""Of screws, per radian."""
_AXIS: Final = np.array([0.0, 0.0, 1.0])


class TrueJoint(NamedTuple):
    """A joint: axis or centre in the body frame and in the world frame, and translation per radian of those
    that turn about an axis. A slider's axis is the line on which the body's origin moves."""

    kind: JointKind
    object: Element
    environment: Element
    pitch_m_per_rad: float | None

    def to_json(self) -> str:
        """As recordings have it in their metadata."""
        return json.dumps(
            {
                "kind": self.kind.value,
                "object": self.object.to_json(),
                "environment": self.environment.to_json(),
                "pitch_m_per_rad": self.pitch_m_per_rad,
            }
        )


@dataclass(frozen=True, eq=False)
class Jointed:
    """Poses (N,) of the object in the joint's frame, where the axis is z, and the middle of the object from
    there at rest."""

    kind: JointKind
    pose: Rigid
    arm_m: Array
    pitch_m: float

    def joint(self, body: Rigid, world: Rigid) -> TrueJoint:
        """The joint after the changes of frame ``body`` and ``world``."""
        pitch = {JointKind.HINGE: 0.0, JointKind.SCREW: self.pitch_m}.get(self.kind)
        # Every line along a slider's axis is one: that on which the body's origin moves stands for all.
        in_object = body.inverse().translation if self.kind is JointKind.SLIDER else -self.arm_m
        return TrueJoint(
            self.kind,
            self._element(in_object, body),
            self._element(self.arm_m + in_object, world),
            pitch,
        )

    def _element(self, point_m: Array, frame: Rigid) -> Element:
        place = frame.rotation @ point_m + frame.translation
        return Point(place) if self.kind is JointKind.BALL else Line(frame.rotation @ _AXIS, place)


def move_in_joint(rng: np.random.Generator, kind: JointKind, scenario: Scenario, time_s: Array) -> Jointed:
    """Move an object as its joint allows: by ``amplitude_rad`` about the axis or the centre, by
    ``amplitude_m`` along the axis of a slider (root mean squares)."""
    signal = band_limited(rng, time_s, 3, rng.uniform(*scenario.bandwidth_hz))
    pitch_m = float(rng.choice([-1.0, 1.0]) * rng.uniform(*_PITCH_M))
    outwards = rng.uniform(0.0, 2.0 * np.pi)
    arm = rng.uniform(*_ARM_M[kind]) * np.array([np.cos(outwards), np.sin(outwards), 0.0])
    turn, shift = np.zeros((2, len(time_s), 3))
    match kind:
        case JointKind.HINGE:
            turn[:, 2] = scenario.amplitude_rad * signal[:, 0]
        case JointKind.SLIDER:
            shift[:, 2] = scenario.amplitude_m * signal[:, 0]
        case JointKind.SCREW:
            turn[:, 2] = scenario.amplitude_rad * signal[:, 0]
            shift[:, 2] = pitch_m * turn[:, 2]
        case JointKind.BALL:
            turn = scenario.amplitude_rad * signal
    rotation = Rotation.from_rotvec(turn)
    return Jointed(kind, Rigid(rotation.as_matrix(), rotation.apply(arm) + shift), arm, pitch_m)
