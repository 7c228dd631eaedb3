"""Motion of the object at its contact: it slides, rolls, pivots or rests, by the velocity of the touching
point and its standard deviation.

Two bodies that touch at a point slide with the relative velocity of their material there, roll with the part
of their relative angular velocity in the common tangent plane, and pivot with the part about the common
normal (Johnson, Contact Mechanics, 1985, section 1.2). Each is decided by its significance against the noise.
"""

from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyder, polyfit, polyval
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc, chdtri

from contact_tracker.geometry.elements import Array, ContactGeometry, Element, Line, Plane, Point
from contact_tracker.geometry.linalg import (
    PARALLEL,
    between,
    cross,
    cross_matrix,
    dot,
    matrices,
    rotation_vectors,
    sphere_tangent,
)

SIGNIFICANCE: Final = 0.01
"""Probability, over all ticks of a segment at rest, that it is said to move in one of the ways."""
KINDS: Final = ("slides", "rolls", "pivots")
RESTS, STICK_SLIP = "rests", "sticks and slips"
MEANS: Final = ("slip_m_per_s", "slip_sd_m_per_s", "roll_rad_per_s", "spin_rad_per_s", "turn_sd_rad_per_s")
"""Names of the means of a segment."""
_FEWEST: Final = 4
"""Least number of ticks that determine velocity, jerk and noise."""
_STILL: Final = 0.25
"""Least median p-value of the slip of an object that sticks; without slip it is 0.5."""


