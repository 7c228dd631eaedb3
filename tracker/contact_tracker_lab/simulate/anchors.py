"""Poses at which one contact changes into another; they satisfy both, so the motion is continuous."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.geometry.polyhedron import Feature, Polyhedron, unit
from contact_tracker.states import Contact
from contact_tracker_lab.simulate.chart import Chart, Rigid

Array = NDArray[np.float64]

SETTLE_S = 0.15  # time constant of the decay of an anchor's rates
_CROSSING = (np.radians(50.0), np.radians(130.0))  # crossing angle of edges at a change of contact
_SPEED_M_S = 0.06
_TURN_RAD_S = np.radians(20.0)
_ROOM_M = 0.07  # desired distance from the touching point to the feature's rim
_ROOM_RAD = np.radians(20.0)  # desired angle from the normal to the sides of its cone


@dataclass(frozen=True, eq=False)
class Anchor:
    """The pose and velocity between two legs of the motion.

    ``touch_object`` (object frame) and ``touch_scene`` (scene frame) are the touching point on either
    feature in m; the rates are their velocities in m/s and that of the spin in rad/s. The normals are at
    rest.
    """

    normal: Array
    object_normal: Array
    rotation: Array
    touch_object: Array
    touch_scene: Array
    object_rate: Array
    scene_rate: Array
    spin_rate: float

    @property
    def pose(self) -> Rigid:
        """From the object's frame to the scene's."""
        return Rigid(self.rotation, self.touch_scene - self.rotation @ self.touch_object)

    def distance_to(self, other: "Anchor") -> tuple[float, float]:
        """Distance (m) and angle (rad) to another anchor's pose."""
        shift = self.pose.translation - other.pose.translation
        turn = Rotation.from_matrix(self.rotation.T @ other.rotation).magnitude()
        return float(np.linalg.norm(shift)), float(turn)


def choose_chart(
    rng: np.random.Generator,
    contact: Contact,
    object: Polyhedron,
    scene: Polyhedron,
    related: Chart | None = None,
) -> Chart:
    """Choose features for ``contact`` that are contained in those of ``related`` or contain them."""
    features = []
    for kind, choice, given in (
        (contact.value[0], object.features, related.object if related else None),
        (contact.value[2], scene.top, related.environment if related else None),
    ):
        fitting = [f for f in choice if f.kind == kind and (given is None or _nested(f, given))]
        features.append(fitting[rng.integers(len(fitting))])
    return Chart.of(contact, *features)


def _nested(a: Feature, b: Feature) -> bool:
    return a.indices <= b.indices or b.indices <= a.indices


def sample_anchor(
    rng: np.random.Generator, before: Anchor | None, leaving: Chart | None, arriving: Chart
) -> Anchor:
    """Sample a pose that satisfies both contacts, near ``before``, with velocities that both allow.

    ``leaving`` is None after free motion and at the start. The touching point lies on the features of the
    contact with fewer constraints, the normals in the cones of the other.
    """
    charts = (leaving or arriving, arriving)
    lower = min(charts, key=lambda chart: chart.contact.codimension)
    higher = max(charts, key=lambda chart: chart.contact.codimension)
    normal = sample_normal(rng, higher.environment, before.normal if before else None)
    object_normal = sample_normal(rng, higher.object, before.object_normal if before else None)
    if before is None:
        spin = rng.uniform(-np.pi, np.pi)
    elif leaving is None:
        spin = lower.spin(before.rotation, normal, object_normal)
    else:
        spin = lower.spin(before.rotation, before.normal, before.object_normal)
    wanted = spin + rng.normal(0.0, np.radians(20.0))
    if lower.contact is Contact.EE:
        side = 1.0 if spin > 0.0 else -1.0
        wanted = side * float(np.clip(side * wanted, *_CROSSING))
    touch_object = sample_point(rng, lower.object, before.touch_object if before else None)
    touch_scene = sample_point(rng, lower.environment, before.touch_scene if before else None)
    return Anchor(
        normal,
        object_normal,
        lower.rotation(normal, object_normal, np.array(wanted)),
        touch_object,
        touch_scene,
        _rate(rng, lower.object, touch_object),
        _rate(rng, lower.environment, touch_scene),
        rng.normal(0.0, _TURN_RAD_S),
    )


def sample_normal(rng: np.random.Generator, feature: Feature, near: Array | None) -> Array:
    """Sample a normal of the feature's cone, away from its sides and near ``near``."""
    normals = unit(rng.dirichlet(np.full(len(feature.normals), 1.5), 8) @ feature.normals)

    def effort(normal: Array) -> float:
        angle = 0.0 if near is None else float(np.arccos(np.clip(normal @ near, -1.0, 1.0)))
        return angle + 4.0 * max(0.0, float(_ROOM_RAD) - feature.normal_clearance(normal))

    return min(normals, key=effort)


def sample_point(rng: np.random.Generator, feature: Feature, near: Array | None) -> Array:
    """Sample a point on the feature, away from its rim and near ``near``."""
    points = rng.dirichlet(np.ones(len(feature.points)), 16) @ feature.points

    def effort(point: Array) -> float:
        distance = 0.0 if near is None else float(np.linalg.norm(point - near))
        return distance + 4.0 * max(0.0, _ROOM_M - feature.point_clearance(point))

    return min(points, key=effort)


def _rate(rng: np.random.Generator, feature: Feature, point: Array) -> Array:
    """Sample a velocity within the feature that does not lead out of it."""
    span = feature.span
    limit = 0.5 * feature.point_clearance(point) / SETTLE_S
    rate = rng.normal(0.0, _SPEED_M_S, len(span)) @ span
    return np.asarray(rate * min(1.0, limit / max(float(np.linalg.norm(rate)), 1e-12)), float)
