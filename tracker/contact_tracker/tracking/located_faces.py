"""Where the faces of f-f are, by the map of the recording.

The motion of a face on a face shows the distance of both alone, and fits all parallel faces, so the map may
take one for another.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain, pairwise
from typing import Final

from contact_tracker.geometry.elements import ContactGeometry, Element, Plane, numbers
from contact_tracker.hypotheses.births import name_listed
from contact_tracker.map.elements import Key, best_known_place, covariance_of, plane_covariance
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap, Touch
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.segmentation import Segmentation

KNOWN_M: Final = 0.02
"""Largest standard deviation (m) of an offset that is reported. It is 0.4 to 5 mm on everyday handling if
other contacts touch the same faces, and that of the prior, 300 mm, if f-f alone does."""


def with_offsets(piece: Segmentation, world: GrowingMap | None, known_map: Map = EMPTY_MAP) -> Segmentation:
    """The piece with the offsets of faces on faces, where contacts show them (``located``), and the names in
    ``known_map`` of faces at these places. A name by direction alone (``name_listed``) gives way."""
    if world is None:
        return piece
    shown, elements, error_m = located(piece.segments, world), world.known, world.prior_error_m
    changed = dict[bytes, ContactGeometry]()
    for geometry, (*_, keys) in _touching(piece.segments, world):
        if geometry.has_open_offset[0] and shown >= {*keys}:
            own, faces = (geometry.object, geometry.environment), [elements[key] for key in keys]
            body, environment = (_with_offset(*pair, error_m) for pair in zip(own, faces, strict=True))
            if body is not None and environment is not None:
                changed[_key(geometry)] = name_listed(ContactGeometry(body, environment), known_map, False)

    def change(geometry: ContactGeometry) -> ContactGeometry:
        return changed.get(_key(geometry), geometry)

    return piece.with_elements(change)


def located(segments: Iterable[Segment], world: GrowingMap) -> set[Key]:
    """The elements of a map whose places contacts show.

    These are the elements of contacts other than f-f in whose ``segments`` nothing is unobserved, and those
    of a contact that changes to one of these, or from it, without free motion between, and keeps an element,
    as in tilting onto an edge. What was known before shows the places of faces whose side it has.
    """
    shown = {touch for geometry, touch in _touching(segments, world) if _shows_places(geometry)}
    found = {*world.prior.outward, *chain.from_iterable(keys for *_, keys in shown)}
    for before, after in pairwise(world.sightings):
        touches = world.touch(before), world.touch(after)
        pair, following = ({*keys} for *_, keys in touches)
        if before.is_beside(after) and pair & following and not shown.isdisjoint(touches):
            found |= pair | following
    return found


def _touching(segments: Iterable[Segment], world: GrowingMap) -> Iterator[tuple[ContactGeometry, Touch]]:
    """The elements of the segments in which a map's elements touched, and when and which these are."""
    for segment in segments:
        middle_ns = (segment.start_ns + segment.end_ns) // 2
        touches = [touch for touch in world.touches if touch[0] <= middle_ns <= touch[1]]
        if segment.geometry is not None and touches:
            yield segment.geometry, touches[0]


def _shows_places(geometry: ContactGeometry) -> bool:
    body, world = geometry.object, geometry.environment
    are_faces = isinstance(body, Plane) and isinstance(world, Plane)
    return not (are_faces or body.unobserved or world.unobserved)


def _with_offset(estimate: Element, face: Element, error_m: float) -> Plane | None:
    """A face with the estimated normal and the offset of the known ``face``; None if that is not known.

    The offset is taken at the place at which it does not depend on the error of the normal. Where elements
    that were known before turn out to be wrong by ``error_m``, it is that uncertain.
    """
    if not isinstance(estimate, Plane) or not isinstance(face, Plane):
        return None
    sense = 1.0 if estimate.normal @ face.normal >= 0.0 else -1.0
    covariance = covariance_of(face)
    place = best_known_place(covariance)
    offset_m = estimate.normal @ place + sense * (face.offset_m - face.normal @ place)
    variance = max(float(covariance[3, 3] - covariance[:3, 3] @ place), error_m**2)
    if variance > KNOWN_M**2:
        return None
    own = plane_covariance(covariance_of(estimate)[:3, :3], place, variance)
    return replace(estimate, offset_m=float(offset_m), covariance=own, name=None)


def _key(geometry: ContactGeometry) -> bytes:
    return numbers(geometry.object).tobytes() + numbers(geometry.environment).tobytes()
