"""Test of the repeatability of elements: whether estimates of what seems to be one element, in several
segments, differ by no more than their covariances allow. With systematic errors of the poses they do not."""

from collections.abc import Iterable
from math import degrees, inf, pi
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Element, Line, Plane, Point
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.landmarks.association import mahalanobis
from contact_tracker.tracking.belief import Segment

Array = NDArray[np.float64]

NEAR_RAD: Final = 0.035
NEAR_M: Final = 0.008
"""Estimates that are closer than this are taken to be of one element."""
SIGNIFICANT: Final = 6.0
"""Difference in standard deviations that noise hardly causes."""
MOST_ELEMENTS: Final = 40
"""Number of the latest elements of each side with which a new one is compared."""
_WORDS: Final = {Plane: "face", Line: "edge", Point: "vertex"}
_SIDES: Final = ("object", "surroundings")


class Estimate(NamedTuple):
    """An element in the segment from ``start_ns``, of the object (``side`` 0) or of the surroundings (1)."""

    side: int
    element: Element
    start_ns: int


class Difference(NamedTuple):
    """Difference of two estimates: in standard deviations, as an angle (0 for points) and as a distance (0
    where it is not known)."""

    sigmas: float
    angle_rad: float
    distance_m: float


class Repeatability(NamedTuple):
    """The ``latest`` estimates; how many pairs are ``near`` each other, how many of these are ``apart`` by
    more than noise, and the ``worst`` pair. ``origin_ns`` is the start of the first segment."""

    origin_ns: int = 0
    latest: tuple[Estimate, ...] = ()
    near: int = 0
    apart: int = 0
    worst: tuple[Estimate, Estimate, Difference] | None = None


def advance(found: Repeatability, segments: Iterable[Segment]) -> Repeatability:
    """Advance by segments in order of time."""
    for segment in segments:
        if not found.origin_ns:
            found = found._replace(origin_ns=segment.start_ns)
        if segment.geometry is None:
            continue
        for side, element in enumerate((segment.geometry.object, segment.geometry.environment)):
            if element.covariance is not None and element.name is None:  # names are of given elements
                found = _compared(found, Estimate(side, element, segment.start_ns))
    return found


def findings(found: Repeatability) -> tuple[Finding, ...]:
    """The finding that poses may have systematic errors, if estimates differ by more than noise allows."""
    if found.worst is None:
        return ()
    first, second, by = found.worst
    first_s, second_s = ((one.start_ns - found.origin_ns) * 1e-9 for one in (first, second))
    sizes = [f"{degrees(by.angle_rad):.2g} deg"] * (by.angle_rad > 0.0)
    sizes += [f"{1e3 * by.distance_m:.2g} mm"] * (by.distance_m > 0.0)
    what = f"the {_WORDS[type(first.element)]} of the {_SIDES[first.side]}"
    text = (
        f"elements that seem to be the same differ by more than noise allows ({found.apart} of {found.near} "
        f"pairs; {what} from {first_s:.2f} s and from {second_s:.2f} s by {' and '.join(sizes)}, "
        f"{by.sigmas:.0f} standard deviations): unless they are different, poses have systematic errors, "
        "as of calibration: give their size, such as --accuracy 0.5mm,0.1deg"
    )
    return (Finding("accuracy", text, False),)


def difference(first: Element, second: Element) -> Difference:
    """Difference of two elements of one kind, both with a covariance."""
    sigmas = mahalanobis(first, second)
    match first, second:
        case Plane(), Plane() if sigmas == inf:  # opposite normals
            return Difference(inf, pi, inf)
        case Plane(), Plane():
            return Difference(sigmas, _angle_rad(first.normal, second.normal), _gap_m(first, second))
        case Line(direction, point_m), Line():
            off = second.point_m - point_m
            off = off - second.direction * (second.direction @ off)
            return Difference(sigmas, _angle_rad(direction, second.direction), float(np.linalg.norm(off)))
        case Point(), Point():
            return Difference(sigmas, 0.0, float(np.linalg.norm(second.point_m - first.point_m)))
    raise TypeError(f"{type(first).__name__} and {type(second).__name__}")


def _compared(found: Repeatability, new: Estimate) -> Repeatability:
    """The new estimate compared with the latest ones, and added to them."""
    for one in found.latest:
        if one.side != new.side or type(one.element) is not type(new.element):
            continue
        by = difference(one.element, new.element)
        if by.angle_rad > NEAR_RAD or by.distance_m > NEAR_M:
            continue
        found = found._replace(near=found.near + 1)
        if by.sigmas > SIGNIFICANT:
            is_worst = found.worst is None or by.sigmas > found.worst[2].sigmas
            found = found._replace(apart=found.apart + 1, worst=(one, new, by) if is_worst else found.worst)
    return found._replace(latest=(*found.latest, new)[-2 * MOST_ELEMENTS :])


def _gap_m(first: Plane, second: Plane) -> float:
    """Distance of two planes where it is known best; zero if an offset is not known, as in f-f."""
    assert first.covariance is not None
    assert second.covariance is not None
    covariance = first.covariance + second.covariance
    place = np.linalg.pinv(covariance[:3, :3], hermitian=True) @ covariance[:3, 3]
    if covariance[3, 3] - covariance[3, :3] @ place > NEAR_M**2:
        return 0.0
    return abs(float((first.normal - second.normal) @ place) - (first.offset_m - second.offset_m))


def _angle_rad(first: Array, second: Array) -> float:
    """Angle of two directions without regard to their senses."""
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), abs(first @ second)))
