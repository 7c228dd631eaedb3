"""Elements of the map in free coordinates, the parameters of a contact between two of them, what is learned
of all together, and whether two estimates are of one element.

A plane and a line have no sense here: a normal, or a direction, and its opposite are the same element. A
contact's parameters x have senses, which ``Sighting`` and ``pairs`` choose.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from math import inf, sqrt
from typing import Final, TypeVar

import numpy as np
from scipy.linalg import block_diag

from contact_tracker.contacts import ContactModel, face_face
from contact_tracker.geometry import linalg
from contact_tracker.geometry.elements import (
    Array,
    Element,
    Line,
    Origins,
    Plane,
    Point,
    by_foot,
    numbers,
    of_numbers,
    opposite,
)
from contact_tracker.geometry.linalg import EYE, sphere_tangent, unit

Value = TypeVar("Value")
Key = tuple[int, int]
"""Side (0: object, 1: environment) and number of an element."""
KINDS: Final = {"f": "face", "e": "edge", "v": "vertex"}
TURNS: Final = {"f": 2, "e": 2, "v": 0}
SHIFTS: Final = {"f": 1, "e": 2, "v": 3}
"""Free coordinates of an element of each kind: angles (rad), then lengths (m)."""
WIDTHS: Final = {"f": 4, "e": 6, "v": 3}
"""Number of the parameters of an element: three of a direction, if it has one, then lengths (m)."""
LOOSE_M: Final = 0.3e-3
LOOSE_RAD: Final = 2e-3
"""Standard deviations by which real elements differ from one touch to the next."""
PARALLEL: Final = 0.99
"""Least cosine of the angle between the normals of parallel faces: 8 deg."""
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

    @classmethod
    def of(cls, element: Element) -> "MapElement":
        """An element without its covariance."""
        kind, values = kind_of(element), numbers(element)
        return cls(kind, np.zeros(3), values) if kind == "v" else cls(kind, values[:3], values[3:])

    @cached_property
    def across(self) -> Array:
        """Two directions (3, 2) across its own, in which it can turn."""
        return sphere_tangent(self.direction)

    @property
    def size(self) -> int:
        """Number of free coordinates."""
        return TURNS[self.kind] + SHIFTS[self.kind]

    def moved(self, change: Array) -> "MapElement":
        """The element moved by a change of its free coordinates (P,)."""
        if self.kind == "v":
            return replace(self, place_m=self.place_m + change)
        across, turn, shift = self.across, change[:2], change[2:]
        moved_m = self.place_m + (across @ shift if self.kind == "e" else shift)
        return MapElement(self.kind, unit(self.direction + across @ turn), moved_m)

    def change_to(self, other: "MapElement") -> Array:
        """Change (P,) of the free coordinates from this element to another one nearby."""
        if self.kind == "v":
            return np.asarray(other.place_m - self.place_m)
        across, sense = self.across, -1.0 if self.direction @ other.direction < 0.0 else 1.0
        turn = across.T @ (sense * other.direction)
        if self.kind == "f":
            return np.append(turn, sense * other.place_m - self.place_m)
        apart = other.place_m - self.place_m
        apart = apart - other.direction * (other.direction @ apart)
        return np.concatenate([turn, across.T @ apart])

    def parameters(self, near_m: Array | None = None) -> tuple[Array, Array]:
        """The parameters (w,), as of ``geometry.elements.numbers``, and their derivative (w, P) by the free
        coordinates; of an edge with its point nearest to ``near_m``, which moves only across it."""
        if self.kind == "v":
            return self.place_m, EYE
        across, place_m = self.across, self.place_m
        by_free = np.zeros((3 + len(place_m), self.size))
        by_free[:3, :2], by_free[3:, 2:] = across, across if self.kind == "e" else 1.0
        if self.kind == "e" and near_m is not None:
            arm = near_m - place_m
            along = float(self.direction @ arm)
            place_m = place_m + self.direction * along
            by_free[3:, :2] = along * across + np.outer(self.direction, arm @ across)
        return np.concatenate([self.direction, place_m]), by_free

    @property
    def foot(self) -> tuple[Array, Array]:
        """Its point (3,) nearest to the origin, and the derivative (3, P) by the free coordinates."""
        values, by_free = self.parameters(np.zeros(3))
        if self.kind == "f":
            normal, offset_m = values[:3], values[3]
            return offset_m * normal, offset_m * by_free[:3] + np.outer(normal, by_free[3])
        return values[-3:], by_free[-3:]

    def with_covariance(self, covariance: Array, near_m: Array | None = None) -> Element:
        """The element with a covariance (P, P) of its free coordinates, of ``parameters``."""
        values, onto = self.parameters(near_m)
        kind = {"f": Plane, "e": Line, "v": Point}[self.kind]
        return of_numbers(kind, values, onto @ covariance @ onto.T)


def kind_of(element: Element) -> str:
    """``f``, ``e`` or ``v``."""
    match element:
        case Plane():
            return "f"
        case Line():
            return "e"
        case Point():
            return "v"


def loose_variance(kind: str) -> Array:
    """Variance (P,) by which real elements differ from one touch to the next."""
    return np.repeat([LOOSE_RAD**2, LOOSE_M**2], [TURNS[kind], SHIFTS[kind]])


def prior_variance(kind: str, reach_m: float) -> Array:
    """Variance (P,) of the free coordinates of an element that nothing is known of."""
    return np.repeat([ANY_DIRECTION_RAD**2, reach_m**2], [TURNS[kind], SHIFTS[kind]])


@cache
def kinds_of(model: ContactModel) -> tuple[str, str]:
    """Kinds of the object's and of the environment's element."""
    return model.contact.value[0], model.contact.value[2]


def split(model: ContactModel, x: Array) -> tuple[MapElement, MapElement]:
    """The object's and the environment's element of x (S,); the first face of f-f goes through its origin."""
    first, second = kinds_of(model) if model.body_in_1 else kinds_of(model)[::-1]
    form = model.family.FORM
    element_1 = _element(first, x, form.d1, form.q1, -1)
    element_2 = _element(second, x, form.d2, form.q2, form.h)
    return (element_1, element_2) if model.body_in_1 else (element_2, element_1)


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
    for i, (element, (direction, point), column) in enumerate(zip(ordered, places, columns, strict=True)):
        values, by_free = element.parameters(anchors[3 * i : 3 * i + 3])
        if element.kind != "v":
            x[direction : direction + 3] = senses[i] * values[:3]
            derivative[direction : direction + 3, column] = senses[i] * by_free[:3]
        if element.kind != "f":
            x[point : point + 3], derivative[point : point + 3, column] = values[-3:], by_free[-3:]
        elif i == 1 or model.family is face_face:
            share = senses[i] * (1.0 if i == 1 else -turned)
            x[form.h] += share * values[3]
            derivative[form.h, column] += share * by_free[3]
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


MOST_CORNERS: Final = 24
"""Largest number of points around a touched region."""
ANYWHERE_M: Final = 1.0
"""Standard deviation of places that nothing is known of, for users."""


@dataclass(frozen=True, eq=False)
class LearnedElements:
    """A Gaussian on elements of the object (body frame) and of the environment (world frame).

    Parameters
    ----------
    elements : faces, edges and vertices by their keys.
    counts : how many contacts touched each.
    information : (P, P) on the free coordinates of all elements, in the order of these.
    extents : points (N, 3) around the touched region of faces and edges, where they are known.
    outward : normals (3,) of faces out of the bodies that they bound, where the motion shows the side.
    listed : keys of those that the user lists, which no contact need have touched.
    """

    elements: Mapping[Key, MapElement] = field(default_factory=dict)
    counts: Mapping[Key, float] = field(default_factory=dict)
    information: Array = field(default_factory=lambda: np.zeros((0, 0)))
    extents: Mapping[Key, Array] = field(default_factory=dict)
    outward: Mapping[Key, Array] = field(default_factory=dict)
    listed: tuple[Key, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.elements)

    def with_listed(self, side: int, elements: Sequence[Element]) -> "LearnedElements":
        """The same with elements of a side that the user lists, with covariances. Together they count as one
        contact: that they are many does not show that new ones are rare."""
        known, counts, outward = dict(self.elements), dict(self.counts), dict(self.outward)
        blocks, listed = [self.information], list(self.listed)
        for element in elements:
            key = side, 1 + max((number for _, number in known), default=0)
            known[key], counts[key] = MapElement.of(element), 1.0 / len(elements)
            listed.append(key)
            free = known[key].parameters()[1]
            blocks.append(np.asarray(np.linalg.inv(free.T @ covariance_of(element) @ free)))
            if isinstance(element, Plane):
                outward[key] = element.normal
        information = np.asarray(block_diag(*blocks))
        return LearnedElements(known, counts, information, self.extents, outward, tuple(listed))

    @property
    def touched(self) -> frozenset[Key]:
        """Keys of those that contacts of another recording have touched."""
        return frozenset(self.elements) - {*self.listed}

    @property
    def slots(self) -> dict[Key, slice]:
        """Rows of the free coordinates of each element."""
        return slots_of(self.elements, self.elements)

    @property
    def known(self) -> dict[Key, Element]:
        """The elements with their covariances."""
        covariance, slots = self.covariance(), self.slots
        return {
            key: element.with_covariance(covariance[slots[key], slots[key]])
            for key, element in self.elements.items()
        }

    def weak(self, reach_m: float) -> Array:
        """Variance (P,) of elements that nothing is known of."""
        variances = [prior_variance(element.kind, reach_m) for element in self.elements.values()]
        return np.concatenate([np.zeros(0), *variances])

    def covariance(self, reach_m: float = ANYWHERE_M) -> Array:
        """Covariance (P, P) of the free coordinates; wide in what is not known."""
        return np.asarray(np.linalg.inv(self.information + np.diag(1.0 / self.weak(reach_m))))

    def of(self, keys: Collection[Key], reach_m: float) -> "LearnedElements":
        """The elements with these keys, whatever the others are."""
        sizes = [element.size for element in self.elements.values()]
        is_kept = np.repeat(np.array([key in keys for key in self.elements], bool), sizes)
        full = self.information + np.diag(~is_kept / self.weak(reach_m))
        cross, others = full[np.ix_(is_kept, ~is_kept)], full[np.ix_(~is_kept, ~is_kept)]
        information = full[np.ix_(is_kept, is_kept)] - cross @ np.linalg.solve(others, cross.T)

        def kept(values: Mapping[Key, Value]) -> dict[Key, Value]:
            return {key: values[key] for key in self.elements if key in keys and key in values}

        elements, counts = kept(self.elements), kept(self.counts)
        sides = kept(self.extents), kept(self.outward)
        listed = tuple(key for key in self.listed if key in keys)
        return LearnedElements(elements, counts, information, *sides, listed)

    def shifted(self, origins: Origins) -> "LearnedElements":
        """The same in frames in which the present origins are at ``origins``."""
        elements, back = dict(self.elements), np.eye(len(self.information))
        for (side, number), rows in self.slots.items():
            element, by_m = self.elements[side, number], origins.world_m if side else origins.body_m
            if element.kind != "f":
                elements[side, number] = replace(element, place_m=element.place_m + by_m)
                continue
            elements[side, number] = replace(element, place_m=element.place_m + element.direction @ by_m)
            # the offset changes with the normal, too
            back[rows.stop - 1, rows.start : rows.start + 2] = -by_m @ element.across
        shifts_m = origins.body_m, origins.world_m
        extents = {key: points_m + shifts_m[key[0]] for key, points_m in self.extents.items()}
        return replace(self, elements=elements, information=back.T @ self.information @ back, extents=extents)


NOTHING_LEARNED = LearnedElements()


def slots_of(elements: Mapping[Key, MapElement], keys: Iterable[Key]) -> dict[Key, slice]:
    """Rows of the free coordinates of each element."""
    slots, end = dict[Key, slice](), 0
    for key in keys:
        slots[key] = slice(end, end + elements[key].size)
        end = slots[key].stop
    return slots


SAME: Final = 4.0
"""Gate in standard deviations within which two estimates may be of one element."""
ROUNDING: Final = 1e-12
"""Least standard deviation (m, rad) of a coordinate: an exact one differs by rounding."""
LOST: Final = 1e-12
"""Variances below this share of the largest count as zero: rounding errors, or what cannot move."""


def is_same_element(first: Element, second: Element) -> bool:
    """Whether two elements of one kind differ by no more than their covariances allow (docs/theory.md,
    T28)."""
    return mahalanobis(first, second) <= SAME


def mahalanobis(first: Element, second: Element) -> float:
    """Distance of two elements of one kind in standard deviations of their difference.

    Lines may have other points and opposite directions. Normals point out of the bodies, so planes with
    opposite normals are infinitely far apart.
    """
    if isinstance(first, Plane) and isinstance(second, Plane) and first.normal @ second.normal < 0.0:
        return inf
    if covariance_of(second)[:3, :3].trace() < covariance_of(first)[:3, :3].trace():
        first, second = (
            second,
            first,
        )  # the change from the better known direction, or place, is nearly linear
    if isinstance(first, Line) and isinstance(second, Line):
        second = _aligned(second, first)
    start, end = MapElement.of(first), MapElement.of(second)
    free, off = start.parameters()[1], start.change_to(end)
    covariance = free.T @ (covariance_of(first) + covariance_of(second)) @ free
    sd = np.sqrt(covariance.diagonal() + ROUNDING**2)  # one coordinate may be known much better than another
    relative = covariance / (sd[:, None] * sd)
    np.fill_diagonal(relative, 1.0)  # also of a coordinate that is exact, as of a line through a known point
    return float(np.linalg.norm(whitening(relative, 0) @ (off / sd)))


def combined(listed: Element, estimate: Element) -> Element:
    """The mean and covariance of an element by two independent estimates, with the sense of the first."""
    if isinstance(listed, Line) and isinstance(estimate, Line):
        estimate = _aligned(estimate, listed)
    start, end = MapElement.of(listed), MapElement.of(estimate)
    free = start.parameters()[1]
    own, other = (free.T @ covariance_of(element) @ free for element in (listed, estimate))
    gain = np.linalg.solve(own + other, own).T
    return start.moved(gain @ start.change_to(end)).with_covariance(own - gain @ own)


def distance_of_planes_m(first: Plane, second: Plane) -> float:
    """Distance of two planes, without regard to the senses of their normals, where they are known best."""
    sense = np.sign(first.normal @ second.normal) or 1.0
    covariance = covariance_of(first) + covariance_of(second)  # it is the same for the opposite normal
    place = best_known_place(covariance)
    off = (first.normal - sense * second.normal) @ place - (first.offset_m - sense * second.offset_m)
    return abs(float(off))


def best_known_place(covariance: Array) -> Array:
    """The point (3,), in m, at which the offset of a plane does not depend on the error of its normal, by the
    covariance (4, 4) of both."""
    return np.asarray(np.linalg.pinv(covariance[:3, :3], hermitian=True) @ covariance[:3, 3])


def plane_covariance(normal: Array, place_m: Array, variance: float) -> Array:
    """Covariance (4, 4) of a plane by that of its normal (3, 3), about a place (3,) at which its offset has a
    ``variance`` (m^2)."""
    onto = np.vstack([EYE, place_m])
    covariance = onto @ normal @ onto.T
    covariance[3, 3] += variance
    return np.asarray(covariance)


def _aligned(line: Line, like: Line) -> Element:
    """A line with its point nearest to that of ``like``, and with the same sense of direction."""
    near = by_foot(line, like.point_m)
    return near if line.direction @ like.direction >= 0.0 else opposite(near)


def covariance_of(element: Element) -> Array:
    """The covariance of an element that is known."""
    if element.covariance is None:
        raise ValueError("a known element needs a covariance")
    return element.covariance


def whitening(covariance: Array, lengths: int) -> Array:
    """Independent coordinates of variance one, as rows by the n given ones; zero for those without variance.
    The last ``lengths`` of these are in m, others in rad."""
    variance, turns = covariance.diagonal().tolist(), len(covariance) - lengths
    weight = np.array([_unit(variance[:turns])] * turns + [_unit(variance[turns:])] * lengths)
    values, axes = linalg.eigenvectors(weight[:, None] * covariance * weight)
    good = values > LOST * max(float(values[-1]), 0.0)
    return np.asarray(
        np.divide(1.0, values, out=np.zeros_like(values), where=good)[:, None] ** 0.5 * axes.T * weight
    )


def _unit(variance: Sequence[float]) -> float:
    """Scale that makes the largest variance one; one if all are zero."""
    largest = max(variance, default=0.0)
    return 1.0 / sqrt(largest) if largest > 0.0 else 1.0
