"""Checks whether contacts are on the map's elements and at their places, and whether estimates agree.

If contacts touch only elements without a name on a side, the named ones may be elsewhere. If a named element
is wrong by more than its standard deviations, but too little to be refuted, contacts are still found on it,
at a compromise between the given and the true place.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from math import asin, copysign, cos, degrees, inf, pi, sqrt
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.checks.check import Check, Stream
from contact_tracker.checks.clearance import CHECK
from contact_tracker.geometry.elements import ContactGeometry, Element, Line, Plane, Point, canonical, shifted
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.elements import (
    PARALLEL,
    TURNS,
    MapElement,
    covariance_of,
    distance_of_planes_m,
    mahalanobis,
)
from contact_tracker.map.map import Map, NamedElement
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import FurtherContact, Segment
from contact_tracker.tracking.segmentation import Segmentation

NEAR_RAD: Final = 0.035
NEAR_M: Final = 0.008
"""Estimates closer than this are taken for estimates of one element."""
SIGNIFICANT: Final = 6.0
"""Difference in standard deviations that noise rarely causes."""
MOST_ELEMENTS: Final = 80
"""Number of the latest estimates, of both sides, with which a new one is compared."""
LEAST: Final = 0.5
"""Least probability of a contact whose elements count; any contact confirms a named element."""
_WORDS: Final = {Plane: "face", Line: "edge", Point: "vertex"}
_SIDES: Final = ("object", "surroundings")


class Estimate(NamedTuple):
    """An element of the object (``side`` 0) or of the surroundings (1), in the segment from ``start_ns``.

    ``touch`` numbers the times in contact between free motion. The offset of a face may be unknown
    (``has_open_offset``), as in f-f.
    """

    side: int
    element: Element
    touch: int
    start_ns: int
    has_open_offset: bool


class Difference(NamedTuple):
    """Difference of two estimates: in standard deviations, as an angle (0 for points), and as a distance (0
    if unknown)."""

    sigmas: float
    angle_rad: float
    distance_m: float


def difference(first: Element, second: Element) -> Difference:
    """Difference of two elements of one kind, both with a covariance."""
    sigmas, start = mahalanobis(first, second), MapElement.of(first)
    if sigmas == inf:  # opposite normals
        return Difference(inf, pi, inf)
    turn, shift = np.split(start.change_to(MapElement.of(second)), [TURNS[start.kind]])
    angle = asin(min(float(np.linalg.norm(turn)), 1.0))
    if isinstance(first, Plane) and isinstance(second, Plane):
        return Difference(sigmas, angle, distance_of_planes_m(first, second))
    return Difference(sigmas, angle, float(np.linalg.norm(shift)))


def _normal_alone(element: Element) -> Element:
    """The face with offset 0 and the covariance of its normal only: differences ignore the offset."""
    if not isinstance(element, Plane) or element.covariance is None:
        return element
    covariance = np.eye(4)
    covariance[:3, :3] = element.covariance[:3, :3]
    return replace(element, offset_m=0.0, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Repeatability(Check):
    """The ``latest`` estimates; the number of pairs ``near`` each other, and of those ``apart`` by more than
    noise; the ``worst`` pair. ``origin_ns``: start of the first segment; ``touches``: number of segments of
    free motion."""

    origin_ns: int | None = None
    touches: int = 0
    latest: tuple[Estimate, ...] = ()
    near: int = 0
    apart: int = 0
    worst: tuple[Estimate, Estimate, Difference] | None = None

    def update_segments(self, segments: Iterable[Segment], stream: Stream) -> "Repeatability":
        state = self
        for segment in segments:
            geometry, touches = segment.geometry, state.touches + (segment.contact is Contact.FREE)
            origin_ns = segment.start_ns if state.origin_ns is None else state.origin_ns
            state = replace(state, origin_ns=origin_ns, touches=touches)
            may_be_free = Contact.FREE in segment.inseparable  # without these elements
            if geometry is None or may_be_free or segment.probability < LEAST:
                continue
            body, world = geometry.object, geometry.environment
            if not (isinstance(body, Plane) and isinstance(world, Plane)):  # else the offset is not known
                body = shifted(body, -stream.body_m)  # far from the point, small angles are large distances
            sides = zip((body, world), geometry.has_open_offset, strict=True)
            for side, (element, has_open_offset) in enumerate(sides):
                # named elements are given, not estimated
                if element.covariance is not None and element.name is None and element.covariance.any():
                    new = Estimate(side, element, touches, segment.start_ns, has_open_offset)
                    state = state._compared(new)
        return state

    def _compared(self, new: Estimate) -> "Repeatability":
        """The check after a comparison of the new estimate with the latest ones."""
        near, apart, worst = self.near, self.apart, self.worst
        for old in self.latest:
            is_open = old.has_open_offset or new.has_open_offset
            # an object that tilts stays on its face; after free motion it may be on another, parallel one
            is_other = old.side != new.side or (is_open and old.touch != new.touch)
            if is_other or type(old.element) is not type(new.element):
                continue
            pair = old.element, new.element
            by = difference(*(map(_normal_alone, pair) if is_open else pair))
            if by.angle_rad > NEAR_RAD or by.distance_m > NEAR_M:
                continue
            near, apart = near + 1, apart + (by.sigmas > SIGNIFICANT)
            if by.sigmas > (SIGNIFICANT if worst is None else worst[2].sigmas):
                worst = old, new, by
        return replace(self, near=near, apart=apart, worst=worst, latest=(*self.latest, new)[-MOST_ELEMENTS:])

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        """That poses may have (larger) systematic errors."""
        if self.worst is None or self.origin_ns is None:
            return []
        assert stream.best is not None
        errors = stream.best.systematic
        first, second, apart = self.worst
        first_s, second_s = ((estimate.start_ns - self.origin_ns) * 1e-9 for estimate in (first, second))
        sizes = [f"{degrees(apart.angle_rad):.2g} deg"] * (apart.angle_rad > 0.0)
        sizes += [f"{1e3 * apart.distance_m:.2g} mm"] * (apart.distance_m > 0.0)
        element = f"the {_WORDS[type(first.element)]} of the {_SIDES[first.side]}"
        allowed = "noise allows (with --accuracy)" if errors.are_given else "noise allows"
        remedy = "errors larger than these" if errors.are_given else "systematic errors"
        text = (
            f"elements that seem to be the same differ by more than {allowed} ({self.apart} of {self.near} "
            f"pairs; {element} from {first_s:.2f} s and from {second_s:.2f} s by {' and '.join(sizes)}, "
            f"{apart.sigmas:.0f} standard deviations): unless they are different, poses have {remedy}, "
            "as of calibration: give their size, such as --accuracy 0.5mm,0.1deg"
        )
        return [Finding("accuracy", text, False)]


NEAREST_M: Final = 0.005
"""Smaller distances (m) are not reported: they are within usual errors."""
SIGMAS: Final = 6.0
"""Standard deviations by which a contact may move its two named elements together. On nine of the shared
physics recordings it is at most 2.0 with exact elements, 5.4 with elements wrong by one of them."""
LEAST_M: Final = 5e-5
LEAST_DEG: Final = 0.05
"""Smaller movements are not reported."""
_NAMED: Final = 3
BESIDE_M: Final = 0.1
BESIDE_RAD: Final = 0.2
"""Within these a touched face is taken for a given one that was measured wrongly: errors are seldom larger,
and other surfaces seldom nearer."""


@dataclass(frozen=True, eq=False)
class MapUse(Check):
    """Evidence from contacts on the map's named elements.

    Parameters
    ----------
    unknown : whether contacts touch elements without a name, of the object and of the surroundings.
    known : whether contacts confirm the place of a named element, of the object and of the surroundings.
    nearest : least distance (m) of a touched face from a parallel named face, and the name of that face.
    moved : largest number of standard deviations by which a contact moves its named elements together, and
        the difference of each by name.
    shown : names of the surroundings' elements whose place contacts confirm.
    beside : the named faces that are nearest to a touched face without a name and differ from it by more
        than noise, with the least difference.
    """

    unknown: tuple[bool, bool] = (False, False)
    known: tuple[bool, bool] = (False, False)
    nearest: tuple[float, str] = (inf, "")
    moved: tuple[float, tuple[tuple[str, Difference], ...]] = (0.0, ())
    shown: tuple[str, ...] = ()
    beside: tuple[tuple[str, Difference], ...] = ()

    @property
    def confirmed(self) -> tuple[bool, bool]:
        """Whether contacts confirm elements of the object, and of the surroundings; these also by a face
        without a name at the place of a named one."""
        return self.known[0], self.known[1] or self.nearest[0] <= NEAREST_M

    @property
    def contradicts_nearest(self) -> bool:
        """Whether contacts touch no named element, but a face parallel to the nearest named one."""
        return self.unknown[1] and not self.known[1] and NEAREST_M < self.nearest[0] < inf

    def update_segments(self, segments: Iterable[Segment], stream: Stream) -> "MapUse":
        map = stream.map
        if not map.listed_object and not map.listed_environment:
            return self
        unknown, known, nearest, moved = self.unknown, self.known, self.nearest, self.moved
        shown, beside = {*self.shown}, dict(self.beside)
        parts: Iterator[Segment | FurtherContact] = chain.from_iterable(
            (segment, *segment.further) for segment in segments
        )
        for part in parts:
            geometry = part.geometry
            if geometry is None:
                continue
            object_named, world_named = (name is not None for name in geometry.names)
            # a face of the object fits any parallel face, and is named by other contacts
            is_flat = isinstance(geometry.object, Plane) and isinstance(geometry.environment, Plane)
            shows_place = world_named and not (is_flat and not object_named)
            known = known[0] or object_named, known[1] or shows_place
            if shows_place:
                shown.add(str(geometry.environment.name))
            if part.probability < LEAST:
                continue
            moved = max(moved, _moved(map, geometry), key=itemgetter(0))
            if len(part.inseparable) < len(STATES) - 1:
                unknown = unknown[0] or not object_named, unknown[1] or not world_named
                nearest = min(nearest, _nearest(map, geometry))
                for name, apart in _beside(map, geometry):
                    beside[name] = min(apart, beside.get(name, apart), key=itemgetter(2))
        return MapUse(unknown, known, nearest, moved, tuple(sorted(shown)), tuple(beside.items()))

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        """Elements that are moved far, and sides on which contacts touch no named element, unless an earlier
        finding about the map explains that."""
        if any(finding.kind == "knowledge" for finding in earlier):
            return []
        texts, (sigmas, moved) = list[str](), self.moved
        if sigmas > SIGMAS:
            places = ", ".join(f"{name} by {_size(step)}" for name, step in moved if _size(step))
            statement = f"contacts move what is given by {sigmas:.0f} of its standard deviations ({places})"
            texts.append(f"{statement}: {CHECK}, or give larger standard deviations")
        for side, listed in enumerate((stream.map.listed_object, stream.map.listed_environment)):
            if listed and self.unknown[side] and not self.confirmed[side]:
                texts.append(self._untouched_text(side, listed))
        for name, apart in self.beside if self.confirmed[1] else ():
            if name not in self.shown:
                off = f"a face that is touched differs from it by {_size(apart)}"
                texts.append(f"no contact confirms {name} of the surroundings, and {off}: {CHECK}")
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
    """Distance (m) and name of the named face that is nearest to the touched face and parallel to it."""
    face = geometry.environment
    if not isinstance(face, Plane) or face.name is not None or geometry.has_open_offset[1]:
        return inf, ""
    faces = ((named.element, named.name) for named in map.listed_environment if not named.is_covered)
    distances_m = (
        (distance_of_planes_m(face, plane), name)
        for plane, name in faces
        if isinstance(plane, Plane) and abs(face.normal @ plane.normal) >= cos(NEAR_RAD)
    )
    return min(distances_m, default=(inf, ""))


def _beside(map: Map, geometry: ContactGeometry) -> Iterator[tuple[str, Difference]]:
    """The named face that is nearest to a touched face without a name, with their difference, if that is more
    than noise, but no more than a wrong measurement."""
    face = geometry.environment
    if not isinstance(face, Plane) or face.name is not None or geometry.has_open_offset[1]:
        return
    planes = ((named.name, named.element) for named in map.listed_environment if not named.is_covered)
    faces = (
        (name, plane, float(face.normal @ plane.normal)) for name, plane in planes if isinstance(plane, Plane)
    )
    apart = (
        (name, difference(face, replace(plane, normal=sense * plane.normal, offset_m=sense * plane.offset_m)))
        for name, plane, along in faces
        if abs(along) >= cos(BESIDE_RAD) and (sense := copysign(1.0, along))
    )
    name, by = min(apart, default=("", Difference(0.0, inf, inf)), key=lambda one: one[1].distance_m)
    if by.sigmas > SIGNIFICANT and by.distance_m <= BESIDE_M:
        yield name, by


def _moved(map: Map, geometry: ContactGeometry) -> tuple[float, tuple[tuple[str, Difference], ...]]:
    """Standard deviations by which a contact moves its named elements together, and by how much each."""
    moved, sides = list[tuple[str, Difference]](), (map.listed_object, map.listed_environment)
    for element, listed in zip((geometry.object, geometry.environment), sides, strict=True):
        prior = next((named.element for named in listed if named.name == element.name), None)
        if prior is not None and prior.covariance is not None:
            exact = replace(element, covariance=np.zeros_like(prior.covariance))
            moved.append((str(element.name), difference(exact, prior)))
    return sqrt(sum(step.sigmas**2 for _, step in moved)), tuple(moved)


def _names(listed: Sequence[NamedElement]) -> str:
    named = ", ".join(element.name for element in listed[:_NAMED])
    return f"{named} and {len(listed) - _NAMED} more" if len(listed) > _NAMED else named


def _size(step: Difference) -> str:
    """A movement in words; empty if it is small."""
    sizes = [f"{1e3 * step.distance_m:.2g} mm"] * (step.distance_m > LEAST_M)
    sizes += [f"{degrees(step.angle_rad):.2g} deg"] * (degrees(step.angle_rad) > LEAST_DEG)
    return " and ".join(sizes)


def without_contradicted_names(
    piece: Segmentation, listed: Iterable[NamedElement], map_use: MapUse
) -> Segmentation:
    """A piece without the names of faces that contacts contradict, by their evidence so far.

    Motion of a face on a face does not determine their offset along the normal, so a ``listed`` face of this
    direction is assumed to be touched. Another contact may show that it is not.
    """
    nearest = next((named.element for named in listed if named.name == map_use.nearest[1]), None)
    if not map_use.contradicts_nearest or not isinstance(nearest, Plane):
        return piece
    return piece.with_elements(partial(_without_name, nearest))


def _without_name(known_face: Plane, geometry: ContactGeometry) -> ContactGeometry:
    """The elements without the name of a face parallel to ``known_face`` that is named by direction alone."""
    body, face = geometry.object, geometry.environment
    if not (isinstance(face, Plane) and isinstance(body, Plane) and geometry.has_open_offset[0]):
        return geometry
    if face.name is None or abs(face.normal @ known_face.normal) < PARALLEL:
        return geometry
    covariance = covariance_of(face).copy()
    covariance[3, 3] = max(covariance[3, 3], covariance_of(body)[3, 3])  # the face's offset is unknown
    return ContactGeometry(body, canonical(replace(face, covariance=covariance, name=None)))
