"""What is known of elements before a recording: the map of an earlier one."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from contact_tracker.geometry.elements import Array
from contact_tracker.geometry.vectors import sphere_tangent
from contact_tracker.map.elements import MapElement
from contact_tracker.map.view import Key


@dataclass(frozen=True, eq=False)
class MapPrior:
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
        slots, end = dict[Key, slice](), 0
        for key, one in self.elements.items():
            slots[key] = slice(end, end + one.size)
            end += one.size
        return slots

    def shifted(self, by_m: Array) -> "MapPrior":
        """The same with the environment moved by ``by_m`` (3,), as for another origin of the world."""
        elements, back = dict(self.elements), np.eye(len(self.information))
        for (side, number), rows in self.slots.items():
            one = self.elements[side, number]
            if side == 0:
                continue
            if one.kind != "f":
                elements[side, number] = replace(one, place_m=one.place_m + by_m)
                continue
            elements[side, number] = replace(one, place_m=one.place_m + one.direction @ by_m)
            # the offset changes with the normal, too
            back[rows.stop - 1, rows.start : rows.start + 2] = -by_m @ sphere_tangent(one.direction)
        return replace(self, elements=elements, information=back.T @ self.information @ back)


NO_PRIOR = MapPrior()
