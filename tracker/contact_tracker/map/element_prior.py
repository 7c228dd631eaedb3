"""Known elements as a Gaussian prior on a contact's parameter vector x, which stacks both elements.

Normals point out of the bodies that they bound, so those of touching faces are opposite.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel, face_face
from contact_tracker.contacts.family import Array
from contact_tracker.geometry import linalg
from contact_tracker.geometry.elements import Element, Line, Pair, Plane, numbers

_SMALLEST: Final = 1e-12
"""Variances below this share of the largest count as zero: the element cannot move in these directions."""
_WIDTHS: Final = {"f": 4, "e": 6, "v": 3}
_LENGTHS: Final = {"f": 1, "e": 3, "v": 3}
"""Number of the parameters of an element that are lengths (m); they come last."""


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
        return PairPrior(*_facing(*map(_Faces.of, sides)), pivots)
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


def _facing(first: _Faces, second: _Faces) -> tuple[Array, Array]:
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
    covariance = _covariance(element)
    information = _inverse(covariance[:3, :3], 0)
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
    covariance, lengths = _covariance(element), _LENGTHS[kind]
    if isinstance(element, Line):
        across = np.zeros((6, 6))
        across[:3, :3] = across[3:, 3:] = np.eye(3) - np.outer(element.direction, element.direction)
        information = across @ _inverse(across @ covariance @ across, lengths) @ across
        pivot = element.point_m if _goes_through(element) else pivot
    else:
        information = _inverse(covariance, lengths)
    return np.concatenate([numbers(element), information.ravel(), pivot])


def _goes_through(line: Line) -> bool:
    """Whether the line's point is known. It is not where the direction is known in part, as for lines in a
    face."""
    return bool(line.direction.any() or not _covariance(line)[:3, :3].any())


def _covariance(element: Element) -> Array:
    if element.covariance is None:
        raise ValueError("a known element needs a covariance")
    return element.covariance


def _inverse(covariance: Array, lengths: int) -> Array:
    """Pseudo-inverse on the directions with variance; the last ``lengths`` are in m, others in rad."""
    variance, turns = covariance.diagonal().tolist(), len(covariance) - lengths
    weight = np.array([_unit(variance[:turns])] * turns + [_unit(variance[turns:])] * lengths)
    values, axes = linalg.eigenvectors(weight[:, None] * covariance * weight)
    good = values > _SMALLEST * max(float(values[-1]), 0.0)
    axes = weight[:, None] * axes[:, good]
    return np.asarray((axes / values[good]) @ axes.T)


def _unit(variance: Sequence[float]) -> float:
    """Scale that makes the largest variance one; one if all are zero."""
    largest = max(variance, default=0.0)
    return 1.0 / math.sqrt(largest) if largest > 0.0 else 1.0
