"""Pairs of elements that a new contact may touch: those with names, and those of other contacts."""

from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel, face_face
from contact_tracker.geometry.elements import Array, Element, Pair, by_foot, face_towards, shifted
from contact_tracker.map.element_prior import PairPrior
from contact_tracker.map.elements import MapElement, kinds_of, loose_variance, stacked
from contact_tracker.map.map import Map, NamedElement, Up
from contact_tracker.map.view import Key, MapView

UNLISTED: Final = 0.5
"""Prior probability that the touching element is not listed, where the list is not complete."""


class NamedPair(NamedTuple):
    """A pair of named elements; None stands for an unknown one.

    ``log_share`` is its log share of the contact's weight; the shares of all pairs of a contact add up to
    one. ``up`` is of an unknown face of the environment.
    """

    object: NamedElement | None
    environment: NamedElement | None
    log_share: float
    up: Up | None = None

    @property
    def touching(self) -> tuple[str | None, str | None]:
        """Names of the object's and of the environment's element; None for an unknown one."""
        ours, theirs = self.object, self.environment
        return None if ours is None else ours.name, None if theirs is None else theirs.name

    @property
    def is_certain(self) -> bool:
        """Whether both elements are known completely."""
        return self.object is not None and self.environment is not None

    def pair(self, world_m: tuple[float, ...], body_m: tuple[float, ...]) -> Pair:
        """The elements in the frames of x, whose origins are at ``world_m`` and ``body_m``.

        A line of the object gets the point nearest to the origin, which is least correlated with its
        direction.
        """
        ours = None if self.object is None else _of_body(self.object.element, body_m)
        if self.environment is not None:
            return ours, _relative_to_origin(self.environment.element, world_m)
        return ours, None if self.up is None else _facing(self.up)


@lru_cache(maxsize=512)
def _of_body(element: Element, body_m: tuple[float, ...]) -> Element:
    return by_foot(_relative_to_origin(element, body_m), np.zeros(3))


@lru_cache(maxsize=512)
def _relative_to_origin(element: Element, origin_m: tuple[float, ...]) -> Element:
    """The element from another origin; cached, so that equal elements are one object and their priors are
    found."""
    return shifted(element, -np.array(origin_m))


@lru_cache(maxsize=8)
def _facing(up: Up) -> Element:
    return face_towards(up.direction, up.spread_rad)


@lru_cache(maxsize=64)
def named_pairs(known: Map, model: ContactModel) -> tuple[NamedPair, ...]:
    """All pairs that a contact may touch by what has names; empty if the map rules the contact out."""
    if not known.allows(model.contact):
        return ()
    kinds = kinds_of(model)
    up = known.up if kinds[1] == "f" else None
    return tuple(
        NamedPair(ours, theirs, our_share + their_share, up if theirs is None else None)
        for ours, our_share in _choices(known.object, kinds[0], known.object_complete)
        for theirs, their_share in _choices(known.environment, kinds[1], known.environment_complete)
    )


def _choices(
    listed: tuple[NamedElement, ...], kind: str, is_complete: bool
) -> list[tuple[NamedElement | None, float]]:
    """Elements of a kind, and None for an unlisted one, with log shares."""
    own = [element for element in listed if element.kind == kind and not element.is_covered]
    if not own:
        return [] if is_complete else [(None, 0.0)]
    unlisted = 0.0 if is_complete else UNLISTED
    share = float(np.log((1.0 - unlisted) / len(own)))
    others = [(None, float(np.log(unlisted)))] if unlisted else []
    return [*((element, share) for element in own), *others]


class LearnedPairs(NamedTuple):
    """n pairs with an element of the map that other contacts have touched: the ``prior`` of each, whether
    both elements are of the map (``are_both_known``), and its log probability (``log_share``)."""

    prior: PairPrior
    are_both_known: NDArray[np.bool_]
    log_share: Array


