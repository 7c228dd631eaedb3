"""Observed and unobserved directions of a geometry (docs/theory.md, T21, T22).

Noise alone adds information on every direction, in proportion to the length of the window. A direction is
observed only if its information exceeds that of noise.
"""

from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Final, Literal, NamedTuple

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.contacts.family import directions
from contact_tracker.geometry import lifted_pose, linalg
from contact_tracker.geometry.elements import (
    ContactGeometry,
    Element,
    Line,
    Origins,
    Plane,
    Point,
    Unobserved,
    by_foot,
    shifted,
)
from contact_tracker.geometry.lifted_pose import R, T
from contact_tracker.geometry.linalg import cross
from contact_tracker.hypotheses import gauss_newton
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.births import name_elements, name_listed
from contact_tracker.hypotheses.evidence import EvidenceParameters, weak_prior
from contact_tracker.hypotheses.refit import anchors_of
from contact_tracker.hypotheses.schedule import REST_WEIGHT
from contact_tracker.map.association import ElementEstimate
from contact_tracker.map.elements import LOOSE_M, LOOSE_RAD
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.pairs import named_pairs
from contact_tracker.motion.window import Window
from contact_tracker.states import Contact

OBSERVED_RATIO: Final = 10.0
"""A direction is observed if the window has this many times the information of prior and noise."""
NOISE_MARGIN: Final = 1.5
"""In a whole segment, up to this many times the information of prior and noise may be due to noise."""
OPEN_SHARE: Final = 0.1
"""An unobserved direction is reported if the prior lets the element move by this share of a radian or of the
reach."""


def observed_geometry(
    hypothesis: Bank,
    model: ContactModel,
    scales: EvidenceParameters,
    variance: Array,
    information: Array | None = None,
    systematic: Array | float = 0.0,
) -> ContactGeometry:
    """Elements of a single hypothesis with covariance and unobserved directions.

    Parameters
    ----------
    hypothesis : bank of one hypothesis.
    variance : (2,) noise of a tick: position (m^2) and rotation (rad^2).
    information : (P, P) of the ticks on x, for a bank with moments of the poses; by default that of the
        running fit, whose moments hold innovations.
    systematic : covariance (S, S) of x by errors that are not noise.

    Returns
    -------
    ContactGeometry in the frames of the bank.
    """
    x = hypothesis.x[0].copy()  # the elements have views of it
    covariance, tangent, prior, eigenvalues, eigenvectors = information_spectrum(
        hypothesis, model, scales, variance, information
    )
    if np.any(systematic):
        covariance = _within(prior, tangent, covariance + systematic)
    geometry = model.geometry(x, covariance, scales.reach_m)
    unseen = eigenvectors[:, : eigenvalues.searchsorted(OBSERVED_RATIO)]
    if not unseen.size:
        return geometry
    free = tangent @ unseen
    open_covariance = free @ linalg.solve(unseen.T @ prior @ unseen, free.T)
    if open_covariance.diagonal() @ _in_lengths(model, scales.reach_m) <= OPEN_SHARE**2:  # the usual case
        return geometry
    open_ = model.geometry(x, open_covariance, 0.0)
    return ContactGeometry(
        replace(geometry.object, unobserved=_open_directions(open_.object, scales.reach_m)),
        replace(geometry.environment, unobserved=_open_directions(open_.environment, scales.reach_m)),
    )


def _within(prior: Array, tangent: Array, covariance: Array) -> Array:
    """A covariance (S, S) along ``tangent`` (S, P) that is nowhere wider than the ``prior`` (P, P) allows."""
    lower = np.linalg.cholesky(prior)
    units = np.linalg.pinv(tangent).T @ lower
    ratio, axes = linalg.eigenvectors(units.T @ covariance @ units)
    if ratio[-1] <= 1.0:
        return covariance
    wide = tangent @ np.linalg.solve(lower.T, axes)
    return np.asarray(covariance - (wide * np.maximum(ratio - 1.0, 0.0)) @ wide.T)


class InformationSpectrum(NamedTuple):
    """Information of the motion on the geometry of one hypothesis, by direction."""

    covariance: Array
    """(S, S) of x."""
    tangent: Array
    """(S, P) free directions of x."""
    prior: Array
    """(P, P) prior precision along the tangent."""
    values: Array
    """(P,) generalised eigenvalues, ascending: ratio of the information of the motion to prior and noise."""
    directions: Array
    """(P, P) their eigenvectors, columns along the tangent."""


