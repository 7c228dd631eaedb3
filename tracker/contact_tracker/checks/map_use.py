"""Whether contacts use what the map names, and where it is.

If no contact is on any named element of a side, but some are on others, the named ones may be elsewhere. If
one is wrong by more than its standard deviations, but by less than what refutes it, contacts are still found
on it, at a compromise between the given place and the true one.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from math import degrees, inf, radians, sqrt
from operator import itemgetter
from typing import Final

import numpy as np

from contact_tracker.checks.check import Check, Stream
from contact_tracker.checks.clearance import CHECK
from contact_tracker.checks.repeatability import Difference, difference
from contact_tracker.geometry.elements import ContactGeometry, Plane, canonical
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.elements import distance_of_planes_m
from contact_tracker.map.map import Map, NamedElement
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
        texts = [self._moved_text] if self.moved[0] > SIGMAS else []
        for side, listed in enumerate((stream.map.listed_object, stream.map.listed_environment)):
            if listed and self.unknown[side] and not self.confirmed[side]:
                texts.append(self._untouched_text(side, listed))
        return [Finding("knowledge", text, False) for text in texts]

    @property
    def _moved_text(self) -> str:
        sigmas, moved = self.moved
        places = ", ".join(f"{name} by {_size(by)}" for name, by in moved if _size(by))
        return (
            f"contacts move what is given by {sigmas:.0f} of its standard deviations ({places}): "
            f"{CHECK}, or give larger standard deviations"
        )

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
    return min(
        (
            (distance_of_planes_m(face, one.element), one.name)
            for one in map.listed_environment
            if isinstance(one.element, Plane) and not one.is_covered
            if abs(face.normal @ one.element.normal) >= PARALLEL
        ),
        default=(inf, ""),
    )


def _moved(map: Map, geometry: ContactGeometry) -> tuple[float, tuple[tuple[str, Difference], ...]]:
    """The named elements that a contact moves, as in ``MapUse``."""
    moved = list[tuple[str, Difference]]()
    for element, listed in (
        (geometry.object, map.listed_object),
        (geometry.environment, map.listed_environment),
    ):
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
        is_decided = found.confirmed[1] or not any(map(_is_by_direction, self._segments()))
        if is_decided or sum(len(one.beliefs) for one in self._pieces) > MOST_TICKS:
            yield from self.finish(found)

    def finish(self, found: MapUse) -> Iterator[Segmentation]:
        """All pieces that wait, without the names that contacts contradict."""
        waiting, self._pieces = self._pieces, []
        nearest = None
        if found.contradicts_nearest:
            nearest = next((one for one in self._environment if one.name == found.nearest[1]), None)
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
