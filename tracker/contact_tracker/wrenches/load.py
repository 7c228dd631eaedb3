"""The load of the hand: weight, centre of mass, inertia and sensor bias, estimated from ticks without
contact.

Newton and Euler about the body's origin, in its axes, for the wrench (f, m) of the hand (docs/theory.md,
T38).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.geometry.linalg import EYE, cross_matrix
from contact_tracker.motion.poses import Poses
from contact_tracker.wrenches.wrenches import (
    TickWrenches,
    Wrenches,
    about_body,
    average,
    reversed_wrenches,
)

GRAVITY: Final = 9.80665
LEAST_SHARE: Final = 0.1
"""Least share of the ticks with wrenches; if it is smaller, the two streams may have different clocks."""
FITS_BETTER: Final = 1.25
"""Least ratio of fits at which another reading of the wrenches overrules a load without doubt. If the object
hardly turns, the opposite sign of the moments fits right wrenches as well, with the centre of mass on the
other side: at most 1.01 times better in 224 simulated recordings, wrong wrenches 1.49 times or more."""
TOO_LITTLE: Final = "too little free motion shows what the hand carries: weight and sensor bias are not known"
FEWEST_TICKS: Final = 4
"""Least number of ticks without contact for an estimate."""
STARTS: Final = 6
"""Largest number of initial weights: outliers get little weight, so an estimate may end at a few ticks. Of 48
simulated loads, with as many ticks in contact, 3 are within 5 % from 1 start, 39 from 3, all from 6."""
ROUNDS: Final = 30
CONVERGED: Final = 1e-4
"""Change of the ticks' weights, between 0 and 1, after which no further round changes the load."""
MOST_COMPARED: Final = 2000
"""Largest number of free ticks that are compared with each other."""
NEAR_N: Final = 1.0
"""Weights (N) that differ by less belong to the same load."""
BIAS_SD: Final = (1.0, 0.1)
"""Prior standard deviations of the sensor's bias per axis (N, N m)."""
_FORCE_PRIOR: Final = np.diag([0.0] * 3 + [BIAS_SD[0] ** -2] * 3)
"""Prior precision (6, 6) of weight and force bias (1/N^2)."""
REACH_M: Final = 0.3
"""Prior standard deviation (m) of the centre of mass about the body's origin, scale of the radius of
gyration, and prior standard deviation of touching elements from the origin of a window's frame."""
EXPLAINED: Final = 0.25
"""Least share of the free ticks that a load has to explain: by motion alone some contacts seem free."""
UNEXPLAINED: Final = 0.05
MISFIT: Final = 9.0
"""Bounds of the residual force in this share of the ticks: over the median force, and squared over its noise.
A load above both does not explain them. On the shared physics recordings they are at most 0.085 and 2.3."""
MOST_BIAS: Final = 0.5
"""Largest ratio of a bias to the weight or to its moment, if the bias is far beyond its prior."""
DOUBTED_DEVIATIONS: Final = 3.0
"""Standard deviations from which a bias exceeds its prior, and from which a property that no load has is
significant: negative accelerated mass, negative moment of inertia, turned axes."""
TURNED_RAD: Final = 0.1
"""Largest angle (rad) between the axes of the forces and the body's axes; for right forces at most 0.03 on
the shared physics recordings."""
CENTRES_APART_M: Final = 0.03
"""Largest distance (m) between the centres of mass by forces and by moments. For right wrenches it is at most
0.026 on these recordings; in 280 simulated ones it exceeds this by at most 2.2 standard deviations."""