def information_spectrum(
    hypothesis: Bank,
    model: ContactModel,
    scales: EvidenceParameters,
    variance: Array,
    information: Array | None = None,
) -> InformationSpectrum:
    """The spectrum of a single hypothesis; arguments as of ``observed_geometry``."""
    noise_margin = NOISE_MARGIN
    if information is None:  # with correlated errors the moments hold innovations, in which most of a
        noise_margin, variance = 1.0, variance / (1.0 - scales.correlation) ** 2  # constant pose cancels
    tangent = model.family.tangent(hypothesis.x[0], anchors_of(hypothesis, model)[0])
    observed, noise = information_of_ticks(hypothesis, model, tangent, variance)
    observed = observed if information is None else information
    prior = prior_along(hypothesis, model, tangent, scales.reach_m)
    eigenvalues, eigenvectors = linalg.eigenvectors(observed, prior + noise)
    covariance = tangent @ posterior_covariance(eigenvalues, eigenvectors, prior, noise_margin) @ tangent.T
    return InformationSpectrum(covariance, tangent, prior, eigenvalues, eigenvectors)


def prior_along(hypothesis: Bank, model: ContactModel, tangent: Array, reach_m: float) -> Array:
    """Precision (P, P) of the prior of a single hypothesis along ``tangent`` (S, P)."""
    return np.asarray(tangent.T @ (_vague(model, reach_m) + hypothesis.prior_information[0]) @ tangent)


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


def information_of_ticks(
    hypothesis: Bank, model: ContactModel, tangent: Array, variance: Array
) -> tuple[Array, Array]:
    """Information (P, P) along ``tangent`` (S, P) of the ticks by their moments, and that which the noise of
    the poses alone would add to it."""
    moments, x = hypothesis.second_moment[0], hypothesis.x[0]
    precision = gauss_newton.per_metre(model.family, moments, hypothesis.row_weight[0], x)
    slopes = np.sqrt(precision)[:, None, None] * (tangent.T @ model.family.rows_derivative(x))
    # change of each row when a pose is perturbed by one sigma in each direction
    sigma = np.sqrt(variance[lifted_pose.NOISE_OF_PERTURBATION])[:, None, None]
    off = (slopes[:, None] @ (sigma * model.moves)).reshape(-1, *slopes.shape[1:])
    observed, noise = ((rows @ moments @ rows.swapaxes(1, 2)).sum(axis=0) for rows in (slopes, off))
    return observed, noise


def perturbed_rows(hypothesis: Bank, model: ContactModel) -> Array:
    """Coefficients (K, 6, C) of the change of each residual of a single hypothesis by small turns about the
    body's axes and shifts along the world's."""
    return np.asarray((model.family.rows(hypothesis.x[0]) @ model.moves).swapaxes(0, 1))


def _open_directions(free: Element, reach_m: float) -> tuple[Unobserved, ...]:
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
    """Unobserved turns of a unit vector, and the covariance of the element's other part given no turn."""
    turned, remaining = covariance[:3, :3], covariance[3:, 3:]
    wide = _wide(turned, OPEN_SHARE)
    if not wide.size:
        return (), remaining
    turns = _unobserved("turns_about", cross(axis, wide.T))
    with_turn = covariance[3:, :3] @ wide
    explained = with_turn @ linalg.solve(wide.T @ turned @ wide, with_turn.T)
    return turns, remaining - explained


def _shifts(covariance: Array, reach_m: float) -> tuple[Unobserved, ...]:
    return _unobserved("shifts_along", _wide(covariance, OPEN_SHARE * reach_m).T)


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


MOST_TICKS: Final = 300
"""Number of ticks that represent a longer window."""


