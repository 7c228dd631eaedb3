"""What a contact that begins may assume: elements that the user knows, elements met before, or nothing."""

from dataclasses import replace
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.assumptions import Assumption, assumptions
from contact_tracker.begins import Begins, fresh
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.form import directions
from contact_tracker.contacts.given import given
from contact_tracker.geometry import Array, ContactGeometry, Element, Line, Plane, canonical
from contact_tracker.knowledge import Knowledge, Known
from contact_tracker.memory import Memory

CELL_M: Final = 0.25
"""Known lines are told anew when the body has gone so far."""
_ANYWHERE: Final = (0.0, 0.0, 0.0)


class Frame(NamedTuple):
    """The world's origin in which hypotheses are, and from there about where the body is (m)."""

    origin_m: tuple[float, ...]
    near_m: tuple[float, ...]

    @classmethod
    def around(cls, origin_m: Array, place_m: Array) -> "Frame":
        """With the body at ``place_m`` from the origin."""
        cell_m = CELL_M * np.round(place_m / CELL_M)
        return cls(tuple(origin_m.tolist()), tuple(cell_m.tolist()))


def beginnings(
    model: ContactModel, knowledge: Knowledge, memory: Memory, recognised: float, frame: Frame
) -> Begins:
    """Hypotheses of a contact that may begin now; their shares add up to one, or there are none.

    ``recognised`` is the share of those that have met their elements before, if there are any.
    """
    if not _has_lines(knowledge, memory):
        frame = frame._replace(near_m=_ANYWHERE)
    return _beginnings(model, knowledge, memory, recognised, frame)


@lru_cache(maxsize=16)
def _has_lines(knowledge: Knowledge, memory: Memory) -> bool:
    surroundings = (*knowledge.environment, *(met.known for met in memory.environment))
    return any(isinstance(known.element, Line) for known in surroundings)


@lru_cache(maxsize=64)  # for as long as nothing is learnt
def _beginnings(
    model: ContactModel, knowledge: Knowledge, memory: Memory, recognised: float, frame: Frame
) -> Begins:
    met = memory.assumptions(model)
    rows: list[tuple[Assumption, float, int, bool]] = []
    for number, known in enumerate(assumptions(knowledge, model)):
        filled = [merged for other in met if (merged := _filled(known, other)) is not None]
        own_share = known.log_share + (float(np.log1p(-recognised)) if filled else 0.0)
        whole = float(np.logaddexp.reduce([other.log_share for other in filled]))
        rows.append((known, own_share, number, False))
        for other in filled:
            share = known.log_share + float(np.log(recognised)) + other.log_share - whole
            rows.append((other, share, number, True))
    if not rows:
        return fresh(model).pick(np.zeros(0, np.int64))
    assumed, log_share, pair, is_met = zip(*rows, strict=True)
    prior, pivot = given(model, [one.pair(*map(np.array, frame)) for one in assumed])
    recalled, told = np.array(is_met), prior.told(model)[:, directions(model.family.FORM)]
    something = prior.information.any(axis=(1, 2)) | recalled
    return Begins(
        source=np.where(something, 1 + np.arange(len(rows)), 0),
        log_share=np.array(log_share),
        known_mean=prior.mean,
        known=prior.information,
        pivot=pivot,
        pair=np.array(pair),
        certain=np.array([one.certain for one in assumed]) & ~recalled,
        searched=~told.all(axis=1) & ~recalled,  # directions are unknown: the rest is a linear problem
        met=recalled,
    )


def _filled(known: Assumption, met: Assumption) -> Assumption | None:
    """``known`` with elements met before where it leaves them open; None if they do not go together."""
    if (known.object and met.object) or (known.environment and met.environment) or known.certain:
        return None
    object, environment = known.object or met.object, known.environment or met.environment
    return Assumption(object, environment, met.log_share, None if environment else known.up)


def named(geometry: ContactGeometry, known: Assumption) -> ContactGeometry:
    """The geometry of a hypothesis that assumes ``known``, with the names that the user gave."""
    faces = isinstance(geometry.object, Plane) and isinstance(geometry.environment, Plane)
    return ContactGeometry(
        _named(geometry.object, known.object, faces), _named(geometry.environment, known.environment, faces)
    )


def _named(element: Element, known: Known | None, faces: bool) -> Element:
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
