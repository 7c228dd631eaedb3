"""Motion that none of the six contacts explains completely: along curved surfaces, and in joints.

Each motion takes times (N,) in s and a random generator and returns rotations and positions of the object,
with amplitude and bandwidth as in the simulator: about 3.5 cm and 15 deg, up to 1 Hz.
"""

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.motion.poses import Poses
from contact_tracker_lab.simulate.motion import band_limited

Random = np.random.Generator
Motion = Callable[[Array, Random], tuple[Rotation, Array]]

SLIDE_M: Final = 0.035
TURN_RAD: Final = np.radians(15.0)
SIGMA: Final = (3e-4, np.radians(0.15))
"""Noise of a pose (m, rad), as in the shipped recordings."""
Z: Final = np.array([0.0, 0.0, 1.0])


def poses_of(motion: Motion, rng: Random, duration_s: float = 24.0, rate_hz: float = 200.0) -> Poses:
    """Measured poses of a motion, at a random pose in the world."""
    time_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    turn, place = motion(time_s, rng)
    world, count = _random_rotation(rng), len(time_s)
    error = Rotation.from_rotvec(SIGMA[1] * rng.normal(size=(count, 3)))
    position = world.apply(place) + 0.3 * rng.normal(size=3) + SIGMA[0] * rng.normal(size=(count, 3))
    return Poses((1e9 * time_s).astype(np.int64), position, (world * turn * error).as_quat())


def on_sphere(time_s: Array, rng: Random, radius_m: float) -> tuple[Rotation, Array]:
    """A vertex on a sphere; the object rotates freely."""
    tilt = SLIDE_M / radius_m * _signals(rng, time_s, 2)
    normal = (_random_rotation(rng) * Rotation.from_rotvec(np.c_[tilt, 0.0 * time_s])).apply(Z)
    turn = _turning(rng, time_s)
    return turn, radius_m * normal - turn.apply(_vertex(rng))


def on_cylinder(time_s: Array, rng: Random, radius_m: float) -> tuple[Rotation, Array]:
    """A vertex on a cylinder; the object rotates freely."""
    angle, along = SLIDE_M * _signals(rng, time_s, 2).T
    touch = np.c_[radius_m * np.cos(angle / radius_m), radius_m * np.sin(angle / radius_m), along]
    turn = _turning(rng, time_s)
    return turn, touch - turn.apply(_vertex(rng))


def edge_on_cylinder(time_s: Array, rng: Random, radius_m: float) -> tuple[Rotation, Array]:
    """An edge on a cylinder, about 70 deg from its axis; the object also rotates about the edge."""
    around, along_axis, along_edge, rolled, swung = _signals(rng, time_s, 5).T
    angle = SLIDE_M / radius_m * around
    normal = np.c_[np.cos(angle), np.sin(angle), 0.0 * angle]
    tangent = np.c_[-np.sin(angle), np.cos(angle), 0.0 * angle]
    crossing = np.radians(70.0) + TURN_RAD * swung
    edge = np.cos(crossing)[:, None] * Z + np.sin(crossing)[:, None] * tangent
    frame = Rotation.from_matrix(np.stack([edge, np.cross(normal, edge), normal], axis=2))
    turn = frame * Rotation.from_rotvec(TURN_RAD * rolled[:, None] * [1.0, 0.0, 0.0])
    point = _vertex(rng) + SLIDE_M * along_edge[:, None] * [1.0, 0.0, 0.0]
    return turn, radius_m * normal + SLIDE_M * along_axis[:, None] * Z - turn.apply(point)


def rim_on_plane(time_s: Array, rng: Random, radius_m: float) -> tuple[Rotation, Array]:
    """A tilted cup that slides on its rim."""
    x, y, leaned, turned, rolled = _signals(rng, time_s, 5).T
    lean = np.radians(30.0) + np.radians(6.0) * leaned
    turn = Rotation.from_euler("zxz", np.c_[TURN_RAD * turned, lean, 2.0 * TURN_RAD * rolled])
    turn = turn * _random_rotation(rng)
    centre = np.c_[SLIDE_M * x, SLIDE_M * y, radius_m * np.sin(lean)]
    return turn, centre - turn.apply(_vertex(rng))