def systematic_covariance(
    hypothesis: Bank,
    model: ContactModel,
    window: Window,
    reach_m: float,
    errors: SystematicErrors,
    is_refined: bool,
) -> Array:
    """Covariance (S, S) that systematic errors of the poses add to the geometry x of a single hypothesis.

    Ticks since the onset count, as far as they are in the window; ticks before are left out.

    Parameters
    ----------
    hypothesis : bank of one hypothesis.
    is_refined : whether each tick counts by its noise alone; else also by its motion.
    """
    ticks, count = representatives(window.cut(int(np.searchsorted(window.index, hypothesis.onset[0])), None))
    x, family, lifted = hypothesis.x[0], model.family, model.lifted(ticks.zeta)
    tangent = family.tangent(x, anchors_of(hypothesis, model)[0])
    weight = count / ticks.variance[:, 0]
    if not is_refined:
        weight *= np.maximum(ticks.motion_ratio, REST_WEIGHT)
    precision = gauss_newton.per_metre(family, hypothesis.second_moment[0], hypothesis.row_weight[0], x)
    slopes = np.einsum("sp,ksc,tc->pkt", tangent, family.rows_derivative(x), lifted)
    weighted = slopes * precision[:, None] * weight
    information = np.einsum("pkt,qkt->pq", weighted, slopes)
    by_error = np.einsum("pkt,kdt->dpt", weighted, perturbed_rows(hypothesis, model) @ lifted.T)
    prior = prior_along(hypothesis, model, tangent, reach_m)
    return np.asarray(
        tangent @ added_covariance(information, prior, by_error, ticks.zeta, errors) @ tangent.T
    )


def added_covariance(
    information: Array, prior: Array, by_error: Array, zeta: Array, errors: SystematicErrors
) -> Array:
    """Covariance (P, P) that the systematic errors of N poses add to that by noise.

    Parameters
    ----------
    information, prior : (P, P) information of the ticks, and of the prior, on the parameters.
    by_error : (6, P, N) derivatives of the cost's gradient by the errors of each pose: three turns about the
        body's axes, three shifts along the world's.
    zeta : (N, 25) the lifted poses.
    """
    turn, shift = _error_covariances(zeta, errors)
    spread = (by_error @ np.repeat([turn, shift], 3, axis=0) @ by_error.swapaxes(1, 2)).sum(axis=0)
    # in units of the prior, which is far above the rounding errors of the information then, however large
    ratio, axes = linalg.eigenvectors(information, prior)
    ratio[ratio < linalg.LEAST_SHARE * ratio[-1]] = 0.0
    by_noise = axes * np.divide(1.0, np.sqrt(ratio), out=np.zeros_like(ratio), where=ratio > 0.0)
    squared, turned = linalg.eigenvectors(by_noise.T @ spread @ by_noise)
    squared = np.maximum(squared, 0.0)
    # the errors lower the information of the ticks by this share, and not that of the prior
    known = np.sqrt(ratio / (1.0 + ratio))
    lost = known[:, None] * ((turned * (squared / (1.0 + squared))) @ turned.T) * known
    share, turned = linalg.eigenvectors(lost)
    widened = share.clip(0.0, known[-1] ** 2)
    axes /= np.sqrt(1.0 + ratio)
    spanned = axes @ turned
    return np.asarray((spanned * (widened / (1.0 - widened))) @ spanned.T)


def representatives(window: Window) -> tuple[Window, Array]:
    """All ticks of a window, or a part if it is long, half of it by their motion, the rest evenly; and
    the number (N,) of ticks that each stands for."""
    length = len(window)
    if length <= MOST_TICKS:
        return window, np.ones(length)
    passed = np.cumsum(window.motion_ratio + max(window.motion_ratio.mean(), REST_WEIGHT))
    cuts = np.unique(np.searchsorted(passed, np.linspace(0.0, passed[-1], MOST_TICKS + 1)[1:-1]))
    first, end = np.append(0, cuts), np.append(cuts, length)
    filled = end > first
    first, end = first[filled], end[filled]
    return window.pick((first + end) // 2, window.before), (end - first).astype(float)


def _error_covariances(zeta: Array, errors: SystematicErrors) -> tuple[Array, Array]:
    """Covariances (N, N) of the errors of N poses about one axis (rad^2) and along one axis (m^2)."""
    return (
        errors.rotation_rad**2 * np.exp(-_squared_distances(zeta[:, R]) / (4.0 * errors.angle_rad**2)),
        errors.position_m**2 * np.exp(-_squared_distances(zeta[:, T]) / (2.0 * errors.length_m**2)),
    )


def _squared_distances(points: Array) -> Array:
    """(N, N) squared distances of points (N, D)."""
    apart = points[:, None] - points
    return np.asarray((apart * apart).sum(axis=2))


@dataclass(frozen=True, eq=False, repr=False)
class FittedContact:
    """A hypothesis whose ``geometry`` is computed when it is first read; in most ticks it is not.

    Parameters
    ----------
    bank : bank of the hypothesis alone.
    variance : (W, 2) noise of the ticks: position (m^2) and rotation (rad^2).
    rotation : (3, 3) of the body in the last tick.
    origins : origins of the bank's coordinates.
    systematic : covariance (S, S) of x by errors that are not noise.
    known_map : has the names of elements.
    information : as in ``observed_geometry``.
    """

    bank: Bank
    contact: Contact
    scales: EvidenceParameters
    variance: Array
    rotation: Array
    origins: Origins
    systematic: Array
    known_map: Map
    information: Array | None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.contact.value})"

    @cached_property
    def geometry(self) -> ContactGeometry:
        """Its elements, with covariance and unobserved directions, in the user's frames."""
        bank, model, usual = self.bank, CONTACT_MODELS[self.contact.column], linalg.median(self.variance)
        local = observed_geometry(bank, model, self.scales, usual, self.information, self.systematic)
        if not np.isnan(bank.line_anchor).all():  # other lines have their point near the body already
            body_m = bank.weighted_position_sum[0] / bank.weight[0]
            local = ContactGeometry(by_foot(local.object, np.zeros(3)), by_foot(local.environment, body_m))
        geometry = _in_users_frames(local, self.rotation, self.origins)
        if self.known_map.fixes_elements:  # otherwise the hypothesis assumes elements of the map that grows
            return name_elements(geometry, named_pairs(self.known_map, model)[bank.known_pair_index[0]])
        is_by_motion = not bank.prior_information.any()
        return name_listed(geometry, self.known_map, is_by_motion)


