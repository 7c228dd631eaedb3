"""Whether two elements that were found are one and the same, found twice (docs/theory.md, T28)."""

from dataclasses import replace
from typing import Final

import numpy as np

from contact_tracker.geometry import Element, Line, by_foot, numbers

SAME: Final = 4.0
"""Standard deviations by which what was found of one element may differ."""
_UNABLE: Final = 1e-9
"""Variance below this share of the largest is a way in which an element cannot move."""


def are_same(first: Element, second: Element) -> bool:
    """Whether two elements of one kind differ by no more than their covariances allow.

    Lines may be told by other points and by the opposite direction; normals point out of the bodies, so that
    planes that look the other way are others.
    """
    if isinstance(first, Line):
        second = _told_alike(second, first)
    assert first.covariance is not None
    assert second.covariance is not None
    information = np.linalg.pinv(first.covariance + second.covariance, _UNABLE, hermitian=True)
    off = numbers(first) - numbers(second)
    return bool(off @ information @ off <= SAME**2)


def _told_alike(line: Element, like: Line) -> Element:
    """A line by its point nearest to that of another, and by the direction nearer to the other's."""
    near = by_foot(line, like.point_m)
    assert isinstance(near, Line)
    assert near.covariance is not None
    if near.direction @ like.direction >= 0.0:
        return near
    flip = np.repeat([-1.0, 1.0], 3)
    return replace(near, direction=-near.direction, covariance=flip[:, None] * near.covariance * flip)
