"""Refine the fit of a finished segment: maximum a posteriori geometry with the noise of every tick.

The running fit uses moments: rows weighted by their mean noise, ticks by their motion (docs/theory.md, T13).
It is fast, but its estimate and its covariance are approximate. Here every tick counts by its own noise
(T16), ticks at rest as well; the noise depends on the geometry; and the variance and correlation of each
row's errors are estimated from the residuals (T26).
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array, Ints
from contact_tracker.contacts import ContactModel
from contact_tracker.geometry import linalg
from contact_tracker.geometry.linalg import adapted
from contact_tracker.hypotheses import compiled
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import EvidenceParameters, residual_noise
from contact_tracker.hypotheses.gauss_newton import Prior
from contact_tracker.hypotheses.refit import anchors_of, prior_of
from contact_tracker.motion.window import Window

LEARNING_STEPS: Final = 15
"""Iterations of expectation-maximisation."""
PRIOR_TICKS: Final = 1.0
"""Weight of the prior noise variance, as a number of ticks."""
MOST_CORRELATION: Final = 0.95
LEAST_SCALE: Final = 1e-6
LEAST_SHARE: Final = 1e-12


class Ar1Noise(NamedTuple):
    """Errors of the K residuals: an autoregressive process of order one from tick to tick."""

    weight: Array
    """(K,) estimated precision over the assumed precision."""
    correlation: Array
    """(K,) correlation between neighbouring ticks."""


def estimate_ar1(
    errors: Ar1Noise, whitened: Array, jacobian: Array, prior_information: Array, index: Ints
) -> Ar1Noise:
    """Estimate the errors from the whitened residuals (K, W) of a fit, by expectation-maximisation.

    Residuals are smaller than errors, because the fit absorbs errors that look like geometry. Their share
    follows from the ``jacobian`` (K, W, P) and the ``prior_information`` (P, P). With too few ticks the
    estimate stays near ``errors``.
    """
    (weight, correlation), count = errors, whitened.shape[1]
    rows, follows = np.concatenate([jacobian, whitened[..., None]], axis=2), np.diff(index) == 1
    paired = rows[:, np.append(follows, False) | np.append(False, follows)]  # others would only add scatter
    across = _products(rows[:, 1:][:, follows], rows[:, :-1][:, follows])
    product = 0.5 * (across + across.swapaxes(1, 2)) / max(int(np.count_nonzero(follows)), 1)
    pairs = np.array([product, _products(paired, paired) / max(paired.shape[1], 1)])
    new = _innovation_products(rows, correlation, index)
    for _ in range(LEARNING_STEPS):
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
        weight = variance ** (-count / (count + PRIOR_TICKS))
    return Ar1Noise(weight, correlation)


def whiten_ar1(rows: Array, correlation: Array, index: Ints) -> Array:
    """Innovations of rows (K, W, ...) given the tick before, scaled to the same variance."""
    decay = correlation[:, None] ** np.diff(index)
    decay = decay.reshape(*decay.shape, *(1,) * (rows.ndim - 2))
    later = (rows[:, 1:] - decay * rows[:, :-1]) / np.sqrt(1.0 - decay**2)
    return np.concatenate([rows[:, :1], later], axis=1)


def _innovation_products(rows: Array, correlation: Array, index: Ints) -> Array:
    """Sums (K, Z, Z) over ticks of products of the innovations of rows (K, W, Z)."""
    new = whiten_ar1(rows, correlation, index)
    return _products(new, new)


def _products(a: Array, b: Array) -> Array:
    return np.asarray(a.swapaxes(1, 2) @ b)


ROUNDS: Final = 3
"""Alternations of fitting the geometry and estimating the noise from the residuals."""
STEPS: Final = 20
TOLERANCE_NATS: Final = 1e-4
FIRST_CORRELATION: Final = 0.5
FEW_TICKS: Final = 15
END_TICK_SIGMAS: Final = 2.5
"""The first and the last tick are left out if they are this far off, unless there are fewer than
``FEW_TICKS``."""
LEAST_CURVATURE: Final = 1e-9
FIRST_DAMPING: Final = 1e-6
STEP: Final = 1e-6
"""Step of finite differences, in radians and metres."""
LEAST_SHOWN: Final = 1e-15
"""Directions with less than this share of the largest information count as unobserved."""


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
    anchors = anchors_of(bank, model)
    prior = prior_of(bank, model, anchors, scales.reach_m)
    x, errors = bank.x, Ar1Noise(np.ones(family.ROWS), np.full(family.ROWS, FIRST_CORRELATION))
    for _ in range(ROUNDS):
        x = _maximise(model, x, errors, anchors, window, prior, scales.reach_m)
        whitened, jacobian, tangent = _linearised(model, x, anchors, window)
        prior_information = tangent.T @ prior.precision[0] @ tangent
        errors = estimate_ar1(errors, whitened, jacobian, prior_information, window.index)
    innovation = whiten_ar1(jacobian, errors.correlation, window.index)
    information = np.einsum("ktp,k,ktq->pq", innovation, errors.weight, innovation)
    lifted, position = model.lifted(window.zeta), window.variance[:, 0]
    # precision of an AR(1) error given both neighbours, relative to its marginal precision
    alone = (1.0 + errors.correlation**2) / (1.0 - errors.correlation**2)
    row_weight = errors.weight * alone * np.mean(position / _noise(model, x, window)[1][0], axis=1)
    moments = np.einsum("t,tc,td->cd", 1.0 / position, lifted, lifted)
    belong = _are_inlier_ticks(whitened, jacobian, errors.weight, information + prior_information)
    fitted = bank.replace_columns(x=x[0], row_weight=row_weight).replace_onset_columns(second_moment=moments)
    return Refined(fitted, information), bool(belong[0]), bool(belong[-1])


def _are_inlier_ticks(
    whitened: Array, jacobian: Array, weight: Array, information: Array
) -> NDArray[np.bool_]:
    """Whether each tick (W,) is an inlier: studentised residuals, noise reduced by leverage."""
    # unobserved directions have no leverage
    covariance = np.linalg.pinv(information, LEAST_SHOWN, hermitian=True)
    leverage = np.einsum("k,ktp,pq,ktq->kt", weight, jacobian, covariance, jacobian)
    square = weight[:, None] * whitened**2 / np.maximum(1.0 - leverage, LEAST_SCALE)
    return np.asarray(np.all(square < END_TICK_SIGMAS**2, axis=0))


class Equations(NamedTuple):
    """Gauss-Newton equations of the likelihood at one x (S,)."""

    cost: float
    """Half the weighted squares of the residuals' innovations."""
    gradient: Array
    """(P,)"""
    curvature: Array
    """(P, P)"""
    tangent: Array
    """(P, S) the free directions."""


