"""Data association of two estimated elements, and the fusion of those that are the same (docs/theory.md,
T28)."""

from dataclasses import replace
from math import inf, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry import linalg
from contact_tracker.geometry.elements import Element, Line, Plane, Point, by_foot, numbers
from contact_tracker.geometry.vectors import EYE, sphere_tangent, unit

Array = NDArray[np.float64]

SAME: Final = 4.0
"""Gate in standard deviations within which two estimates may be of one element."""
VAGUER: Final = 2.0
"""The earlier estimate is kept in a direction if the later one's standard deviation is this many times
larger."""
_LOST: Final = 1e-12
"""Eigenvalues below this share of the largest are rounding errors."""


def is_same_element(first: Element, second: Element) -> bool:
    """Whether two elements of one kind differ by no more than their covariances allow."""
    return mahalanobis(first, second) <= SAME


def mahalanobis(first: Element, second: Element) -> float:
    """Distance of two elements of one kind in standard deviations of their difference.

    Lines may have other points and opposite directions. Normals point out of the bodies, so planes with
    opposite normals are infinitely far apart.
    """
    if isinstance(first, Plane) and isinstance(second, Plane) and first.normal @ second.normal < 0.0:
        return inf
    first, second = _better_first(first, second)
    free = _free(first)
    off = free.T @ (numbers(first) - numbers(second))
    information = _inverse(_along(free, first) + _along(free, second))
    return sqrt(max(float(off @ information @ off), 0.0))


def distance_of_planes_m(first: Plane, second: Plane) -> float:
    """Distance of two planes, without regard to the senses of their normals, where they are known best."""
    assert first.covariance is not None
    assert second.covariance is not None
    sense = np.sign(first.normal @ second.normal) or 1.0
    covariance = first.covariance + second.covariance  # it is the same for the opposite normal
    place = np.linalg.pinv(covariance[:3, :3], hermitian=True) @ covariance[:3, 3]
    off = (first.normal - sense * second.normal) @ place - (first.offset_m - sense * second.offset_m)
    return abs(float(off))


def fuse(later: Element, earlier: Element) -> Element:
    """Fuse two estimates of one element whose correlation is unknown.

    The later estimate may have assumed the earlier one, so information must not be added. Along each joint
    eigenvector of the covariances the later one is kept, unless the earlier one is far more certain (as in
    ellipsoidal intersection: Sijs, Lazar and van den Bosch, ACC 2010). The result has the point and the sense
    of direction of the later line. Neither covariance may be zero in a free direction.
    """
    first, second = _better_first(later, earlier)
    free = _free(first)
    ours, theirs = _along(free, first), _along(free, second)
    # shares: of the variance of both, that of the second
    share, eigenvectors = linalg.eigenvectors(theirs, ours + theirs)
    was, now = (share, 1.0 - share) if first is later else (1.0 - share, share)
    of_second = (now > VAGUER**2 * was) == (first is later)
    back = free @ (ours + theirs) @ eigenvectors
    off = back @ np.where(of_second, eigenvectors.T @ (free.T @ (numbers(second) - numbers(first))), 0.0)
    covariance = (back * np.where(of_second, share, 1.0 - share)) @ back.T
    covariance = 0.5 * (covariance + covariance.T)
    match first:
        case Point(point_m):
            return replace(first, point_m=point_m + off, covariance=covariance)
        case Plane(normal, offset_m):
            normal = _turned(normal, off[:3])
            return replace(first, normal=normal, offset_m=offset_m + float(off[3]), covariance=covariance)
        case Line(direction, point_m):
            direction = _turned(direction, off[:3])
            found = replace(first, direction=direction, point_m=point_m + off[3:], covariance=covariance)
            return _aligned(found, later)


def _turned(direction: Array, by: Array) -> Array:
    """A unit vector turned such that its component perpendicular to ``direction`` is ``by`` (3,)."""
    return unit(direction * np.sqrt(max(1.0 - float(by @ by), 0.0)) + by)


def _better_first(first: Element, second: Element) -> tuple[Element, Element]:
    """The one with the more certain direction (or place) first, the other aligned to it, so that the change
    between them is nearly linear."""
    assert first.covariance is not None
    assert second.covariance is not None
    if second.covariance[:3, :3].trace() < first.covariance[:3, :3].trace():
        first, second = second, first
    return first, _aligned(second, first)


def _free(element: Element) -> Array:
    """(S, P) free directions of an element's parameters; a line's point moves only across the line."""
    match element:
        case Point():
            return EYE
        case Plane(normal):
            free = np.zeros((4, 3))
            free[:3, :2], free[3, 2] = sphere_tangent(normal), 1.0
        case Line(direction):
            free = np.zeros((6, 4))
            free[:3, :2] = free[3:, 2:] = sphere_tangent(direction)
    return free


def _along(free: Array, element: Element) -> Array:
    assert element.covariance is not None
    return np.asarray(free.T @ element.covariance @ free)


def _inverse(covariance: Array) -> Array:
    """Information matrix; zero along directions lost in rounding."""
    sd = np.sqrt(covariance.diagonal())
    eigenvalues, eigenvectors = linalg.eigenvectors(covariance / (sd[:, None] * sd))
    eigenvectors = (eigenvectors / sd[:, None])[:, eigenvalues > _LOST * eigenvalues[-1]]
    return np.asarray((eigenvectors / eigenvalues[eigenvalues > _LOST * eigenvalues[-1]]) @ eigenvectors.T)


def _aligned(element: Element, like: Element) -> Element:
    """A line with its point nearest to that of ``like``, and with the same sense of direction."""
    if not isinstance(like, Line):
        return element
    near = by_foot(element, like.point_m)
    assert isinstance(near, Line)
    assert near.covariance is not None
    if near.direction @ like.direction >= 0.0:
        return near
    flip = np.repeat([-1.0, 1.0], 3)
    return replace(near, direction=-near.direction, covariance=flip[:, None] * near.covariance * flip)
