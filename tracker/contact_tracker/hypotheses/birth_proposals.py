"""Which elements a new contact may assume: those that are known, those of the map, or new ones."""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import (
    Array,
    ContactGeometry,
    Element,
    Origins,
    Pair,
    Plane,
    canonical,
)
from contact_tracker.hypotheses.birth import (
    BirthProposals,
    make_proposals,
    uninformed_proposal,
    with_prior,
)
from contact_tracker.map.element_prior import by_feet, pair_priors
from contact_tracker.map.map import Map, NamedElement, Up
from contact_tracker.map.pairs import LearnedPairs, NamedPair, learned_pairs, named_pairs
from contact_tracker.map.view import Key, MapView
from contact_tracker.map.world_map import GrowingMap

CELL_M: Final = 0.25
"""Known lines are parametrised again when the body has moved to another cell of this size."""


class Frame(NamedTuple):
    """Origins of the hypotheses' coordinates in the world and in the body frame, and the cell in which the
    body is from the first (m)."""

    world_m: tuple[float, ...]
    body_m: tuple[float, ...]
    near_m: tuple[float, ...]

    @classmethod
    def around(cls, origins: Origins, place_m: Array) -> "Frame":
        """The frame with the body at ``place_m`` from the origin."""
        cell_m = (CELL_M * np.round(place_m / CELL_M)).tolist()
        return cls(tuple(origins.world_m.tolist()), tuple(origins.body_m.tolist()), tuple(cell_m))


class CachedProposals(NamedTuple):
    """Proposals with what they were computed from: the map without the sightings ``left_out``, the pair that
    touches already, and the frame."""

    map: GrowingMap
    left_out: tuple[int, ...]
    current: tuple[Key, Key] | None
    frame: Frame | None
    proposals: BirthProposals


def propose_births(
    model: ContactModel, known_map: Map, view: MapView | None, incident_share: float, frame: Frame
) -> BirthProposals:
    """Proposals of a contact for the next tick. Their shares add up to one, unless there are none.

    Where the ``known_map`` leaves both elements open, they may be of the map. The elements of the map were
    estimated from the motion at other times, so all that is known of them is in the prior, and free motion is
    as predictable as for a new contact. ``incident_share`` is the prior probability that they are those of
    the last contact, or incident with these, where the contact needs elements of other kinds.
    """
    known, near = named_pairs(known_map, model), _near_lines(model, frame)
    if not known:
        return uninformed_proposal(model).pick(np.zeros(0, np.int64))
    near_m = np.array(frame.near_m)
    pairs, log_share = (
        [one.pair(frame.world_m, frame.body_m) for one in known],
        [one.log_share for one in known],
    )
    number, is_known = list(range(len(known))), [one.is_certain for one in known]
    found: LearnedPairs | None = None
    is_open = [one.object is None and one.environment is None for one in known]
    if view is not None and any(is_open):
        whole, first = log_share[is_open.index(True)], is_open.index(True)
        beside = view.incident_pair(model, near_m)
        if beside is not None and incident_share:
            pairs.append(beside)
            number.append(first)
            is_known.append(False)
            log_share.append(whole + np.log(incident_share))
            whole += np.log1p(-incident_share)
        log_p_new, found = learned_pairs(view, model, near_m)
        log_share[first] = whole + log_p_new
        log_share += (whole + found.log_share).tolist()
        number += [first] * len(found.log_share)
    prior, elements_known = pair_priors(model, pairs), is_known
    if near is not None:
        prior = by_feet(model, prior, near_m)
    if found is not None:
        prior, is_known = prior.and_(found.prior), [*is_known, *found.are_both_known.tolist()]
        elements_known = [*elements_known, *([False] * len(found.log_share))]
    return with_prior(
        model, prior, np.array(log_share), np.array(number), np.array(is_known), np.array(elements_known)
    )


def _near_lines(model: ContactModel, frame: Frame) -> tuple[float, ...] | None:
    """Where lines of the surroundings are parametrised; None for contacts without one."""
    return frame.near_m if model.contact.value[2] == "e" else None


def propose_measured(model: ContactModel, known_map: Map, measured: Pair, frame: Frame) -> BirthProposals:
    """Proposals of a contact with elements that were ``measured`` otherwise than by motion (object in the
    body frame, surroundings in the world frame), where the map does not give them.

    Of a measured normal of the surroundings and the direction up, the more certain one counts.
    """
    ours, theirs = (None if one is None else NamedElement("measured", one) for one in measured)
    if known_map.up is not None and theirs is not None and not _is_surer_than_up(theirs, known_map.up):
        theirs = None
    known, near_m = named_pairs(known_map, model), _near_lines(model, frame)
    return make_proposals(
        model,
        [_with(one, ours, theirs).pair(frame.world_m, frame.body_m) for one in known],
        None if near_m is None else np.array(near_m),
        [one.log_share for one in known],
        range(len(known)),
        [one.is_certain for one in known],
    )


def _is_surer_than_up(measured: NamedElement, up: Up) -> bool:
    """Whether a measured face has a smaller deviation than faces that point up; other elements have none."""
    element = measured.element
    if not isinstance(element, Plane) or element.covariance is None:
        return True
    return bool(np.trace(element.covariance[:3, :3]) < 2.0 * up.spread_rad**2)


def _with(known: NamedPair, object: NamedElement | None, environment: NamedElement | None) -> NamedPair:
    """``known`` with these elements where it leaves them open."""
    theirs = known.environment or environment
    return NamedPair(known.object or object, theirs, known.log_share, None if theirs else known.up)


def named(geometry: ContactGeometry, known: NamedPair) -> ContactGeometry:
    """The geometry of a hypothesis that assumes ``known``, with the names in the map."""
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
