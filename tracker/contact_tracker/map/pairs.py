"""Pairs of elements that a new contact may touch, those with names and those of other contacts, as Gaussian
priors on the contact's parameter vector x, which stacks both elements.

Normals point out of the bodies that they bound, so those of touching faces are opposite.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel, face_face
from contact_tracker.geometry.elements import (
    Array,
    Element,
    Line,
    Pair,
    Plane,
    by_foot,
    face_towards,
    numbers,
    shifted,
)
from contact_tracker.map.association import MapView
from contact_tracker.map.elements import (
    Key,
    MapElement,
    covariance_of,
    information_of,
    kinds_of,
    loose_variance,
    stacked,
)
from contact_tracker.map.map import Map, NamedElement, Up

_SMALLEST: Final = 1e-12
"""Variances below this share of the largest count as zero: the element cannot move in these directions."""
_WIDTHS: Final = {"f": 4, "e": 6, "v": 3}
"""Number of the parameters of an element: three of a direction, if it has one, then lengths (m)."""


class PairPrior(NamedTuple):
    """Gaussian priors on x of n pairs: ``mean`` (n, S) and ``information`` (n, S, S), both zero where nothing
    is known, and ``line_points_m`` (n, 6), points of known lines in frames 1 and 2, NaN elsewhere."""

    mean: Array
    information: Array
    line_points_m: Array

    def and_(self, other: "PairPrior") -> "PairPrior":
        """Both, one after the other."""
        return PairPrior(*(np.concatenate(both) for both in zip(self, other, strict=True)))


def known_entries(model: ContactModel, mean: Array, information: Array) -> NDArray[np.bool_]:
    """(..., S) which entries of x a prior with this mean (..., S) and information (..., S, S) fixes.

    A direction is known if its mean is not zero: zero stands for one that is unknown or known in part.
    """
    known = np.asarray(information.diagonal(axis1=-2, axis2=-1) > 0.0)
    form = model.family.FORM
    for first in (form.d1, form.d2):
        if first >= 0:
            part = slice(first, first + 3)
            known[..., part] = mean[..., part].any(axis=-1, keepdims=True)
    return known


def pair_priors(model: ContactModel, pairs: Sequence[Pair]) -> PairPrior:
    """Priors of a contact from n pairs of known elements, which are independent.

    Elements have covariances and are in the frames of x. A direction of zero stands for one that is unknown
    or known in part.
    """
    sides, pivots = rows_of(model, pairs), np.full((len(pairs), 6), np.nan)
    if model.family is face_face:
        return PairPrior(*_facing_prior(*map(_Faces.of, sides)), pivots)
    mean = np.zeros((len(pairs), model.family.SIZE))
    information = np.zeros((*mean.shape, model.family.SIZE))
    first = _WIDTHS[_kinds(model)[0]]
    halves = slice(first), slice(first, None)
    for kind, side, own, point in zip(_kinds(model), sides, halves, (slice(3), slice(3, None)), strict=True):
        parts, width = np.array(side), _WIDTHS[kind]
        mean[:, own], pivots[:, point] = parts[:, :width], parts[:, -3:]
        information[:, own, own] = parts[:, width:-3].reshape(-1, width, width)
    return PairPrior(mean, information, pivots)


def rows_of(model: ContactModel, pairs: Sequence[Pair]) -> tuple[list[Array], list[Array]]:
    """Mean and information of both elements of each pair, in their order in x: rows of ``_part``, for f-f of
    ``_face``."""
    sides = zip(*(pair if model.body_in_1 else pair[::-1] for pair in pairs), strict=True)
    if model.family is face_face:
        first, second = ([_face(element) for element in side] for side in sides)
    else:
        kinds = zip(_kinds(model), sides, strict=True)
        first, second = ([_part(kind, element) for element in side] for kind, side in kinds)
    return first, second


def _kinds(model: ContactModel) -> str:
    """Kinds of the two elements, in their order in x."""
    return model.contact.value[0::2] if model.body_in_1 else model.contact.value[2::-2]


def by_feet(model: ContactModel, prior: PairPrior, near_m: Array) -> PairPrior:
    """Priors with lines of the surroundings parametrised by their points nearest to ``near_m`` (3,).

    That is a linear change of x: the point moves by the change of direction times its distance along the
    line.
    """
    form, world = model.family.FORM, slice(3, 6) if model.body_in_1 else slice(0, 3)
    first = form.d2 if model.body_in_1 else form.d1
    turn, place = slice(first, first + 3), slice(first + 3, first + 6)
    direction = prior.mean[:, turn]
    if not direction.any():
        return prior
    along_m = ((near_m - prior.mean[:, place]) * direction).sum(axis=1, keepdims=True)
    mean, pivots = prior.mean.copy(), prior.line_points_m.copy()
    moves = np.zeros(prior.information.shape[1:])
    mean[:, place] += along_m * direction
    pivots[:, world] += along_m * direction
    moves[place, turn] = np.eye(3)
    back = np.eye(len(moves)) - along_m[:, None] * moves
    return PairPrior(mean, back.swapaxes(1, 2) @ prior.information @ back, pivots)


class _Faces(NamedTuple):
    """n faces of f-f."""

    normal: Array
    """(n, 3)"""
    information: Array
    """(n, 9) on the normals."""
    offset_m: Array
    """(n, 1)"""
    slope: Array
    """(n, 3) regression of the offset on the normal."""
    variance: Array
    """(n, 1) residual variance of the offset, m^2; infinite if it is unknown."""

    @classmethod
    def of(cls, faces: Sequence[Array]) -> "_Faces":
        rows = np.array(faces)
        return cls(rows[:, :3], rows[:, 3:12], rows[:, 12:13], rows[:, 13:16], rows[:, 16:])


def _facing_prior(first: _Faces, second: _Faces) -> tuple[Array, Array]:
    """Mean and information of f-f on both normals, and on the height if both offsets are known."""
    variance = first.variance + second.variance
    weight = np.divide(1.0, variance, out=np.zeros_like(variance), where=variance > 0.0)
    height_m = np.where(np.isfinite(variance), first.offset_m + second.offset_m, 0.0)
    off = np.concatenate([first.slope, -second.slope, np.ones_like(variance)], axis=1)
    information = (weight * off)[:, :, None] * off[:, None]
    information[:, face_face.M, face_face.M] += first.information.reshape(-1, 3, 3)
    information[:, face_face.N, face_face.N] += second.information.reshape(-1, 3, 3)
    return np.concatenate([-first.normal, second.normal, height_m], axis=1), information


@lru_cache(maxsize=256)
def _face(element: Element | None) -> Array:
    """A row of ``_Faces``."""
    if element is None:
        return np.array([*np.zeros(16), np.inf])
    assert isinstance(element, Plane)
    covariance = covariance_of(element)
    information = information_of(covariance[:3, :3], 0)
    slope = information @ covariance[:3, 3]
    off = np.array([*-slope, 1.0])
    variance = off @ covariance @ off  # in this form errors of the slope enter by their square only
    variance *= variance > _SMALLEST * covariance[3, 3]
    return np.concatenate([element.normal, information.ravel(), [element.offset_m], slope, [variance]])


@lru_cache(maxsize=1024)
def _part(kind: str, element: Element | None) -> Array:
    """An element's part of x as one row: mean (w,), information (w, w), and the known point (3,) of a line,
    else NaN."""
    width, pivot = _WIDTHS[kind], np.full(3, np.nan)
    if element is None:
        return np.concatenate([np.zeros(width + width**2), pivot])
    covariance, lengths = covariance_of(element), width - 3 or 3
    if isinstance(element, Line):
        across = np.zeros((6, 6))
        across[:3, :3] = across[3:, 3:] = np.eye(3) - np.outer(element.direction, element.direction)
        information = across @ information_of(across @ covariance @ across, lengths) @ across
        pivot = element.point_m if _goes_through(element) else pivot
    else:
        information = information_of(covariance, lengths)
    return np.concatenate([numbers(element), information.ravel(), pivot])


def _goes_through(line: Line) -> bool:
    """Whether the line's point is known. It is not where the direction is known in part, as for lines in a
    face."""
    return bool(line.direction.any() or not covariance_of(line)[:3, :3].any())


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
    ours, theirs = (_Side.of(view, model, side, near_m) for side in (0, 1))
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
    covariance = view.joint_covariance(ours.rows[i], theirs.rows[j], known, np.ones(onto.shape[1]))
    covariance += np.diag(np.concatenate([loose_variance(kind) for kind in kinds_of(model)]))
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
        rows, points_m = np.array([view.rows(key, size) for key in keys]), np.full((len(keys), 3), np.nan)
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
            if one.kind == "e":
                points_m[k] = whole[point : point + 3]
        return cls(keys, np.array([log_p for _, log_p in choices]), x, onto, rows, points_m)


def _stand_in(kind: str) -> MapElement:
    """An element beside which x has the other one only."""
    return MapElement(kind, np.zeros(3), np.zeros(1 if kind == "f" else 3))
