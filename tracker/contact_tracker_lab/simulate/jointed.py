"""An object in a joint of its surroundings: a hinge, a slider, a screw or a ball joint."""

import json
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.explanations.joint_models import JointKind
from contact_tracker.geometry.elements import Element, Line, Point
from contact_tracker_lab.simulate.motion import band_limited
from contact_tracker_lab.simulate.plan import Rigid
from contact_tracker_lab.simulate.scenarios import Scenario

_ARM_M: Final = {
    JointKind.HINGE: (0.1, 0.4),
    JointKind.SLIDER: (0.0, 0.1),
    JointKind.SCREW: (0.0, 0.1),
    JointKind.BALL: (0.05, 0.15),
}
"""Range of the distance (m) of the object's middle from the axis or centre."""
_PITCH_M: Final = (0.01, 0.04)
"""Range of the pitch (m/rad) of screws."""
_AXIS: Final = np.array([0.0, 0.0, 1.0])


class TrueJoint(NamedTuple):
    """A joint: its axis or centre in the body frame and in the world frame, and its pitch, for kinds that
    turn about an axis. A slider's axis is the line on which the body's origin moves."""

    kind: JointKind
    object: Element
    environment: Element
    pitch_m_per_rad: float | None

    def to_json(self) -> str:
        """JSON text for the metadata of recordings."""
        elements = {"object": self.object.to_json(), "environment": self.environment.to_json()}
        return json.dumps(self._asdict() | elements)


def move_in_joint(
    rng: np.random.Generator, kind: JointKind, scenario: Scenario, time_s: Array, body: Rigid, world: Rigid
) -> tuple[Rigid, TrueJoint]:
    """Move an object as its joint allows: by ``amplitude_rad`` about the axis or the centre, by
    ``amplitude_m`` along the axis of a slider (root mean squares).

    Returns
    -------
    Poses (N,) of the object in the frame of the joint, whose axis is z, and the joint after the changes of
    frame ``body`` and ``world``.
    """
    signal = band_limited(rng, time_s, 3, rng.uniform(*scenario.bandwidth_hz))
    pitch_m = float(rng.choice([-1.0, 1.0]) * rng.uniform(*_PITCH_M))
    outwards = rng.uniform(0.0, 2.0 * np.pi)
    arm = rng.uniform(*_ARM_M[kind]) * np.array([np.cos(outwards), np.sin(outwards), 0.0])
    turn, shift = np.zeros((2, len(time_s), 3))
    pitch = {JointKind.HINGE: 0.0, JointKind.SCREW: pitch_m}.get(kind)
    if kind is JointKind.SLIDER:
        shift[:, 2] = scenario.amplitude_m * signal[:, 0]
    elif pitch is None:
        turn = scenario.amplitude_rad * signal
    else:
        turn[:, 2] = scenario.amplitude_rad * signal[:, 0]
        shift[:, 2] = pitch * turn[:, 2]
    rotation = Rotation.from_rotvec(turn)
    # any line along a slider's axis is an axis: here the line on which the body's origin moves
    in_object = body.inverse().translation if kind is JointKind.SLIDER else -arm
    elements = _element(kind, in_object, body), _element(kind, arm + in_object, world)
    pose = Rigid(rotation.as_matrix(), rotation.apply(arm) + shift)
    return pose, TrueJoint(kind, *elements, pitch)


def _element(kind: JointKind, point_m: Array, frame: Rigid) -> Element:
    """The joint's axis or centre through a point."""
    place = frame.rotation @ point_m + frame.translation
    return Point(place) if kind is JointKind.BALL else Line(frame.rotation @ _AXIS, place)