@dataclass(frozen=True, eq=False)
class Load:
    """Parameters of the hand's wrench without contact.

    Parameters
    ----------
    weight_n : (3,) force of gravity on the object, in the world's axes.
    centre_m : (3,) centre of mass in the body frame.
    inertia : (6,) about the body's origin: xx, yy, zz, xy, xz, yz (kg m^2).
    force_bias_n, moment_bias_nm : (3,) of the sensor, in the body's axes.
    force_covariance, moment_covariance : (6, 6) of weight and bias, (12, 12) of centre, inertia and bias.
    scale : mean squared residual of the free ticks over their noise.
    ticks : sum of the weights of the free ticks that fit.
    doubt : reason why no hand has this load, so that the wrenches have a wrong sign or frame; empty if there
        is none.
    """

    weight_n: Array
    centre_m: Array
    inertia: Array
    force_bias_n: Array
    moment_bias_nm: Array
    force_covariance: Array
    moment_covariance: Array
    scale: float
    ticks: float
    doubt: str

    @property
    def fit(self) -> float:
        """Number of ticks that the load explains over their misfit; smaller for wrong loads."""
        return self.ticks / self.scale

    @property
    def mass_kg(self) -> float:
        return float(np.linalg.norm(self.weight_n)) / GRAVITY


def estimate_load(ticks: TickWrenches, is_free: Bools, p_free: Array) -> Load | None:
    """Estimate the load by robust least squares over ticks that are probably free.

    Ticks in contact may be among them: the estimate starts from the load of most runs of free ticks, and
    outliers get little weight. None if there are too few ticks.

    Parameters
    ----------
    is_free : (T,) whether a tick is free by its motion; only these are used.
    p_free : (T,) probability of that.
    """
    usable = ticks.is_measured & is_free
    usable[1:] &= is_free[:-1]
    usable[:-1] &= is_free[1:]  # an acceleration includes the neighbouring ticks
    rows = np.flatnonzero(usable)
    if len(rows) < FEWEST_TICKS:
        return None
    starts, free = _agreed_weights(ticks, rows, p_free[rows]), ticks.at(rows)
    loads = (_refine(free, weight_n) for weight_n in starts)
    return max(loads, key=lambda load: load.fit, default=None)


