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
    Origins,
    Pair,
    Plane,
    by_foot,
    face_towards,
    numbers,
    opposite,
    shifted,
)
from contact_tracker.geometry.linalg import EYE
from contact_tracker.map.association import MapView
from contact_tracker.map.elements import LOST, WIDTHS, covariance_of, kinds_of, whitening
from contact_tracker.map.map import Map, NamedElement, Up


class PairPrior(NamedTuple):
    """Gaussian priors on x of n pairs: ``mean`` (n, S) and ``information`` (n, S, S), both zero where nothing
    is known, and ``line_points_m`` (n, 6), points of known lines in frames 1 and 2, NaN elsewhere."""

    mean: Array
    information: Array
    line_points_m: Array


def known_entries(model: ContactModel, mean: Array, information: Array) -> NDArray[np.bool_]:
    """(..., S) which entries of x a prior with this mean (..., S) and information (..., S, S) fixes.

    A direction is known if its mean is not zero: zero stands for one that is unknown or known in part.
    """
    is_known = np.asarray(information.diagonal(axis1=-2, axis2=-1) > 0.0)
    form = model.family.FORM
    for column in (form.d1, form.d2):
        if column >= 0:
            part = slice(column, column + 3)
            is_known[..., part] = mean[..., part].any(axis=-1, keepdims=True)
    return is_known


def pair_priors(model: ContactModel, pairs: Sequence[Pair], cross: Array | None = None) -> PairPrior:
    """Priors of a contact from n pairs of known elements.

    Elements have covariances and are in the frames of x. A direction of zero stands for one that is unknown
    or known in part. ``cross`` (n, w, w') are covariances of the parameters of both elements of a pair, in
    their order in x; by default they are independent.
    """
    kinds = model.contact.value[0::2] if model.body_in_1 else model.contact.value[2::-2]
    sides = zip(*(pair if model.body_in_1 else pair[::-1] for pair in pairs), strict=True)
    width, size = WIDTHS[kinds[0]], sum(WIDTHS[kind] for kind in kinds)
    mean, variance, points_m = np.zeros((len(pairs), size)), np.ones((len(pairs), size)), list[Array]()
    onto = np.zeros((len(pairs), size, size))
    for kind, side, columns in zip(kinds, sides, (slice(width), slice(width, size)), strict=True):
        parts, w = np.array([_part(kind, element) for element in side]), WIDTHS[kind]
        mean[:, columns], variance[:, columns] = parts[:, :w], parts[:, -3 - w : -3]
        onto[:, columns, columns] = parts[:, w:][:, : w**2].reshape(-1, w, w)
        points_m.append(parts[:, -3:])
    linked = np.flatnonzero([] if cross is None else cross.any(axis=(1, 2)))
    joint = variance[linked, :, None] * np.eye(size)
    if cross is not None and linked.size:
        joint[:, :width, width:] = onto[linked, :width, :width] @ cross[linked]
        joint[:, :width, width:] @= onto[linked, width:, width:].swapaxes(1, 2)
        joint[:, width:, :width] = joint[:, :width, width:].swapaxes(1, 2)
    if model.family is face_face:
        mean, variance = mean @ _FACING.T, np.add.reduceat(variance[:, [0, 1, 2, 4, 5, 6, 3, 7]], range(7), 1)
        onto, joint = _SUMS @ onto @ _APART, _SUMS @ joint @ _SUMS.T
        mean[np.isinf(variance[:, -1]), face_face.H] = 0.0
    weight = np.divide(1.0, variance, out=np.zeros_like(variance), where=variance > 0.0)
    along = onto.swapaxes(1, 2)
    information = along @ (weight[:, :, None] * onto)
    if linked.size:
        information[linked] = along[linked] @ np.linalg.inv(joint) @ onto[linked]
    return PairPrior(mean, information, np.concatenate(points_m, axis=1))


_FACING: Final = np.zeros((7, 8))
"""x of f-f by normal and offset of both faces: of the offsets it has the sum, as the normals are opposite."""
_FACING[:3, :3], _FACING[3:6, 4:7], _FACING[6, [3, 7]] = -np.eye(3), np.eye(3), 1.0
_SUMS: Final = np.abs(_FACING)
_APART: Final = np.linalg.pinv(_FACING)


@lru_cache(maxsize=1024)
def _part(kind: str, element: Element | None) -> Array:
    """What an element tells about its w parameters, as one row: their mean (w,), the independent coordinates
    (w, w) that are known, by them, the variances (w,) of these, and the known point (3,) of a line, else NaN.

    The last coordinate of a face is its offset less its regression on the normal, of infinite variance if
    the face is unknown.
    """
    width, point_m = WIDTHS[kind], np.full(3, np.nan)
    mean, onto, variance = np.zeros(width), np.zeros((width, width)), np.ones(width)
    if element is None:
        variance[-1] = np.inf
        return np.concatenate([mean, onto.ravel(), variance, point_m])
    covariance = covariance_of(element)
    if isinstance(element, Plane):
        turns = onto[:3, :3] = whitening(covariance[:3, :3], 0)
        onto[3] = np.array([*-(turns.T @ (turns @ covariance[:3, 3])), 1.0])
        variance[3] = onto[3] @ covariance @ onto[3]  # errors of the slope enter by their square only
        variance[3] *= variance[3] > LOST * covariance[3, 3]
    elif isinstance(element, Line):
        across = np.zeros((6, 6))
        across[:3, :3] = across[3:, 3:] = EYE - np.outer(element.direction, element.direction)
        onto = whitening(across @ covariance @ across, 3) @ across
        if element.direction.any() or not covariance[:3, :3].any():  # else it is known in part, as in a face
            point_m = element.point_m
    else:
        onto = whitening(covariance, 3)
    return np.concatenate([numbers(element), onto.ravel(), variance, point_m])


