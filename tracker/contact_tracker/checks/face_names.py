"""Names of known faces that a face on a face has by its direction alone, withdrawn where contacts contradict
their place.

Motion of a face on a face does not show where along their normal they are, so a known face of that direction
is taken for the one that is touched. A later contact shows whether it is; until then the result waits.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Final

from contact_tracker.checks.map_use import PARALLEL, MapUse
from contact_tracker.geometry.elements import ContactGeometry, Plane, canonical
from contact_tracker.map.map import Map
from contact_tracker.tracking.belief import FurtherContact, Segment
from contact_tracker.tracking.segmentation import Segmentation

MOST_TICKS: Final = 6000
"""Ticks that wait at most; after them the names are kept as they are."""


class FaceNameDelay:
    """Pieces of a segmentation whose names of known faces are not confirmed yet."""

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
