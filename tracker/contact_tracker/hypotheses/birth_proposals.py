"""Which elements a new contact may assume: those of the prior map, remembered landmarks, or none."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.geometry.elements import Array, ContactGeometry, Element, Pair, Plane, canonical
from contact_tracker.hypotheses.birth import (
    BirthProposals,
    make_proposals,
    uninformed_proposal,
    with_prior,
)
from contact_tracker.hypotheses.element_prior import ElementPrior
from contact_tracker.landmarks.element_pairs import ElementPair, element_pairs
from contact_tracker.landmarks.landmark_memory import LandmarkMemory
from contact_tracker.landmarks.prior_map import NamedElement, PriorMap, Up
from contact_tracker.map.pairs import map_pairs
from contact_tracker.map.world_map import MapView

CELL_M: Final = 0.25
"""Known lines are parametrised again when the body has moved to another cell of this size."""


class Frame(NamedTuple):
    """Origin of the hypotheses' coordinates in the world, and the cell in which the body is from there
    (m)."""

    origin_m: tuple[float, ...]
    near_m: tuple[float, ...]

    @classmethod
    def around(cls, origin_m: Array, place_m: Array) -> "Frame":
        """The frame with the body at ``place_m`` from the origin."""
        cell_m = [CELL_M * round(coordinate / CELL_M) for coordinate in place_m.tolist()]
        return cls(tuple(origin_m.tolist()), tuple(cell_m))


class CachedProposals(NamedTuple):
    """Proposals with what they were computed from: the landmark memory and the frame."""

    memory: LandmarkMemory
    frame: Frame | None
    proposals: BirthProposals


def propose_births(
    model: ContactModel, knowledge: PriorMap, memory: LandmarkMemory, recognised: float, frame: Frame
) -> BirthProposals:
    """Proposals of a contact for the next tick. Their shares add up to one, unless there are none.

    ``recognised`` is the share of the proposals from the landmark memory, if there are any.
    """
    return _propose_births(model, knowledge, memory, recognised, frame.origin_m, _near_lines(model, frame))


def _near_lines(model: ContactModel, frame: Frame) -> tuple[float, ...] | None:
    """Where lines of the surroundings are parametrised; None for contacts without one."""
    return frame.near_m if model.contact.value[2] == "e" else None


def propose_measured(
    model: ContactModel, knowledge: PriorMap, measured: Pair, frame: Frame
) -> BirthProposals:
    """Proposals of a contact with elements that were ``measured`` otherwise than by motion (object in the
    body frame, surroundings in the world frame), where the prior map does not give them.

    Of a measured normal of the surroundings and the direction up, the more certain one counts.
    """
    ours, theirs = (None if one is None else NamedElement("measured", one) for one in measured)
    if knowledge.up is not None and theirs is not None and not _is_surer_than_up(theirs, knowledge.up):
        theirs = None
    known, near_m = element_pairs(knowledge, model), _near_lines(model, frame)
    return make_proposals(
        model,
        [_with(one, ours, theirs).pair(frame.origin_m) for one in known],
        None if near_m is None else np.array(near_m),
        [one.log_share for one in known],
        range(len(known)),
        [one.certain for one in known],
        [False] * len(known),
    )


@lru_cache(maxsize=2 * len(CONTACT_MODELS))  # the map as other contacts know it rarely changes
def propose_from_map(model: ContactModel, view: MapView, near_m: tuple[float, ...]) -> BirthProposals:
    """Proposals of a contact between elements of the map, or new ones at their price.

    The elements of the map were estimated from the motion at other times, so all that is known of them is in
    the prior, and free motion is as predictable as for a new contact. ``near_m`` as in ``Frame``.
    """
    pairs = map_pairs(view, model, np.array(near_m))
    prior = ElementPrior(np.array([one.mean for one in pairs]), np.array([one.information for one in pairs]))
    nothing = np.zeros(len(pairs), bool)
    return with_prior(
        model,
        prior,
        np.array([one.line_points_m for one in pairs]),
        [one.log_share for one in pairs],
        [0] * len(pairs),
        np.array([one.is_known for one in pairs]),
        nothing,
        nothing.tolist(),
    )


def _is_surer_than_up(measured: NamedElement, up: Up) -> bool:
    """Whether a measured face has a smaller deviation than faces that point up; other elements have none."""
    element = measured.element
    if not isinstance(element, Plane) or element.covariance is None:
        return True
    return bool(np.trace(element.covariance[:3, :3]) < 2.0 * up.spread_rad**2)


@lru_cache(maxsize=64)  # memory and frame rarely change
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
    """The pairs that may be assumed: (pair, log share, index of the known pair, whether from a landmark)."""
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
    """``known`` with remembered elements where it leaves them open; None if both give the same side."""
    if (
        (known.object and remembered.object)
        or (known.environment and remembered.environment)
        or known.certain
    ):
        return None
    filled = _with(known, remembered.object, remembered.environment)
    return filled._replace(log_share=remembered.log_share)


def _with(known: ElementPair, object: NamedElement | None, environment: NamedElement | None) -> ElementPair:
    """``known`` with these elements where it leaves them open."""
    theirs = known.environment or environment
    return ElementPair(known.object or object, theirs, known.log_share, None if theirs else known.up)


def named(geometry: ContactGeometry, known: ElementPair) -> ContactGeometry:
    """The geometry of a hypothesis that assumes ``known``, with the names in the prior map."""
    faces = isinstance(geometry.object, Plane) and isinstance(geometry.environment, Plane)
    return ContactGeometry(
        _named(geometry.object, known.object, faces), _named(geometry.environment, known.environment, faces)
    )


def _named(element: Element, known: NamedElement | None, faces: bool) -> Element:
    """The element with its name. If both are ``faces``, motion does not show the offset: take the known
    one."""
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