CELL_M: Final = 0.25
"""Known lines are parametrised again when the body has moved to another cell of this size."""


class Frame(NamedTuple):
    """Origins of the hypotheses' coordinates in the world and in the body frame, and the cell in which the
    body is from the first (m)."""

    world_m: tuple[float, ...]
    body_m: tuple[float, ...]
    near_m: tuple[float, ...]

    @classmethod
    def around(cls, origins: Origins, place_m: Array) -> "Frame":
        """The frame with the body at ``place_m`` from the origin."""
        cell_m = (CELL_M * np.round(place_m / CELL_M)).tolist()
        return cls(tuple(origins.world_m.tolist()), tuple(origins.body_m.tolist()), tuple(cell_m))


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
        body, world = self.object, self.environment
        return None if body is None else body.name, None if world is None else world.name

    @property
    def is_certain(self) -> bool:
        """Whether both elements are known completely."""
        return self.object is not None and self.environment is not None

    def pair(self, frame: Frame) -> Pair:
        """The elements in the frames of x.

        Lines get their points nearest to the body, which are least correlated with their directions.
        """
        body = None if self.object is None else _placed(self.object.element, frame.body_m, _AT_ORIGIN)
        if self.environment is not None:
            return body, _placed(self.environment.element, frame.world_m, frame.near_m)
        return body, None if self.up is None else _facing(self.up)


_AT_ORIGIN: Final = (0.0, 0.0, 0.0)


@lru_cache(maxsize=1024)
def _placed(element: Element, origin_m: tuple[float, ...], near_m: tuple[float, ...]) -> Element:
    """The element from another origin, a line with its point nearest to ``near_m`` from there; cached, so
    that equal elements are one object and their priors are found."""
    return by_foot(shifted(element, -np.array(origin_m)), np.array(near_m))


@lru_cache(maxsize=8)
def _facing(up: Up) -> Element:
    return face_towards(up.direction, up.spread_rad)


@lru_cache(maxsize=64)
def named_pairs(known_map: Map, model: ContactModel) -> tuple[NamedPair, ...]:
    """All pairs that a contact may touch by elements that are fixed; empty if the map rules it out."""
    if not known_map.allows(model.contact):
        return ()
    kinds = kinds_of(model)
    bodies, worlds = known_map.listed_object, known_map.listed_environment
    if not known_map.fixes_elements:  # the map of the recording has them
        bodies, worlds = (), ()
    up = known_map.up if kinds[1] == "f" else None
    return tuple(
        NamedPair(body, world, body_share + world_share, up if world is None else None)
        for body, body_share in _choices(bodies, kinds[0], known_map.object_complete)
        for world, world_share in _choices(worlds, kinds[1], known_map.environment_complete)
    )


def _choices(
    listed: tuple[NamedElement, ...], kind: str, is_complete: bool
) -> list[tuple[NamedElement | None, float]]:
    """Elements of a kind, and None for an unlisted one, with log shares."""
    of_kind = [element for element in listed if element.kind == kind and not element.is_covered]
    if not of_kind:
        return [] if is_complete else [(None, 0.0)]
    unlisted = 0.0 if is_complete else UNLISTED
    share = float(np.log((1.0 - unlisted) / len(of_kind)))
    unlisted_choice = [(None, float(np.log(unlisted)))] if unlisted else []
    return [*((element, share) for element in of_kind), *unlisted_choice]


class LearnedPairs(NamedTuple):
    """n pairs with an element of the map that other contacts have touched: the ``pairs`` of elements, their
    ``cross`` covariances as of ``pair_priors``, whether both elements are of the map (``are_both_known``),
    and the log probabilities (``log_share``)."""

    pairs: list[Pair]
    cross: Array
    are_both_known: NDArray[np.bool_]
    log_share: Array


def learned_pairs(view: MapView, model: ContactModel, near_m: Array) -> tuple[float, LearnedPairs]:
    """All pairs with an element of the map that a contact may touch, and the log probability of a new pair.

    ``near_m`` (3,) is the body's place in the world. Two faces of the map may face each other or look the
    same way, which their normals do not say.
    """
    kinds, are_faces = kinds_of(model), model.family is face_face
    body, world = (view.side(i, kinds[i], place) for i, place in enumerate((np.zeros(3), near_m)))
    index = [
        (i, j, sense)
        for i, row in enumerate(body.keys)
        for j, column in enumerate(world.keys)
        if (i or j) and (row, column) != view.current
        for sense in ((-1, 1) if are_faces and i and j else (-1,) if are_faces else (1,))
    ]
    i, j, sense = np.array(index, int).reshape(-1, 3).T
    are_known = (i > 0) & (j > 0)
    log_share = body.log_p[i] + world.log_p[j] - (np.log(2.0) * are_known if are_faces else 0.0)
    cross = view.cross_covariance(body, i, world, j) * sense[:, None, None]
    turned = body.elements, [None if face is None else opposite(face) for face in body.elements]
    pairs = [(turned[way < 0][row], world.elements[column]) for row, column, way in index]
    cross = cross if model.body_in_1 else cross.swapaxes(1, 2)
    return float(body.log_p[0] + world.log_p[0]), LearnedPairs(pairs, cross, are_known, log_share)