def rolling_disc(time_s: Array, rng: Random, radius_m: float) -> tuple[Rotation, Array]:
    """A disc tilted by about 30 deg that rolls on its rim without slipping, along a curved path."""
    along, leaned, turned = _signals(rng, time_s, 3).T
    lean, heading = np.radians(30.0) + np.radians(6.0) * leaned, 2.0 * TURN_RAD * turned
    path = 2.0 * SLIDE_M * along
    steps = np.c_[np.cos(heading), np.sin(heading)][1:] * np.diff(path)[:, None]
    touch = np.concatenate([np.zeros((1, 2)), steps.cumsum(axis=0)])
    upright = Rotation.from_euler("ZX", np.c_[heading, lean])
    turn = upright * Rotation.from_rotvec(path[:, None] / radius_m * Z) * _random_rotation(rng)
    centre = np.c_[touch, 0.0 * path] + radius_m * upright.apply([0.0, 1.0, 0.0])
    return turn, centre - turn.apply(_vertex(rng))


def tilted_mug(time_s: Array, _: Random) -> tuple[Rotation, Array]:
    """A mug that slides on its bottom, and after 6 s on the rim of it, which is tilted and turned about."""
    lean = np.clip(0.5 * (time_s - 6.0), 0.0, 0.5 + 0.2 * np.sin(0.9 * time_s))
    towards = 0.7 + 0.8 * np.sin(1.5 * time_s)
    down = np.c_[np.cos(towards), np.sin(towards), 0.0 * time_s]
    tilt = Rotation.from_rotvec(lean[:, None] * np.cross(Z, down))
    slide = np.c_[0.07 * np.sin(1.4 * time_s), 0.1 * np.cos(1.7 * time_s), 0.0 * time_s]
    turn = Rotation.from_euler("z", 0.5 * np.sin(1.6 * time_s)[:, None])
    return tilt * turn, slide + 0.04 * (down - tilt.apply(down))


def screw(time_s: Array, rng: Random, angle_rad: float, slide_m: float) -> tuple[Rotation, Array]:
    """Coupled motion about and along one axis; a hinge or a slider if one of them is zero."""
    signal = _signals(rng, time_s, 1)
    turn = Rotation.from_rotvec(angle_rad * signal * Z)
    return turn * _random_rotation(rng), turn.apply([0.3, 0.1, 0.2]) + slide_m * signal * Z


def ball(time_s: Array, rng: Random) -> tuple[Rotation, Array]:
    """Rotation about a fixed point."""
    turn = _turning(rng, time_s)
    return turn, -turn.apply(_vertex(rng))


def vertex_on_plane(time_s: Array, rng: Random) -> tuple[Rotation, Array]:
    """v-f, for comparison."""
    turn = _turning(rng, time_s)
    return turn, np.c_[SLIDE_M * _signals(rng, time_s, 2), 0.0 * time_s] - turn.apply(_vertex(rng))


def free_motion(time_s: Array, rng: Random) -> tuple[Rotation, Array]:
    """Free motion, for comparison."""
    return _turning(rng, time_s), SLIDE_M * _signals(rng, time_s, 3)


MOTIONS: Final[dict[str, Motion]] = {
    **{f"vertex on a sphere of {r} m": partial(on_sphere, radius_m=r) for r in (0.1, 0.2, 0.3)},
    **{f"vertex on a cylinder of {r} m": partial(on_cylinder, radius_m=r) for r in (0.1, 0.3)},
    "edge across a cylinder of 0.1 m": partial(edge_on_cylinder, radius_m=0.1),
    "rim of 0.04 m on a face": partial(rim_on_plane, radius_m=0.04),
    "disc of 0.1 m that rolls on a face": partial(rolling_disc, radius_m=0.1),
    "hinge": partial(screw, angle_rad=np.radians(25.0), slide_m=0.0),
    "drawer": partial(screw, angle_rad=0.0, slide_m=0.1),
    "screw": partial(screw, angle_rad=np.radians(25.0), slide_m=0.02),
    "ball joint": ball,
    "vertex on a face": vertex_on_plane,
    "free": free_motion,
}


def _signals(rng: Random, time_s: Array, count: int) -> Array:
    return band_limited(rng, time_s, count, 1.0)


def _random_rotation(rng: Random) -> Rotation:
    return Rotation.from_quat(rng.normal(size=4))


def _turning(rng: Random, time_s: Array) -> Rotation:
    return _random_rotation(rng) * Rotation.from_rotvec(TURN_RAD * _signals(rng, time_s, 3))


def _vertex(rng: Random) -> Array:
    return np.asarray(0.06 * rng.normal(size=3))
