"""What a contact that begins may assume: elements that the user knows, elements met before, or nothing."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import Array, ContactGeometry, Element, Plane, canonical
from contact_tracker.hypotheses.birth import BirthProposals, make_proposals, uninformed_proposal
from contact_tracker.landmarks.element_pairs import ElementPair, element_pairs
from contact_tracker.landmarks.landmark_memory import LandmarkMemory
from contact_tracker.landmarks.prior_map import NamedElement, PriorMap

CELL_M: Final = 0.25
"""Known lines are told anew when the body has gone so far."""


class Frame(NamedTuple):
    """The world's origin in which hypotheses are, and from there about where the body is (m)."""

    origin_m: tuple[float, ...]
    near_m: tuple[float, ...]

    @classmethod
    def around(cls, origin_m: Array, place_m: Array) -> "Frame":
        """With the body at ``place_m`` from the origin."""
        cell_m = [CELL_M * round(coordinate / CELL_M) for coordinate in place_m.tolist()]
        return cls(tuple(origin_m.tolist()), tuple(cell_m))


class CachedProposals(NamedTuple):
    """What a contact may begin with, and what that follows from: what was remembered, about where."""

    memory: LandmarkMemory
    frame: Frame | None
    proposals: BirthProposals


def propose_births(
    model: ContactModel, knowledge: PriorMap, memory: LandmarkMemory, recognised: float, frame: Frame
) -> BirthProposals:
    """Hypotheses of a contact that may begin now; their shares add up to one, or there are none.

    ``recognised`` is the share of those that have met their elements before, if there are any.
    """
    near_m = frame.near_m if model.contact.value[2] == "e" else None
    return _propose_births(model, knowledge, memory, recognised, frame.origin_m, near_m)


@lru_cache(maxsize=64)  # for as long as nothing is learnt, and the body is about there
def _propose_births(
    model: ContactModel,
    knowledge: PriorMap,
    memory: LandmarkMemory,
    recognised: float,
    origin_m: tuple[float, ...],
    near_m: tuple[float, ...] | None,
) -> BirthProposals:
    rows = _assumed(model, knowledge, memory, recognised)
    if not rows:
        return uninformed_proposal(model).pick(np.zeros(0, np.int64))
    assumed, log_share, known_pair_index, remembered = zip(*rows, strict=True)
    certain = [
        one.certain and not is_remembered for one, is_remembered in zip(assumed, remembered, strict=True)
    ]
    near = None if near_m is None else np.array(near_m)
    return make_proposals(
        model, [one.pair(origin_m) for one in assumed], near, log_share, known_pair_index, certain, remembered
    )


def _assumed(
    model: ContactModel, knowledge: PriorMap, memory: LandmarkMemory, recognised: float
) -> list[tuple[ElementPair, float, int, bool]]:
    """What may be assumed, with its log share, the number of the pair that the user knows, and whether
    elements of it were met before."""
    remembered, rows = memory.assumptions(model), []
    for number, known in enumerate(element_pairs(knowledge, model)):
        filled = [merged for other in remembered if (merged := _filled(known, other)) is not None]
        rows.append((known, known.log_share + (math.log1p(-recognised) if filled else 0.0), number, False))
        if filled:
            whole = math.log(sum(math.exp(other.log_share) for other in filled))
            share = known.log_share + math.log(recognised) - whole
            rows += [(other, share + other.log_share, number, True) for other in filled]
    return rows


def _filled(known: ElementPair, remembered: ElementPair) -> ElementPair | None:
    """``known`` with elements met before where it leaves them open; None if they do not go together."""
    if (
        (known.object and remembered.object)
        or (known.environment and remembered.environment)
        or known.certain
    ):
        return None
    object, environment = known.object or remembered.object, known.environment or remembered.environment
    return ElementPair(object, environment, remembered.log_share, None if environment else known.up)


def named(geometry: ContactGeometry, known: ElementPair) -> ContactGeometry:
    """The geometry of a hypothesis that assumes ``known``, with the names that the user gave."""
    faces = isinstance(geometry.object, Plane) and isinstance(geometry.environment, Plane)
    return ContactGeometry(
        _named(geometry.object, known.object, faces), _named(geometry.environment, known.environment, faces)
    )


def _named(element: Element, known: NamedElement | None, faces: bool) -> Element:
    """With the name; where faces slide on each other (``faces``) only the user knows how far out they are."""
    if known is None:
        return canonical(element)
    if faces and isinstance(element, Plane) and isinstance(known.element, Plane):
        assert element.covariance is not None
        assert known.element.covariance is not None
        covariance = np.zeros((4, 4))
        covariance[:3, :3] = element.covariance[:3, :3]
        covariance[3, 3] = known.element.covariance[3, 3]
        side = 1.0 if element.normal @ known.element.normal > 0 else -1.0
        normal, offset_m = side * element.normal, known.element.offset_m
        return Plane(normal, offset_m, covariance, element.unobserved, known.name)
    return replace(element, name=known.name)
