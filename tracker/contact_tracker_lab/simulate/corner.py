"""Motion of an object that touches a table and a wall at once.

A free random motion is projected to the nearest poses (rotations weighted with a lever) with the required
residuals of all contacts: zero while a contact lasts. The table is the plane z = 0, the wall x = 0; the
object is at positive z and x.
"""

from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.errors import UsageError
from contact_tracker.explanations.conditional_contact import KnownContact
from contact_tracker.geometry.elements import ContactGeometry, Plane
from contact_tracker.geometry.lifted_pose import lift, perturbations
from contact_tracker.geometry.polyhedron import Feature, Polyhedron, unit
from contact_tracker.states import Contact
from contact_tracker_lab.simulate.motion import band_limited, smooth_step, within
from contact_tracker_lab.simulate.plan import Rigid
from contact_tracker_lab.simulate.scenarios import Scenario

TABLE: Final = np.array([0.0, 0.0, 1.0])
WALL: Final = np.array([1.0, 0.0, 0.0])
_RAMP_S: Final = 0.8
_AWAY_M: Final = 0.07
"""Distance (m) from the wall while the object does not touch it."""
_SOFT_M: Final = 0.005
_LEVER_M: Final = 0.1
_STEPS: Final = 25
_DAMPING: Final = 1e-10
_EXACT: Final = 1e-9
_ENOUGH: Final = 1e-13
_TRIES: Final = 60
_DRAWS: Final = 400
_ROOM_SHARE: Final = 0.8
_ANY_TURN_RAD: Final = 0.8


class Touch(NamedTuple):
    """A feature of the object on the table or the wall, whose ``normal`` (3,) points to the object."""

    contact: Contact
    feature: Feature
    normal: Array

    @property
    def model(self) -> ContactModel:
        return CONTACT_MODELS[self.contact.column]

    @property
    def x(self) -> Array:
        """Parameters (S,) of the contact, see ``contacts``."""
        point = self.feature.points.mean(axis=0)
        if self.contact is Contact.FF:
            offset = float(self.feature.normals[0] @ point)
            return np.concatenate([self.feature.normals[0], self.normal, [offset]])
        on_plane = [self.normal, [0.0]]
        if self.contact is Contact.VF:
            return np.concatenate([point, *on_plane])
        direction = self.feature.span[0]
        return np.concatenate([direction, point - direction * (direction @ point), *on_plane])

    @property
    def c(self) -> Array:
        """Coefficients (K, 25) of the residuals on the whole lifted pose."""
        return KnownContact(self.contact, self.x).c

    def geometry(self, body: Rigid, world: Rigid) -> ContactGeometry:
        """The touching elements, transformed by ``body`` and ``world``."""
        normal = world.rotation @ self.normal
        plane = Plane(normal, float(normal @ world.translation))
        near = self.feature.points.mean(axis=0)
        return ContactGeometry(self.feature.element(body.rotation, body.translation, near), plane)


Chosen = tuple[Touch, Touch, Array]
"""The touches of the table and of the wall, and a rotation (3, 3) of the object with both."""


def move_in_corner(
    rng: np.random.Generator, object: Polyhedron, scenario: Scenario, further: Contact, time_s: Array
) -> tuple[Rigid, Touch, Touch]:
    """The motion of a scenario of one phase with a ``further`` contact at times (N,): poses, object to scene,
    the touch of the table, and that of the wall, which may last for part of the time only.

    Raises
    ------
    UsageError : the object has no two features that can touch table and wall in these contacts.
    """
    for attempt in range(_TRIES):
        chosen = _choose(rng, object, scenario.phases[0].contact, further)
        pose = _motion(rng, chosen, scenario, time_s, 0.97**attempt)
        if pose is None:
            continue
        corners = np.einsum("nij,vj->nvi", pose.rotation, object.vertices) + pose.translation[:, None]
        if corners[..., [0, 2]].min() > -1e-7:  # no vertex penetrates the table or the wall
            return pose, *chosen[:2]
    raise UsageError(f"scenario: a {scenario.object} cannot be moved like that between table and wall")


