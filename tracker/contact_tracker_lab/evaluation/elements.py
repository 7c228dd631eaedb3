"""Errors of a found plane, line or point against the true one, without regard to signs, at a given place.

Far from the contact a small angle is a large distance, so distances and covariances are those at a place
given by the caller. ``(n, h)`` and ``(-n, -h)`` are the same plane, ``d`` and ``-d`` the same direction.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcinv, gammaincc

from contact_tracker.geometry.elements import Element, Line, Plane, Point

Array = NDArray[np.float64]

NEGLIGIBLE: Final = 1e-13
"""Directions with less than this share of the largest variance are no degrees of freedom of the element."""


class Deviation(NamedTuple):
    """A normalised error: ``e^T covariance^-1 e`` and its degrees of freedom; nan and 0 where unknown."""

    squared: float
    freedom: int

    @property
    def sd(self) -> float:
        """The number of standard deviations at which a one-dimensional error would be as improbable."""
        if not self.freedom:
            return float("nan")
        tail = float(gammaincc(self.freedom / 2, self.squared / 2))
        # beyond 37 deviations the tail underflows: the Mahalanobis distance instead
        return float(np.sqrt(2) * erfcinv(tail)) if tail > 0 else float(np.sqrt(self.squared))


UNKNOWN: Final = Deviation(float("nan"), 0)


def nearest(element: Element, place: Array) -> Array:
    """The point (3,) of ``element`` nearest to ``place`` (3,)."""
    match element:
        case Plane(normal, offset_m):
            return place - (normal @ place - offset_m) * normal
        case Line(direction, point_m):
            return point_m + direction * (direction @ (place - point_m))
        case Point(point_m):
            return point_m


def distance_m(element: Element, place: Array) -> float:
    """Distance of ``place`` (3,) from ``element``."""
    return float(np.linalg.norm(nearest(element, place) - place))


def angle_rad(found: Element, true: Element) -> float:
    """Angle of normals or directions, 0 to pi/2; nan for points, which have none."""
    match found, true:
        case (Plane(normal=a), Plane(normal=b)) | (Line(direction=a), Line(direction=b)):
            return float(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(a @ b)))
    return float("nan")


def deviation(found: Element, true: Element, place: Array) -> Deviation:
    """Error of ``found`` against its covariance.

    On the element's tangent space: 3 dimensions for planes and points, 4 for lines, fewer where the
    covariance is singular.
    """
    match found, true:
        case Plane(), Plane():
            error, basis = _plane_error(found, true, place)
            shift = np.eye(4)  # offset at `place`: h - n . place
            shift[3, :3] = -place
            return _deviation(found.covariance, basis.T @ shift, error)
        case Line(), Line():
            error, basis = _line_error(found, true)
            return _deviation(found.covariance, basis.T, error)
        case Point(), Point():
            return _deviation(found.covariance, np.eye(3), true.point_m - found.point_m)
    raise TypeError(f"{type(found).__name__} against {type(true).__name__}")


def normal_deviation(found: Plane, true: Plane) -> Deviation:
    """As ``deviation``, of the normal alone: where the offset cannot be determined (f-f)."""
    tangent = _tangent(found.normal)
    covariance = None if found.covariance is None else found.covariance[:3, :3]
    return _deviation(covariance, tangent.T, tangent.T @ _turn(found.normal, true.normal))


def error_at(found: Element, true: Element, place: Array) -> Array:
    """Error in coordinates of ``true``: its two angles (rad), if any, then its distances (m) at ``place``.

    ``place`` lies on ``true``; shapes are (3,) for planes and points, (4,) for lines.
    """
    match found, true:
        case Plane(), Plane():
            return _plane_error(true, found, place)[0]
        case Line(), Line():
            return _line_error(Line(true.direction, place), found)[0]
        case Point(), Point():
            return found.point_m - true.point_m
    raise TypeError(f"{type(found).__name__} against {type(true).__name__}")


def _plane_error(found: Plane, true: Plane, place: Array) -> tuple[Array, Array]:
    sign = np.sign(found.normal @ true.normal) or 1.0
    offset = sign * (true.offset_m - true.normal @ place) - (found.offset_m - found.normal @ place)
    tangent = _tangent(found.normal)
    basis = np.zeros((4, 3))
    basis[:3, :2], basis[3, 2] = tangent, 1.0
    return np.append(tangent.T @ _turn(found.normal, true.normal), offset), basis


def _line_error(found: Line, true: Line) -> tuple[Array, Array]:
    tangent = _tangent(found.direction)
    basis = np.zeros((6, 4))
    basis[:3, :2], basis[3:, 2:] = tangent, tangent
    moved = nearest(true, found.point_m) - found.point_m
    return np.concatenate([tangent.T @ _turn(found.direction, true.direction), tangent.T @ moved]), basis


def _turn(found: Array, true: Array) -> Array:
    """The tangent vector at ``found`` towards the nearer of +-``true``; its norm is the angle."""
    true = true * (np.sign(found @ true) or 1.0)
    across = true - (found @ true) * found
    sine = np.linalg.norm(across)
    return across * (np.arctan2(sine, found @ true) / sine) if sine > 0 else across


def _tangent(direction: Array) -> Array:
    """Two orthonormal columns (3, 2) perpendicular to ``direction``."""
    return np.linalg.svd(direction[None])[2][1:].T


def _deviation(covariance: Array | None, to_tangent: Array, error: Array) -> Deviation:
    if covariance is None or not np.isfinite(covariance).all():
        return UNKNOWN
    variance, axes = np.linalg.eigh(to_tangent @ covariance @ to_tangent.T)
    free = variance > NEGLIGIBLE * variance[-1]
    if not free.any() or variance[-1] <= 0:
        return UNKNOWN
    return Deviation(float(np.sum((axes[:, free].T @ error) ** 2 / variance[free])), int(free.sum()))
