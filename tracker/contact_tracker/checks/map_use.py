"""Whether contacts use what the map names and where it is, and whether elements found twice agree.

If no contact is on any named element of a side, but some are on others, the named ones may be elsewhere. If
one is wrong by more than its standard deviations, but by less than what refutes it, contacts are still found
on it, at a compromise between the given place and the true one.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from math import degrees, inf, pi, radians, sqrt
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.checks.check import Check, Stream
from contact_tracker.checks.clearance import CHECK
from contact_tracker.geometry.elements import ContactGeometry, Element, Line, Plane, Point, canonical, shifted
from contact_tracker.geometry.linalg import angle_of_lines
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.elements import distance_of_planes_m, mahalanobis
from contact_tracker.map.map import Map, NamedElement
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import FurtherContact, Segment
from contact_tracker.tracking.segmentation import Segmentation

NEAR_RAD: Final = 0.035
NEAR_M: Final = 0.008
"""Estimates that are closer than this are taken to be of one element."""
SIGNIFICANT: Final = 6.0
"""Difference in standard deviations that noise hardly causes."""
MOST_ELEMENTS: Final = 80
"""Number of the latest elements, of both sides together, with which a new one is compared."""
LEAST: Final = 0.5
"""Probability of a contact from which on its elements count; a named element is confirmed with any."""
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
            angle = angle_of_lines(first.normal, second.normal)
            return Difference(sigmas, angle, distance_of_planes_m(first, second))
        case Line(direction, point_m), Line():
            off = second.point_m - point_m
            off = off - second.direction * (second.direction @ off)
            return Difference(sigmas, angle_of_lines(direction, second.direction), float(np.linalg.norm(off)))
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
            found = replace(found, near=found.near + 1, apart=found.apart + (by.sigmas > SIGNIFICANT))
            if by.sigmas > max(SIGNIFICANT, 0.0 if found.worst is None else found.worst[2].sigmas):
                found = replace(found, worst=(one, new, by))
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
        allowed = "noise allows (with --accuracy)" if errors.are_given else "noise allows"
        remedy = "errors larger than these" if errors.are_given else "systematic errors"
        text = (
            f"elements that seem to be the same differ by more than {allowed} ({self.apart} of {self.near} "
            f"pairs; {what} from {first_s:.2f} s and from {second_s:.2f} s by {' and '.join(sizes)}, "
            f"{by.sigmas:.0f} standard deviations): unless they are different, poses have {remedy}, "
            "as of calibration: give their size, such as --accuracy 0.5mm,0.1deg"
        )
        return [Finding("accuracy", text, False)]


PARALLEL: Final = 1.0 - 0.5 * radians(5.0) ** 2
"""Cosine of the angle of normals below which a face that is touched may be meant by a named one."""
NEAREST_M: Final = 0.005
"""Distances below are not given: they are within usual errors."""
SIGMAS: Final = 6.0
"""Standard deviations by which both elements of a contact are moved together. On nine of the shared physics
recordings it is at most 2.0 with exact elements, and 5.4 with such that are wrong by one."""
LEAST_M: Final = 5e-5
LEAST_DEG: Final = 0.05
"""Smaller movements are not given."""
_NAMED: Final = 3


@dataclass(frozen=True, eq=False)
class MapUse(Check):
    """What contacts have shown of the map's named elements.

    Parameters
    ----------
    unknown : whether contacts that the motion shows touch elements without a name, of the object and of the
        surroundings.
    known : whether any confirms the place of a named one.
    nearest : where normals agree, the distance (m) of a face that is touched from the nearest named face, and
        that one's name.
    moved : by how many standard deviations the contact that moves named elements furthest moves them
        together, and by how much each, by its name.
    """

    unknown: tuple[bool, bool] = (False, False)
    known: tuple[bool, bool] = (False, False)
    nearest: tuple[float, str] = (inf, "")
    moved: tuple[float, tuple[tuple[str, Difference], ...]] = (0.0, ())

    @property
    def confirmed(self) -> tuple[bool, bool]:
        """Whether contacts confirm elements of the object, and of the surroundings: also a face that is
        touched where a named one is, though not as that one."""
        return self.known[0], self.known[1] or self.nearest[0] <= NEAREST_M

    @property
    def contradicts_nearest(self) -> bool:
        """Whether contacts are on elements without a name only, one a face parallel to the nearest."""
        return self.unknown[1] and not self.known[1] and NEAREST_M < self.nearest[0] < inf

    def update_segments(self, segments: Iterable[Segment], stream: Stream) -> "MapUse":
        map = stream.map
        if not map.listed_object and not map.listed_environment:
            return self
        unknown, known, nearest, moved = self.unknown, self.known, self.nearest, self.moved
        parts: Iterator[Segment | FurtherContact] = chain.from_iterable(
            (one, *one.further) for one in segments
        )
        for one in parts:
            geometry = one.geometry
            if geometry is None:
                continue
            of_object, of_environment = (name is not None for name in geometry.names)
            # a face on a face of unknown offset is on any parallel one
            shows_place = of_environment and not geometry.has_open_offset[0]
            known = known[0] or of_object, known[1] or shows_place
            if one.probability < LEAST:
                continue
            moved = max(moved, _moved(map, geometry), key=itemgetter(0))
            if len(one.inseparable) < len(STATES) - 1:
                unknown = unknown[0] or not of_object, unknown[1] or not of_environment
                nearest = min(nearest, _nearest(map, geometry))
        return MapUse(unknown, known, nearest, moved)

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        """Elements that are moved far, and sides of which contacts touch elements without a name only, unless
        another finding about the map explains that."""
        if any(one.kind == "knowledge" for one in earlier):
            return []
        texts, (sigmas, moved) = list[str](), self.moved
        if sigmas > SIGMAS:
            places = ", ".join(f"{name} by {_size(by)}" for name, by in moved if _size(by))
            what = f"contacts move what is given by {sigmas:.0f} of its standard deviations ({places})"
            texts.append(f"{what}: {CHECK}, or give larger standard deviations")
        for side, listed in enumerate((stream.map.listed_object, stream.map.listed_environment)):
            if listed and self.unknown[side] and not self.confirmed[side]:
                texts.append(self._untouched_text(side, listed))
        return [Finding("knowledge", text, False) for text in texts]

    def _untouched_text(self, side: int, listed: Sequence[NamedElement]) -> str:
        near = ""
        if side == 1 and self.contradicts_nearest:
            gap_m, face = self.nearest
            near = f"; a face that is touched is parallel to {face}, {1e3 * gap_m:.0f} mm from it"
        return (
            f"no contact confirms what is given of the {_SIDES[side]} ({_names(listed)}): contacts are on "
            f"what is not given{near}: check it (place in metres, in the frame of the "
            f"{'object' if side == 0 else 'poses'}), or leave it out"
        )


def _nearest(map: Map, geometry: ContactGeometry) -> tuple[float, str]:
    """The named face that is nearest to the face that is touched, if normals agree, after its distance."""
    face = geometry.environment
    if not isinstance(face, Plane) or face.name is not None or geometry.has_open_offset[1]:
        return inf, ""
    faces = ((one.element, one.name) for one in map.listed_environment if not one.is_covered)
    distances_m = (
        (distance_of_planes_m(face, plane), name)
        for plane, name in faces
        if isinstance(plane, Plane) and abs(face.normal @ plane.normal) >= PARALLEL
    )
    return min(distances_m, default=(inf, ""))


def _moved(map: Map, geometry: ContactGeometry) -> tuple[float, tuple[tuple[str, Difference], ...]]:
    """The named elements that a contact moves, as in ``MapUse``."""
    moved, sides = list[tuple[str, Difference]](), (map.listed_object, map.listed_environment)
    for element, listed in zip((geometry.object, geometry.environment), sides, strict=True):
        known = next((one.element for one in listed if one.name == element.name), None)
        if known is not None and known.covariance is not None:
            exact = replace(element, covariance=np.zeros_like(known.covariance))
            moved.append((str(element.name), difference(exact, known)))
    return sqrt(sum(by.sigmas**2 for _, by in moved)), tuple(moved)


def _names(listed: Sequence[NamedElement]) -> str:
    named = ", ".join(one.name for one in listed[:_NAMED])
    return f"{named} and {len(listed) - _NAMED} more" if len(listed) > _NAMED else named


def _size(by: Difference) -> str:
    """A movement in words; empty if it is small."""
    sizes = [f"{1e3 * by.distance_m:.2g} mm"] * (by.distance_m > LEAST_M)
    sizes += [f"{degrees(by.angle_rad):.2g} deg"] * (degrees(by.angle_rad) > LEAST_DEG)
    return " and ".join(sizes)


MOST_TICKS: Final = 6000
"""Ticks that wait at most; after them the names are kept as they are."""


class FaceNameDelay:
    """Pieces of a segmentation whose names of known faces are not confirmed yet.

    Motion of a face on a face does not show where along their normal they are, so a known face of that
    direction is taken for the one that is touched. A later contact shows whether it is: until then the result
    waits, and names whose place contacts contradict are withdrawn.
    """

    def __init__(self, map: Map) -> None:
        self._environment = map.listed_environment
        self._pieces: list[Segmentation] = []

    def release(self, piece: Segmentation, found: MapUse) -> Iterator[Segmentation]:
        """The pieces that need not wait after this one; ``found`` is what contacts have shown so far."""
        self._pieces.append(piece)
        segments = (segment for piece in self._pieces for segment in piece.segments)
        is_decided = found.confirmed[1] or not any(map(_is_by_direction, segments))
        if is_decided or sum(len(one.beliefs) for one in self._pieces) > MOST_TICKS:
            yield from self.finish(found)

    def finish(self, found: MapUse) -> Iterator[Segmentation]:
        """All pieces that wait, without the names that contacts contradict."""
        waiting, self._pieces = self._pieces, []
        nearest = {one.name: one.element for one in self._environment}.get(found.nearest[1])
        for piece in waiting:
            if found.contradicts_nearest and isinstance(nearest, Plane):
                piece = _without_names(piece, nearest)
            yield piece


def has_name_by_direction(geometry: ContactGeometry | None) -> bool:
    """Whether a known face is touched by a face whose place along the normal the motion does not show."""
    return geometry is not None and geometry.environment.name is not None and geometry.has_open_offset[0]


def _is_by_direction(segment: Segment) -> bool:
    return any(map(has_name_by_direction, (segment.geometry, *(one.geometry for one in segment.further))))


def _without_names(piece: Segmentation, known: Plane) -> Segmentation:
    """The piece in which no face has the name of one parallel to ``known`` by its direction alone."""
    change = partial(_without_name, known)
    segments = tuple(
        replace(
            one,
            geometry=None if one.geometry is None else change(one.geometry),
            further=tuple(_changed(known, other) for other in one.further),
        )
        for one in piece.segments
    )
    beliefs = piece.beliefs.with_elements(change, partial(_changed, known))
    return replace(piece, segments=segments, beliefs=beliefs)


def _changed(known: Plane, one: FurtherContact) -> FurtherContact:
    return one if one.geometry is None else replace(one, geometry=_without_name(known, one.geometry))


def _without_name(known: Plane, geometry: ContactGeometry) -> ContactGeometry:
    body, face = geometry.object, geometry.environment
    if not has_name_by_direction(geometry) or not isinstance(face, Plane) or not isinstance(body, Plane):
        return geometry
    if abs(face.normal @ known.normal) < PARALLEL or face.covariance is None or body.covariance is None:
        return geometry
    covariance = face.covariance.copy()
    covariance[3, 3] = max(covariance[3, 3], body.covariance[3, 3])  # as of a face of unknown place
    return ContactGeometry(body, canonical(replace(face, covariance=covariance, name=None)))
