"""Motion that none of the six contacts explains, or only in part: along curved surfaces, and in joints.

Each motion takes times (N,) in s and a random generator and returns rotations and positions of the object,
which moves like the simulator's hand: about 3.5 cm and 15 deg, within 1 Hz.
"""

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.motion.poses import Poses
from contact_tracker.simulate.signals import band_limited

Array = NDArray[np.float64]
Random = np.random.Generator
Motion = Callable[[Array, Random], tuple[Rotation, Array]]

SLIDE_M: Final = 0.035
TURN_RAD: Final = np.radians(15.0)
SIGMA: Final = (3e-4, np.radians(0.15))
"""Noise of a pose (m, rad), as in the recordings that come with the project."""
Z: Final = np.array([0.0, 0.0, 1.0])


def poses_of(motion: Motion, rng: Random, duration_s: float = 24.0, rate_hz: float = 200.0) -> Poses:
    """What a sensor sees of it, somewhere in the world."""
    time_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    turn, place = motion(time_s, rng)
    somewhere, count = _any(rng), len(time_s)
    error = Rotation.from_rotvec(SIGMA[1] * rng.normal(size=(count, 3)))
    position = somewhere.apply(place) + 0.3 * rng.normal(size=3) + SIGMA[0] * rng.normal(size=(count, 3))
    return Poses((1e9 * time_s).astype(np.int64), position, (somewhere * turn * error).as_quat())


def on_sphere(time_s: Array, rng: Random, radius_m: float) -> tuple[Rotation, Array]:
    """A vertex, while the object turns freely."""
    tilt = SLIDE_M / radius_m * _signals(rng, time_s, 2)
    normal = (_any(rng) * Rotation.from_rotvec(np.c_[tilt, 0.0 * time_s])).apply(Z)
    turn = _turning(rng, time_s)
    return turn, radius_m * normal - turn.apply(_vertex(rng))


def on_cylinder(time_s: Array, rng: Random, radius_m: float) -> tuple[Rotation, Array]:
    """A vertex, while the object turns freely."""
    angle, along = SLIDE_M * _signals(rng, time_s, 2).T
    touch = np.c_[radius_m * np.cos(angle / radius_m), radius_m * np.sin(angle / radius_m), along]
    turn = _turning(rng, time_s)
    return turn, touch - turn.apply(_vertex(rng))


def edge_on_cylinder(time_s: Array, rng: Random, radius_m: float) -> tuple[Rotation, Array]:
    """An edge that crosses the cylinder's axis at 70 deg or so, and rolls about itself."""
    slid, along_axis, along_edge, rolled, swung = _signals(rng, time_s, 5).T
    angle = SLIDE_M / radius_m * slid
    normal = np.c_[np.cos(angle), np.sin(angle), 0.0 * angle]
    tangent = np.c_[-np.sin(angle), np.cos(angle), 0.0 * angle]
    crossing = np.radians(70.0) + TURN_RAD * swung
    edge = np.cos(crossing)[:, None] * Z + np.sin(crossing)[:, None] * tangent
    frame = Rotation.from_matrix(np.stack([edge, np.cross(normal, edge), normal], axis=2))
    turn = frame * Rotation.from_rotvec(TURN_RAD * rolled[:, None] * [1.0, 0.0, 0.0])
    point = _vertex(rng) + SLIDE_M * along_edge[:, None] * [1.0, 0.0, 0.0]
    return turn, radius_m * normal + SLIDE_M * along_axis[:, None] * Z - turn.apply(point)


def rim_on_plane(time_s: Array, rng: Random, radius_m: float) -> tuple[Rotation, Array]:
    """A cup that is held aslant, and moved about on its rim."""
    x, y, leaned, turned, rolled = _signals(rng, time_s, 5).T
    lean = np.radians(30.0) + np.radians(6.0) * leaned
    turn = Rotation.from_euler("zxz", np.c_[TURN_RAD * turned, lean, 2.0 * TURN_RAD * rolled])
    turn = turn * _any(rng)
    centre = np.c_[SLIDE_M * x, SLIDE_M * y, radius_m * np.sin(lean)]
    return turn, centre - turn.apply(_vertex(rng))


def rolling_disc(time_s: Array, rng: Random, radius_m: float) -> tuple[Rotation, Array]:
    """A disc that leans by 30 deg or so and rolls on its rim without slipping, along a path that winds."""
    along, leaned, turned = _signals(rng, time_s, 3).T
    lean, heading = np.radians(30.0) + np.radians(6.0) * leaned, 2.0 * TURN_RAD * turned
    path = 2.0 * SLIDE_M * along
    way = np.c_[np.cos(heading), np.sin(heading)][1:] * np.diff(path)[:, None]
    touch = np.concatenate([np.zeros((1, 2)), way.cumsum(axis=0)])
    upright = Rotation.from_euler("ZX", np.c_[heading, lean])
    turn = upright * Rotation.from_rotvec(path[:, None] / radius_m * Z) * _any(rng)
    centre = np.c_[touch, 0.0 * path] + radius_m * upright.apply([0.0, 1.0, 0.0])
    return turn, centre - turn.apply(_vertex(rng))


def screw(time_s: Array, rng: Random, angle_rad: float, slide_m: float) -> tuple[Rotation, Array]:
    """About one axis and along it, by one signal: a hinge or a slide where one of them is zero."""
    signal = _signals(rng, time_s, 1)
    turn = Rotation.from_rotvec(angle_rad * signal * Z)
    return turn * _any(rng), turn.apply([0.3, 0.1, 0.2]) + slide_m * signal * Z


def ball(time_s: Array, rng: Random) -> tuple[Rotation, Array]:
    """About one point."""
    turn = _turning(rng, time_s)
    return turn, -turn.apply(_vertex(rng))


def vertex_on_plane(time_s: Array, rng: Random) -> tuple[Rotation, Array]:
    """One of the six, to compare with."""
    turn = _turning(rng, time_s)
    return turn, np.c_[SLIDE_M * _signals(rng, time_s, 2), 0.0 * time_s] - turn.apply(_vertex(rng))


def freely(time_s: Array, rng: Random) -> tuple[Rotation, Array]:
    """To compare with."""
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
    "free": freely,
}


def _signals(rng: Random, time_s: Array, count: int) -> Array:
    return band_limited(rng, time_s, count, 1.0)


def _any(rng: Random) -> Rotation:
    return Rotation.from_quat(rng.normal(size=4))


def _turning(rng: Random, time_s: Array) -> Rotation:
    return _any(rng) * Rotation.from_rotvec(TURN_RAD * _signals(rng, time_s, 3))


def _vertex(rng: Random) -> Array:
    return np.asarray(0.06 * rng.normal(size=3))
