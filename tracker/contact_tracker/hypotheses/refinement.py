"""Refine the fit of a finished segment: maximum a posteriori geometry with the noise of every tick.

The running fit uses moments: rows weighted by their mean noise, ticks by their motion (docs/theory.md, T13).
It is fast, but its estimate and its covariance are approximate. Here every tick counts by its own noise
(T16), ticks at rest as well; the noise depends on the geometry; and the variance and correlation of each
row's errors are estimated from the residuals (T26).
"""

from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.contacts import ContactModel
from contact_tracker.geometry import linalg
from contact_tracker.geometry.linalg import LEAST_SHARE, STEP, adapted
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import EvidenceParameters, residual_noise
from contact_tracker.hypotheses.gauss_newton import LEAST_CURVATURE, TOLERANCE, Prior
from contact_tracker.hypotheses.refit import prior_at_anchors
from contact_tracker.motion.window import Window

STEPS: Final = 20
"""Most iterations, of expectation-maximisation and of fits."""
MOST_CORRELATION: Final = 0.95
LEAST_SCALE: Final = 1e-6


class Ar1Noise(NamedTuple):
    """Errors of the K residuals: an autoregressive process of order one from tick to tick."""

    weight: Array
    """(K,) estimated precision over the assumed precision."""
    correlation: Array
    """(K,) correlation between neighbouring ticks."""


def estimate_ar1(errors: Ar1Noise, rows: Array, prior_information: Array, index: Ints) -> Ar1Noise:
    """Estimate the errors from the whitened residuals of a fit, by expectation-maximisation.

    Residuals are smaller than errors, because the fit absorbs errors that look like geometry. Their share
    follows from the jacobian, which ``rows`` (K, W, P + 1) have before the residual, and from the
    ``prior_information`` (P, P). With too few ticks the estimate stays near ``errors``.
    """
    (weight, correlation), count = errors, rows.shape[1]
    follows = np.diff(index) == 1
    paired = rows[:, np.append(follows, False) | np.append(False, follows)]  # others would only add scatter
    across = _products(rows[:, 1:][:, follows], rows[:, :-1][:, follows])
    product = 0.5 * (across + across.swapaxes(1, 2)) / max(int(np.count_nonzero(follows)), 1)
    pairs = np.array([product, _products(paired, paired) / max(paired.shape[1], 1)])
    new = _innovation_products(rows, correlation, index)
    for _ in range(STEPS):
        eigenvalues, eigenvectors = linalg.eigenvectors(
            np.einsum("k,kpq->pq", weight, new[:, :-1, :-1]) + prior_information
        )
        determined = eigenvalues > LEAST_SHARE * eigenvalues[-1]
        # expected products of errors: of the residuals plus of the errors that the fit may have absorbed
        taken = np.eye(len(eigenvalues) + 1)
        taken[:-1, :-1] = (eigenvectors[:, determined] / eigenvalues[determined]) @ eigenvectors[
            :, determined
        ].T
        product, square = np.einsum("ikpq,pq->ik", pairs, taken)
        correlation = np.minimum(np.maximum(product / np.maximum(square, LEAST_SCALE), 0.0), MOST_CORRELATION)
        new = _innovation_products(rows, correlation, index)
        variance = np.maximum(np.einsum("kpq,pq->k", new, taken) / count, LEAST_SCALE)
        weight = variance ** (-count / (count + 1.0))  # the prior variance counts as one tick
    return Ar1Noise(weight, correlation)


def _innovation_products(rows: Array, correlation: Array, index: Ints) -> Array:
    """Sums (K, Z, Z) over ticks of products of the innovations of rows (K, W, Z), given the tick before and
    scaled to the same variance."""
    decay = (correlation[:, None] ** np.diff(index))[..., None]
    later = (rows[:, 1:] - decay * rows[:, :-1]) / np.sqrt(1.0 - decay**2)
    new = np.concatenate([rows[:, :1], later], axis=1)
    return _products(new, new)


def _products(a: Array, b: Array) -> Array:
    return np.asarray(a.swapaxes(1, 2) @ b)


ROUNDS: Final = 3
"""Alternations of fitting the geometry and estimating the noise from the residuals."""
FEW_TICKS: Final = 15
END_TICK_SIGMAS: Final = 2.5
"""The first and the last tick are left out if they are this far off, unless there are fewer than
``FEW_TICKS``."""
FIRST_DAMPING: Final = 1e-6


class Refined(NamedTuple):
    """The refined fit of a segment."""

    bank: Bank
    """One hypothesis with x (1, S) at the maximum a posteriori, and moments and row weights by the noise
    there."""
    information: Array
    """(P, P) of all ticks on x."""


def refine(bank: Bank, model: ContactModel, window: Window, scales: EvidenceParameters) -> Refined:
    """Refine the one hypothesis of ``bank``; ``window`` is the whole segment.

    The first and the last tick are left out if they do not fit the others: they may contain frames of the
    neighbouring segments. If no step improves the cost, x stays that of ``bank``.
    """
    refined, begins, ends = _refine_once(bank, model, window, scales)
    if len(window) < FEW_TICKS or (begins and ends):
        return refined
    inner = window.cut(0 if begins else 1, None if ends else -1)
    return _refine_once(refined.bank, model, inner, scales)[0]