def _maximise(
    model: ContactModel,
    x: Array,
    errors: Ar1Noise,
    anchors: Array,
    window: Window,
    prior: Prior,
    reach_m: float,
) -> Array:
    """Minimise the weighted squares of the residuals' innovations from x (1, S), by Levenberg-Marquardt."""

    def new(x: Array) -> tuple[float, Equations]:
        equations = _equations(model, x, errors, anchors, window, reach_m)
        return equations.cost + float(prior.cost(x)[0]), equations

    damping, (cost, current) = np.array(FIRST_DAMPING), new(x)
    for _ in range(STEPS):
        gradient = current.gradient + current.tangent @ prior.gradient(x)[0]
        curvature = current.curvature + current.tangent @ prior.precision[0] @ current.tangent.T
        curvature.flat[:: len(curvature) + 1] += damping * curvature.diagonal() + LEAST_CURVATURE
        step = -linalg.solve(curvature, gradient[:, None])[:, 0]
        proposal = model.family.normalise(x + step @ current.tangent, anchors)
        trial = new(proposal)  # its cost alone would take nearly as long
        damping = adapted(damping, trial[0] < cost)
        if trial[0] < cost:
            x, (cost, current) = proposal, trial
        if abs(gradient @ step) < TOLERANCE_NATS:
            break
    return x


def _equations(
    model: ContactModel, x: Array, errors: Ar1Noise, anchors: Array, window: Window, reach_m: float
) -> Equations:
    """The equations of the data at x (1, S)."""
    if not compiled.in_use():
        return _equations_reference(model, x, errors, anchors, window)
    from contact_tracker.hypotheses.compiled import calls

    kind, ticks = calls.model_of(model, reach_m), calls.ticks_of(window)
    return Equations(*calls.equations(kind, x[0], anchors[0], ticks, *errors, STEP))


def _equations_reference(
    model: ContactModel, x: Array, errors: Ar1Noise, anchors: Array, window: Window
) -> Equations:
    """``_equations`` in numpy: the reference of the compiled kernel."""
    weight, correlation = errors
    whitened, slopes, tangent = _linearised(model, x, anchors, window)
    residual = whiten_ar1(whitened, correlation, window.index)
    jacobian = whiten_ar1(slopes, correlation, window.index)
    weighted = weight[:, None, None] * jacobian
    cost = float(0.5 * weight @ np.sum(residual**2, axis=1))
    gradient = np.einsum("ktp,kt->p", weighted, residual)
    return Equations(cost, gradient, np.einsum("ktp,ktq->pq", weighted, jacobian), tangent.T)


def _noise(model: ContactModel, x: Array, window: Window) -> tuple[Array, Array]:
    """Residuals of x (B, S) and their noise variances, (B, K, W) both."""
    residuals = model.measure(x, window.zeta)
    return residuals.residual, residual_noise(residuals, window)


def _whitened(model: ContactModel, x: Array, window: Window) -> Array:
    """Residuals of x (B, S) in units of their noise, (B, K, W)."""
    residual, variance = _noise(model, x, window)
    return np.asarray(residual / np.sqrt(variance))


def _linearised(model: ContactModel, x: Array, anchors: Array, window: Window) -> tuple[Array, Array, Array]:
    """Whitened residuals (K, W) at x (1, S), their derivative (K, W, P) along the tangent (S, P)."""
    tangent = model.family.tangent(x, anchors)[0]
    steps = STEP * tangent.T
    around = model.family.normalise(x + np.concatenate([steps, -steps]), anchors)
    residuals = _whitened(model, np.concatenate([x, around]), window)
    half = len(steps)
    jacobian: Array = (residuals[1 : half + 1] - residuals[half + 1 :]) / (2.0 * STEP)
    return residuals[0], np.moveaxis(jacobian, 0, -1), tangent
