"""Whether two estimated elements may be the same (docs/theory.md, T28)."""

from dataclasses import replace
from math import inf, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry import linalg
from contact_tracker.geometry.elements import Element, Line, Plane, Point, by_foot, numbers
from contact_tracker.map.elements import free_directions

Array = NDArray[np.float64]

SAME: Final = 4.0
"""Gate in standard deviations within which two estimates may be of one element."""
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


def _better_first(first: Element, second: Element) -> tuple[Element, Element]:
    """The one with the more certain direction (or place) first, the other aligned to it, so that the change
    between them is nearly linear."""
    assert first.covariance is not None
    assert second.covariance is not None
    if second.covariance[:3, :3].trace() < first.covariance[:3, :3].trace():
        first, second = second, first
    return first, _aligned(second, first)


def _free(element: Element) -> Array:
    match element:
        case Point():
            return free_directions("v", element.point_m)
        case Plane(normal):
            return free_directions("f", normal)
        case Line(direction):
            return free_directions("e", direction)


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
