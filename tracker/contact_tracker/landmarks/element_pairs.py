"""Pairs of known elements that a hypothesis of a contact may assume, with their prior shares."""

from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import Element, Pair, by_foot, face_towards, shifted
from contact_tracker.landmarks.prior_map import NamedElement, PriorMap, Up

UNLISTED: Final = 0.5
"""Prior probability that the touching element is not listed, where the list is not complete."""


class ElementPair(NamedTuple):
    """A pair of elements of one contact; None stands for an unknown one.

    ``log_share`` is its log share of the contact's weight; the shares of all pairs of a contact add up to
    one.
    """

    object: NamedElement | None
    environment: NamedElement | None
    log_share: float
    up: Up | None = None

    @property
    def touching(self) -> tuple[str | None, str | None]:
        """Names of the object's and of the environment's element; None for an unknown one."""
        return _name(self.object), _name(self.environment)

    @property
    def certain(self) -> bool:
        """Whether both elements are known completely."""
        return self.object is not None and self.environment is not None

    def pair(self, origin_m: tuple[float, ...]) -> Pair:
        """The elements in the frames of x, whose world has its origin at ``origin_m``.

        A line of the object gets the point nearest to the body's origin, which is least correlated with its
        direction.
        """
        ours = None if self.object is None else _of_body(self.object.element)
        theirs = None if self.up is None else _facing(self.up)
        return ours, theirs if self.environment is None else _relative_to_origin(
            self.environment.element, origin_m
        )


@lru_cache(maxsize=512)
def _of_body(element: Element) -> Element:
    return by_foot(element, np.zeros(3))


@lru_cache(maxsize=512)
def _relative_to_origin(element: Element, origin_m: tuple[float, ...]) -> Element:
    """The element from another origin; cached, so that equal elements are one object and their priors are
    found."""
    return shifted(element, -np.array(origin_m))


@lru_cache(maxsize=64)
def element_pairs(knowledge: PriorMap, model: ContactModel) -> tuple[ElementPair, ...]:
    """All pairs that a contact may assume; empty if the prior map rules the contact out."""
    if not knowledge.allows(model.contact):
        return ()
    object_kind, environment_kind = model.contact.value[0], model.contact.value[2]
    up = knowledge.up if environment_kind == "f" else None
    return tuple(
        ElementPair(ours, theirs, our_share + their_share, up if theirs is None else None)
        for ours, our_share in _choices(knowledge.object, object_kind, knowledge.object_complete)
        for theirs, their_share in _choices(
            knowledge.environment, environment_kind, knowledge.environment_complete
        )
    )


def _choices(
    listed: tuple[NamedElement, ...], kind: str, complete: bool
) -> list[tuple[NamedElement | None, float]]:
    """Elements of a kind, and None for an unlisted one, with log shares."""
    known = [element for element in listed if element.kind == kind and not element.is_covered]
    if not known:
        return [] if complete else [(None, 0.0)]
    unlisted = 0.0 if complete else UNLISTED
    listed_share = float(np.log((1.0 - unlisted) / len(known)))
    others = [(None, float(np.log(unlisted)))] if unlisted else []
    return [*((element, listed_share) for element in known), *others]


def _name(known: NamedElement | None) -> str | None:
    return None if known is None else known.name


@lru_cache(maxsize=8)
def _facing(up: Up) -> Element:
    return face_towards(up.direction, up.spread_rad)
