"""Whether contacts use what the map names, and where it is.

If no contact is on any named element of a side, but some are on others, the named ones may be elsewhere. If
one is wrong by more than its standard deviations, but by less than what refutes it, contacts are still found
on it, at a compromise between the given place and the true one.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import degrees, inf, radians, sqrt
from typing import Final

import numpy as np

from contact_tracker.checks.check import Check, Stream
from contact_tracker.checks.clearance import CHECK
from contact_tracker.checks.repeatability import Difference, difference
from contact_tracker.geometry.elements import ContactGeometry, Plane, canonical
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.map import Map, NamedElement
from contact_tracker.map.same_element import distance_of_planes_m
from contact_tracker.states import STATES
from contact_tracker.tracking.belief import FurtherContact, Segment
from contact_tracker.tracking.segmentation import Segmentation

LEAST: Final = 0.5
"""Probability of a contact from which on it counts; a named element is confirmed with any."""
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
_SIDES: Final = ("object", "surroundings")


@dataclass(frozen=True, eq=False)
class MapUse(Check):
    """What contacts have shown of the map's named elements.

    Parameters
    ----------
    unknown : whether contacts that the motion shows touch elements without a name, of the object and of the
        surroundings.
    known : whether any confirms the place of a named one.
    nearest, gap_m : the named face that is nearest to a face that is touched, and its distance where normals
        agree.
    sigmas, moved : by how much the contact that moves named elements furthest moves them together, and each,
        by its name.
    """

    unknown: tuple[bool, bool] = (False, False)
    known: tuple[bool, bool] = (False, False)
    nearest: str = ""
    gap_m: float = inf
    sigmas: float = 0.0
    moved: tuple[tuple[str, Difference], ...] = ()

    @property
    def confirmed(self) -> tuple[bool, bool]:
        """Whether contacts confirm elements of the object, and of the surroundings: also a face that is
        touched where a named one is, though not as that one."""
        return self.known[0], self.known[1] or self.gap_m <= NEAREST_M

    @property
    def contradicts_nearest(self) -> bool:
        """Whether contacts are on elements without a name only, one a face parallel to the nearest."""
        return self.unknown[1] and not self.known[1] and NEAREST_M < self.gap_m < inf

    def update_segments(self, segments: Iterable[Segment], stream: Stream) -> "MapUse":
        found, map = self, stream.map
        if not map.object and not map.environment:
            return self
        for segment in segments:
            first = segment.geometry, segment.probability, segment.inseparable
            further = ((one.geometry, one.probability, one.inseparable) for one in segment.further)
            for geometry, probability, inseparable in (first, *further):
                if geometry is None:
                    continue
                is_open = len(inseparable) == len(STATES) - 1
                found = found._with_touched(map, geometry, probability, is_open)
                if probability >= LEAST:
                    found = found._with_moved(map, geometry)
        return found

    def _with_touched(
        self, map: Map, geometry: ContactGeometry, probability: float, is_open: bool
    ) -> "MapUse":
        of_object, of_environment = (name is not None for name in geometry.names)
        # a face on a face of unknown offset is on any parallel one
        shows_place = of_environment and not geometry.has_open_offset[0]
        found = replace(self, known=(self.known[0] or of_object, self.known[1] or shows_place))
        if probability < LEAST or is_open:
            return found
        unknown = self.unknown[0] or not of_object, self.unknown[1] or not of_environment
        return replace(found, unknown=unknown)._with_distance(map, geometry)

    def _with_distance(self, map: Map, geometry: ContactGeometry) -> "MapUse":
        """With the named face that is nearest to the face that is touched, if it is nearer."""
        face, found = geometry.environment, self
        if not isinstance(face, Plane) or face.name is not None or geometry.has_open_offset[1]:
            return self
        for listed in map.environment:
            one = listed.element
            if not isinstance(one, Plane) or listed.is_covered or abs(face.normal @ one.normal) < PARALLEL:
                continue
            gap_m = distance_of_planes_m(face, one)
            if gap_m < found.gap_m:
                found = replace(found, nearest=listed.name, gap_m=gap_m)
        return found

    def _with_moved(self, map: Map, geometry: ContactGeometry) -> "MapUse":
        """With the named elements that the contact moves, if it moves them further."""
        moved = list[tuple[str, Difference]]()
        for element, listed in ((geometry.object, map.object), (geometry.environment, map.environment)):
            known = next((one.element for one in listed if one.name == element.name), None)
            if known is not None and known.covariance is not None:
                exact = replace(element, covariance=np.zeros_like(known.covariance))
                moved.append((str(element.name), difference(exact, known)))
        sigmas = sqrt(sum(by.sigmas**2 for _, by in moved))
        return replace(self, sigmas=sigmas, moved=tuple(moved)) if sigmas > self.sigmas else self

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        """Elements that are moved far, and sides of which contacts touch elements without a name only, unless
        another finding about the map explains that."""
        if any(one.kind == "knowledge" for one in earlier):
            return []
        texts = [self._moved_text] if self.sigmas > SIGMAS else []
        for side, listed in enumerate((stream.map.object, stream.map.environment)):
            if listed and self.unknown[side] and not self.confirmed[side]:
                texts.append(self._untouched_text(side, listed))
        return [Finding("knowledge", text, False) for text in texts]

    @property
    def _moved_text(self) -> str:
        places = ", ".join(f"{name} by {_size(by)}" for name, by in self.moved if _size(by))
        return (
            f"contacts move what is given by {self.sigmas:.0f} of its standard deviations ({places}): "
            f"{CHECK}, or give larger standard deviations"
        )

    def _untouched_text(self, side: int, listed: Sequence[NamedElement]) -> str:
        near = ""
        if side == 1 and self.contradicts_nearest:
            gap_mm = 1e3 * self.gap_m
            near = f"; a face that is touched is parallel to {self.nearest}, {gap_mm:.0f} mm from it"
        return (
            f"no contact confirms what is given of the {_SIDES[side]} ({_names(listed)}): contacts are on "
            f"what is not given{near}: check it (place in metres, in the frame of the "
            f"{'object' if side == 0 else 'poses'}), or leave it out"
        )


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
        self._environment = map.environment
        self._pieces: list[Segmentation] = []

    def release(self, piece: Segmentation, found: MapUse) -> Iterator[Segmentation]:
        """The pieces that need not wait after this one; ``found`` is what contacts have shown so far."""
        self._pieces.append(piece)
        is_decided = found.confirmed[1] or not any(map(_is_by_direction, self._segments()))
        if is_decided or sum(len(one.beliefs) for one in self._pieces) > MOST_TICKS:
            yield from self.finish(found)

    def finish(self, found: MapUse) -> Iterator[Segmentation]:
        """All pieces that wait, without the names that contacts contradict."""
        waiting, self._pieces = self._pieces, []
        nearest = None
        if found.contradicts_nearest:
            nearest = next((one for one in self._environment if one.name == found.nearest), None)
        for piece in waiting:
            if nearest is None or not isinstance(nearest.element, Plane):
                yield piece
            else:
                yield _without_names(piece, nearest.element)

    def _segments(self) -> Iterator[Segment]:
        return (segment for piece in self._pieces for segment in piece.segments)


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