@dataclass(frozen=True, eq=False)
class ContactMotion:
    """The relative motion at the touching point in T ticks of a segment.

    The touching point is the vertex, the crossing of two edges, the point of an edge nearest to the tracked
    point (docs/theory.md, 2.3), or for two faces the tracked point itself.

    Parameters
    ----------
    stamp_ns : (T,) of the ticks.
    slip_m_per_s : (T, 3) velocity of the object's material at the point, in the tangent plane, in the world.
    slip_sd_m_per_s : (T,) its standard deviation per axis; it includes the uncertainty of the elements.
    over_m_per_s : (T, 2) speeds of the touching point over the element of the object and of the surroundings.
    roll_rad_per_s, spin_rad_per_s : (T,) angular speed about axes in the tangent plane, and about the normal.
    turn_sd_rad_per_s : (T,) standard deviation of the angular velocity per axis.
    p_value : (T, 3) probabilities of at least this slip, roll and spin in a tick by noise alone.
    """

    stamp_ns: NDArray[np.int64]
    slip_m_per_s: Array
    slip_sd_m_per_s: Array
    over_m_per_s: Array
    roll_rad_per_s: Array
    spin_rad_per_s: Array
    turn_sd_rad_per_s: Array
    p_value: Array

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def __getitem__(self, rows: slice) -> "ContactMotion":
        return ContactMotion(*(getattr(self, field.name)[rows] for field in fields(self)))

    @property
    def speed_m_per_s(self) -> Array:
        """(T,) speed of the slip."""
        return np.sqrt(dot(self.slip_m_per_s, self.slip_m_per_s))

    @property
    def is_significant(self) -> NDArray[np.bool_]:
        """(T, 3) whether the object slides, rolls and pivots in each tick."""
        return np.asarray(self.p_value < SIGNIFICANCE / max(len(self), 1))

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of motion in the segment: ``slides`` or ``sticks and slips``, ``rolls``, ``pivots``, or
        ``rests`` if none of them is significant. With more noise fewer are."""
        kinds = [KINDS[column] for column in np.flatnonzero(self.is_significant.any(axis=0))]
        if self._slips_again:
            kinds[0] = STICK_SLIP
        return tuple(kinds) or (RESTS,)

    @property
    def means(self) -> dict[str, float]:
        """Root mean squares over the ticks, by ``MEANS``."""
        turns = self.roll_rad_per_s, self.spin_rad_per_s, self.turn_sd_rad_per_s
        values = (self.speed_m_per_s, self.slip_sd_m_per_s, *turns)
        squares = (np.mean(np.square(value)) for value in values)
        return {name: float(np.sqrt(square)) for name, square in zip(MEANS, squares, strict=True)}

    @property
    def _slips_again(self) -> bool:
        """Whether the object sticks and then begins to slide at least twice. It sticks while a slip of median
        speed would be significant, but most ticks have no more slip than noise.

        Where a slide reverses, half of the ticks without significant slip have a p-value below 0.1.
        """
        slides, limit = self.is_significant[:, 0], chdtri(2, SIGNIFICANCE / max(len(self), 1))
        edges = np.flatnonzero(np.diff(slides)) + 1
        usual = np.median(self.speed_m_per_s[slides]) if slides.any() else 0.0
        sticks = 0
        for start, end in pairwise([0, *edges]):
            detectable = np.median(self.slip_sd_m_per_s[start:end]) * np.sqrt(limit) < usual
            is_still = np.median(self.p_value[start:end, 0]) > _STILL and end - start >= _FEWEST
            sticks += bool(not slides[start] and detectable and is_still)
        return sticks >= 2


def contact_motion(
    geometry: ContactGeometry,
    stamp_ns: NDArray[np.int64],
    time_s: Array,
    quat_xyzw: Array,
    position_m: Array,
    variance: Array,
) -> ContactMotion | None:
    """The motion at a contact in T ticks; None if there are too few ticks or the edges are parallel.

    Parameters
    ----------
    geometry : the elements; the origin of the body frame is the tracked point, the world's origin is any.
    time_s, quat_xyzw, position_m : (T,), (T, 4), (T, 3) mean poses of the ticks, with the position of the
        tracked point, whose noise is independent of the noise of the orientation.
    variance : (T, 2) of the noise per axis (m^2, rad^2).
    """
    if len(time_s) < _FEWEST:
        return None
    rotation = matrices(quat_xyzw)
    touch = _touch(geometry, rotation, position_m, variance)
    if touch is None:
        return None
    steps = rotation_vectors(between(quat_xyzw[:-1], quat_xyzw[1:]))  # in the axes of the earlier pose
    turned = np.cumsum(np.einsum("tij,tj->ti", rotation[:-1], steps), axis=0)
    velocity, v_variance = smooth_rates(time_s, position_m, variance[:, 0])
    angular, w_variance = smooth_rates(time_s, np.vstack([np.zeros(3), turned]), variance[:, 1])

    arm, tangents = touch.point_m - position_m, sphere_tangent(touch.normal)  # (T, 3), (T, 3, 2)
    slip = np.einsum("tia,ti->ta", tangents, velocity + cross(angular, arm))
    per_turn = np.einsum("tij,tja->tia", cross_matrix(arm), tangents)
    per_shift = np.einsum("tij,tja->tia", cross_matrix(angular), tangents)
    slip_covariance = (
        v_variance[:, None, None] * np.eye(2)
        + w_variance[:, None, None] * np.einsum("tia,tib->tab", per_turn, per_turn)
        + np.einsum("tia,tij,tjb->tab", per_shift, touch.covariance, per_shift)
    )
    roll = np.einsum("tia,ti->ta", tangents, angular)
    spin = dot(touch.normal, angular)
    if isinstance(geometry.object, Plane) and isinstance(geometry.environment, Plane):
        roll = np.zeros_like(roll)  # touching faces cannot roll
    squares = np.einsum("ta,tab,tb->t", slip, np.linalg.inv(slip_covariance), slip)
    p_value = [chdtrc(2, squares), *_turn_p_values(geometry, roll, spin, w_variance, touch.normal_variance)]
    slip_in_world = np.einsum("tia,ta->ti", tangents, slip)
    return ContactMotion(
        stamp_ns,
        slip_in_world,
        np.sqrt(np.trace(slip_covariance, axis1=1, axis2=2) / 2.0),
        _over(geometry, rotation, slip_in_world),
        np.linalg.norm(roll, axis=1),
        np.abs(spin),
        np.sqrt(w_variance),
        np.stack(p_value, axis=1),
    )


def _turn_p_values(
    geometry: ContactGeometry, roll: Array, spin: Array, variance: Array, normal_variance: Array
) -> list[Array]:
    """p-values (T,) of the roll and of the spin. The roll has one axis if an edge touches a face, else two.
    An error of the normal counts a part of the spin as roll, and the reverse."""
    axes = 1 if {type(geometry.object), type(geometry.environment)} == {Line, Plane} else 2
    rolled, spun = np.sum(roll**2, axis=1), spin**2
    return [
        chdtrc(axes, rolled / (variance + normal_variance * spun)),
        chdtrc(1, spun / (variance + normal_variance * rolled)),
    ]


class _Touch(NamedTuple):
    """The touching point (T, 3) with its ``covariance`` (T, 3, 3), and the common normal (T, 3) with the
    variance (T,) of its angle per axis, in the world."""

    point_m: Array
    covariance: Array
    normal: Array
    normal_variance: Array


def _touch(geometry: ContactGeometry, rotation: Array, position_m: Array, variance: Array) -> _Touch | None:
    """The touching point and the common normal; None for edges that are parallel at some time."""
    body, world, back = geometry.object, geometry.environment, rotation.swapaxes(1, 2)
    turn_variance = variance[:, 1]
    of_position = variance[:, 0, None, None] * np.eye(3)
    match body, world:
        case Plane(), Plane(normal):
            return _Touch(position_m, 0.0 * of_position, *_constant(normal, _tilt(world), len(rotation)))
        case ((Point() | Line()), Plane(normal)):
            arm = rotation @ body.point_m
            levers = cross_matrix(arm)
            of_turn = turn_variance[:, None, None] * levers @ levers.swapaxes(1, 2)
            covariance = rotation @ _spread(body) @ back + of_turn
            return _Touch(arm + position_m, covariance, *_constant(normal, _tilt(world), len(rotation)))
        case Plane(normal), (Point() | Line()):
            point_m = np.broadcast_to(world.point_m, position_m.shape)
            return _Touch(
                point_m, of_position + _spread(world), rotation @ normal, turn_variance + _tilt(body)
            )
        case Line(), Line():
            along, start_m = rotation @ body.direction, rotation @ body.point_m + position_m
            normals = cross(along, world.direction)
            sine = np.linalg.norm(normals, axis=1)
            if sine.min() < PARALLEL:
                return None
            to_world_m = world.point_m - start_m
            share = dot(cross(to_world_m, world.direction), normals) / sine**2
            covariance = of_position + rotation @ _spread(body) @ back + _spread(world)
            tilt = (turn_variance + _tilt(body) + _tilt(world)) / sine**2
            return _Touch(start_m + share[:, None] * along, covariance, normals / sine[:, None], tilt)
    raise ValueError("no contact has such elements")


def _constant(normal: Array, tilt: float, ticks: int) -> tuple[Array, Array]:
    """A constant normal and its variance, repeated for all ticks."""
    return np.tile(normal, (ticks, 1)), np.full(ticks, tilt)


def _over(geometry: ContactGeometry, rotation: Array, slip: Array) -> Array:
    """Speeds (T, 2) of the touching point over the elements of object and surroundings, from the slip."""
    body, world, speed = geometry.object, geometry.environment, np.linalg.norm(slip, axis=1)
    if isinstance(body, Line) and isinstance(world, Line):
        axes = np.stack([-(rotation @ body.direction), np.broadcast_to(world.direction, slip.shape)], axis=2)
        return np.asarray(np.abs(np.einsum("tai,ti->ta", np.linalg.pinv(axes), slip)))
    is_on_body = isinstance(body, Plane) and not isinstance(world, Plane)
    return np.outer(speed, [is_on_body, not is_on_body])


def _spread(element: Line | Point) -> Array:
    """Covariance (3, 3) of an element's point, zero if it is unknown."""
    return np.asarray(_covariance(element)[-3:, -3:])


