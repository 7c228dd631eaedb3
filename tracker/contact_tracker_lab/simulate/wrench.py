"""Wrenches of a hand that carries the object and presses it against its surroundings, measured by a sensor in
between."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.geometry.polyhedron import Polyhedron, unit
from contact_tracker.states import Contact
from contact_tracker.wrenches.wrenches import Wrenches
from contact_tracker_lab.simulate.motion import Path, band_limited, blend, within
from contact_tracker_lab.simulate.plan import Leg, Rigid

MASS_KG: Final = 0.5
"""Mass (kg) of the object, in equal parts at its vertices."""
GRAVITY_M_S2: Final = np.array([0.0, 0.0, -9.80665])
"""Gravity in the scene's axes; its top faces look up."""
PRESS_N: Final = 15.0
_PRESS_RAMP_S: Final = 0.4
"""Time (s) from free motion to the full force, and back."""
_VARYING: Final = (0.07, 0.02)
"""Standard deviations of the force along the normal and across it (friction), as shares of ``PRESS_N``."""
_WANDER_M: Final = 0.03
"""Standard deviation of the centre of pressure along lines and faces that touch."""
_CLEARANCE_SHARE: Final = 0.8
"""Largest displacement of the centre of pressure, as a share of its distance to the rims of both features."""
_CLEARANCE_SAMPLES: Final = 50
"""Number of touching points of a leg at which this distance is measured."""
_BANDWIDTH_HZ: Final = 0.8
NOISE: Final = (0.1, 0.01)
"""Standard deviations of the white noise per axis (N, N m)."""
BIAS: Final = (0.3, 0.03)
"""Standard deviations of the sensor's bias per axis (N, N m), which is constant in a recording."""


def measure_wrenches(
    rng: np.random.Generator,
    stamp_ns: Ints,
    rate_hz: float,
    legs: Sequence[Leg],
    paths: Sequence[Path],
    object: Polyhedron,
    body: Rigid,
) -> Wrenches:
    """The measured wrench of the hand at each pose, about the body's origin and in its axes.

    Parameters
    ----------
    stamp_ns : (N,) of the poses, which are ``1 / rate_hz`` apart but for jitter.
    legs, paths : the motion (object to scene).
    body : from the frame of ``object`` to the body's.
    """
    time_s = np.arange(len(stamp_ns)) / rate_hz
    pose = Rigid.join([path.pose for path in paths])
    origin = pose.rotation @ body.inverse().translation + pose.translation
    masses = np.einsum("nij,vj->nvi", pose.rotation, object.vertices) + pose.translation[:, None]
    velocity = np.gradient(masses, axis=0, edge_order=2)
    acceleration = np.gradient(velocity, axis=0, edge_order=2) * rate_hz**2
    pushes = MASS_KG / len(object.vertices) * (acceleration - GRAVITY_M_S2)
    moves = list(zip(legs, paths, strict=True))
    normal = np.concatenate([contact_normals(leg, path) for leg, path in moves])
    touches = [leg.contact is not Contact.FREE for leg in legs]
    is_touching = np.repeat(touches, [len(path.touch_scene) for path in paths])
    along, *across = band_limited(rng, time_s, 4, _BANDWIDTH_HZ).T
    friction = np.stack(across, axis=1)
    friction -= np.einsum("ni,ni->n", friction, normal)[:, None] * normal
    # force of the surroundings on the object, at the touching point, in the scene
    contact_force = (1.0 + _VARYING[0] * along)[:, None] * normal + _VARYING[1] * friction
    contact_force = PRESS_N * press_share(is_touching, rate_hz)[:, None] * contact_force
    pressed = np.concatenate([_pressed_points(rng, leg, path, rate_hz) for leg, path in moves])
    force = pushes.sum(axis=1) - contact_force
    moment = np.cross(masses - origin[:, None], pushes).sum(axis=1)
    moment -= np.cross(pressed - origin, contact_force)
    axes = pose.rotation @ body.rotation.T
    force_n, moment_nm = (
        np.einsum("nji,nj->ni", axes, values)
        + rng.normal(0.0, noise, values.shape)
        + rng.normal(0.0, bias, 3)
        for values, noise, bias in zip((force, moment), NOISE, BIAS, strict=True)
    )
    return Wrenches(stamp_ns, force_n, moment_nm)


def _pressed_points(rng: np.random.Generator, leg: Leg, path: Path, rate_hz: float) -> Array:
    """Centres of pressure (N, 3) in the scene: the touching point, or where lines or faces touch, a point
    that wanders about it, as the hand presses harder on one side."""
    object, fixed = leg.chart.object, leg.chart.environment
    if leg.contact not in (Contact.FF, Contact.EF, Contact.FE):
        return path.touch_scene
    feature, to_scene = (fixed, np.eye(3)) if leg.contact is Contact.FE else (object, path.pose.rotation)
    clearance_m = min(
        touched.point_clearance(point)
        for touched, points in ((object, path.touch_object), (fixed, path.touch_scene))
        for point in points[:: max(len(points) // _CLEARANCE_SAMPLES, 1)]
    )
    time_s = np.arange(len(path.touch_scene)) / rate_hz
    wander = band_limited(rng, time_s, len(feature.span), _BANDWIDTH_HZ) * _WANDER_M
    shift = within(wander, _CLEARANCE_SHARE * clearance_m) @ feature.span
    return np.asarray(path.touch_scene + (to_scene @ shift[..., None])[..., 0], float)


def contact_normals(leg: Leg, path: Path) -> Array:
    """(N, 3) common normals in the scene, from the surroundings to the object."""
    rotation, chart = path.pose.rotation, leg.chart
    if chart.environment.kind == "f":
        return np.broadcast_to(chart.environment.normals[0], path.touch_scene.shape)
    if chart.object.kind == "f":
        return np.asarray(-rotation @ chart.object.normals[0], float)
    normal = unit(np.cross(rotation @ chart.object.span[0], chart.environment.span[0]))
    return np.asarray(normal * np.sign(normal @ leg.start.normal)[:, None], float)


def press_share(is_touching: Bools, rate_hz: float) -> Array:
    """Share (N,) of the full force, 0 in free motion; without ramps at the ends of a recording."""
    share = np.zeros(len(is_touching))
    changes = np.flatnonzero(np.diff(is_touching)) + 1
    for rows in np.split(np.arange(len(is_touching)), changes):
        if not is_touching[rows[0]]:
            continue
        duration_s = len(rows) / rate_hz
        begin, middle, end = blend(np.arange(len(rows)) / rate_hz, duration_s, _PRESS_RAMP_S)
        share[rows] = middle + begin * (rows[0] == 0) + end * (rows[-1] == len(is_touching) - 1)
    return share
