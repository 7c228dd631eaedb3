"""A map as a new contact may use it."""

import math
from dataclasses import dataclass

import numpy as np

from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import Array, Element, Pair
from contact_tracker.geometry.incidence import incident
from contact_tracker.map.elements import MapElement, kinds_of, loose_variance

Key = tuple[int, int]
"""Side (0: object, 1: environment) and number of an element."""


@dataclass(frozen=True, eq=False)
class MapView:
    """The map without some of its contacts: ``elements`` that others touched, how often (``counts``), and the
    joint ``covariance`` of their free coordinates, in which each has its ``slots``.

    ``log_p_new`` are the log probabilities that a contact touches a new element of the object, and of the
    environment; ``latest`` are those that the last contact touched, and ``current`` those that touch already,
    so that they do not begin to.
    """

    elements: dict[Key, MapElement]
    counts: dict[Key, int]
    slots: dict[Key, slice]
    covariance: Array
    log_p_new: tuple[float, float]
    latest: tuple[Key, Key] | None
    current: tuple[Key, Key] | None = None

    def choices(self, side: int, kind: str) -> list[tuple[Key | None, float]]:
        """Elements of a kind, None for a new one, with their log probabilities.

        Their sum is less than one if no element of the kind is known: contacts with known elements are more
        probable than those with new ones.
        """
        known = [key for key, one in self.elements.items() if key[0] == side and one.kind == kind]
        log_p_new = self.log_p_new[side]
        if not known:
            return [(None, log_p_new)]
        log_share = math.log(-math.expm1(log_p_new) / sum(self.counts[key] for key in known))
        return [(None, log_p_new), *((key, log_share + math.log(self.counts[key])) for key in known)]

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
