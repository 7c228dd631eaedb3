"""The landmark memory: a desk is recognised at the second touch (docs/theory.md, T28).

Elements estimated with confidence are stored, those of the surroundings in the world's frame and those of the
object in the body's. Later hypotheses may assume them, with their covariance as a prior; they have fewer
unknowns and so a lower complexity.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import Array, ContactGeometry, Element, Line, Plane, Point
from contact_tracker.geometry.incidence import incident
from contact_tracker.landmarks.association import fuse, is_same_element
from contact_tracker.landmarks.element_pairs import ElementPair
from contact_tracker.landmarks.prior_map import NamedElement

MAP_INSERTION_PROBABILITY: Final = 0.9
"""Elements are stored if the probability of their contact is at least this."""
LONGER: Final = 1.5
"""Elements are stored again when their contact has lasted this many times as long."""
KEPT: Final = 2
"""How many elements of each kind and side are remembered: the latest."""
LAST: Final = 3.0
"""How many times as likely an element of the last contact is to touch as another landmark."""
LOOSE_M: Final = 0.3e-3
LOOSE_RAD: Final = 2e-3
"""Inflation of landmarks' covariances: real elements are not exactly the same at the second touch."""


@dataclass(frozen=True, eq=False)
class Landmark:
    """An element with the onset of its contact, the time of its estimate, and the body's position (3,)
    then."""

    onset_ns: int
    stamp_ns: int
    element: NamedElement
    body_m: Array


@dataclass(frozen=True, eq=False)
class LandmarkMemory:
    """Landmarks of the object (body frame) and of the surroundings (world frame), the latest last."""

    object: tuple[Landmark, ...] = ()
    environment: tuple[Landmark, ...] = ()

    def insert(
        self, geometry: ContactGeometry, onset_ns: int, stamp_ns: int, position_m: Array
    ) -> "LandmarkMemory":
        """Store the elements of a contact, as estimated at ``stamp_ns``; earlier estimates of the same
        contact are replaced.

        ``position_m`` (3,) of the body's origin in the world gives the outward side of a face.
        """
        here = np.zeros(3)
        ours = _inflated(_outward(geometry.object, here, inside=True))
        theirs = _inflated(_outward(geometry.environment, position_m, inside=False))
        when = onset_ns, stamp_ns
        return LandmarkMemory(
            _kept(self.object, *when, ours, here), _kept(self.environment, *when, theirs, position_m)
        )

    @cached_property
    def due_ns(self) -> dict[int, int]:
        """Time from which the elements of each stored contact are due again, by onset."""
        latest_ns = dict[int, int]()
        for landmark in (*self.object, *self.environment):
            latest_ns[landmark.onset_ns] = max(
                landmark.stamp_ns, latest_ns.get(landmark.onset_ns, landmark.stamp_ns)
            )
        return {onset: onset + math.ceil(LONGER * (stamp - onset)) for onset, stamp in latest_ns.items()}

    def is_due(self, onset_ns: int, stamp_ns: int) -> bool:
        """Whether elements of a contact with this onset are due at ``stamp_ns``."""
        return stamp_ns >= self.due_ns.get(onset_ns, stamp_ns)

    def assumptions(self, model: ContactModel) -> tuple[ElementPair, ...]:
        """Plausible pairs of landmarks, or of a landmark and an unknown element."""
        ours, theirs = model.contact.value[0], model.contact.value[2]
        last_ns = max((landmark.onset_ns for landmark in (*self.object, *self.environment)), default=0)
        offers = product(
            _candidates(_distinct(self.object), ours, last_ns),
            _candidates(_distinct(self.environment), theirs, last_ns),
        )
        pairs = [(our, their) for our, their in offers if _is_plausible_pair(our, their)]
        whole = sum(our.weight * their.weight for our, their in pairs)
        return tuple(
            ElementPair(our.known, their.known, math.log(our.weight * their.weight / whole))
            for our, their in pairs
        )


EMPTY_MEMORY: Final = LandmarkMemory()


def _kept(
    landmarks: Sequence[Landmark], onset_ns: int, stamp_ns: int, element: Element, body_m: Array
) -> tuple[Landmark, ...]:
    if element.name is not None:  # it is in the prior map
        return tuple(landmarks)
    new = Landmark(onset_ns, stamp_ns, NamedElement("met before", element), body_m)
    others = [old for old in landmarks if old.onset_ns != onset_ns]
    alike = [old.onset_ns for old in others if old.element.kind == new.element.kind]
    forgotten = alike[: max(len(alike) - KEPT + 1, 0)]
    return (*(old for old in others if old.onset_ns not in forgotten), new)