def _tilt(element: Line | Plane) -> float:
    """Variance of the angle of a normal or direction, the mean of both axes; zero if it is unknown."""
    return float(np.trace(_covariance(element)[:3, :3])) / 2.0


def _covariance(element: Element) -> Array:
    """Covariance of an element, zero if it is unknown."""
    covariance = element.covariance
    return np.zeros((6, 6)) if covariance is None or not np.isfinite(covariance).all() else covariance


_LOG_JERK: Final = (-25.0, 15.0)
"""Range of the log strength of jerk (noise variances per tick^5): from a parabola to independent ticks."""


def smooth_rates(time_s: Array, values: Array, variance: Array) -> tuple[Array, Array]:
    """Rates (T, 3) of smooth vectors (T, 3) measured with noise of ``variance`` (T,) per axis, and the
    variances (T,) of the rates per axis.

    The vectors move with constant acceleration, disturbed by white jerk as in the free-motion model
    (docs/theory.md, T18), here in all ticks together (a Rauch-Tung-Striebel smoother in information form).
    The strength of the jerk has the maximum likelihood.
    """
    unit_s, unit = float(np.median(np.diff(time_s))), float(np.sqrt(np.median(variance)))
    steps, weights = np.diff(time_s) / unit_s, unit**2 / variance
    since = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    parabola = polyfit(since, values, 2)  # has no jerk; subtracted, so that sums of squares keep their digits
    scaled = (values - polyval(since, parabola).T) / unit
    jerk, right = _information_of_unit_jerk(steps), np.zeros((3 * len(scaled), 3))
    right[0::3] = weights[:, None] * scaled

    def factor(log_jerk: float) -> Array:
        bands = jerk * np.exp(-log_jerk)
        bands[0, 0::3] += weights
        return np.asarray(cholesky_banded(bands, lower=True))

    def loss(log_jerk: float) -> float:
        root = factor(log_jerk)
        explained = np.sum(right * cho_solve_banded((root, True), right))
        return float(3 * (3 * len(steps) * log_jerk + 2 * np.log(root[0]).sum()) - explained)

    root = factor(minimize_scalar(loss, bounds=_LOG_JERK, method="bounded", options={"xatol": 0.1}).x)
    rates = cho_solve_banded((root, True), right)[1::3]
    spread = _marginal_covariances(root)[:, 1, 1]
    slope = polyval(since, polyder(parabola)).T / (time_s[-1] - time_s[0])
    return slope + rates * unit / unit_s, spread * (unit / unit_s) ** 2


