"""Data association: priors of elements incident with known ones, sightings of pairs of elements, the map as a
new contact may use it, how well the motion of a contact agrees with each pair of elements of the map, and how
probable new elements are.

On each side, a contact touches a new element with probability a / (N + a) after N contacts, or else a known
one of its kind, each in proportion to how many have touched it (a Chinese restaurant process). Whether an
element is new is decided before its kind: a new edge costs as much as a new face. The concentration a is that
of the recording.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import gammaln

from contact_tracker.contacts import CONTACT_MODELS, ContactModel, face_face
from contact_tracker.geometry.elements import Array, Element, Line, Pair, Plane, Point, nearest
from contact_tracker.geometry.linalg import EYE
from contact_tracker.hmm import log_sum_exp
from contact_tracker.map.elements import (
    SHIFTS,
    TURNS,
    WIDTHS,
    Key,
    MapElement,
    best_known_place,
    covariance_of,
    kinds_of,
    loose_variance,
    plane_covariance,
    prior_variance,
    split,
    stacked,
    with_offset,
)
from contact_tracker.states import Contact

LENGTH_M: Final = 0.2
"""Distance of the ends of an edge from its point nearest to the body."""
ANYWHERE_M: Final = 10.0
"""Standard deviation of an unknown position."""


def incident(element: Element, kind: str, near_m: Array) -> Element:
    """Prior of an element of another ``kind`` (f, e or v) that is incident with ``element`` near ``near_m``
    (3,). Directions that are unknown, or known in part, are zero, see ``known_entries`` of ``map.pairs``."""
    covariance, unknown = covariance_of(element), np.zeros(3)
    match element, kind:
        case Line(direction, point_m), "v":
            along = np.outer(direction, direction)
            return Point(point_m, covariance[3:, 3:] + LENGTH_M**2 * (along + covariance[:3, :3]))
        case Point(point_m), "e":
            return Line(unknown, point_m, block_diag(np.zeros((3, 3)), covariance))
        case Line(direction, point_m), "f":
            along = np.outer(direction, direction)
            turn, shift = (0.5 * float(part.trace()) for part in (covariance[:3, :3], covariance[3:, 3:]))
            return Plane(unknown, 0.0, plane_covariance(EYE - along + turn * along, point_m, shift))
        case Point(point_m), "f":
            return Plane(unknown, 0.0, plane_covariance(EYE, point_m, float(covariance.trace()) / 3.0))
        case Plane(normal), _:
            out, tilt = np.outer(normal, normal), 0.5 * float(covariance[:3, :3].trace())
            height = float(covariance[3, 3] - best_known_place(covariance) @ covariance[:3, 3])
            height = max(height, 0.0) + tilt * (0.5 * LENGTH_M) ** 2  # of positions near the contact
            place_m, places = nearest(element, near_m), ANYWHERE_M**2 * (EYE - out) + height * out
            if kind == "v":
                return Point(place_m, places)
            return Line(unknown, place_m, block_diag(EYE - out + tilt * out, places))
    raise ValueError(f"{kind} is the kind of the element itself")


MapPair = tuple[MapElement, MapElement]
"""Elements of the object and of the environment."""
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

    def is_part_of(self, later: "Sighting") -> bool:
        """Whether a sighting that knows later ticks is of the same contact at that time."""
        is_same_kind = self.estimate.contact is later.estimate.contact
        return is_same_kind and later.first < self.end and self.first < later.end

    def is_beside(self, other: "Sighting") -> bool:
        """Whether one contact changes to the other, without free motion between."""
        return abs(self.first - other.end) <= 1 or abs(other.first - self.end) <= 1

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
    def own_pair(self) -> MapPair:
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

    def completed(self, pair: MapPair, is_new: tuple[bool, bool]) -> MapPair:
        """The pair with the offset of a new face of f-f as estimated here: f-f shows their difference."""
        if not self.has_one_height or is_new[0] == is_new[1]:
            return pair
        height_m = float(self.estimate.x[face_face.H][0])
        return with_offset(pair, height_m, self._senses(pair), self._turned, is_new)

    def linearised(self, pair: MapPair) -> tuple[Array, Array]:
        """Residual (P,) of the estimate if this pair touched, and its derivative by their coordinates."""
        estimate = self.estimate
        x, derivative = stacked(estimate.model, pair, estimate.anchors, self._senses(pair), self._turned)
        return self._onto_tangent @ (x - estimate.x), self._onto_tangent @ derivative

    def _senses(self, pair: MapPair) -> Array:
        estimates = self.own_pair
        senses = [
            1.0 if element.direction @ estimated.direction >= 0.0 else -1.0
            for element, estimated in zip(pair, estimates, strict=True)
        ]
        return np.array(senses if self.estimate.model.body_in_1 else senses[::-1])


class Side(NamedTuple):
    """The elements (K) of one side and kind that a contact may touch, the first of which is new (None).

    ``log_p`` (K,) are their log probabilities, ``elements`` have covariances as they differ from one touch to
    the next, ``by_free`` (K, w, p) are the derivatives of their parameters by their free coordinates, and
    ``rows`` (K, p) the rows of these in the covariance of the map; zero for a new one.
    """

    keys: list[Key | None]
    log_p: Array
    elements: list[Element | None]
    by_free: Array
    rows: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class MapView:
    """The map without some of its contacts: ``elements`` that others touched, how often (``counts``), and the
    joint ``covariance`` of their free coordinates, in which each has its ``slots``.

    ``log_p_new`` are the log probabilities that a contact touches a new element of the object, and of the
    environment; ``latest`` are those that the last contact touched, and ``current`` those that touch already,
    so that they do not begin to.
    """

    elements: dict[Key, MapElement]
    counts: dict[Key, float]
    slots: dict[Key, slice]
    covariance: Array
    log_p_new: tuple[float, float]
    latest: tuple[Key, Key] | None
    current: tuple[Key, Key] | None = None
    sides: dict[tuple[object, ...], Side] = field(default_factory=dict)
    asked: dict[tuple[object, ...], Element] = field(default_factory=dict)
    """Those that were asked for so far; as the same objects, whose priors are known."""
    incident_share: float = 0.0
    """Share of new vertices that are on an edge or in a face of the map, see ``with_incident_vertices``."""

    def with_incident_vertices(self, share: float, reach_m: float) -> "MapView":
        """The same with a vertex anywhere on each edge and in each face, to touch with this ``share`` of the
        probability of a new one.

        It has the covariances with all elements that its edge or face has, beside a standard deviation of
        ``reach_m`` along that: where of a face only the distance to another is known, that of the vertex is.
        """
        elements, slots, end = dict(self.elements), dict(self.slots), len(self.covariance)
        by_known, free = [np.eye(end)], [np.zeros((end, end))]
        for (side, number), element in self.elements.items():
            if element.kind == "v":
                continue
            foot_m, by_free = element.foot
            along = np.outer(element.direction, element.direction)
            elements[side, ~number], slots[side, ~number] = MapElement.of(Point(foot_m)), slice(end, end + 3)
            by_known.append(np.zeros((3, len(self.covariance))))
            by_known[-1][:, self.slots[side, number]] = by_free
            rows, across = self.slots[side, number], element.across
            turns = self.covariance[rows, rows][:2, :2]  # they move what is away from the foot
            if element.kind == "e":
                free.append(reach_m**2 * (along + across @ turns @ across.T))
            else:
                free.append(reach_m**2 * (EYE - along + turns.trace() * along))
            end += 3
        onto = np.concatenate(by_known)
        covariance = onto @ self.covariance @ onto.T + block_diag(*free)
        return replace(
            self,
            elements=elements,
            slots=slots,
            covariance=covariance,
            incident_share=share,
            sides={},
            asked={},
        )

    def side(self, side: int, kind: str, near_m: Array) -> Side:
        """The elements of a side and kind, edges with their points nearest to ``near_m`` (3,)."""
        query = side, kind, *near_m.tolist()
        if query not in self.sides:
            keys, log_p = zip(*self.choices(side, kind), strict=True)
            known_keys = [key for key in keys if key is not None]
            nothing = np.zeros((WIDTHS[kind], TURNS[kind] + SHIFTS[kind]))
            by_free = [nothing, *(self.elements[key].parameters(near_m)[1] for key in known_keys)]
            rows = np.array([self.rows(key, nothing.shape[1]) for key in keys])
            elements = [None, *(self.element(key, kind, near_m) for key in known_keys)]
            self.sides[query] = Side([*keys], np.array(log_p), elements, np.array(by_free), rows)
        return self.sides[query]

    def element(self, key: Key, kind: str, near_m: Array) -> Element:
        """An element as it differs from one touch to the next, an edge by its point nearest to ``near_m``
        (3,); of another ``kind``, one that is incident with it there."""
        query = key, kind, *near_m.tolist()
        if query not in self.asked:
            element, rows = self.elements[key], self.slots[key]
            covariance = self.covariance[rows, rows] + np.diag(loose_variance(element.kind))
            with_covariance = element.with_covariance(covariance, near_m if element.kind == kind else None)
            self.asked[query] = (
                with_covariance if element.kind == kind else incident(with_covariance, kind, near_m)
            )
        return self.asked[query]

    def cross_covariance(self, body: Side, i: NDArray[np.int64], world: Side, j: NDArray[np.int64]) -> Array:
        """Covariances (n, w, w') of the parameters of the i-th elements (n,) of the object with those of the
        j-th (n,) of the environment; zero for new ones."""
        free = self.covariance[body.rows[i][:, :, None], world.rows[j][:, None]]
        return body.by_free[i] @ free @ world.by_free[j].swapaxes(1, 2)

    def choices(self, side: int, kind: str) -> list[tuple[Key | None, float]]:
        """Elements of a kind, None for a new one, with their log probabilities.

        Their sum is less than one if no element of the kind is known: contacts with known elements are more
        probable than those with new ones.
        """
        of_kind = [key for key, element in self.elements.items() if key[0] == side and element.kind == kind]
        known_keys = [key for key in of_kind if key in self.counts]
        incident = [key for key in of_kind if key not in self.counts]
        log_p_new, of_new = self.log_p_new[side], self.incident_share if incident else 0.0
        chosen: list[tuple[Key | None, float]] = [(None, log_p_new + math.log1p(-of_new))]
        chosen += [(key, log_p_new + math.log(of_new / len(incident))) for key in incident]
        if known_keys:
            log_share = math.log(-math.expm1(log_p_new) / sum(self.counts[key] for key in known_keys))
            chosen += [(key, log_share + math.log(self.counts[key])) for key in known_keys]
        return chosen

    def rows(self, key: Key | None, size: int) -> NDArray[np.int64]:
        """Rows of the free coordinates of an element in the covariance; zeros for a new one."""
        return np.zeros(size, np.int64) if key is None else np.arange(size) + self.slots[key].start

    def incident_pair(self, model: ContactModel, near_m: Array) -> Pair | None:
        """The elements of the last contact, or where the contact of ``model`` needs another kind, elements of
        it that are incident with these; None if it needs the same kinds.

        A contact that gains or loses a constraint keeps its elements or changes to incident ones. Without
        this prior, labels of six sequences are right for 0.830 of the time online instead of 0.853, and
        four hard recordings surely wrong for 0.037 of the time offline instead of 0.010.
        """
        kinds = kinds_of(model)
        if self.latest is None or all(
            self.elements[key].kind == kind for key, kind in zip(self.latest, kinds, strict=True)
        ):
            return None
        at_m = np.zeros(3), near_m
        body, world = (self.element(*query) for query in zip(self.latest, kinds, at_m, strict=True))
        return body, world


CONCENTRATIONS: Final = np.logspace(-2.0, 1.0, 13)
"""Equally probable concentrations, between which the map decides while it grows: new elements become cheap
where each contact has elements of its own, and dear where some are touched again. On ten recordings of all
kinds, online, a fixed one of 0.3 gives 0.730 and these 0.731; on those of single contacts 0.667 and 0.677, in
the first pass offline 0.818 and 0.890. With a price for each kind (0.3) it is 0.710 online."""
CONCENTRATION: Final = (0.2, 0.02)
"""Concentrations of the object and of the environment offline, where all contacts count, of which few are
sure enough to tell them: an object shows more of its elements than its place. On ten recordings of all kinds
these give 0.908, 0.02 for both 0.900 and ``CONCENTRATIONS`` 0.862; single contacts are not taken as one
world, as it does not explain them better."""


def log_probabilities_of_new(
    counts: Mapping[tuple[int, int], float], contacts: int | None
) -> tuple[float, float]:
    """Log probabilities of a new element of the object and of one of the environment.

    Parameters
    ----------
    counts : how many contacts touched each element, by its side and number.
    contacts : how many there were in the whole recording, sure or not; None while the map grows.
    """
    touched = [[n for (own_side, _), n in counts.items() if own_side == side] for side in (0, 1)]
    if contacts is not None:
        body_log_p, world_log_p = (
            math.log(a / (max(sum(numbers), contacts) + a))
            for numbers, a in zip(touched, CONCENTRATION, strict=True)
        )
        return body_log_p, world_log_p
    a, log_weight = CONCENTRATIONS, np.zeros(len(CONCENTRATIONS))
    for numbers in touched:
        log_weight += len(numbers) * np.log(a) + gammaln(a) - gammaln(a + sum(numbers))
    log_weight -= log_sum_exp(log_weight)
    body_log_p, world_log_p = (
        float(log_sum_exp(log_weight + np.log(a / (sum(numbers) + a)))) for numbers in touched
    )
    return body_log_p, world_log_p


def log_prior_of_new(contacts: int) -> float:
    """Log prior probability that so many contacts all touched elements of their own."""
    return sum(math.log(a / (touched + a)) for a in CONCENTRATION for touched in range(contacts))


Choices = list[list[tuple[Key | None, float]]]


def weigh_pairs(sighting: Sighting, view: MapView, reach_m: float) -> tuple[Choices, Array]:
    """The choices of each side, None for a new element, and the log weights (I, J) of their pairs: prior
    probability times evidence of the sighting."""
    choices = [view.choices(side, kind) for side, kind in enumerate(sighting.kinds)]
    log_weight = log_evidence(sighting, view, choices, reach_m)
    log_weight += np.add.outer(*([log_p for _, log_p in side] for side in choices))
    return choices, log_weight


def log_marginal(sighting: Sighting, view: MapView, reach_m: float) -> float:
    """Log probability of a sighting whatever it touched, relative to all others that use the same ones."""
    return float(log_sum_exp(weigh_pairs(sighting, view, reach_m)[1].ravel()))


def log_odds_of_known(sighting: Sighting, view: MapView, reach_m: float) -> float:
    """Log odds that a sighting touched an element of the map, on either side, against two new ones."""
    log_weight = weigh_pairs(sighting, view, reach_m)[1].ravel()
    return float(log_sum_exp(log_weight[1:]) - log_weight[0]) if len(log_weight) > 1 else -math.inf


def log_evidence(
    sighting: Sighting, view: MapView, choices: Sequence[Sequence[tuple[Key | None, float]]], reach_m: float
) -> Array:
    """Log evidence (I, J) of a sighting if it touched the i-th of the object's choices and the j-th of the
    environment's; None stands for a new element, which is as estimated."""
    body, world = (_contributions(sighting, view, side, [key for key, _ in choices[side]]) for side in (0, 1))
    i, j = np.indices((len(choices[0]), len(choices[1]))).reshape(2, -1)
    residual = body[0][i] + world[0][j]
    if sighting.has_one_height:  # a new face has the offset that was estimated
        residual[(i == 0) | (j == 0), -1] = 0.0
    # new elements are independent of all others
    rows = np.concatenate([body[2][i], world[2][j]], axis=1)
    is_known = np.repeat(np.stack([i > 0, j > 0], axis=1), (body[2].shape[1], world[2].shape[1]), axis=1)
    of_new = np.diag(np.concatenate([prior_variance(kind, reach_m) for kind in sighting.kinds]))
    covariance = view.covariance if view.slots else np.zeros((1, 1))
    are_known = is_known[:, :, None] & is_known[:, None]
    joint = np.where(are_known, covariance[rows[:, :, None], rows[:, None]], of_new)
    whitened = sighting.root.T @ np.concatenate([body[1][i], world[1][j]], axis=2)
    ratio = np.eye(residual.shape[-1]) + whitened @ joint @ whitened.swapaxes(1, 2)
    residual = residual @ sighting.root
    misfit = (residual * np.linalg.solve(ratio, residual[..., None])[..., 0]).sum(axis=-1)
    log_ratio = -0.5 * (np.linalg.slogdet(ratio)[1] + misfit)
    return np.asarray(log_ratio.reshape(len(choices[0]), len(choices[1])))


def _contributions(
    sighting: Sighting, view: MapView, side: int, keys: list[Key | None]
) -> tuple[Array, Array, NDArray[np.int64]]:
    """What the choices (I) of one side contribute to a sighting's residual (P,): the difference (I, P) from
    the sighting's own element, the derivative (I, P, p) by the p free coordinates of each, and the rows (I,
    p) of these in the map (any for a new one)."""
    estimates = sighting.own_pair
    columns = slice(estimates[0].size) if side == 0 else slice(estimates[0].size, None)
    offsets, derivatives, rows = [], [], []
    for key in keys:
        element = estimates[side] if key is None else view.elements[key]
        residual, derivative = sighting.linearised(
            (element, estimates[1]) if side == 0 else (estimates[0], element)
        )
        offsets.append(residual)
        derivatives.append(derivative[:, columns])
        rows.append(view.rows(key, element.size))
    return np.array(offsets), np.array(derivatives), np.array(rows)
