"""A map as a new contact may use it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import Array, Element, Pair
from contact_tracker.geometry.incidence import incident
from contact_tracker.map.elements import MapElement, kinds_of, loose_variance

Key = tuple[int, int]
"""Side (0: object, 1: environment) and number of an element."""
Side = tuple[int, str]
"""Side and kind of an element."""


@dataclass(frozen=True, eq=False)
class MapView:
    """The map without some of its contacts: ``elements`` that others touched, how often (``counts``), and the
    joint ``covariance`` of their free coordinates, in which each has its ``slots``.

    ``contacts`` as in ``Map``; ``concentration`` is how readily contacts touch new elements;
    ``latest`` are those that the last contact touched, and ``current`` those that touch already, so that they
    do not begin to.
    """

    elements: dict[Key, MapElement]
    counts: dict[Key, int]
    slots: dict[Key, slice]
    covariance: Array
    contacts: Mapping[Side, int]
    concentration: float
    latest: tuple[Key, Key] | None
    current: tuple[Key, Key] | None = None

    def choices(self, side: int, kind: str) -> list[tuple[Key | None, float]]:
        """Elements of a kind, None for a new one, with their log probabilities."""
        known = [key for key, one in self.elements.items() if key[0] == side and one.kind == kind]
        touched = max(sum(self.counts[key] for key in known), self.contacts.get((side, kind), 0))
        total = touched + self.concentration
        return [
            (None, math.log(self.concentration / total)),
            *((key, math.log(self.counts[key] / total)) for key in known),
        ]

    def incident_pair(self, model: ContactModel, near_m: Array) -> Pair | None:
        """The elements of the last contact, or where the contact of ``model`` needs another kind, elements of
        it that are incident with these; None if it needs the same kinds.

        A contact that gains or loses a constraint keeps its elements or changes to incident ones.
        """
        if self.latest is None:
            return None
        kinds, pair = kinds_of(model), list[Element]()
        for key, kind, at_m in zip(self.latest, kinds, (np.zeros(3), near_m), strict=True):
            one, rows = self.elements[key], self.slots[key]
            loose = np.diag(loose_variance(one.kind))
            known = one.with_covariance(self.covariance[rows, rows] + loose)
            pair.append(known if one.kind == kind else incident(known, kind, at_m))
        if all(self.elements[key].kind == kind for key, kind in zip(self.latest, kinds, strict=True)):
            return None
        return pair[0], pair[1]