def _marginal_covariances(root: Array) -> Array:
    """Covariance (T, 3, 3) of each tick, from the banded Cholesky factor (6, 3 T) of the information, by a
    recursion from the last tick to the first, in memory and time proportional to T."""
    ticks = root.shape[1] // 3
    diagonal, below = np.zeros((ticks, 3, 3)), np.zeros((ticks, 3, 3))  # blocks (3, 3) of the factor
    for row in range(3):
        for column in range(3):
            if row >= column:
                diagonal[:, row, column] = root[row - column, column::3]
            below[:, row, column] = root[3 + row - column, column::3]
    inverse = np.linalg.inv(diagonal)
    covariance, onto = inverse.swapaxes(1, 2) @ inverse, below @ inverse
    for tick in range(ticks - 2, -1, -1):
        covariance[tick] += onto[tick].T @ covariance[tick + 1] @ onto[tick]
    return np.asarray(covariance)


def _information_of_unit_jerk(steps: Array) -> Array:
    """Bands (6, 3 T), in lower form, of the information of value, rate and acceleration in all ticks, if
    white jerk of strength 1 acts for ``steps`` (T - 1,) between them."""
    h, ones, zeros = steps, np.ones(len(steps)), np.zeros(len(steps))
    along = np.moveaxis(np.array([[ones, h, h**2 / 2], [zeros, ones, h], [zeros, zeros, ones]]), 2, 0)
    rows = [[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]]
    information = np.linalg.inv(np.moveaxis(np.array(rows), 2, 0))
    cross = -information @ along
    diagonal = np.zeros((len(steps) + 1, 3, 3))
    diagonal[1:] += information
    diagonal[:-1] -= along.swapaxes(1, 2) @ cross
    bands = np.zeros((6, 3 * len(diagonal)))
    for row in range(3):
        for column in range(3):
            if row >= column:
                bands[row - column, column::3] = diagonal[:, row, column]
            bands[3 + row - column, column::3][:-1] = cross[:, row, column]
    return bands
