"""What the motion has shown of a geometry, and what it has not (docs/theory.md, T21, T22).

Poses that only jitter seem to tell something about every direction, the more the longer they do. So what the
motion tells is what exceeds what the noise of the poses alone would feign.
"""

from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from contact_tracker import fit, lift
from contact_tracker.bank import anchors_of, prior_of
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.base import cross
from contact_tracker.evidence import Scales
from contact_tracker.geometry import ContactGeometry, Element, Line, Plane, Point, Unobserved
from contact_tracker.table import Bank

Array = NDArray[np.float64]

SHOWN: Final = 10.0
"""A direction is observed if the window tells this many times what prior and noise say of it."""
OPEN: Final = 0.1
"""An element could still move if the prior lets it do so by this share of a radian or of the reach."""


def observed_geometry(
    bank: Bank, row: int, model: ContactModel, scales: Scales, variance: Array
) -> ContactGeometry:
    """Elements of hypothesis ``row``, with covariance, and with the directions that the motion left open.

    Parameters
    ----------
    variance : (2,) noise of a tick: position (m^2) and rotation (rad^2).

    Returns
    -------
    ContactGeometry in the frames in which the bank works.
    """
    one = bank.pick(np.array([row]))
    anchors = anchors_of(one, model)
    before = prior_of(one, model, anchors, scales.reach_m)
    tangent = model.family.tangent(one.x, anchors)[0]
    prior = tangent.T @ (before.precision[0] + np.diag(before.flat)) @ tangent
    known = prior + feigned_information(one, model, anchors, variance)
    told, ways = eigh(one.hessian[0].sum(axis=0), known, check_finite=False)
    covariance = tangent @ posterior_covariance(told, ways, prior) @ tangent.T
    x = one.x[0].copy()  # it is given away
    found = model.geometry(x, covariance, scales.reach_m)
    left = ways[:, told < SHOWN]
    if not left.size:
        return found
    could = tangent @ left @ np.linalg.inv(left.T @ prior @ left) @ left.T @ tangent.T
    free = model.geometry(x, could, 0.0)
    return ContactGeometry(
        replace(found.object, unobserved=_ways(free.object, scales.reach_m)),
        replace(found.environment, unobserved=_ways(free.environment, scales.reach_m)),
    )


def posterior_covariance(told: Array, ways: Array, prior: Array) -> Array:
    """Covariance (P, P) by what each of the ``ways`` (P, P) is ``told`` (P,) beyond noise, and the ``prior``.

    Seen along the ways, the precision is a diagonal of all magnitudes and little beside it: then its inverse
    has all its digits, also where one way is known all too well, as of two lines that are all but parallel.
    """
    precision = np.diag(np.maximum(told - 1.0, 0.0)) + ways.T @ prior @ ways
    scale = 1.0 / np.sqrt(precision.diagonal())
    scaled = ways * scale
    return np.asarray(scaled @ np.linalg.inv(precision * np.outer(scale, scale)) @ scaled.T)


def feigned_information(one: Bank, model: ContactModel, anchors: Array, variance: Array) -> Array:
    """Information (P, P) that the noise of the poses alone adds up to in the window of one hypothesis."""
    off = _perturbations(model)
    by_each = off @ one.moments[0] @ np.swapaxes(off, 1, 2)
    jitter = np.einsum("i,icd->cd", variance[[1, 1, 1, 0, 0, 0]], by_each)
    window = one.row_weight, one.moments, anchors, one.x
    return np.asarray(fit.information(model.family, jitter[None], *window)[0])


@cache
def _perturbations(model: ContactModel) -> Array:
    """Six linear maps (6, C, C): what the family's columns change by when the pose is a little off."""
    select = model.lifted(np.eye(lift.SIZE)).T
    return np.asarray(select @ lift.perturbations() @ select.T)


def _ways(free: Element, reach_m: float) -> tuple[Unobserved, ...]:
    """How an element can move whose covariance is that of what was left open."""
    covariance = np.zeros((6, 6)) if free.covariance is None else free.covariance
    match free:
        case Point():
            return _shifts(covariance, reach_m)
        case Line(direction):
            turns, shifts = _turns(direction, covariance)
            return turns + _shifts(shifts, reach_m)
        case Plane(normal):
            turns, along_normal = _turns(normal, covariance)
            return turns + _shifts(along_normal * np.outer(normal, normal), reach_m)


def _turns(axis: Array, covariance: Array) -> tuple[tuple[Unobserved, ...], Array]:
    """Turns of a unit vector, and the covariance of the rest of the element where it has not turned."""
    turned, rest = covariance[:3, :3], covariance[3:, 3:]
    wide = _wide(turned, OPEN)
    if not wide.size:
        return (), rest
    turns = tuple(Unobserved("turns_about", _signed(cross(axis, to))) for to in wide.T)
    with_turn = covariance[3:, :3] @ wide
    explained = with_turn @ np.linalg.inv(wide.T @ turned @ wide) @ with_turn.T
    return turns, rest - explained


def _shifts(covariance: Array, reach_m: float) -> tuple[Unobserved, ...]:
    wide = _wide(covariance, OPEN * reach_m)
    return tuple(Unobserved("shifts_along", _signed(along)) for along in wide.T)


def _wide(covariance: Array, sd: float) -> Array:
    """Orthonormal directions (3, n) in which ``covariance`` is wider than ``sd``, the widest first."""
    if covariance.trace() <= sd**2:  # as mostly
        return np.zeros((3, 0))
    variance, axes = np.linalg.eigh(covariance)
    return np.asarray(axes[:, variance > sd**2][:, ::-1])


def _signed(axis: Array) -> Array:
    """Of the two unit vectors along an axis the one whose largest component is positive."""
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))
