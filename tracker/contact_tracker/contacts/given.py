"""Known elements as a Gaussian prior on a contact's parameter vector x, which stacks both elements.

Normals point out of the bodies that they bound, so that faces that touch look at each other.
"""

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel, face_face
from contact_tracker.contacts.base import Array
from contact_tracker.geometry import Element, Line, Plane, Point, numbers

_SMALLEST: Final = 1e-12
"""Variances below this share of the largest are no variances: directions in which an element cannot move."""


class Given(NamedTuple):
    """Mean (S,) and information (S, S) on x; both zero where nothing is given."""

    mean: Array
    information: Array

    def told(self, model: ContactModel) -> NDArray[np.bool_]:
        """(..., S) which entries of x are given.

        Of a direction the mean says so: it is zero where only part of it is known.
        """
        told = np.asarray(self.information.diagonal(axis1=-2, axis2=-1) > 0.0)
        form = model.family.FORM
        for first in (form.d1, form.d2):
            if first >= 0:
                part = slice(first, first + 3)
                told[..., part] = self.mean[..., part].any(axis=-1, keepdims=True)
        return told


Pair = tuple[Element | None, Element | None]
"""Of the object and of the environment; None is an unknown one."""


def given(model: ContactModel, pairs: Sequence[Pair]) -> tuple[Given, Array]:
    """Priors (n, ...) of a contact of n pairs of elements, and their anchors.

    Elements have covariances, and are given in the frames in which x is. A direction is zero where it is
    unknown, or known in part.

    Returns
    -------
    The priors; and (n, 6) the points that lines go through, NaN where they are anchored where the body is.
    The foot of a line depends on its direction and on where the body is, unless it is a point that is known.
    """
    firsts, seconds = zip(*(pair if model.body_in_1 else pair[::-1] for pair in pairs), strict=True)
    pivots = np.array([[_pivot(e) for e in side] for side in (firsts, seconds)]).swapaxes(0, 1)
    pivots = pivots.reshape(len(pairs), 6)
    if model.family is face_face:
        faces = [_faces(*pair) for pair in zip(firsts, seconds, strict=True)]
        return Given(*(np.array(part) for part in zip(*faces, strict=True))), pivots
    kinds = model.contact.value[0::2] if model.body_in_1 else model.contact.value[2::-2]
    size, first = model.family.SIZE, 0
    mean, information = np.zeros((len(pairs), size)), np.zeros((len(pairs), size, size))
    for kind, side in zip(kinds, (firsts, seconds), strict=True):
        part = slice(first, first + _WIDTHS[kind])
        parts = [_unknown(kind) if element is None else _part(element) for element in side]
        mean[:, part] = [one.mean for one in parts]
        information[:, part, part] = [one.information for one in parts]
        first = part.stop
    return Given(mean, information), pivots


def _pivot(element: Element | None) -> Array:
    return element.point_m if isinstance(element, Line) and _goes_through(element) else _ANYWHERE


def _goes_through(line: Line) -> bool:
    """Whether its point is one: not where only a part of the direction is known, as of any line in a face."""
    return bool(line.direction.any() or not _covariance(line)[:3, :3].any())


_WIDTHS: Final = {"f": 4, "e": 6, "v": 3}
_LENGTHS: Final = {Plane: slice(3, 4), Line: slice(3, 6), Point: slice(0, 3)}


_ANYWHERE: Final = np.full(3, np.nan)


@cache
def _unknown(kind: str) -> Given:
    return Given(np.zeros(_WIDTHS[kind]), np.zeros((_WIDTHS[kind], _WIDTHS[kind])))


@lru_cache(maxsize=256)
def _faces(first: Element | None, second: Element | None) -> Given:
    """f-f: the normal of either; how high the body's origin lies over the world's, only if both are known."""
    assert not isinstance(first, Line | Point)
    assert not isinstance(second, Line | Point)
    size = face_face.SIZE
    mean, covariance, known = np.zeros(size), np.zeros((size, size)), np.zeros(size)
    if first is not None:
        mean[face_face.M], known[face_face.M] = -first.normal, 1.0
        covariance[face_face.M, face_face.M] = _covariance(first)[:3, :3]
    if second is not None:
        mean[face_face.N], known[face_face.N] = second.normal, 1.0
        covariance[face_face.N, face_face.N] = _covariance(second)[:3, :3]
    if first is not None and second is not None:
        of_first, of_second = _covariance(first), _covariance(second)
        h = size - 1
        mean[h], known[h] = second.offset_m + first.offset_m, 1.0
        covariance[h, face_face.M] = covariance[face_face.M, h] = -of_first[:3, 3]
        covariance[h, face_face.N] = covariance[face_face.N, h] = of_second[:3, 3]
        covariance[h, h] = of_first[3, 3] + of_second[3, 3]
    return Given(mean, _inverse(covariance, face_face.H) * np.outer(known, known))


@lru_cache(maxsize=1024)
def _part(element: Element) -> Given:
    """An element's part of x, of a line by the point that it has."""
    covariance, lengths = _covariance(element), _LENGTHS[type(element)]
    if not isinstance(element, Line):
        return Given(numbers(element), _inverse(covariance, lengths))
    across = np.kron(np.eye(2), np.eye(3) - np.outer(element.direction, element.direction))
    inverse = _inverse(across @ covariance @ across, lengths)
    return Given(numbers(element), across @ inverse @ across)


def _covariance(element: Element) -> Array:
    if element.covariance is None:
        raise ValueError("a known element says how exactly it is known")
    return element.covariance


def _inverse(covariance: Array, lengths: slice) -> Array:
    """Inverse on directions in which there is variance; ``lengths``, the last, are in m, others in rad."""
    variance, weight = covariance.diagonal(), np.ones(len(covariance))
    for part in (lengths, slice(0, lengths.start)):
        largest = variance[part].max(initial=0.0)
        weight[part] = 1.0 / np.sqrt(largest) if largest > 0.0 else 1.0
    values, axes = np.linalg.eigh(weight[:, None] * covariance * weight)
    good = values > _SMALLEST * max(float(values[-1]), 0.0)
    axes = weight[:, None] * axes[:, good]
    return np.asarray((axes / values[good]) @ axes.T)
