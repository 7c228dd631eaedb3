"""Coordinates in which a contact holds by construction, and the plan of a recording in them.

A contact of two convex bodies has a common normal n (world frame, out of the environment) and a touching
point. Object and environment do not overlap if -n, in the body frame, lies in the normal cone of the
object's feature, n in that of the environment's, and both features contain the touching point. So a pose is
given by two normals, the spin about them and the touching point on either feature. Any values within the
features give exact contact without overlap.

A plan has the features that touch in each leg, and the anchors between legs: poses at which one contact
changes into another. An anchor satisfies both, so the motion is continuous.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.geometry.polyhedron import Feature, Polyhedron, unit
from contact_tracker.states import Contact
from contact_tracker_lab.simulate.scenarios import Phase

_FACING = np.diag([1.0, -1.0, -1.0])  # the normals of touching surfaces are opposite


@dataclass(frozen=True, eq=False)
class Chart:
    """The two features of a contact. The spin is the angle between their reference directions.

    For two edges, whose references are their directions, it is the angle at which they cross.
    """

    contact: Contact
    object: Feature
    environment: Feature

    def rotation(self, normal: Array, object_normal: Array, spin: Array) -> Array:
        """Rotations (N, 3, 3) from normals (N, 3) and spin (N,) in rad."""
        c, s, o = np.cos(spin), np.sin(spin), np.zeros_like(spin)
        about = np.stack([c, -s, o, s, c, o, o, o, o + 1.0], axis=-1).reshape(*spin.shape, 3, 3)
        environment = _frame(normal, self.environment.reference)
        object_frame = _frame(object_normal, self.object.reference)
        return np.asarray(environment @ about @ _FACING @ np.swapaxes(object_frame, -1, -2), float)

    def spin(self, rotation: Array, normal: Array, object_normal: Array) -> float:
        """The spin (rad) whose rotation with these normals is nearest to ``rotation`` (3, 3)."""
        environment = _frame(normal, self.environment.reference)
        about = environment.T @ rotation @ _frame(object_normal, self.object.reference) @ _FACING
        return float(np.arctan2(about[1, 0] - about[0, 1], about[0, 0] + about[1, 1]))

    def geometry(
        self, body: "Rigid", world: "Rigid", touch_object: Array, touch_scene: Array
    ) -> ContactGeometry:
        """The touching elements, transformed by ``body`` and ``world``."""
        return ContactGeometry(
            self.object.element(body.rotation, body.translation, touch_object),
            self.environment.element(world.rotation, world.translation, touch_scene),
        )


@dataclass(frozen=True, eq=False)
class Rigid:
    """Rigid motions x -> R x + t: ``rotation`` (..., 3, 3), ``translation`` (..., 3)."""

    rotation: Array
    translation: Array

    def __matmul__(self, pose: "Rigid") -> "Rigid":
        moved = np.einsum("...ij,...j->...i", self.rotation, pose.translation)
        return Rigid(self.rotation @ pose.rotation, moved + self.translation)

    @classmethod
    def join(cls, parts: Sequence["Rigid"]) -> "Rigid":
        """The motions of all parts, one after the other."""
        return cls(*(np.concatenate([getattr(p, key) for p in parts]) for key in ("rotation", "translation")))

    def inverse(self) -> "Rigid":
        back = np.swapaxes(self.rotation, -1, -2)
        return Rigid(back, -np.einsum("...ij,...j->...i", back, self.translation))


def _frame(normal: Array, reference: Array) -> Array:
    """Right-handed frames (..., 3, 3) with columns x, y, normal; x is ``reference`` made orthogonal."""
    x = unit(reference - (normal @ reference)[..., None] * normal)
    return np.stack([x, np.cross(normal, x), normal], axis=-1)


Neighbours = tuple[Phase | None, Phase | None]
"""The phase of a leg and that of the next; None for a lift."""
Bodies = tuple[Polyhedron, Polyhedron]
"""The object and the scene."""
SETTLE_S = 0.15  # time constant of the decay of an anchor's rates
_CROSSING = (np.radians(50.0), np.radians(130.0))  # crossing angle of edges at a change of contact
_DRIFT_M_S = 0.06
_SPIN_RAD_S = np.radians(20.0)
_ROOM_M = 0.07  # desired distance from the touching point to the feature's rim
_ROOM_RAD = np.radians(20.0)  # desired angle from the normal to the sides of its cone
_TRAVEL_M_S = 0.25
_TURN_RAD_S = 1.0


@dataclass(frozen=True, eq=False)
class Anchor:
    """The pose and velocity between two legs of the motion.

    ``touch_object`` (object frame) and ``touch_scene`` (scene frame): the touching point (m) on either
    feature; the rates: their velocities (m/s) and that of the spin (rad/s). The normals are at rest.
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

    def distance_to(self, anchor: "Anchor") -> tuple[float, float]:
        """Distance (m) and angle (rad) to another anchor's pose."""
        shift = self.pose.translation - anchor.pose.translation
        turn = Rotation.from_matrix(self.rotation.T @ anchor.rotation).magnitude()
        return float(np.linalg.norm(shift)), float(turn)


