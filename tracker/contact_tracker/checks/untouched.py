"""Test whether contacts confirm the prior map: known elements of a side of which no contact shows any."""

from collections.abc import Iterable
from math import inf, radians
from typing import Final, NamedTuple

from contact_tracker.geometry.elements import ContactGeometry, Plane
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.map import NamedElement, PriorMap
from contact_tracker.map.same_element import distance_of_planes_m
from contact_tracker.states import STATES
from contact_tracker.tracking.belief import Segment

LEAST: Final = 0.5
"""Probability of a contact from which on its unknown elements count; a known one confirms with any."""
PARALLEL: Final = 1.0 - 0.5 * radians(5.0) ** 2
"""Cosine of the angle of normals below which a face that is touched may be meant by a known one."""
NEAREST_M: Final = 0.005
"""Distances below are not given: they are within usual errors."""
_NAMED: Final = 3
_SIDES: Final = ("object", "surroundings")


class Untouched(NamedTuple):
    """Whether contacts that the motion shows touch elements that are not given (``unknown``), and whether any
    confirms the place of a known one (``known``), of the object and of the surroundings; the known face that
    is nearest to a face that is touched, and its distance (m) where normals agree."""

    unknown: tuple[bool, bool] = (False, False)
    known: tuple[bool, bool] = (False, False)
    nearest: str = ""
    gap_m: float = inf

    @property
    def confirmed(self) -> tuple[bool, bool]:
        """Whether contacts confirm elements of the object, and of the surroundings: also a face that is
        touched where a known one is, though not as that one."""
        return self.known[0], self.known[1] or self.gap_m <= NEAREST_M

    @property
    def contradicts_nearest(self) -> bool:
        """Whether contacts are on unknown elements only, one of them a face parallel to ``nearest``."""
        return self.unknown[1] and not self.known[1] and NEAREST_M < self.gap_m < inf


def advance(found: Untouched, knowledge: PriorMap, segments: Iterable[Segment]) -> Untouched:
    """Advance by the next segments."""
    if not knowledge.object and not knowledge.environment:
        return found
    for segment in segments:
        first = (segment.geometry, segment.probability, segment.inseparable)
        others = [(one.geometry, one.probability, one.inseparable) for one in segment.further]
        for geometry, probability, inseparable in [first, *others]:
            if geometry is None:
                continue
            of_object, of_environment = (name is not None for name in geometry.names)
            # a face on a face of unknown offset is on any parallel one
            shows_place = of_environment and not geometry.has_open_offset[0]
            found = found._replace(known=(found.known[0] or of_object, found.known[1] or shows_place))
            if probability < LEAST or len(inseparable) == len(STATES) - 1:
                continue
            found = found._replace(
                unknown=(found.unknown[0] or not of_object, found.unknown[1] or not of_environment)
            )
            found = _with_distance(found, knowledge, geometry)
    return found


def findings(found: Untouched, knowledge: PriorMap) -> tuple[Finding, ...]:
    """A finding for each side of which contacts touch unknown elements only."""
    texts = []
    for side, listed in enumerate((knowledge.object, knowledge.environment)):
        if not listed or found.confirmed[side] or not found.unknown[side]:
            continue
        near, gap_mm = "", 1e3 * found.gap_m
        if side == 1 and found.contradicts_nearest:
            near = f"; a face that is touched is parallel to {found.nearest}, {gap_mm:.0f} mm from it"
        texts.append(
            f"no contact confirms what is given of the {_SIDES[side]} ({_names(listed)}): contacts are on "
            f"what is not given{near}: check it (place in metres, in the frame of the "
            f"{'object' if side == 0 else 'poses'}), or leave it out"
        )
    return tuple(Finding("knowledge", text, False) for text in texts)


def _with_distance(found: Untouched, knowledge: PriorMap, geometry: ContactGeometry) -> Untouched:
    """``found`` with the known face that is nearest to the face that is touched, if it is nearer."""
    face = geometry.environment
    if not isinstance(face, Plane) or face.name is not None or geometry.has_open_offset[1]:
        return found
    for listed in knowledge.environment:
        if (
            not isinstance(listed.element, Plane)
            or listed.is_covered
            or abs(face.normal @ listed.element.normal) < PARALLEL
        ):
            continue
        gap_m = distance_of_planes_m(face, listed.element)
        if gap_m < found.gap_m:
            found = found._replace(nearest=listed.name, gap_m=gap_m)
    return found


def _names(listed: tuple[NamedElement, ...]) -> str:
    named = ", ".join(one.name for one in listed[:_NAMED])
    return f"{named} and {len(listed) - _NAMED} more" if len(listed) > _NAMED else named
