"""Test of the repeatability of elements: whether estimates of what seems to be one element, in several
segments, differ by no more than their covariances allow. With systematic errors of the poses they do not."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import degrees, inf, pi
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.checks.check import Check, Stream
from contact_tracker.geometry.elements import Element, Line, Plane, Point, shifted
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.elements import distance_of_planes_m, mahalanobis
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Segment

Array = NDArray[np.float64]

NEAR_RAD: Final = 0.035
NEAR_M: Final = 0.008
"""Estimates that are closer than this are taken to be of one element."""
SIGNIFICANT: Final = 6.0
"""Difference in standard deviations that noise hardly causes."""
MOST_ELEMENTS: Final = 80
"""Number of the latest elements, of both sides together, with which a new one is compared."""
LEAST: Final = 0.5
"""Probability of a contact from which on its elements count."""
_WORDS: Final = {Plane: "face", Line: "edge", Point: "vertex"}
_SIDES: Final = ("object", "surroundings")


class Estimate(NamedTuple):
    """An element of the object (``side`` 0) or of the surroundings (1), in the segment from ``start_ns``.

    ``touch`` is the number of the time in contact, without free motion. The offset of a face may be unknown
    (``has_open_offset``), as in f-f.
    """

    side: int
    element: Element
    touch: int
    start_ns: int
    has_open_offset: bool


class Difference(NamedTuple):
    """Difference of two estimates: in standard deviations, as an angle (0 for points) and as a distance (0
    where it is not known)."""

    sigmas: float
    angle_rad: float
    distance_m: float


def difference(first: Element, second: Element) -> Difference:
    """Difference of two elements of one kind, both with a covariance."""
    sigmas = mahalanobis(first, second)
    match first, second:
        case Plane(), Plane() if sigmas == inf:  # opposite normals
            return Difference(inf, pi, inf)
        case Plane(), Plane():
            angle = _angle_rad(first.normal, second.normal)
            return Difference(sigmas, angle, distance_of_planes_m(first, second))
        case Line(direction, point_m), Line():
            off = second.point_m - point_m
            off = off - second.direction * (second.direction @ off)
            return Difference(sigmas, _angle_rad(direction, second.direction), float(np.linalg.norm(off)))
        case Point(), Point():
            return Difference(sigmas, 0.0, float(np.linalg.norm(second.point_m - first.point_m)))
    raise TypeError(f"{type(first).__name__} and {type(second).__name__}")


def _normal_alone(element: Element) -> Element:
    """A face with the offset 0, by which it then differs from no other."""
    if not isinstance(element, Plane) or element.covariance is None:
        return element
    covariance = np.eye(4)
    covariance[:3, :3] = element.covariance[:3, :3]
    return replace(element, offset_m=0.0, covariance=covariance)


def _angle_rad(first: Array, second: Array) -> float:
    """Angle of two directions without regard to their senses."""
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), abs(first @ second)))


@dataclass(frozen=True, eq=False)
class Repeatability(Check):
    """The ``latest`` estimates; how many pairs are ``near`` each other, how many of these are ``apart`` by
    more than noise, and the ``worst`` pair. ``origin_ns`` is the start of the first segment; ``touches``
    counts the segments of free motion."""

    origin_ns: int | None = None
    touches: int = 0
    latest: tuple[Estimate, ...] = ()
    near: int = 0
    apart: int = 0
    worst: tuple[Estimate, Estimate, Difference] | None = None

    def update_segments(self, segments: Iterable[Segment], stream: Stream) -> "Repeatability":
        found = self
        for segment in segments:
            where, touches = segment.geometry, found.touches + (segment.contact is Contact.FREE)
            origin_ns = segment.start_ns if found.origin_ns is None else found.origin_ns
            found = replace(found, origin_ns=origin_ns, touches=touches)
            is_open = len(segment.inseparable) == len(STATES) - 1
            if where is None or is_open or segment.probability < LEAST:
                continue
            ours, theirs = where.object, where.environment
            if not isinstance(ours, Plane) or not isinstance(theirs, Plane):  # else the offset is not known
                ours = shifted(ours, -stream.body_m)  # far from there, small angles are large distances
            sides = zip((ours, theirs), where.has_open_offset, strict=True)
            for side, (element, has_open_offset) in enumerate(sides):
                # names are of given elements
                if element.covariance is not None and element.name is None and element.covariance.any():
                    new = Estimate(side, element, touches, segment.start_ns, has_open_offset)
                    found = found._compared(new)
        return found

    def _compared(self, new: Estimate) -> "Repeatability":
        """The new estimate compared with the latest ones, and added to them."""
        found = self
        for one in self.latest:
            if one.side != new.side or type(one.element) is not type(new.element):
                continue
            # an object that tilts stays on its face; later it may be on another, parallel one
            if (one.has_open_offset or new.has_open_offset) and one.touch != new.touch:
                continue
            first, second = one.element, new.element
            if one.has_open_offset or new.has_open_offset:
                first, second = _normal_alone(first), _normal_alone(second)
            by = difference(first, second)
            if by.angle_rad > NEAR_RAD or by.distance_m > NEAR_M:
                continue
            found = replace(found, near=found.near + 1)
            if by.sigmas > SIGNIFICANT:
                is_worst = found.worst is None or by.sigmas > found.worst[2].sigmas
                found = replace(
                    found, apart=found.apart + 1, worst=(one, new, by) if is_worst else found.worst
                )
        return replace(found, latest=(*found.latest, new)[-MOST_ELEMENTS:])

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        """That poses may have (larger) systematic errors."""
        if self.worst is None or self.origin_ns is None:
            return []
        assert stream.best is not None
        errors = stream.best.systematic
        first, second, by = self.worst
        first_s, second_s = ((one.start_ns - self.origin_ns) * 1e-9 for one in (first, second))
        sizes = [f"{degrees(by.angle_rad):.2g} deg"] * (by.angle_rad > 0.0)
        sizes += [f"{1e3 * by.distance_m:.2g} mm"] * (by.distance_m > 0.0)
        what = f"the {_WORDS[type(first.element)]} of the {_SIDES[first.side]}"
        allowed = "noise and --accuracy allow" if errors.are_given else "noise allows"
        remedy = "errors larger than these" if errors.are_given else "systematic errors"
        text = (
            f"elements that seem to be the same differ by more than {allowed} ({self.apart} of {self.near} "
            f"pairs; {what} from {first_s:.2f} s and from {second_s:.2f} s by {' and '.join(sizes)}, "
            f"{by.sigmas:.0f} standard deviations): unless they are different, poses have {remedy}, "
            "as of calibration: give their size, such as --accuracy 0.5mm,0.1deg"
        )
        return [Finding("accuracy", text, False)]