def _agreed_weights(ticks: TickWrenches, rows: Ints, p_free: Array) -> list[Array]:
    """Weights (3,) in which most runs of ticks agree, at most ``STARTS``, the best supported one first; the
    weight of a single run may be from a contact."""
    stride = -(-len(rows) // MOST_COMPARED)
    rows, p_free = rows[::stride], p_free[::stride]
    free = ticks.at(rows)
    weight_n = _in_world(free, free.force_n)
    distance_n = np.linalg.norm(weight_n[:, None] - weight_n, axis=2)
    run = np.cumsum(np.append(0, np.diff(rows) > stride))
    kernel = p_free / (1.0 + (distance_n / NEAR_N) ** 2)
    support = np.sum([kernel[:, run == number].mean(axis=1) for number in range(run[-1] + 1)], axis=0)
    weights = list[Array]()
    while len(weights) < STARTS and np.max(support) > 0.0:
        near = distance_n[int(np.argmax(support))] < 2.0 * NEAR_N
        weights.append(np.asarray(weight_n[near].mean(axis=0)))
        support = np.where(near, 0.0, support)
    return weights


def _in_world(ticks: TickWrenches, force_n: Array) -> Array:
    """Weights (T, 3) in the world's axes that forces of the hand (T, 3) balance."""
    return np.asarray(-np.einsum("tij,tj->ti", ticks.rotation, force_n))


def _refine(free: TickWrenches, weight_n: Array) -> Load:
    """Iteratively reweighted least squares: force for weight and its bias, moment for the rest."""
    force_noise, moment_noise = free.force_variance, free.moment_variance
    centre, scale = np.zeros(3), 1.0
    by_tick = _in_world(free, free.force_n)
    weight = _redescending((np.linalg.norm(by_tick - weight_n, axis=1) / NEAR_N) ** 2)
    for _ in range(ROUNDS):
        mass = float(np.linalg.norm(weight_n)) / GRAVITY
        inertial, design = _forces(free, weight_n, mass, centre)[1], _force_design(free)
        down = weight_n / max(float(np.linalg.norm(weight_n)), 1e-9)
        # the mass follows from the weight: a mass of its own would add up the errors of all rounds
        design[..., :3] += inertial[..., None] * down / max(GRAVITY * mass, 1e-9)
        force, by_force = _solve(design, free.force_n, weight / force_noise, _FORCE_PRIOR)
        weight_n, bias = force[:3], force[3:]
        off_force = free.force_n - np.einsum("tij,j->ti", design, force)
        mass = float(np.linalg.norm(weight_n)) / GRAVITY
        design = _moment_design(free, _forces(free, weight_n, mass, centre)[0])
        inertia = max(mass, 1e-3) * REACH_M**2
        prior = np.diag([REACH_M**-2] * 3 + [inertia**-2] * 6 + [BIAS_SD[1] ** -2] * 3)
        moment, by_moment = _solve(design, free.moment_nm, weight / moment_noise, prior)
        centre = moment[:3]
        off_moment = free.moment_nm - np.einsum("tij,j->ti", design, moment)
        squares = (off_force**2).sum(axis=1) / force_noise + (off_moment**2).sum(axis=1) / moment_noise
        order = squares.argsort()
        heavy = weight[order].cumsum()
        usual = max(float(squares[order[heavy.searchsorted(0.5 * heavy[-1])]]), 6.0)  # the weighted median
        previous, weight = weight, _redescending(squares / usual)
        scale = max(float((weight * squares).sum() / weight.sum()) / 6.0, 1.0)
        if np.abs(weight - previous).max() < CONVERGED:
            break
    covariances = by_force * scale, by_moment * scale
    explained = scale, float(weight.sum())
    load = Load(weight_n, centre, moment[3:9], bias, moment[9:], *covariances, *explained, doubt="")
    return replace(load, doubt=_doubt(load, free, weight / (force_noise * scale), off_force, inertial))


def _doubt(load: Load, free: TickWrenches, precision: Array, off_force: Array, inertial: Array) -> str:
    """Reason why no hand has this load; empty if there is none.

    Parameters
    ----------
    precision : (n,) of the forces of the free ticks.
    off_force, inertial : (n, 3) force that is not explained, and that accelerates the centre of mass (N).
    """
    mass, centre = load.mass_kg, load.centre_m
    solution, covariance = _solve_with(free, precision, free.force_n, inertial[..., None] / max(mass, 1e-9))
    carried_kg = max(float(np.linalg.norm(solution[:3])) / GRAVITY, 1e-9)
    share, sd = float(solution[6]) / carried_kg, float(covariance[6, 6]) ** 0.5 / carried_kg
    if share < 0.0 and share + DOUBTED_DEVIATIONS * sd < 1.0:
        return "in free motion the forces are as if the mass were negative"
    weight_n = GRAVITY * mass
    moment_nm = weight_n * float(np.linalg.norm(centre))
    for text, bias, usual, limit in (
        ("force of {:.1f} N", load.force_bias_n, BIAS_SD[0], weight_n),
        ("moment of {:.1f} N m", load.moment_bias_nm, BIAS_SD[1], moment_nm),
    ):
        size = float(np.linalg.norm(bias))
        if size > max(DOUBTED_DEVIATIONS * usual, MOST_BIAS * limit):
            return f"in free motion a {text.format(size)} turns with the object, as gravity does not"
    values, axes = np.linalg.eigh(_inertia_times(EYE) @ load.inertia)
    along = axes[:, 0] @ (axes[:, 0] @ _inertia_times(EYE))
    if (
        _beyond(values[:1], (along @ load.moment_covariance[3:9, 3:9] @ along)[None, None])
        and values[0] < 0.0
    ):
        return "in free motion the moments are as if the inertia were negative"
    expected = free.force_n - off_force - load.force_bias_n
    angle = _beyond(*_misfit(free, precision, expected, -cross_matrix(expected)))
    if angle > TURNED_RAD:
        turn = f"{np.degrees(angle):.0f} deg against the object's"
        return f"in free motion the forces are as if their axes were turned by {turn}"
    # noise of the poses enlarges accelerations: the distance from the line between origin and centre
    off_m, by_point = _misfit(free, precision, expected, mass * _acceleration_by_point(free))
    place = float(np.clip((centre + off_m) @ centre / max(float(centre @ centre), 1e-12), 0.0, 1.0))
    if _beyond(centre + off_m - place * centre, by_point) > CENTRES_APART_M:
        return "in free motion the moments are not about the object's origin"
    squares = (off_force**2).sum(axis=1)
    usual_n = max(float(np.median(np.linalg.norm(free.force_n, axis=1))), NEAR_N)
    residual = float(np.quantile(squares, EXPLAINED)) ** 0.5 / usual_n
    misfit = float(np.quantile(squares / free.force_variance, EXPLAINED)) / 3.0
    if load.ticks < FEWEST_TICKS or (residual > UNEXPLAINED and misfit > MISFIT):
        return "in free motion the forces are not those of weight and inertia"
    return ""


def _misfit(ticks: TickWrenches, weight: Array, expected: Array, columns: Array) -> tuple[Array, Array]:
    """Coefficients (3,) of ``columns`` (n, 3, 3) that explain the forces beyond the ``expected`` ones, and
    their covariance (3, 3). A share of the acceleration is fitted as well, as averaging over a tick reduces
    fast accelerations."""
    design = np.concatenate([columns, ticks.acceleration[..., None]], axis=2)
    solution, covariance = _solve_with(ticks, weight, ticks.force_n - expected, design)
    return solution[6:9], covariance[6:9, 6:9]


def _beyond(difference: Array, covariance: Array) -> float:
    """The length of a ``difference`` (D,), or zero if it is not significant."""
    size = float(np.linalg.norm(difference))
    along = difference / max(size, 1e-9)
    return size if size > DOUBTED_DEVIATIONS * float(along @ covariance @ along) ** 0.5 else 0.0


def _solve_with(ticks: TickWrenches, weight: Array, force_n: Array, columns: Array) -> tuple[Array, Array]:
    """Solve the forces for weight, bias and coefficients of further ``columns`` (n, 3, k): the solution (6 +
    k,) and its covariance."""
    design = np.concatenate([_force_design(ticks), columns], axis=2)
    return _solve(design, force_n, weight, np.pad(_FORCE_PRIOR, (0, columns.shape[2])))


def contact_wrenches(ticks: TickWrenches, load: Load) -> tuple[Array, Array, Array, Array]:
    """Force and moment (T, 3) of the surroundings on the object, about the body's origin in its axes: the
    load's less the measured wrench; and their derivatives (T, 3, 18) by independent standard errors of the
    load."""
    gravity, inertial = _forces(ticks, load.weight_n, load.mass_kg, load.centre_m)
    by_force, by_moment = _force_design(ticks), _moment_design(ticks, gravity)
    force = by_force @ np.append(load.weight_n, load.force_bias_n) + inertial - ticks.force_n
    moment = by_moment @ np.concatenate([load.centre_m, load.inertia, load.moment_bias_nm]) - ticks.moment_nm
    force_errors = np.pad(by_force @ _root(load.force_covariance), ((0, 0), (0, 0), (0, 12)))
    moment_errors = np.pad(by_moment @ _root(load.moment_covariance), ((0, 0), (0, 0), (6, 0)))
    return force, moment, force_errors, moment_errors


def _redescending(squares: Array) -> Array:
    return np.asarray(1.0 / (1.0 + 0.25 * squares) ** 2)


def _root(covariance: Array) -> Array:
    """Matrix whose product with its transpose is the covariance (P, P)."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _solve(design: Array, target: Array, weight: Array, prior: Array) -> tuple[Array, Array]:
    """Weighted least squares: the solution (P,) and its covariance (P, P)."""
    information = np.einsum("t,tij,tik->jk", weight, design, design) + prior
    covariance = np.linalg.pinv(information, hermitian=True)
    return covariance @ np.einsum("t,tij,ti->j", weight, design, target), covariance


def _forces(ticks: TickWrenches, weight_n: Array, mass: float, centre_m: Array) -> tuple[Array, Array]:
    """Weight less the force that accelerates the body's origin, and the force that accelerates the centre of
    mass, (n, 3) in the body's axes (N)."""
    swing = _acceleration_by_point(ticks) @ centre_m
    down = np.einsum("tji,j->ti", ticks.rotation, weight_n)
    return down - mass * ticks.acceleration, mass * (ticks.acceleration + swing)


def _acceleration_by_point(ticks: TickWrenches) -> Array:
    """(n, 3, 3): derivatives of a point's acceleration about the origin by the point."""
    spin = cross_matrix(ticks.angular_velocity)
    return np.asarray(cross_matrix(ticks.angular_acceleration) + spin @ spin)


def _force_design(ticks: TickWrenches) -> Array:
    """Derivatives (n, 3, 6) of the hand's force by weight and bias."""
    turned = ticks.rotation.swapaxes(1, 2)
    return np.concatenate([-turned, np.broadcast_to(EYE, turned.shape)], axis=2)


def _moment_design(ticks: TickWrenches, gravity: Array) -> Array:
    """Derivatives (n, 3, 12) of the hand's moment by centre of mass, inertia and bias."""
    spin = ticks.angular_velocity
    inertial = _inertia_times(ticks.angular_acceleration) + cross_matrix(spin) @ _inertia_times(spin)
    bias = np.broadcast_to(EYE, (len(inertial), 3, 3))
    return np.concatenate([cross_matrix(gravity), inertial, bias], axis=2)


def _inertia_times(v: Array) -> Array:
    """(n, 3, 6): derivatives by an inertia's six parameters of its product with vectors v (n, 3)."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    rows = [[x, zero, zero, y, z, zero], [zero, y, zero, x, zero, z], [zero, zero, z, zero, x, y]]
    return np.asarray(np.array(rows).transpose(2, 0, 1))


class NoLoad(Exception):
    """The wrenches of a recording cannot be used; the text is one line with the reason."""


def require_load(
    poses: Poses, wrenches: Wrenches, stamp_ns: Ints, is_free: Bools, p_free: Array
) -> tuple[TickWrenches, Load]:
    """Wrenches in the ticks that end at ``stamp_ns`` (T,), and the load estimated from them.

    Parameters
    ----------
    is_free, p_free : see ``estimate_load``.

    Raises
    ------
    NoLoad
        As ``wrench_evidence``.
    """
    ticks = average(poses, wrenches, stamp_ns)
    if ticks.is_measured.mean() < LEAST_SHARE:
        raise NoLoad("wrenches and poses hardly overlap in time: are their stamps of one clock?")
    load = estimate_load(ticks, is_free, p_free)
    if load is None:
        raise NoLoad(TOO_LITTLE)
    fits = list[tuple[float, str]]()
    for text, reading in _other_readings(poses, wrenches):
        alternative = estimate_load(average(poses, reading, stamp_ns), is_free, p_free)
        if alternative is not None and not alternative.doubt:
            fits.append((alternative.fit, text))
    best, text = max(fits, default=(0.0, ""))
    if best > (1.0 if load.doubt else FITS_BETTER) * load.fit:
        less = "they explain less of the free motion as they are than otherwise"
        raise NoLoad(f"{load.doubt or less}. They fit {text}")
    if not load.doubt:
        return ticks, load
    reason = TOO_LITTLE if load.ticks < FEWEST_TICKS else load.doubt
    raise NoLoad(
        f"{reason}. Check their sign, their frame, the sensor's bias, and "
        "whether there are some seconds of free motion"
    )


def _other_readings(poses: Poses, wrenches: Wrenches) -> Iterator[tuple[str, Wrenches]]:
    """Other readings of the same numbers with their descriptions: with opposite signs, and in the axes of the
    world, about its origin or the body's."""
    reverse = "with the opposite sign: they act on the hand, not on the object"
    yield reverse, reversed_wrenches(wrenches)
    yield "with the opposite sign of the forces only", replace(wrenches, force_n=-wrenches.force_n)
    yield "with the opposite sign of the moments only", replace(wrenches, moment_nm=-wrenches.moment_nm)
    for text, from_world in (
        ("in the frame of the poses instead of the object's: set header.frame_id", True),
        ("in the axes of the poses' frame, about the object's origin: turn them into its axes", False),
    ):
        reading = about_body(wrenches, poses, from_world)
        yield text, reading
        yield f"{reverse}, {text}", reversed_wrenches(reading)
