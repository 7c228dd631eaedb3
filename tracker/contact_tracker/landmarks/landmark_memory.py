"""Elements met before: the desk is recognised at the second touch (docs/theory.md, T28).

What was found with confidence, of the surroundings in the world's frame and of the object in the body's, is
offered to the hypotheses that begin later, with the accuracy at which it is known. Who recognises an element
has fewer unknowns to pay for.
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
"""An element is kept that belongs to a contact of so much probability."""
LONGER: Final = 1.5
"""Elements are looked at again when their contact has lasted so many times as long."""
KEPT: Final = 2
"""So many elements of each kind and side are remembered, the latest."""
LAST: Final = 3.0
"""An element of the last contact is so many times as likely to touch again as another one."""
LOOSE_M: Final = 0.3e-3
LOOSE_RAD: Final = 2e-3
"""Real elements are not quite the same at the second touch."""


@dataclass(frozen=True, eq=False)
class Landmark:
    """An element, the onset of the contact in which it was met, when it was looked at, and where the body was
    then (3,)."""

    onset_ns: int
    stamp_ns: int
    element: NamedElement
    body_m: Array


@dataclass(frozen=True, eq=False)
class LandmarkMemory:
    """Elements of the object and of the surroundings, each in its own frame, the latest last."""

    object: tuple[Landmark, ...] = ()
    environment: tuple[Landmark, ...] = ()

    def insert(
        self, geometry: ContactGeometry, onset_ns: int, stamp_ns: int, position_m: Array
    ) -> "LandmarkMemory":
        """Remember the elements of a contact as they are told at ``stamp_ns``; what it has taught before is
        replaced.

        ``position_m`` (3,) of the body's origin in the world tells on which side of a face it is.
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
        """When each onset that has taught something can teach more."""
        looked_ns = dict[int, int]()
        for landmark in (*self.object, *self.environment):
            looked_ns[landmark.onset_ns] = max(
                landmark.stamp_ns, looked_ns.get(landmark.onset_ns, landmark.stamp_ns)
            )
        return {onset: onset + math.ceil(LONGER * (stamp - onset)) for onset, stamp in looked_ns.items()}

    def is_due(self, onset_ns: int, stamp_ns: int) -> bool:
        """Whether what began then can teach more at ``stamp_ns`` than it has, whatever contact it is."""
        return stamp_ns >= self.due_ns.get(onset_ns, stamp_ns)

    def assumptions(self, model: ContactModel) -> tuple[ElementPair, ...]:
        """Pairs of elements met before, or of one and an unknown one, where ``_is_plausible_pair``."""
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
    if element.name is not None:  # the user knows it anyway
        return tuple(landmarks)
    new = Landmark(onset_ns, stamp_ns, NamedElement("met before", element), body_m)
    others = [old for old in landmarks if old.onset_ns != onset_ns]
    alike = [old.onset_ns for old in others if old.element.kind == new.element.kind]
    forgotten = alike[: max(len(alike) - KEPT + 1, 0)]
    return (*(old for old in others if old.onset_ns not in forgotten), new)


@lru_cache(maxsize=16)  # the same for all contacts
def _distinct(landmarks: tuple[Landmark, ...]) -> tuple[Landmark, ...]:
    """Those that are one and the same as one, of the latest contact, told by that as far as that tells."""
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
    """What an element of a contact may be: ``element``, or None for an unknown one.

    Whether it is of the last contact, whether it was met itself, and whether none of its kind was met later.
    """

    known: NamedElement | None
    is_last: bool
    was_met: bool
    is_latest: bool = True

    @property
    def weight(self) -> float:
        """So many times as likely as another one."""
        return LAST if self.is_last and self.known is not None else 1.0


@lru_cache(maxsize=64)  # the same for all contacts
def _candidates(landmarks: tuple[Landmark, ...], kind: str, last_ns: int) -> tuple[_Candidate, ...]:
    """What an element of a kind may be, where the last contact is that of ``last_ns``.

    An unknown one is of the last contact, too, where the user knows what touched. An end of the edge met last
    counts as met; what else is next to the last contact does not: an edge through that vertex ...
    """
    offers = [_Candidate(None, all(beside.onset_ns != last_ns for beside in landmarks), True)]
    edges = [beside for beside in landmarks if beside.element.kind == "e"][-1:] if kind == "v" else []
    latest_ns = max((beside.onset_ns for beside in landmarks if beside.element.kind == kind), default=last_ns)
    for beside in landmarks:
        is_last = beside.onset_ns == last_ns
        is_latest = beside.onset_ns >= latest_ns
        if beside.element.kind == kind:
            offers.append(_Candidate(beside.element, is_last, True, is_latest))
        elif is_last or beside in edges:
            offers.append(_Candidate(_incident_landmark(beside, kind), is_last, beside in edges, is_latest))
    return tuple(offers)


def _is_plausible_pair(ours: _Candidate, theirs: _Candidate) -> bool:
    """Whether a contact may be of two elements, of which one at least is known.

    What is next to the last contact goes with what is of that as well. Two that were met go together if one
    of them is of the last contact; what is new on one side goes with the latest of a kind on the other, what
    the user knows and touched last with all.
    """
    if not ((ours.was_met and theirs.was_met) or (ours.is_last and theirs.is_last)):
        return False
    if ours.is_last or theirs.is_last:
        return not (ours.known is None and theirs.known is None)
    is_one_new = (ours.known is None) != (theirs.known is None)
    return is_one_new and ours.is_latest and theirs.is_latest


@lru_cache(maxsize=64)  # the same object as long as it is remembered
def _incident_landmark(landmark: Landmark, kind: str) -> NamedElement:
    return NamedElement(landmark.element.name, incident(landmark.element.element, kind, landmark.body_m))


def _outward(element: Element, position_m: Array, inside: bool) -> Element:
    """A plane with its normal out of the body that it bounds; the object's origin is taken to be in it."""
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
