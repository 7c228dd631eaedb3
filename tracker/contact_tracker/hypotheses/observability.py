"""Observed and unobserved directions of a geometry (docs/theory.md, T21, T22).

Noise alone adds information on every direction, in proportion to the length of the window. A direction is
observed only if its information exceeds that of noise.
"""

from dataclasses import replace
from functools import cache
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.parameter_layout import directions
from contact_tracker.geometry import linalg
from contact_tracker.geometry.elements import ContactGeometry, Element, Line, Plane, Point, Unobserved
from contact_tracker.geometry.vectors import cross
from contact_tracker.hypotheses import compiled, gauss_newton, refit
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import EvidenceParameters, weak_prior
from contact_tracker.hypotheses.pruning import anchors_of
from contact_tracker.motion import lifted_pose

Array = NDArray[np.float64]

SHOWN: Final = 10.0
"""A direction is observed if the information of the window is this many times that of prior and noise."""
NOISE_MARGIN: Final = 1.5
"""In a whole segment, information up to this many times that of prior and noise may be due to noise."""
OPEN: Final = 0.1
"""An unobserved direction is reported if the prior lets the element move by this share of a radian or of the
reach."""


def observed_geometry(
    one: Bank,
    model: ContactModel,
    scales: EvidenceParameters,
    variance: Array,
    information: Array | None = None,
    systematic: Array | float = 0.0,
) -> ContactGeometry:
    """Elements of a single hypothesis with covariance and unobserved directions.

    Parameters
    ----------
    one : bank of one hypothesis.
    variance : (2,) noise of a tick: position (m^2) and rotation (rad^2).
    information : (P, P) of the ticks on x, for a bank with moments of the poses; by default that of the
        running fit, whose moments hold innovations.
    systematic : covariance (S, S) of x by errors that are not noise.

    Returns
    -------
    ContactGeometry in the frames of the bank.
    """
    x = one.x[0].copy()  # the elements have views of it
    covariance, tangent, prior, eigenvalues, eigenvectors = information_spectrum(
        one, model, scales, variance, information
    )
    found = model.geometry(x, covariance + systematic, scales.reach_m)
    left = eigenvectors[:, : eigenvalues.searchsorted(SHOWN)]
    if not left.size:
        return found
    free = tangent @ left
    open_covariance = free @ linalg.solve(left.T @ prior @ left, free.T)
    if open_covariance.diagonal() @ _in_lengths(model, scales.reach_m) <= OPEN**2:  # the usual case
        return found
    open_ = model.geometry(x, open_covariance, 0.0)
    return ContactGeometry(
        replace(found.object, unobserved=_ways(open_.object, scales.reach_m)),
        replace(found.environment, unobserved=_ways(open_.environment, scales.reach_m)),
    )


class InformationSpectrum(NamedTuple):
    """Information of the motion on the geometry of one hypothesis, by direction."""

    covariance: Array
    """(S, S) of x."""
    tangent: Array
    """(S, P) free directions of x."""
    prior: Array
    """(P, P) prior precision along the tangent."""
    values: Array
    """(P,) generalised eigenvalues, ascending: information of the motion over that of prior and noise."""
    directions: Array
    """(P, P) their eigenvectors, columns along the tangent."""


def information_spectrum(
    one: Bank,
    model: ContactModel,
    scales: EvidenceParameters,
    variance: Array,
    information: Array | None = None,
) -> InformationSpectrum:
    """The spectrum of a single hypothesis; arguments as of ``observed_geometry``."""
    noise_margin = NOISE_MARGIN
    if information is None:  # with correlated errors the moments hold innovations, in which most of a
        noise_margin, variance = 1.0, variance / (1.0 - scales.correlation) ** 2  # constant pose cancels
    tangent, shown, prior, noise = information_terms(one, model, scales, variance)
    shown = shown if information is None else information
    eigenvalues, eigenvectors = linalg.eigenvectors(shown, prior + noise)
    covariance = tangent @ posterior_covariance(eigenvalues, eigenvectors, prior, noise_margin) @ tangent.T
    return InformationSpectrum(covariance, tangent, prior, eigenvalues, eigenvectors)


def information_terms(
    one: Bank, model: ContactModel, scales: EvidenceParameters, variance: Array
) -> tuple[Array, Array, Array, Array]:
    """Tangent (S, P) of a single hypothesis, and information (P, P) along it: of the ticks by the moments, of
    the prior, and of noise alone. ``variance`` (2,) as in ``observed_geometry``."""
    if not compiled.in_use():
        return information_terms_reference(one, model, scales, variance)
    from contact_tracker.hypotheses.compiled import calls

    return calls.information_terms(
        calls.model_of(model, scales.reach_m), one.words, one.onsets.words, variance
    )


