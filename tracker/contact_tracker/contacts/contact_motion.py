"""How the object moves at its contact: whether it slides, rolls, pivots or rests, by the speed of the
touching point and its standard deviation.

Two bodies that touch at a point slide with the relative velocity of their material there, roll by the part of
their relative angular velocity in the common tangent plane, and pivot by that about the common normal
(Johnson, Contact Mechanics, 1985, section 1.2). Each is decided by significance against the noise.
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

from contact_tracker.contacts.task_frame import PARALLEL
from contact_tracker.geometry.elements import Array, ContactGeometry, Element, Line, Plane, Point
from contact_tracker.geometry.linalg import cross, cross_matrix, dot, sphere_tangent
from contact_tracker.geometry.rotation import between, matrices, rotation_vectors

SIGNIFICANCE: Final = 0.01
"""Probability that a segment at rest is said to move in one of the ways, over all of its ticks."""
KINDS: Final = ("slides", "rolls", "pivots")
RESTS, STICK_SLIP = "rests", "sticks and slips"
MEANS: Final = ("slip_m_per_s", "slip_sd_m_per_s", "roll_rad_per_s", "spin_rad_per_s", "turn_sd_rad_per_s")
"""Names of the means of a segment."""
_FEWEST: Final = 4
"""Ticks from which velocity and jerk can be told from noise."""
_STILL: Final = 0.25
"""Median p-value of the slip above which the object sticks: it is 0.5 without slip."""


@dataclass(frozen=True, eq=False)
class ContactMotion:
    """The relative motion at the touching point in T ticks of a segment.

    The point is the touching vertex, the crossing of two edges, the point of an edge nearest to the tracked
    point (docs/theory.md, 2.3), and of two faces the tracked point itself.

    Parameters
    ----------
    stamp_ns : (T,) of the ticks.
    slip_m_per_s : (T, 3) velocity of the object's material at the point, in the tangent plane, in the world.
    slip_sd_m_per_s : (T,) its standard deviation per axis, with that of the elements.
    over_m_per_s : (T, 2) speed of the touching point over the object's element and over the surroundings'.
    roll_rad_per_s, spin_rad_per_s : (T,) angular speed about axes in the tangent plane, and about the normal.
    turn_sd_rad_per_s : (T,) standard deviation of the angular velocity per axis.
    p_value : (T, 3) probability of as much slip, roll and spin in a tick by noise alone.
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
        return ContactMotion(*(getattr(self, one.name)[rows] for one in fields(self)))

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
        """What the object does in the segment: ``slides`` or ``sticks and slips``, ``rolls``, ``pivots``, or
        ``rests`` if none of them is significant. More noise leaves more of them out."""
        found = [KINDS[column] for column in np.flatnonzero(self.is_significant.any(axis=0))]
        if self._slips_again:
            found[0] = STICK_SLIP
        return tuple(found) or (RESTS,)

    @property
    def means(self) -> dict[str, float]:
        """Root mean squares over the ticks, by ``MEANS``."""
        turns = self.roll_rad_per_s, self.spin_rad_per_s, self.turn_sd_rad_per_s
        values = (self.speed_m_per_s, self.slip_sd_m_per_s, *turns)
        squares = (np.mean(np.square(one)) for one in values)
        return {name: float(np.sqrt(square)) for name, square in zip(MEANS, squares, strict=True)}

    @property
    def _slips_again(self) -> bool:
        """Whether the object begins to slide at least twice after it has stuck: while its usual sliding would
        be significant, and most ticks have no more slip than noise has.

        Where a slide turns round, half of the ticks without significant slip have a p-value below 0.1.
        """
        slides, limit = self.is_significant[:, 0], chdtri(2, SIGNIFICANCE / max(len(self), 1))
        edges = np.flatnonzero(np.diff(slides)) + 1
        usual = np.median(self.speed_m_per_s[slides]) if slides.any() else 0.0
        again = 0
        for first, end in pairwise([0, *edges]):
            detectable = np.median(self.slip_sd_m_per_s[first:end]) * np.sqrt(limit) < usual
            is_still = np.median(self.p_value[first:end, 0]) > _STILL and end - first >= _FEWEST
            again += bool(not slides[first] and detectable and is_still)
        return again >= 2