def _choose(rng: np.random.Generator, object: Polyhedron, first: Contact, second: Contact) -> Chosen:
    """Choose features and a rotation (3, 3) at which both touch, away from the sides of their cones."""
    options = []
    kinds = [object.of_kind(contact.value[0]) for contact in (first, second)]
    for _ in range(_DRAWS):
        on_table, on_wall = (features[int(rng.integers(len(features)))] for features in kinds)
        cones = on_table.normals, on_wall.normals
        down, aside = (unit(rng.dirichlet(np.full(len(normals), 4.0)) @ normals) for normals in cones)
        aside = aside - down * (down @ aside)
        if np.linalg.norm(aside) < 0.3:
            continue
        aside = unit(aside)
        if on_wall.kind == "f" and aside @ on_wall.normals[0] < 1.0 - _EXACT:
            continue
        room = min(_room(on_table, down), _room(on_wall, aside))
        if room > 0.0:
            options.append((room, on_table, on_wall, down, aside))
    if not options:
        raise UsageError(f"scenario: this object cannot be in {first} and {second} at once")
    _, on_table, on_wall, down, aside = max(options, key=lambda option: option[0])
    body = np.array([aside, np.cross(down, aside), down])  # rows: body directions of -x, ..., -z
    scene = np.array([-WALL, np.cross(-TABLE, -WALL), -TABLE])
    return Touch(first, on_table, TABLE), Touch(second, on_wall, WALL), scene.T @ body


def _room(feature: Feature, normal: Array) -> float:
    """Angle (rad) by which the normal may turn; ``_ANY_TURN_RAD`` for a face, with a fixed normal."""
    return _ANY_TURN_RAD if feature.kind == "f" else feature.normal_clearance(normal)


def _motion(
    rng: np.random.Generator,
    chosen: Chosen,
    scenario: Scenario,
    time_s: Array,
    calm: float,
) -> Rigid | None:
    """Poses that keep the first touch always and the second while it lasts; None if there are none."""
    first, second, base = chosen
    assert scenario.further is not None
    _, start_s, end_s = scenario.further
    wave = band_limited(rng, time_s, 6, rng.uniform(*scenario.bandwidth_hz))
    down, aside = base.T @ -TABLE, base.T @ -WALL
    room = _ROOM_SHARE * min(_room(first.feature, down), _room(second.feature, aside))
    turn = within(calm * scenario.amplitude_rad * wave[:, :3], room)
    rotation = base @ Rotation.from_rotvec(turn).as_matrix()
    # 0 while the further contact lasts, 1 otherwise, with smooth transitions
    before = 0.0 if start_s is None else smooth_step((start_s - time_s) / _RAMP_S)
    after = 0.0 if end_s is None else smooth_step((time_s - end_s) / _RAMP_S)
    apart = np.maximum(before, after) + 0.0 * time_s
    place = scenario.amplitude_m * wave[:, 3:]
    place[:, 2] = -rotation[:, 2] @ first.feature.points.mean(axis=0)  # touching, up to the tilt
    away = place[:, 0] * apart + _AWAY_M * apart
    place[:, 0] = away - rotation[:, 0] @ second.feature.points.mean(axis=0)
    touching = np.zeros((len(time_s), len(first.c)))
    pose = _project(Rigid(rotation, place), first.c, touching)
    if pose is None:
        return None
    zeta = second.model.lifted(lift(pose.rotation, pose.translation))
    free = zeta @ second.model.family.rows(second.x).T
    free[:, -1] = _SOFT_M * np.logaddexp(0.0, free[:, -1] / _SOFT_M)
    goals = np.concatenate([touching, apart[:, None] * free], axis=1)
    return _project(pose, np.concatenate([first.c, second.c]), goals)


def _project(pose: Rigid, c: Array, goals: Array) -> Rigid | None:
    """Project to poses (N,) whose residuals with coefficients c (K, 25) are ``goals`` (N, K); None if this
    fails at a pose."""
    weight, moves = np.repeat([1.0, _LEVER_M], 3), perturbations()
    rotation, place = pose.rotation, pose.translation
    for _ in range(_STEPS):
        zeta = lift(rotation, place)
        miss = zeta @ c.T - goals
        if np.abs(miss).max() < _ENOUGH:
            break
        jacobian = np.einsum("kc,icd,nd->nki", c, moves, zeta, optimize=True) * weight
        gram = jacobian @ np.swapaxes(jacobian, 1, 2) + _DAMPING * np.eye(len(c))
        step = -np.einsum("nki,nk->ni", jacobian, np.linalg.solve(gram, miss[..., None])[..., 0]) * weight
        rotation = rotation @ Rotation.from_rotvec(step[:, :3]).as_matrix()
        place = place + step[:, 3:]
    return Rigid(rotation, place) if np.abs(miss).max() < _EXACT else None
