"""Errors of the estimated planes, lines and points, segment by segment.

For f-f, motion determines both normals, but only the difference ``h_env - h_obj`` of the offsets (remark
after eq. 8 of the paper). So unless the map has both offsets, the errors of f-f are those of its normals, and
one distance for the pair: between the estimated and the true plane of motion, at the body's mean position.

Errors of an element do not depend on signs: ``(n, h)`` and ``(-n, -h)`` are the same plane, ``d`` and ``-d``
the same direction. They are taken at a given place: far from the contact a small angle is a large distance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import add
from typing import Final, NamedTuple

import numpy as np
from scipy.special import erfcinv, gammaincc

from contact_tracker.arrays import Array
from contact_tracker.errors import NoTruth
from contact_tracker.geometry.elements import ContactGeometry, Element, Line, Plane, Point, nearest, numbers
from contact_tracker.geometry.linalg import angle_of_lines, sphere_tangent
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker_lab.evaluation.metrics import finite_values

NEGLIGIBLE: Final = 1e-13
"""Directions with a smaller share of the largest variance are no degrees of freedom of the element."""


class Deviation(NamedTuple):
    """A normalised error: ``e^T covariance^-1 e`` and its degrees of freedom; nan and 0 if unknown."""

    squared: float
    freedom: int

    @property
    def sd(self) -> float:
        """Number of standard deviations at which a one-dimensional error would be as improbable."""
        if not self.freedom:
            return float("nan")
        tail = float(gammaincc(self.freedom / 2, self.squared / 2))
        # beyond 37 deviations the tail underflows: the Mahalanobis distance instead
        return float(np.sqrt(2) * erfcinv(tail)) if tail > 0 else float(np.sqrt(self.squared))


UNKNOWN: Final = Deviation(float("nan"), 0)


def distance_m(element: Element, place: Array) -> float:
    """Distance of ``place`` (3,) from ``element``."""
    return float(np.linalg.norm(nearest(element, place) - place))


def angle_rad(estimate: Element, true: Element) -> float:
    """Angle of normals or directions, 0 to pi/2; nan for points."""
    match estimate, true:
        case (Plane(normal=a), Plane(normal=b)) | (Line(direction=a), Line(direction=b)):
            return angle_of_lines(a, b)
    return float("nan")


def deviation(estimate: Element, true: Element, place: Array, of: slice = slice(None)) -> Deviation:
    """Error of ``estimate`` against its covariance.

    On the element's tangent space: 3 dimensions for planes and points, 4 for lines, fewer where the
    covariance is singular. ``of``: these dimensions only, as the first two for the normal of a plane.
    """
    error, to_tangent = (part[of] for part in _error(estimate, true, place))
    if estimate.covariance is None or not np.isfinite(estimate.covariance).all():
        return UNKNOWN
    variance, axes = np.linalg.eigh(to_tangent @ estimate.covariance @ to_tangent.T)
    free = variance > NEGLIGIBLE * variance[-1]
    if not free.any() or variance[-1] <= 0:
        return UNKNOWN
    return Deviation(float(np.sum((axes[:, free].T @ error) ** 2 / variance[free])), int(free.sum()))


def error_at(estimate: Element, true: Element, place: Array) -> Array:
    """Error in coordinates of ``true``: its two angles (rad), if any, then its distances (m) at ``place``.

    ``place`` lies on ``true``; shapes are (3,) for planes and points, (4,) for lines.
    """
    return _error(Line(true.direction, place) if isinstance(true, Line) else true, estimate, place)[0]


def _error(estimate: Element, true: Element, place: Array) -> tuple[Array, Array]:
    """Error (d,) on the tangent space of ``estimate``, the offset of planes at ``place``, and its derivatives
    (d, P) by the parameters of ``estimate``."""
    match estimate, true:
        case Plane(), Plane():
            sign = np.sign(estimate.normal @ true.normal) or 1.0
            height_m = estimate.offset_m - estimate.normal @ place
            offset_m = sign * (true.offset_m - true.normal @ place) - height_m
            tangent = sphere_tangent(estimate.normal)
            to_tangent = np.zeros((3, 4))
            to_tangent[:2, :3], to_tangent[2] = tangent.T, [*-place, 1.0]
            return np.append(tangent.T @ _turn(estimate.normal, true.normal), offset_m), to_tangent
        case Line(), Line():
            tangent = sphere_tangent(estimate.direction)
            moved_m = nearest(true, estimate.point_m) - estimate.point_m
            error = tangent.T @ _turn(estimate.direction, true.direction), tangent.T @ moved_m
            return np.concatenate(error), np.kron(np.eye(2), tangent.T).astype(float)
        case Point(), Point():
            return true.point_m - estimate.point_m, np.eye(3)
    raise TypeError(f"{type(estimate).__name__} against {type(true).__name__}")


def _turn(estimate: Array, true: Array) -> Array:
    """The tangent vector at ``estimate`` towards the nearer of +-``true``; its norm is the angle."""
    true = true * (np.sign(estimate @ true) or 1.0)
    across = true - (estimate @ true) * estimate
    sine = np.linalg.norm(across)
    return across * (np.arctan2(sine, estimate @ true) / sine) if sine > 0 else across


KIND: Final = {"f": Plane, "e": Line, "v": Point}
SIDES: Final = ("object", "environment")


@dataclass(frozen=True)
class ElementError:
    """Errors of one estimated element; nan if a figure does not apply or is unknown.

    ``angle_deg``: between normals or directions; ``distance_mm``: from the estimate to the point of the true
    element nearest to the contact; ``deviation``: of the error by the estimate's covariance.
    """

    contact: Contact
    side: str
    kind: str
    angle_deg: float
    distance_mm: float
    deviation: Deviation


@dataclass(frozen=True)
class GeometryErrors:
    """Errors of one recording, or (``a + b``) of several.

    ``true_segments``: number of segments with true geometry, of which ``found_segments`` have an estimate.
    """

    rows: tuple[ElementError, ...]
    true_segments: int
    found_segments: int

    def __add__(self, errors: "GeometryErrors") -> "GeometryErrors":
        return GeometryErrors(*map(add, vars(self).values(), vars(errors).values()))

    def of_kind(self, *kinds: str) -> "GeometryErrors":
        """Only the errors of ``plane``, ``line`` or ``point``."""
        return replace(self, rows=tuple(row for row in self.rows if row.kind in kinds))

    @property
    def angle_deg(self) -> Array:
        return finite_values(np.array([row.angle_deg for row in self.rows], float))

    @property
    def distance_mm(self) -> Array:
        return finite_values(np.array([row.distance_mm for row in self.rows], float))

    @property
    def within_3_sd(self) -> float:
        """Share of the elements with a covariance that lie within 3 standard deviations of the truth."""
        return float(np.mean(self._sd <= 3)) if len(self._sd) else float("nan")

    @property
    def median_sd(self) -> float:
        """Median error in standard deviations; 0.67 for right covariances, less for too large ones."""
        return float(np.median(self._sd)) if len(self._sd) else float("nan")

    @property
    def _sd(self) -> Array:
        return finite_values(np.array([row.deviation.sd for row in self.rows], float))


def geometry_errors(poses: Poses, truth: Truth, segments: Sequence[Segment]) -> GeometryErrors:
    """Compare each true segment with the estimated one of the same contact that overlaps it most.

    Raises
    ------
    NoTruth
        The truth's elements are not of the kinds that its contact has.
    """
    rows: list[ElementError] = []
    true_segments = found_segments = 0
    for true in _true_segments(truth):
        inside = poses[(poses.stamp_ns >= true.start_ns) & (poses.stamp_ns <= true.end_ns)]
        if true.contact is None or true.geometry is None or not len(inside):
            continue
        true_segments += 1
        overlaps_ns = [
            min(segment.end_ns, true.end_ns) - max(segment.start_ns, true.start_ns)
            if segment.contact is true.contact
            else -1
            for segment in segments
        ]
        longest_ns = max(overlaps_ns, default=-1)
        geometry = segments[overlaps_ns.index(longest_ns)].geometry if longest_ns >= 0 else None
        if geometry is not None:
            found_segments += 1
            rows += _compare(true.contact, geometry, true.geometry, inside)
    return GeometryErrors(tuple(rows), true_segments, found_segments)


def _true_segments(truth: Truth) -> list[TruthInterval]:
    """Intervals with geometry, joined where the same elements remain in contact (at rest, then moving)."""
    joined: list[TruthInterval] = []
    previous: TruthInterval | None = None
    for interval in truth.intervals:
        if interval.contact is not None and interval.geometry is not None:
            kinds = [KIND.get(kind) for kind in interval.contact.value.split("-")]
            if [type(interval.geometry.object), type(interval.geometry.environment)] != kinds:
                elements = f"the true elements at {interval.start_ns} ns"
                raise NoTruth(f"{elements} are not those of {interval.contact.value}")
            start_ns = interval.start_ns
            if previous is not None and _is_same(previous, interval):
                start_ns = joined.pop().start_ns
            joined.append(replace(interval, start_ns=start_ns))
        previous = interval
    return joined


def _is_same(previous: TruthInterval, interval: TruthInterval) -> bool:
    """Whether both have the same contact between the same elements."""
    if previous.contact != interval.contact or previous.geometry is None or interval.geometry is None:
        return False
    first, second = previous.geometry, interval.geometry
    return is_same(first.object, second.object) and is_same(first.environment, second.environment)


def is_same(first: Element, second: Element) -> bool:
    """Whether two exact elements of one kind are equal up to rounding."""
    is_apart = distance_m(first, nearest(second, np.zeros(3))) > 1e-6
    return not is_apart and not angle_rad(first, second) > 1e-6  # nan for points


def _compare(
    contact: Contact, geometry: ContactGeometry, true: ContactGeometry, poses: Poses
) -> list[ElementError]:
    is_open = any(geometry.has_open_offset)
    pairs = (geometry.object, true.object), (geometry.environment, true.environment)
    rows = [
        ElementError(
            contact,
            side,
            type(true_element).__name__.lower(),
            float(np.degrees(angle_rad(estimate, true_element))),
            1e3 * distance_m(estimate, place),
            deviation(estimate, true_element, place, slice(2 if is_open else None)),
        )
        for side, (estimate, true_element), place in zip(SIDES, pairs, places(true, poses), strict=True)
    ]
    if is_open:
        off_m = abs(_height_m(geometry, true, poses) - _height_m(true, true, poses))
        rows = [replace(rows[0], distance_mm=float("nan")), replace(rows[1], distance_mm=1e3 * off_m)]
    return rows


def _height_m(pair: ContactGeometry, true: ContactGeometry, poses: Poses) -> float:
    """Distance of the body's mean position from the plane of motion, n . t + h_obj = h_env, along the true
    normal."""
    (*body, body_m), (*world, world_m) = numbers(pair.object), numbers(pair.environment)
    sign = np.sign(np.mean(poses.rotation @ body, axis=0) @ world)
    upward = np.sign(world @ numbers(true.environment)[:3]) or 1.0
    return float(upward * (world @ poses.position_m.mean(axis=0) - (world_m - sign * body_m)))


def places(true: ContactGeometry, poses: Poses) -> tuple[Array, Array]:
    """Points (3,) of contact on the object's true element (body frame) and on the environment's (world): the
    mean position of the other element, projected."""
    rotation, position = poses.rotation, poses.position_m
    on_object = nearest(true.object, np.zeros(3))
    on_environment = nearest(true.environment, position.mean(axis=0))
    partner_in_world = np.mean(rotation @ on_object + position, axis=0)
    partner_in_body = np.mean(np.einsum("nji,nj->ni", rotation, on_environment - position), axis=0)
    return nearest(true.object, partner_in_body), nearest(true.environment, partner_in_world)