def contact_motion(
    geometry: ContactGeometry,
    stamp_ns: NDArray[np.int64],
    time_s: Array,
    quat_xyzw: Array,
    position_m: Array,
    variance: Array,
) -> ContactMotion | None:
    """The motion at a contact in T ticks; None for few ticks, or edges that are parallel.

    Parameters
    ----------
    geometry : the elements, in frames whose origins are the tracked point of the body and any of the world.
    time_s, quat_xyzw, position_m : (T,), (T, 4), (T, 3) of the ticks' mean poses, the position that of the
        tracked point, whose noise is independent of that of the orientation.
    variance : (T, 2) of their noise per axis (m^2, rad^2).
    """
    if len(time_s) < _FEWEST:
        return None
    rotation = matrices(quat_xyzw)
    touch = _touch(geometry, rotation, position_m, variance)
    if touch is None:
        return None
    steps = rotation_vectors(between(quat_xyzw[:-1], quat_xyzw[1:]))  # in the axes of the pose before
    turned = np.cumsum(np.einsum("tij,tj->ti", rotation[:-1], steps), axis=0)
    velocity, v_variance = smooth_rates(time_s, position_m, variance[:, 0])
    angular, w_variance = smooth_rates(time_s, np.vstack([np.zeros(3), turned]), variance[:, 1])

    arm, tangents = touch.point_m - position_m, sphere_tangent(touch.normal)  # (T, 3), (T, 3, 2)
    slip = np.einsum("tia,ti->ta", tangents, velocity + cross(angular, arm))
    per_turn, per_shift = (np.einsum("tij,tja->tia", cross_matrix(one), tangents) for one in (arm, angular))
    slip_covariance = (
        v_variance[:, None, None] * np.eye(2)
        + w_variance[:, None, None] * np.einsum("tia,tib->tab", per_turn, per_turn)
        + np.einsum("tia,tij,tjb->tab", per_shift, touch.covariance, per_shift)
    )
    roll = np.einsum("tia,ti->ta", tangents, angular)
    spin = dot(touch.normal, angular)
    if isinstance(geometry.object, Plane) and isinstance(geometry.environment, Plane):
        roll = np.zeros_like(roll)  # faces that touch cannot
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
    """Of the roll, which has one axis on an edge that touches a face, and two at a point; and of the spin. A
    turned normal takes a part of one for the other."""
    axes = 1 if {type(geometry.object), type(geometry.environment)} == {Line, Plane} else 2
    rolled, spun = np.sum(roll**2, axis=1), spin**2
    return [
        chdtrc(axes, rolled / (variance + normal_variance * spun)),
        chdtrc(1, spun / (variance + normal_variance * rolled)),
    ]


class _Touch(NamedTuple):
    """The touching point (T, 3) and its ``covariance`` (T, 3, 3), and the common normal (T, 3) with the
    variance per axis (T,) of its angle, in the world."""

    point_m: Array
    covariance: Array
    normal: Array
    normal_variance: Array


def _touch(geometry: ContactGeometry, rotation: Array, position_m: Array, variance: Array) -> _Touch | None:
    """Where the elements touch; None for edges that are parallel at some time."""
    ours, theirs, back = geometry.object, geometry.environment, rotation.swapaxes(1, 2)
    turn_variance = variance[:, 1]
    of_position = variance[:, 0, None, None] * np.eye(3)
    match ours, theirs:
        case Plane(), Plane(normal):
            return _Touch(position_m, 0.0 * of_position, *_constant(normal, _tilt(theirs), len(rotation)))
        case ((Point() | Line()), Plane(normal)):
            arm = rotation @ ours.point_m
            levers = cross_matrix(arm)
            of_turn = turn_variance[:, None, None] * levers @ levers.swapaxes(1, 2)
            covariance = rotation @ _spread(ours) @ back + of_turn
            return _Touch(arm + position_m, covariance, *_constant(normal, _tilt(theirs), len(rotation)))
        case Plane(normal), (Point() | Line()):
            where = np.broadcast_to(theirs.point_m, position_m.shape)
            return _Touch(
                where, of_position + _spread(theirs), rotation @ normal, turn_variance + _tilt(ours)
            )
        case Line(), Line():
            along, start_m = rotation @ ours.direction, rotation @ ours.point_m + position_m
            normals = cross(along, theirs.direction)
            sine = np.linalg.norm(normals, axis=1)
            if sine.min() < PARALLEL:
                return None
            to_theirs = theirs.point_m - start_m
            share = dot(cross(to_theirs, theirs.direction), normals) / sine**2
            covariance = of_position + rotation @ _spread(ours) @ back + _spread(theirs)
            tilt = (turn_variance + _tilt(ours) + _tilt(theirs)) / sine**2
            return _Touch(start_m + share[:, None] * along, covariance, normals / sine[:, None], tilt)
    raise ValueError("no contact has such elements")