def learned_pairs(view: MapView, model: ContactModel, near_m: Array) -> tuple[float, LearnedPairs]:
    """All pairs with an element of the map that a contact may touch, and the log probability of a new pair.

    ``near_m`` (3,) is the body's place in the world. Two faces of the map may face each other or look the
    same way, which their normals do not say. All pairs are computed at once: sixty contacts that share
    nothing make thousands of them.
    """
    are_faces = model.family is face_face
    sides = tuple(_Side.of(view, model, side, near_m) for side in (0, 1))
    ours, theirs = sides
    index = [
        (i, j, way)
        for i, one in enumerate(ours.keys)
        for j, other in enumerate(theirs.keys)
        if (i or j) and (one, other) != view.current
        for way in ((1.0, -1.0) if are_faces and i and j else (1.0,))
    ]
    i, j, way = np.array(index).reshape(-1, 3).T
    i, j, known = i.astype(int), j.astype(int), np.array([i > 0, j > 0])
    both = known[0] & known[1]
    log_share = ours.log_p[i] + theirs.log_p[j] - (np.log(2.0) * both if are_faces else 0.0)
    x = way[:, None] * ours.x[i] + theirs.x[j]
    onto = np.concatenate([way[:, None, None] * ours.onto[i], theirs.onto[j]], axis=1)
    covariance = _covariance(view, ours, theirs, i, j)
    if are_faces:  # of both offsets only the height is a parameter, if both are known
        x[:, face_face.H] *= both[:, None]
        turns, height = [0, 1, 3, 4], np.zeros((len(way), 1, covariance.shape[-1]))
        height[:, 0, 2], height[:, 0, 5] = -way * both, both
        to = np.concatenate([np.broadcast_to(np.eye(6)[turns], (len(way), 4, 6)), height], axis=1)
        covariance = to @ covariance @ to.swapaxes(1, 2)
        covariance[:, 4, 4] += ~both
        by_height = np.zeros((len(way), 1, model.family.SIZE))
        by_height[:, 0, face_face.H] = both[:, None]
        onto = np.concatenate([onto[:, turns], by_height], axis=1)
    information = onto.swapaxes(1, 2) @ np.linalg.inv(covariance) @ onto
    points_m = ours.points_m[i], theirs.points_m[j]
    ordered = points_m if model.body_in_1 else points_m[::-1]
    prior = PairPrior(x, information, np.concatenate(ordered, axis=1))
    return float(ours.log_p[0] + theirs.log_p[0]), LearnedPairs(prior, both, log_share)


class _Side(NamedTuple):
    """The elements (K) of one side that a contact may touch, the first of which is new (None).

    ``log_p`` (K,) their log probabilities, ``x`` (K, S) their entries of x, ``onto`` (K, p, S) the free
    coordinates of each by x, ``rows`` (K, p) of these in the map, ``points_m`` (K, 3) on lines, NaN
    elsewhere. All is zero for a new one.
    """

    kind: str
    keys: list[Key | None]
    log_p: Array
    x: Array
    onto: Array
    rows: NDArray[np.int64]
    points_m: Array

    @classmethod
    def of(cls, view: MapView, model: ContactModel, side: int, near_m: Array) -> "_Side":
        kinds, anchors, form = kinds_of(model), model.anchors(near_m), model.family.FORM
        choices = view.choices(side, kinds[side])
        keys = [key for key, _ in choices]
        other = _stand_in(kinds[1 - side])
        size = _stand_in(kinds[side]).size
        columns = slice(0, size) if side == 0 else slice(-size, None)
        x, onto = np.zeros((len(keys), model.family.SIZE)), np.zeros((len(keys), size, model.family.SIZE))
        rows, points_m = np.zeros((len(keys), size), np.int64), np.full((len(keys), 3), np.nan)
        point = form.q1 if model.body_in_1 == (side == 0) else form.q2
        for k, key in enumerate(keys):
            if key is None:
                continue
            one = view.elements[key]
            pair = (one, other) if side == 0 else (other, one)
            whole, derivative = stacked(model, pair, anchors, np.ones(2), 1.0)
            x[k], by_own = whole, derivative[:, columns]
            if model.family is face_face:
                by_own[face_face.H] = 0.0
            onto[k] = np.linalg.pinv(by_own)
            rows[k] = np.arange(view.slots[key].start, view.slots[key].stop)
            if one.kind == "e":
                points_m[k] = whole[point : point + 3]
        return cls(kinds[side], keys, np.array([log_p for _, log_p in choices]), x, onto, rows, points_m)


def _covariance(
    view: MapView, ours: _Side, theirs: _Side, i: NDArray[np.int64], j: NDArray[np.int64]
) -> Array:
    """Covariance (n, P, P) of the free coordinates of the i-th of our elements and the j-th of theirs; of new
    ones, the identity."""
    rows = np.concatenate([ours.rows[i], theirs.rows[j]], axis=1)
    sizes = ours.rows.shape[1], theirs.rows.shape[1]
    is_known = np.repeat(np.stack([i > 0, j > 0], axis=1), sizes, axis=1)
    within = is_known[:, :, None] & is_known[:, None]
    loose = np.concatenate([loose_variance(side.kind) for side in (ours, theirs)])
    covariance = np.where(within, view.covariance[rows[:, :, None], rows[:, None]], np.eye(len(loose)))
    return np.asarray(covariance + np.diag(loose))


def _stand_in(kind: str) -> MapElement:
    """An element beside which x has the other one only."""
    return MapElement(kind, np.zeros(3), np.zeros(1 if kind == "f" else 3))
