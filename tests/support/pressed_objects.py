"""An object that is carried and then pressed against its surroundings: poses, and the wrench of the hand.

Independent of the simulator: a contact is defined by the points of force, and the motion by its free
directions.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.motion.poses import Poses
from contact_tracker.states import Contact
from contact_tracker.wrenches.wrenches import Wrenches

RATE_HZ = 200.0
TICK = 20
MASS_KG = 2.0
CENTRE_M = np.array([0.03, -0.02, 0.05])
GRAVITY = 9.80665
WEIGHT_N = MASS_KG * GRAVITY * np.array([0.0, 0.6, -0.8])


@dataclass
class Pressed:
    """The object is free until ``touch_ns``, then in contact.

    ``object`` and ``surroundings`` (3,) are the outward normal, the direction, or the point of the element
    that touches, in the frame of body and world.
    """

    poses: Poses
    wrenches: Wrenches
    touch_ns: int
    object: Any = None
    surroundings: Any = None

    @property
    def tick_ns(self) -> Any:
        return self.poses.stamp_ns[TICK - 1 :: TICK]

    @property
    def is_free(self) -> Any:
        return self.tick_ns < self.touch_ns

    @property
    def end_ns(self) -> int:
        return int(self.poses.stamp_ns[-1])


def pressed(
    contact: Contact, seed: int = 0, noise: bool = False, bias: bool = False, seconds: float = 6.0
) -> Pressed:
    """Half the time free, turning in all directions, then ``contact`` with motion that does not identify
    it."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    free = _waves(rng, t, 3, 0.3)
    start, place = Rotation.from_rotvec(rng.normal(0, 0.6, 3)), rng.normal(0, 0.3, 3)
    first = (start * Rotation.from_rotvec(free), place + _waves(rng, t, 3, 0.05))
    turn, position, force, point, elements = _touching(contact, rng, t, start)
    rotation = Rotation.concatenate([first[0], turn])
    where = np.concatenate([first[1], position])
    touching = np.concatenate([np.zeros_like(force), force])
    at = np.concatenate([np.zeros_like(point), point])
    stamps, wrenches = _of_hand(rng, rotation, where, touching, at, noise, bias)
    poses = Poses(stamps, where, rotation.as_quat())
    return Pressed(poses, wrenches, int(stamps[len(t)]), *elements)


def carried(turn_rad: float, most_hz: float, seed: int = 0) -> Pressed:
    """Free for 10 s, with noise of poses and wrenches: turns by ``turn_rad``, moves by 0.1 m."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(10.0 * RATE_HZ)) / RATE_HZ
    start = Rotation.from_rotvec(rng.normal(0, 0.6, 3))
    rotation = start * Rotation.from_rotvec(_waves(rng, t, 3, turn_rad, most_hz))
    where = _waves(rng, t, 3, 0.1, most_hz)
    none = np.zeros_like(where)
    stamps, wrenches = _of_hand(rng, rotation, where, none, none, noise=True, bias=False)
    rotation = rotation * Rotation.from_rotvec(rng.normal(0, 0.0025, where.shape))
    poses = Poses(stamps, where + rng.normal(0, 0.0003, where.shape), rotation.as_quat())
    return Pressed(poses, wrenches, int(stamps[-1]) + 1)


def _of_hand(
    rng: Any, rotation: Rotation, where: Any, touching: Any, at: Any, noise: bool, bias: bool
) -> tuple[Any, Wrenches]:
    """Stamps, and the wrenches of the hand, for a motion in two halves and a force of the surroundings."""
    stamps = 10**9 + np.round(np.arange(len(where)) / RATE_HZ * 1e9).astype(np.int64)
    hand, moment = -touching, -np.cross(at - where, touching)
    for offset in 0.06 * np.concatenate([np.eye(3), -np.eye(3)]):  # Newton, for each of six masses
        mass = where + rotation.apply(CENTRE_M + offset)
        acceleration = np.concatenate([_second_derivative(half) for half in np.split(mass, 2)])
        force = (MASS_KG * acceleration - WEIGHT_N) / 6.0
        hand, moment = hand + force, moment + np.cross(mass - where, force)
    values = np.concatenate([rotation.inv().apply(hand), rotation.inv().apply(moment)], axis=1)
    size = np.array([0.1] * 3 + [0.01] * 3)
    values += noise * size * rng.normal(size=values.shape) + bias * 10.0 * size * rng.normal(size=6)
    return stamps, Wrenches(stamps, values[:, :3], values[:, 3:])


def _touching(contact: Contact, rng: Any, t: Any, start: Rotation) -> Any:
    """Rotations, positions, in the world the force of the surroundings and where it acts, and both
    elements."""
    basis = Rotation.from_rotvec(rng.normal(0, 1, 3)).as_matrix()
    normal, first, second = basis
    slide = _waves(rng, t, 2, 0.03) @ np.array([first, second])
    wander = _waves(rng, t, 2, 0.012)
    tilt = _waves(rng, t, 2, 0.03) @ np.array([first, second])
    swing = _waves(rng, t, 1, 0.15)
    strength = 15.0 + _waves(rng, t, 1, 1.0)
    arm = rng.normal(0, 0.08, 3)  # of the object's element, in its frame
    still, none = Rotation.concatenate([start] * len(t)), np.zeros((len(t), 3))
    anchor = rng.normal(0, 0.3, 3)
    push = strength * (normal + tilt)
    to_body = start.inv().apply
    if contact is Contact.FF:
        point = anchor + slide + wander @ np.array([first, second])
        return still, anchor + slide - start.apply(arm), push, point, (to_body(-normal), normal)
    if contact is Contact.EF:
        point = anchor + slide + wander[:, :1] * first
        return still, anchor + slide - start.apply(arm), push, point, (to_body(first), normal)
    if contact is Contact.FE:
        point = anchor + wander[:, :1] * first + none
        return still, anchor + slide - start.apply(arm), push, point, (to_body(-normal), first)
    if contact is Contact.VF:  # it rocks about an axis through the vertex and slides
        turn = Rotation.from_rotvec(swing * first) * still
        return turn, anchor + slide - turn.apply(arm), push, anchor + slide, (arm, normal)
    if contact is Contact.FV:
        return still, anchor + slide - start.apply(arm), push, anchor + none, (to_body(-normal), anchor)
    # e-e: an edge of the world along `first`, one of the object along `along`
    along = np.cos(0.9) * first + np.sin(0.9) * second
    u, v = _waves(rng, t, 1, 0.03), _waves(rng, t, 1, 0.03)
    position = anchor + u * first - v * along - start.apply(arm)
    return still, position, push, anchor + u * first, (to_body(along), first)


def _waves(rng: Any, t: Any, count: int, size: float, most_hz: float = 0.6) -> Any:
    """Smooth wandering (N, count) with standard deviation about ``size``."""
    frequency, phase = rng.uniform(0.25 * most_hz, most_hz, (3, count)), rng.uniform(0, 2 * np.pi, (3, count))
    return size * np.sqrt(2.0 / 3.0) * np.sin(2 * np.pi * frequency * t[:, None, None] + phase).sum(axis=1)


def _second_derivative(values: Any) -> Any:
    return np.gradient(np.gradient(values, axis=0), axis=0) * RATE_HZ**2