def _constant(normal: Array, tilt: float, ticks: int) -> tuple[Array, Array]:
    return np.tile(normal, (ticks, 1)), np.full(ticks, tilt)


def _over(geometry: ContactGeometry, rotation: Array, slip: Array) -> Array:
    """Speeds (T, 2) of the touching point over the object's element and the surroundings', by the slip."""
    ours, theirs, speed = geometry.object, geometry.environment, np.linalg.norm(slip, axis=1)
    if isinstance(ours, Line) and isinstance(theirs, Line):
        axes = np.stack([-(rotation @ ours.direction), np.broadcast_to(theirs.direction, slip.shape)], axis=2)
        return np.asarray(np.abs(np.einsum("tai,ti->ta", np.linalg.pinv(axes), slip)))
    is_ours = isinstance(ours, Plane) and not isinstance(theirs, Plane)
    return np.outer(speed, [is_ours, not is_ours])


def _spread(element: Line | Point) -> Array:
    """Covariance (3, 3) of an element's point, zero if it is unknown."""
    return np.asarray(_covariance(element)[-3:, -3:])


def _tilt(element: Line | Plane) -> float:
    """Variance of the angle of a normal or direction, the mean of both axes; zero if it is unknown."""
    return float(np.trace(_covariance(element)[:3, :3])) / 2.0


def _covariance(element: Element) -> Array:
    found = element.covariance
    return np.zeros((6, 6)) if found is None or not np.isfinite(found).all() else found


_LOG_JERK: Final = (-25.0, 15.0)
"""Log of the searched strengths of jerk, in noise variances per tick^5: from a parabola through all ticks to
ticks that do not constrain each other."""


def smooth_rates(time_s: Array, values: Array, variance: Array) -> tuple[Array, Array]:
    """Rates (T, 3) of smooth vectors (T, 3) that are measured with a noise ``variance`` (T,) per axis, and
    their variances (T,) per axis.

    The vectors move with constant acceleration, disturbed by white jerk as in the free-motion model
    (docs/theory.md, T18), here in all ticks together (a Rauch-Tung-Striebel smoother in information form).
    The strength of the jerk is the most probable one.
    """
    unit_s, unit = float(np.median(np.diff(time_s))), float(np.sqrt(np.median(variance)))
    steps, weights = np.diff(time_s) / unit_s, unit**2 / variance
    since = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    parabola = polyfit(since, values, 2)  # which costs no jerk: without it, sums of squares keep their digits
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
    """Covariance (T, 3, 3) of each tick, from the Cholesky factor (6, 3 T) of the information in bands: a
    recursion from the last tick to the first, in memory and time proportional to T."""
    ticks = root.shape[1] // 3
    own, next_ = np.zeros((ticks, 3, 3)), np.zeros((ticks, 3, 3))
    for row in range(3):
        for column in range(3):
            if row >= column:
                own[:, row, column] = root[row - column, column::3]
            next_[:, row, column] = root[3 + row - column, column::3]
    inverse = np.linalg.inv(own)
    covariance, onto = inverse.swapaxes(1, 2) @ inverse, next_ @ inverse
    for tick in range(ticks - 2, -1, -1):
        covariance[tick] += onto[tick].T @ covariance[tick + 1] @ onto[tick]
    return np.asarray(covariance)


def _information_of_unit_jerk(steps: Array) -> Array:
    """Bands (6, 3 T) of the information of value, rate and acceleration in all ticks (lower form), by white
    jerk of strength one between them, ``steps`` (T - 1,)."""
    h, one, zero = steps, np.ones(len(steps)), np.zeros(len(steps))
    along = np.moveaxis(np.array([[one, h, h**2 / 2], [zero, one, h], [zero, zero, one]]), 2, 0)
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
