"""Elements of the map in free coordinates, and the parameters of a contact between two of them.

A plane and a line have no sense here: a normal, or a direction, and its opposite are the same element. A
contact's parameters x have senses, which ``Sighting`` and ``pairs`` choose.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from contact_tracker.contacts import ContactModel, face_face
from contact_tracker.geometry.elements import Array, Element, Line, Plane, Point
from contact_tracker.geometry.vectors import EYE, sphere_tangent, unit

TURNS: Final = {"f": 2, "e": 2, "v": 0}
SHIFTS: Final = {"f": 1, "e": 2, "v": 3}
"""Free coordinates of an element of each kind: angles (rad), then lengths (m)."""
LOOSE_M: Final = 0.3e-3
LOOSE_RAD: Final = 2e-3
"""Standard deviations by which real elements differ from one touch to the next."""
ANY_DIRECTION_RAD: Final = 1.0
"""Standard deviation at which a Gaussian on the tangent has the density of a uniform direction without
sense, 1 / (2 pi)."""


@dataclass(frozen=True, eq=False)
class MapElement:
    """A face (normal, offset), an edge (direction, one of its points) or a vertex (no direction, place).

    ``kind`` is ``f``, ``e`` or ``v``; ``direction`` a unit vector (3,), ``place_m`` (1,) or (3,).
    """

    kind: str
    direction: Array
    place_m: Array

    @property
    def size(self) -> int:
        """Number of free coordinates."""
        return TURNS[self.kind] + SHIFTS[self.kind]

    def moved(self, change: Array) -> "MapElement":
        """The element moved by a change of its free coordinates (P,)."""
        if self.kind == "v":
            return replace(self, place_m=self.place_m + change)
        across, turn, shift = sphere_tangent(self.direction), change[:2], change[2:]
        moved_m = self.place_m + (across @ shift if self.kind == "e" else shift)
        return MapElement(self.kind, unit(self.direction + across @ turn), moved_m)

    def change_to(self, other: "MapElement") -> Array:
        """Change (P,) of the free coordinates from this element to another one nearby."""
        if self.kind == "v":
            return np.asarray(other.place_m - self.place_m)
        across, sense = sphere_tangent(self.direction), 1.0
        if self.direction @ other.direction < 0.0:
            sense = -1.0
        turn = across.T @ (sense * other.direction)
        if self.kind == "f":
            return np.append(turn, sense * other.place_m - self.place_m)
        apart = other.place_m - self.place_m
        apart = apart - other.direction * (other.direction @ apart)
        return np.concatenate([turn, across.T @ apart])

    def with_covariance(self, covariance: Array) -> Element:
        """The element with a covariance (P, P) of its free coordinates."""
        if self.kind == "v":
            return Point(self.place_m, covariance)
        onto = free_directions(self.kind, self.direction)
        spread = onto @ covariance @ onto.T
        if self.kind == "f":
            return Plane(self.direction, float(self.place_m[0]), spread)
        return Line(self.direction, self.place_m, spread)


def free_directions(kind: str, direction: Array) -> Array:
    """Derivative (S, P) of an element's parameters, as of ``geometry.elements.numbers``, by its free
    coordinates: the point of a line moves only across it."""
    if kind == "v":
        return EYE
    free, across = np.zeros((4 if kind == "f" else 6, TURNS[kind] + SHIFTS[kind])), sphere_tangent(direction)
    free[:3, :2], free[3:, 2:] = across, across if kind == "e" else 1.0
    return free


def loose_variance(kind: str) -> Array:
    """Variance (P,) by which real elements differ from one touch to the next."""
    return np.repeat([LOOSE_RAD**2, LOOSE_M**2], [TURNS[kind], SHIFTS[kind]])


def prior_variance(kind: str, reach_m: float) -> Array:
    """Variance (P,) of the free coordinates of an element that nothing is known of."""
    return np.repeat([ANY_DIRECTION_RAD**2, reach_m**2], [TURNS[kind], SHIFTS[kind]])


def kinds_of(model: ContactModel) -> tuple[str, str]:
    """Kinds of the object's and of the environment's element."""
    return model.contact.value[0], model.contact.value[2]


def split(model: ContactModel, x: Array) -> tuple[MapElement, MapElement]:
    """The object's and the environment's element of x (S,); the first face of f-f goes through its origin."""
    first, second = kinds_of(model) if model.body_in_1 else kinds_of(model)[::-1]
    form = model.family.FORM
    one = _element(first, x, form.d1, form.q1, -1)
    other = _element(second, x, form.d2, form.q2, form.h)
    return (one, other) if model.body_in_1 else (other, one)


def _element(kind: str, x: Array, direction: int, point: int, offset: int) -> MapElement:
    if kind == "v":
        return MapElement(kind, np.zeros(3), x[point : point + 3].copy())
    place_m = x[point : point + 3] if kind == "e" else x[offset : offset + 1] if offset >= 0 else np.zeros(1)
    return MapElement(kind, x[direction : direction + 3].copy(), place_m.copy())


def stacked(
    model: ContactModel, pair: tuple[MapElement, MapElement], anchors: Array, senses: Array, turned: float
) -> tuple[Array, Array]:
    """x (S,) of a contact between a pair (object, environment), and its derivative (S, P) by both elements'
    free coordinates.

    Parameters
    ----------
    anchors : (6,) points to which the feet of lines are nearest, in frames 1 and 2.
    senses : (2,) 1 or -1, by which the directions in frames 1 and 2 are multiplied.
    turned : of f-f, 1 if the body turns the first normal into the second one, -1 if into its opposite.
    """
    form, ordered = model.family.FORM, pair if model.body_in_1 else pair[::-1]
    x, derivative = np.zeros(model.family.SIZE), np.zeros((model.family.SIZE, pair[0].size + pair[1].size))
    columns = [slice(0, pair[0].size), slice(pair[0].size, None)][:: 1 if model.body_in_1 else -1]
    places = (form.d1, form.q1), (form.d2, form.q2)
    for i, (one, (direction, point), column) in enumerate(zip(ordered, places, columns, strict=True)):
        if one.kind == "v":
            x[point : point + 3], derivative[point : point + 3, column] = one.place_m, EYE
            continue
        across = sphere_tangent(one.direction)
        x[direction : direction + 3] = senses[i] * one.direction
        by_x = derivative[:, column]
        by_x[direction : direction + 3, :2] = senses[i] * across
        if one.kind == "e":
            arm = anchors[3 * i : 3 * i + 3] - one.place_m
            along = float(one.direction @ arm)
            x[point : point + 3] = one.place_m + one.direction * along
            by_x[point : point + 3, :2] = along * across + np.outer(one.direction, arm @ across)
            by_x[point : point + 3, 2:] = across
        elif i == 1 or model.family is face_face:
            share = senses[i] * (1.0 if i == 1 else -turned)
            x[form.h] += share * one.place_m[0]
            by_x[form.h, 2] += share
    return x, derivative


def with_offset(
    pair: tuple[MapElement, MapElement],
    height_m: float,
    senses: Array,
    turned: float,
    is_new: tuple[bool, bool],
) -> tuple[MapElement, MapElement]:
    """Faces of f-f with the offset of the ``is_new`` one such that the height is ``height_m``."""
    body, world = pair
    if is_new[1]:
        offset = senses[1] * (height_m + turned * senses[0] * float(body.place_m[0]))
        return body, replace(world, place_m=np.array([offset]))
    offset = turned * senses[0] * (senses[1] * float(world.place_m[0]) - height_m)
    return replace(body, place_m=np.array([offset])), world