def fitted_contact(
    bank: Bank,
    row: int,
    model: ContactModel,
    scales: EvidenceParameters,
    window: Window,
    origins: Origins,
    errors: SystematicErrors,
    information: Array | None = None,
    known_map: Map = EMPTY_MAP,
) -> FittedContact:
    """The fit of hypothesis ``row`` of a bank.

    ``window`` has the ticks and their noise, ``errors`` are the systematic ones; other arguments are as in
    ``FittedContact``.
    """
    hypothesis, systematic = bank.single(row), np.zeros(())
    if errors.are_given:
        systematic = systematic_covariance(
            hypothesis, model, window, scales.reach_m, errors, is_refined=information is not None
        )
    turn = window.zeta[-1, R].reshape(3, 3)
    return FittedContact(
        hypothesis, model.contact, scales, window.variance, turn, origins, systematic, known_map, information
    )


def _in_users_frames(geometry: ContactGeometry, rotation: Array, origins: Origins) -> ContactGeometry:
    """The elements in the frames of the body, which has this ``rotation`` (3, 3), and of the world.

    Motion determines only the difference of the offsets of two faces: the object's stays at the origin.
    """
    body, world = geometry.object, shifted(geometry.environment, origins.world_m)
    if isinstance(body, Plane) and isinstance(world, Plane):
        swung_m = world.normal @ rotation @ origins.body_m
        return ContactGeometry(body, replace(world, offset_m=float(world.offset_m - swung_m)))
    return ContactGeometry(shifted(body, origins.body_m), world)


def element_estimate(
    bank: Bank,
    model: ContactModel,
    scales: EvidenceParameters,
    window: Window,
    information: Array | None = None,
) -> ElementEstimate:
    """The joint estimate of both elements by the single hypothesis of a ``bank``; arguments as above.

    Real elements are not exactly the same at the next touch, so the information is reduced to that of
    elements which vary by ``LOOSE_M`` and ``LOOSE_RAD``.
    """
    spectrum = information_spectrum(bank, model, scales, window.usual_variance, information)
    back = np.linalg.inv(spectrum.directions)
    reduced = back.T @ (np.maximum(spectrum.values - NOISE_MARGIN, 0.0)[:, None] * back)
    variance = np.full(model.family.SIZE, LOOSE_M**2)
    variance[directions(model.family.FORM)] = LOOSE_RAD**2
    onto = np.linalg.pinv(spectrum.tangent)
    loose = np.linalg.cholesky((onto * variance) @ onto.T)
    values, axes = np.linalg.eigh(loose.T @ reduced @ loose)
    values = np.maximum(values, 0.0)
    along = np.linalg.solve(loose.T, axes)
    reduced = (along * (values / (1.0 + values))) @ along.T
    rotation = window.zeta[len(window) // 2, R].reshape(3, 3)
    anchors = anchors_of(bank, model)[0]
    return ElementEstimate(model.contact, bank.x[0], spectrum.tangent, reduced, anchors, rotation)
