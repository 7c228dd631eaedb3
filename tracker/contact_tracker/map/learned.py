"""What is known of elements before a recording: the map of an earlier one."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from contact_tracker.geometry.elements import Array, Origins
from contact_tracker.geometry.vectors import sphere_tangent
from contact_tracker.map.elements import MapElement, prior_variance
from contact_tracker.map.view import Key

ANYWHERE_M: Final = 1.0
"""Standard deviation of places that nothing is known of, for users."""


@dataclass(frozen=True, eq=False)
class LearnedElements:
    """A Gaussian on elements of the object (body frame) and of the environment (world frame).

    Parameters
    ----------
    elements : in order of their keys.
    counts : how many contacts touched each.
    information : (P, P) on the free coordinates of all elements, in the order of these.
    """

    elements: Mapping[Key, MapElement] = field(default_factory=dict)
    counts: Mapping[Key, int] = field(default_factory=dict)
    information: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def __bool__(self) -> bool:
        return bool(self.elements)

    @property
    def slots(self) -> dict[Key, slice]:
        """Rows of the free coordinates of each element."""
        return slots_of(self.elements, self.elements)

    def weak(self, reach_m: float) -> Array:
        """Variance (P,) of elements that nothing is known of."""
        variances = [prior_variance(one.kind, reach_m) for one in self.elements.values()]
        return np.concatenate([np.zeros(0), *variances])

    def covariance(self, reach_m: float = ANYWHERE_M) -> Array:
        """Covariance (P, P) of the free coordinates; wide in what is not known."""
        return np.asarray(np.linalg.inv(self.information + np.diag(1.0 / self.weak(reach_m))))

    def without_weak(self, reach_m: float) -> "LearnedElements":
        """The same without the weak prior, which its information has beside what was seen."""
        sd = np.sqrt(self.weak(reach_m))
        return self.with_scaled(sd[:, None] * self.information * sd - np.eye(len(sd)), sd)

    def with_scaled(self, scaled: Array, sd: Array) -> "LearnedElements":
        """The same with the information of coordinates in units of ``sd`` (P,), symmetric and not negative
        whatever rounding has left."""
        values, axes = np.linalg.eigh(0.5 * (scaled + scaled.T))
        sound = (axes * np.maximum(values, 0.0)) @ axes.T
        return replace(self, information=sound / (sd[:, None] * sd))

    def shifted(self, origins: Origins) -> "LearnedElements":
        """The same in frames in which the present origins are at ``origins``."""
        elements, back = dict(self.elements), np.eye(len(self.information))
        for (side, number), rows in self.slots.items():
            one, by_m = self.elements[side, number], origins.world_m if side else origins.body_m
            if one.kind != "f":
                elements[side, number] = replace(one, place_m=one.place_m + by_m)
                continue
            elements[side, number] = replace(one, place_m=one.place_m + one.direction @ by_m)
            # the offset changes with the normal, too
            back[rows.stop - 1, rows.start : rows.start + 2] = -by_m @ sphere_tangent(one.direction)
        return replace(self, elements=elements, information=back.T @ self.information @ back)


NOTHING_LEARNED = LearnedElements()


def slots_of(elements: Mapping[Key, MapElement], keys: Iterable[Key]) -> dict[Key, slice]:
    """Rows of the free coordinates of each element."""
    slots, end = dict[Key, slice](), 0
    for key in keys:
        slots[key] = slice(end, end + elements[key].size)
        end = slots[key].stop
    return slots