def _refine_once(
    bank: Bank, model: ContactModel, window: Window, scales: EvidenceParameters
) -> tuple[Refined, bool, bool]:
    """A fit to all ticks of a window, and whether the first and the last tick are inliers."""
    family = model.family
    prior, anchors = prior_at_anchors(bank, model, scales.reach_m)
    x, errors = bank.x, Ar1Noise(np.ones(family.ROWS), np.zeros(family.ROWS))
    for _ in range(ROUNDS):
        x = _maximise(model, x, errors, anchors, window, prior)
        rows, tangent = _linearised(model, x, anchors, window)
        prior_information = tangent.T @ prior.precision[0] @ tangent
        errors = estimate_ar1(errors, rows, prior_information, window.index)
    information = _weighted_products(rows, errors, window.index)[:-1, :-1]
    lifted, position = model.lifted(window.zeta), window.variance[:, 0]
    # precision of an AR(1) error given both neighbours, relative to its marginal precision
    alone = (1.0 + errors.correlation**2) / (1.0 - errors.correlation**2)
    noise = residual_noise(model.measure(x, window.zeta), window)[0]
    row_weight = errors.weight * alone * np.mean(position / noise, axis=1)
    moments = np.einsum("t,tc,td->cd", 1.0 / position, lifted, lifted)
    belong = _are_inlier_ticks(rows, errors.weight, information + prior_information)
    fitted = bank.replace_columns(x=x[0], row_weight=row_weight).replace_onset_columns(second_moment=moments)
    return Refined(fitted, information), bool(belong[0]), bool(belong[-1])


def _are_inlier_ticks(rows: Array, weight: Array, information: Array) -> Bools:
    """Whether each tick (W,) is an inlier: studentised residuals, noise reduced by leverage."""
    jacobian, whitened = rows[..., :-1], rows[..., -1]
    # unobserved directions have no leverage
    covariance = np.linalg.pinv(information, LEAST_SHARE, hermitian=True)
    leverage = np.einsum("k,ktp,pq,ktq->kt", weight, jacobian, covariance, jacobian)
    square = weight[:, None] * whitened**2 / np.maximum(1.0 - leverage, LEAST_SCALE)
    return np.asarray(np.all(square < END_TICK_SIGMAS**2, axis=0))


def _maximise(
    model: ContactModel, x: Array, errors: Ar1Noise, anchors: Array, window: Window, prior: Prior
) -> Array:
    """Minimise the weighted squares of the residuals' innovations from x (1, S), by Levenberg-Marquardt."""

    def equations(x: Array) -> tuple[float, Array, Array, Array]:
        rows, tangent = _linearised(model, x, anchors, window)
        products = _weighted_products(rows, errors, window.index)
        gradient = products[:-1, -1] + tangent.T @ prior.gradient(x)[0]
        curvature = products[:-1, :-1] + tangent.T @ prior.precision[0] @ tangent
        return float(0.5 * products[-1, -1] + prior.cost(x)[0]), gradient, curvature, tangent

    damping, (cost, gradient, curvature, tangent) = np.array(FIRST_DAMPING), equations(x)
    for _ in range(STEPS):
        damped = curvature.copy()
        damped.flat[:: len(damped) + 1] += damping * curvature.diagonal() + LEAST_CURVATURE
        step = -linalg.solve(damped, gradient[:, None])[:, 0]
        decrease = abs(gradient @ step)
        proposal = model.family.normalise(x + tangent @ step, anchors)
        trial = equations(proposal)  # its cost alone would take nearly as long
        damping = adapted(damping, trial[0] < cost)
        if trial[0] < cost:
            x, (cost, gradient, curvature, tangent) = proposal, trial
        if decrease < TOLERANCE:
            break
    return x


def _weighted_products(rows: Array, errors: Ar1Noise, index: Ints) -> Array:
    """Weighted sum (P + 1, P + 1) of products of the innovations of ``rows`` (K, W, P + 1)."""
    return np.asarray(
        np.einsum("k,kpq->pq", errors.weight, _innovation_products(rows, errors.correlation, index))
    )


def _linearised(model: ContactModel, x: Array, anchors: Array, window: Window) -> tuple[Array, Array]:
    """Rows (K, W, P + 1) at x (1, S): the derivatives of the residuals along the tangent (S, P), then the
    residuals, in units of their noise; and the tangent."""
    tangent = model.family.tangent(x, anchors)[0]
    steps = STEP * tangent.T
    around = model.family.normalise(x + np.concatenate([steps, -steps]), anchors)
    measured = model.measure(np.concatenate([x, around]), window.zeta)
    whitened = measured.residual / np.sqrt(residual_noise(measured, window))
    ahead, behind = whitened[1:].reshape(2, len(steps), *whitened.shape[1:])
    return np.moveaxis(np.concatenate([(ahead - behind) / (2.0 * STEP), whitened[:1]]), 0, -1), tangent