def choose_chart(
    rng: np.random.Generator, contact: Contact, bodies: Bodies, related: Chart | None = None
) -> Chart:
    """Choose features for ``contact`` that contain those of ``related`` or are contained in them."""
    features = []
    for kind, choice, partner in (
        (contact.value[0], bodies[0].features, related.object if related else None),
        (contact.value[2], bodies[1].top, related.environment if related else None),
    ):
        fitting = [feature for feature in choice if feature.kind == kind]
        if partner is not None:
            near = partner.indices
            fitting = [feature for feature in fitting if feature.indices <= near or feature.indices >= near]
        features.append(fitting[rng.integers(len(fitting))])
    return Chart(contact, *features)


def sample_anchor(
    rng: np.random.Generator, start: Anchor | None, leaving: Chart | None, arriving: Chart
) -> Anchor:
    """Sample a pose that satisfies both contacts, near ``start``, with velocities that both allow.

    ``leaving`` is None after free motion and at the start. The touching point lies on the features of the
    contact with fewer constraints, the normals in the cones of the other.
    """
    charts = (leaving or arriving, arriving)
    lower = min(charts, key=lambda chart: chart.contact.codimension)
    higher = max(charts, key=lambda chart: chart.contact.codimension)
    normal = sample_normal(rng, higher.environment, start.normal if start else None)
    object_normal = sample_normal(rng, higher.object, start.object_normal if start else None)
    if start is None:
        spin = rng.uniform(-np.pi, np.pi)
    else:
        normals = (normal, object_normal) if leaving is None else (start.normal, start.object_normal)
        spin = lower.spin(start.rotation, *normals)
    goal = spin + rng.normal(0.0, np.radians(20.0))
    if lower.contact is Contact.EE:
        side = 1.0 if spin > 0.0 else -1.0
        goal = side * float(np.clip(side * goal, *_CROSSING))
    touch_object = sample_point(rng, lower.object, start.touch_object if start else None)
    touch_scene = sample_point(rng, lower.environment, start.touch_scene if start else None)
    return Anchor(
        normal,
        object_normal,
        lower.rotation(normal, object_normal, np.array(goal)),
        touch_object,
        touch_scene,
        _rate(rng, lower.object, touch_object),
        _rate(rng, lower.environment, touch_scene),
        rng.normal(0.0, _SPIN_RAD_S),
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
    rate = rng.normal(0.0, _DRIFT_M_S, len(span)) @ span
    return np.asarray(rate * min(1.0, limit / max(float(np.linalg.norm(rate)), 1e-12)), float)


@dataclass(frozen=True, eq=False)
class Leg:
    """The motion between two anchors; a free leg leaves ``chart`` and arrives at ``next_chart``.

    ``lift_m``: height of a free leg; ``wander``: share of the usual random motion; ``from_air``, ``to_air``:
    whether it begins or ends at this height instead of in contact.
    """

    contact: Contact
    motion: str
    duration_s: float
    start: Anchor
    end: Anchor
    chart: Chart
    next_chart: Chart
    lift_m: float = 0.0
    wander: float = 1.0
    from_air: bool = False
    to_air: bool = False


def plan(
    rng: np.random.Generator, phases: Sequence[Phase], object: Polyhedron, scene: Polyhedron, lead_s: float
) -> list[Leg]:
    """The legs of ``phases``; each begins at the anchor where the previous one ended. ``lead_s`` as in
    ``Scenario``."""
    with_transitions = _with_transitions(phases, lead_s)
    bodies = object, scene
    chart = choose_chart(rng, _touching(phases[0]), bodies)
    anchor = sample_anchor(rng, None, None, chart)
    legs: list[Leg] = []
    for index, phase in enumerate(with_transitions):
        after = with_transitions[index + 1] if index + 1 < len(with_transitions) else None
        following, end = _leg_end(rng, (phase, after), chart, anchor, bodies)
        is_same = after and phase and after.contact is phase.contact
        if is_same or _is_restricted(phase) or _is_restricted(after):
            end = replace(end, object_rate=0 * end.object_rate, scene_rate=0 * end.scene_rate, spin_rate=0.0)
        legs.append(_leg(phase, anchor, end, chart, following, object.radius))
        chart, anchor = following, end
    legs[0] = replace(legs[0], from_air=True)
    legs[-1] = replace(legs[-1], to_air=True)
    return legs


def _is_restricted(phase: Phase | None) -> bool:
    """Whether a phase is at rest or has another motion than the normal one: it starts and ends at rest."""
    return phase is not None and phase.motion != "normal"


def _with_transitions(phases: Sequence[Phase], lead_s: float) -> list[Phase | None]:
    """The phases and the transitions between them; None is a lift from one contact to the next."""
    result: list[Phase | None] = []
    for before, phase, after in zip((None, *phases), phases, (*phases[1:], None), strict=False):
        lead = [Phase(phase.contact, lead_s)] if lead_s else []
        if before and not (before.contact.contains(phase.contact) or phase.contact.contains(before.contact)):
            result.append(None)
        is_singular = _is_restricted(phase) and phase.motion != "rest"
        if is_singular and before and before.contact is not phase.contact:
            result += lead
        result.append(phase)
        if _is_restricted(phase) and after and after.contact is not phase.contact:
            result += lead
    return result


def _touching(phase: Phase | None) -> Contact:
    """The contact of a phase; vertex on face for free motion at an end of the recording."""
    return phase.contact if phase and phase.contact is not Contact.FREE else Contact.VF


def _leg_end(
    rng: np.random.Generator, phases: Neighbours, chart: Chart, anchor: Anchor, bodies: Bodies
) -> tuple[Chart, Anchor]:
    """The anchor at which a leg that begins at ``anchor`` ends, and the chart of the next."""
    phase, after = phases

    def option() -> tuple[Chart, Anchor]:
        if phase is None or phase.contact is Contact.FREE:
            arriving = choose_chart(rng, _touching(after), bodies)
            return arriving, sample_anchor(rng, anchor, None, arriving)
        if after is None or after.contact in (Contact.FREE, phase.contact):
            return chart, sample_anchor(rng, anchor, chart, chart)
        arriving = choose_chart(rng, after.contact, bodies, related=chart)
        return arriving, sample_anchor(rng, anchor, chart, arriving)

    if _is_restricted(phase):
        return chart, anchor

    def effort(chosen: tuple[Chart, Anchor]) -> float:
        distance_m, angle_rad = anchor.distance_to(chosen[1])
        return distance_m / 0.2 + angle_rad

    return min((option() for _ in range(60 if phase is None else 6)), key=effort)


def _leg(
    phase: Phase | None, start: Anchor, end: Anchor, chart: Chart, following: Chart, radius: float
) -> Leg:
    distance, angle = start.distance_to(end)
    shortest_s = max(distance / _TRAVEL_M_S, angle / _TURN_RAD_S)
    lift_m = 0.03 + 0.4 * (distance + angle * radius)
    ends = start, end, chart, following
    if phase is None:
        return Leg(Contact.FREE, "normal", max(0.6, 6.5 * lift_m, shortest_s), *ends, lift_m, wander=0.0)
    lift_m = lift_m + 0.15 if phase.contact is Contact.FREE else 0.0
    return Leg(phase.contact, phase.motion, max(phase.duration_s, shortest_s), *ends, lift_m)