def information_terms_reference(
    one: Bank, model: ContactModel, scales: EvidenceParameters, variance: Array
) -> tuple[Array, Array, Array, Array]:
    """``information_terms`` in numpy: the reference of the compiled kernel."""
    tangent = model.family.tangent(one.x[0], anchors_of(one, model)[0])
    return (
        tangent,
        refit.information(one, model, scales)[0],
        prior_along(one, model, tangent, scales.reach_m),
        noise_information(one, model, tangent, variance),
    )


def prior_along(one: Bank, model: ContactModel, tangent: Array, reach_m: float) -> Array:
    """Precision (P, P) of the prior of a single hypothesis along ``tangent`` (S, P)."""
    return np.asarray(tangent.T @ (_vague(model, reach_m) + one.prior_information[0]) @ tangent)


@cache
def _vague(model: ContactModel, reach_m: float) -> Array:
    """Precision (S, S) of the weak prior of every hypothesis, directions on their sphere included."""
    weak = weak_prior(model.family, np.zeros((1, 6)), reach_m)
    return np.asarray(weak.precision[0] + np.diag(weak.flat))


@cache
def _in_lengths(model: ContactModel, reach_m: float) -> Array:
    """(S,) weights that make squared turns and shifts of x comparable: shifts are over the squared reach."""
    scale = np.full(model.family.SIZE, 1.0 / reach_m**2)
    scale[directions(model.family.FORM)] = 1.0
    return scale


def posterior_covariance(values: Array, directions: Array, prior: Array, noise_margin: float = 1.0) -> Array:
    """Covariance (P, P) from an ``InformationSpectrum``: its values (P,), directions (P, P) and prior (P, P).

    In the basis of the directions the precision is nearly diagonal, so that its inverse stays accurate even
    where the magnitudes differ widely, as for lines that are almost parallel.
    """
    precision = directions.T @ prior @ directions
    np.einsum("pp->p", precision)[...] += np.maximum(values - noise_margin, 0.0)
    scale = 1.0 / np.sqrt(precision.diagonal())
    scaled = directions * scale
    return np.asarray(scaled @ linalg.solve(precision * (scale[:, None] * scale), scaled.T))


def noise_information(one: Bank, model: ContactModel, tangent: Array, variance: Array) -> Array:
    """Information (P, P) along ``tangent`` (S, P) that the noise of the poses alone would add in the
    window."""
    family, moments, x = model.family, one.second_moment[0], one.x[0]
    size, rows, columns, free = family.SIZE, family.ROWS, len(family.COLUMNS), tangent.shape[1]
    precision = gauss_newton.per_metre(family, moments, one.row_weight[0], x)
    slopes = tangent.T @ family.rows_derivative(x).swapaxes(0, 1).reshape(size, -1)
    # change of each row when a pose is perturbed by one sigma in each direction
    off = (slopes.reshape(free * rows, columns) @ model.moves).swapaxes(0, 1).reshape(free, rows, 6, columns)
    off *= np.sqrt(precision[:, None] * variance[lifted_pose.NOISE_OF_PERTURBATION])[..., None]
    jitter = off.reshape(-1, columns) @ moments
    return np.asarray(jitter.reshape(free, -1) @ off.reshape(free, -1).T)


def perturbed_rows(one: Bank, model: ContactModel) -> Array:
    """Coefficients (K, 6, C) of the change of each residual of a single hypothesis by small turns about the
    body's axes and shifts along the world's."""
    return np.asarray((model.family.rows(one.x[0]) @ model.moves).swapaxes(0, 1))


def _ways(free: Element, reach_m: float) -> tuple[Unobserved, ...]:
    """Unobserved turns and shifts of an element, given the covariance of the open directions alone."""
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
    """Unobserved turns of a unit vector, and the covariance of the rest of the element given no turn."""
    turned, rest = covariance[:3, :3], covariance[3:, 3:]
    wide = _wide(turned, OPEN)
    if not wide.size:
        return (), rest
    turns = _unobserved("turns_about", cross(axis, wide.T))
    with_turn = covariance[3:, :3] @ wide
    explained = with_turn @ linalg.solve(wide.T @ turned @ wide, with_turn.T)
    return turns, rest - explained


def _shifts(covariance: Array, reach_m: float) -> tuple[Unobserved, ...]:
    return _unobserved("shifts_along", _wide(covariance, OPEN * reach_m).T)


def _wide(covariance: Array, sd: float) -> Array:
    """Orthonormal directions (3, n) in which ``covariance`` is wider than ``sd``, the widest first."""
    if covariance.trace() <= sd**2:  # the usual case
        return np.zeros((3, 0))
    variance, axes = linalg.eigenvectors(covariance)
    return axes[:, variance > sd**2][:, ::-1]


def _unobserved(how: Literal["turns_about", "shifts_along"], axes: Array) -> tuple[Unobserved, ...]:
    """One entry per unit vector (n, 3), signed such that its largest component is positive."""
    if not len(axes):
        return ()
    largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1)
    return tuple(Unobserved(how, axis) for axis in axes * np.sign(largest))
