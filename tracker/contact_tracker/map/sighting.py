"""What one contact of a recording says about the pair of elements that touch in it."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from contact_tracker.contacts import CONTACT_MODELS, ContactModel, face_face
from contact_tracker.geometry.elements import Array
from contact_tracker.map.elements import MapElement, kinds_of, split, stacked, with_offset
from contact_tracker.states import Contact

Pair = tuple[MapElement, MapElement]
MAP_INSERTION_PROBABILITY: Final = 0.9
"""Least probability of a contact that tells something about its elements."""
LONGER: Final = 1.5
"""A contact is estimated again when it has lasted this many times as long."""


@dataclass(frozen=True, eq=False)
class ElementEstimate:
    """The estimate of a contact's parameters in one segment: a Gaussian likelihood around x.

    Parameters
    ----------
    contact : whose elements these are.
    x : (S,), the world's origin as in the bank.
    tangent : (S, P) its free directions.
    information : (P, P) of the motion along them; zero along those that it does not show.
    anchors : (6,) to which the feet of lines are nearest.
    rotation : (3, 3) of the body in the middle of the segment.
    """

    contact: Contact
    x: Array
    tangent: Array
    information: Array
    anchors: Array
    rotation: Array

    @property
    def model(self) -> ContactModel:
        return CONTACT_MODELS[self.contact.column]


@dataclass(frozen=True, eq=False)
class Sighting:
    """The ``estimate`` of the elements that touched in the ticks from ``first`` to ``end`` (excluded).

    The contact began at ``onset_ns`` and was estimated at ``stamp_ns``.
    """

    first: int
    end: int
    estimate: ElementEstimate
    onset_ns: int = 0
    stamp_ns: int = 0

    @property
    def due_ns(self) -> int:
        """Time from which the contact, if it lasts, is estimated again."""
        return self.onset_ns + math.ceil(LONGER * (self.stamp_ns - self.onset_ns))

    def gain(self, reach_m: float) -> float:
        """Information (nats) relative to about what is known before."""
        return float(np.linalg.slogdet(np.eye(len(self.information)) + reach_m**2 * self.information)[1])

    @property
    def kinds(self) -> tuple[str, str]:
        """Kinds of the object's and of the environment's element."""
        return kinds_of(self.estimate.model)

    @property
    def information(self) -> Array:
        """(P, P)"""
        return self.estimate.information

    @cached_property
    def root(self) -> Array:
        """A root (P, P) of the information: its product with its transpose."""
        values, axes = np.linalg.eigh(self.information)
        return np.asarray(axes * np.sqrt(np.maximum(values, 0.0)))

    @property
    def has_one_height(self) -> bool:
        """Whether both elements are faces, of whose offsets only the difference shows; it is the last of the
        free directions."""
        return self.estimate.model.family is face_face

    @cached_property
    def own_pair(self) -> Pair:
        """The elements as this sighting alone estimates them."""
        return split(self.estimate.model, self.estimate.x)

    @cached_property
    def _onto_tangent(self) -> Array:
        return np.asarray(np.linalg.pinv(self.estimate.tangent))

    @cached_property
    def _turned(self) -> float:
        """See ``elements.stacked``."""
        x = self.estimate.x
        if not self.has_one_height:
            return 1.0
        return float(np.sign((self.estimate.rotation @ x[face_face.M]) @ x[face_face.N])) or 1.0

    def completed(self, pair: Pair, is_new: tuple[bool, bool]) -> Pair:
        """The pair with the offset of a new face of f-f as estimated here: f-f shows their difference."""
        if not self.has_one_height or is_new[0] == is_new[1]:
            return pair
        height_m = float(self.estimate.x[face_face.H][0])
        return with_offset(pair, height_m, self._senses(pair), self._turned, is_new)

    def linearised(self, pair: Pair) -> tuple[Array, Array]:
        """Residual (P,) of the estimate if this pair touched, and its derivative by their coordinates."""
        one = self.estimate
        x, derivative = stacked(one.model, pair, one.anchors, self._senses(pair), self._turned)
        return self._onto_tangent @ (x - one.x), self._onto_tangent @ derivative

    def _senses(self, pair: Pair) -> Array:
        own = self.own_pair
        senses = [
            1.0 if one.direction @ mine.direction >= 0.0 else -1.0
            for one, mine in zip(pair, own, strict=True)
        ]
        return np.array(senses if self.estimate.model.body_in_1 else senses[::-1])