@lru_cache(maxsize=16)  # the same for all contacts
def _distinct(landmarks: tuple[Landmark, ...]) -> tuple[Landmark, ...]:
    """Landmarks with those fused that are the same element; the result belongs to the latest contact."""
    latest = (one for one in landmarks if not any(_is_same_landmark(one, later) for later in landmarks))
    return tuple(
        _as_before(one, *[old for old in landmarks if _is_same_landmark(old, one)][-1:]) for one in latest
    )


@lru_cache(maxsize=256)  # the same objects as long as they are remembered
def _is_same_landmark(one: Landmark, other: Landmark) -> bool:
    is_later = other.onset_ns > one.onset_ns and other.element.kind == one.element.kind
    return is_later and is_same_element(one.element.element, other.element.element)


@lru_cache(maxsize=64)
def _as_before(one: Landmark, before: Landmark | None = None) -> Landmark:
    if before is None:
        return one
    return replace(
        one, element=replace(one.element, element=fuse(one.element.element, before.element.element))
    )


class _Candidate(NamedTuple):
    """A candidate for an element of a new contact: ``known``, or None for an unknown one.

    With it: whether it is of the last contact, whether it touched itself (else it is incident with one that
    did), and whether it is the latest of its kind.
    """

    known: NamedElement | None
    is_last: bool
    touched_itself: bool
    is_latest: bool = True

    @property
    def weight(self) -> float:
        """Prior weight relative to other candidates."""
        return LAST if self.is_last and self.known is not None else 1.0


@lru_cache(maxsize=64)  # the same for all contacts
def _candidates(landmarks: tuple[Landmark, ...], kind: str, last_ns: int) -> tuple[_Candidate, ...]:
    """Candidates for an element of a kind, after a last contact with onset ``last_ns``.

    The unknown candidate counts as of the last contact where the prior map has the element that touched. An
    end of the last edge counts as having touched; other elements incident with the last contact do not, such
    as an unknown edge through the last vertex.
    """
    offers = [_Candidate(None, all(landmark.onset_ns != last_ns for landmark in landmarks), True)]
    edges = [landmark for landmark in landmarks if landmark.element.kind == "e"][-1:] if kind == "v" else []
    latest_ns = max(
        (landmark.onset_ns for landmark in landmarks if landmark.element.kind == kind), default=last_ns
    )
    for landmark in landmarks:
        is_last = landmark.onset_ns == last_ns
        is_latest = landmark.onset_ns >= latest_ns
        if landmark.element.kind == kind:
            offers.append(_Candidate(landmark.element, is_last, True, is_latest))
        elif is_last or landmark in edges:
            offers.append(
                _Candidate(_incident_landmark(landmark, kind), is_last, landmark in edges, is_latest)
            )
    return tuple(offers)


def _is_plausible_pair(ours: _Candidate, theirs: _Candidate) -> bool:
    """Whether a new contact may be between two candidates, at least one of them a landmark.

    Elements incident with the last contact pair with elements of the last contact. Two landmarks pair if one
    of them is of the last contact. An unknown element pairs with the latest landmark of its kind on the other
    side, and known elements of the last contact pair with all.
    """
    if not ((ours.touched_itself and theirs.touched_itself) or (ours.is_last and theirs.is_last)):
        return False
    if ours.is_last or theirs.is_last:
        return not (ours.known is None and theirs.known is None)
    is_one_new = (ours.known is None) != (theirs.known is None)
    return is_one_new and ours.is_latest and theirs.is_latest


@lru_cache(maxsize=64)  # the same object as long as it is remembered
def _incident_landmark(landmark: Landmark, kind: str) -> NamedElement:
    return NamedElement(landmark.element.name, incident(landmark.element.element, kind, landmark.body_m))


def _outward(element: Element, position_m: Array, inside: bool) -> Element:
    """A plane with its normal out of the body that it bounds; the object's origin is assumed inside the
    object."""
    if not isinstance(element, Plane):
        return element
    height = float(element.normal @ position_m) - element.offset_m
    if (height > 0) != inside:
        return element
    flip = np.diag([-1.0, -1.0, -1.0, -1.0])
    moved = None if element.covariance is None else flip @ element.covariance @ flip
    return replace(element, normal=-element.normal, offset_m=-element.offset_m, covariance=moved)


def _inflated(element: Element) -> Element:
    turn, shift = LOOSE_RAD**2, LOOSE_M**2
    assert element.covariance is not None
    match element:
        case Point():
            more = shift * np.eye(3)
        case Plane(normal):
            more = np.zeros((4, 4))
            more[:3, :3], more[3, 3] = turn * (np.eye(3) - np.outer(normal, normal)), shift
        case Line(direction):
            across = np.eye(3) - np.outer(direction, direction)
            more = np.zeros((6, 6))
            more[:3, :3], more[3:, 3:] = turn * across, shift * across
    return replace(element, covariance=element.covariance + more)
