"""Refit hypotheses by a tick: accumulate the moments, take Gauss-Newton steps from the last estimate, and
evaluate the evidence of all ticks since the onset.
"""

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.contacts import ContactModel
from contact_tracker.hypotheses import gauss_newton
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import (
    DECISIVE,
    SAME_FIT_RATIO,
    EvidenceParameters,
    EvidenceSums,
    complexity,
    sum_evidence,
    weak_prior,
)
from contact_tracker.hypotheses.gauss_newton import Prior
from contact_tracker.hypotheses.schedule import (
    FIRST_STEPS,
    FIRST_TICKS,
    NEAR_NATS,
    RECOVERY_STEPS,
    REST_WEIGHT,
)
from contact_tracker.motion.window import Window


def anchors_of(bank: Bank, model: ContactModel) -> Array:
    """Anchors (H, 6) of each hypothesis' lines as in ``contacts.family``: known points, or the mean position
    of the body in its window."""
    anchors = model.anchors(bank.weighted_position_sum / bank.weight[:, None])
    return np.where(np.isnan(bank.line_anchor), anchors, bank.line_anchor)


def prior_at_anchors(bank: Bank, model: ContactModel, reach_m: float) -> tuple[Prior, Array]:
    """The prior of each hypothesis, the weak one plus that of its known elements, and the anchors (H, 6)
    around which it is evaluated."""
    anchors = anchors_of(bank, model)
    weak = weak_prior(model.family, anchors, reach_m)
    if not bank.prior_index.any():
        return weak, anchors
    return weak + Prior.around(bank.prior_mean, bank.prior_information, weak.flat), anchors


def accumulate(
    bank: Bank, model: ContactModel, window: Window, scales: EvidenceParameters, log_stay: float = 0.0
) -> Bank:
    """Add the newest tick to the moments, weighted by the ratio of its motion to the noise.

    ``log_stay`` is the log probability that the state did not change in it.
    """
    zeta, activity, tick = window.zeta[-1], float(window.motion_ratio[-1]), window.index[-1]
    lifted, sigma_m = model.lifted(zeta), float(np.sqrt(window.variance[-1, 0]))
    previous, alone = window.before_newest, lifted * scales.alone
    new = alone if previous is None else lifted - scales.correlation * model.lifted(previous)
    onsets = bank.onsets
    begins = onsets.onset == tick
    weight = np.where(begins, 1.0, max(activity, REST_WEIGHT)) / sigma_m**2
    products = np.where(begins[:, None, None], _products(model, alone, lifted), _products(model, new, lifted))
    bank = bank.replace_columns(
        log_prior=bank.log_prior + np.where(bank.onset == tick, 0.0, log_stay)
    ).replace_onset_columns(
        onset_row=np.where(begins[:, None], alone / sigma_m, onsets.onset_row),
        second_moment=onsets.second_moment + weight[:, None, None] * products,
        weighted_position_sum=onsets.weighted_position_sum + weight[:, None] * zeta[9:12],
        weight=onsets.weight + weight,
        effective_ticks=onsets.effective_ticks + np.where(begins, 1.0, activity),
    )
    # births take directions from the best hypothesis and touch at this tick; minimise solves for the rest
    return bank.replace_columns(x=model.family.normalise(bank.x, anchors_of(bank, model)))


def _products(model: ContactModel, innovation: Array, lifted: Array) -> Array:
    """Products (..., C, C) of the innovations of lifted poses (..., C). The column of the constant of e-e,
    whose sine is no linear residual, has the poses themselves."""
    products = innovation[..., :, None] * innovation[..., None, :]
    if model.family.FORM.h < 0:
        products[..., -1, :] = products[..., :, -1] = lifted
    return np.asarray(products)


def accumulate_window(bank: Bank, model: ContactModel, window: Window, scales: EvidenceParameters) -> Bank:
    """``accumulate`` over a whole window, in whose first tick all hypotheses of the bank begin."""
    lifted, variance = model.lifted(window.zeta), window.variance[:, 0]
    motion = np.append(1.0, window.motion_ratio[1:])  # the onset is given
    weight = np.maximum(motion, REST_WEIGHT) / variance
    innovation = scales.innovations(lifted)
    bank = bank.replace_onset_columns(
        onset_row=innovation[0] / np.sqrt(variance[0]),
        second_moment=np.einsum("w,wcd->cd", weight, _products(model, innovation, lifted)),
        weighted_position_sum=weight @ window.zeta[:, 9:12],
        weight=weight.sum(),
        effective_ticks=motion.sum(),
    )
    return bank.replace_columns(x=model.family.normalise(bank.x, anchors_of(bank, model)))


def are_near(bank: Bank) -> Bools:
    """Which hypotheses (H,) are within ``NEAR_NATS`` of the best before this tick."""
    return bank.log_weight >= -NEAR_NATS


def recover_fallen(
    bank: Bank, old_weight: Array, model: ContactModel, window: Window, scales: EvidenceParameters
) -> Bank:
    """Take more steps of hypotheses that were near the best (log weight ``old_weight`` (H,) before the tick),
    lost decisive evidence in this tick and do not fit any more: an open direction may be far off."""
    fallen = (old_weight >= -NEAR_NATS) & (bank.log_weight < old_weight - DECISIVE)
    rows = np.flatnonzero(fallen & (bank.rms > SAME_FIT_RATIO))
    return refit(bank, model, window, scales, rows, RECOVERY_STEPS) if len(rows) else bank


def refit(
    bank: Bank,
    model: ContactModel,
    window: Window,
    scales: EvidenceParameters,
    rows: Ints | None = None,
    steps: int | None = None,
) -> Bank:
    """Take Gauss-Newton steps from the last estimate and evaluate the evidence there, of ``rows`` or all;
    ``steps`` is by default the regular number in a tick.

    The moments are in 1/m^2, the weights of rows are relative to that.
    """
    if rows is not None:
        refitted = refit(bank.pick(rows), model, window, scales, steps=steps)
        return bank.replace_rows(rows, refitted, np.arange(len(rows)))
    count = np.where(bank.effective_ticks < FIRST_TICKS, FIRST_STEPS, 1) if steps is None else steps
    priors = prior_at_anchors(bank, model, scales.reach_m)
    fit = gauss_newton.minimise(model.family, bank.second_moment, bank.row_weight, *priors, bank.x, count)
    return _with_evidence(bank.replace_columns(x=fit.x), model, window, scales, priors, fit)


def _with_evidence(
    bank: Bank,
    model: ContactModel,
    window: Window,
    scales: EvidenceParameters,
    priors: tuple[Prior, Array],
    fit: gauss_newton.Fit,
) -> Bank:
    """The bank with the evidence at x, the minimum of the ``fit``; ``priors`` as of ``prior_at_anchors``."""
    sums = sum_evidence(model, bank.x, bank.onset, window, scales, bank.elements_known)
    prior, anchors = priors
    first = bank.onset_row[:, :, None] * bank.onset_row[:, None]
    onset = gauss_newton.information(
        model.family, first, bank.row_weight, bank.second_moment, anchors, fit.at
    )
    predicted_share = _prior_predictive_share(bank, model, scales, sums)
    cost = complexity(model.family, bank.x, fit.at, anchors, fit.hessian, onset, predicted_share, prior)
    gain = sums.gain.sum(axis=1) + bank.gain_before_window
    count = np.maximum(sums.ticks, 1)
    return bank.replace_columns(
        # geometry never costs more than it has explained
        log_likelihood=bank.log_prior
        + scales.likelihood_exponent * (sums.log_ratio + bank.llr_before_window - np.minimum(cost, gain)),
        row_weight=sums.precision / count[:, None],
        rms=np.sqrt(sums.chi_sq / (count * model.family.ROWS)),
    )


def _prior_predictive_share(
    bank: Bank, model: ContactModel, scales: EvidenceParameters, sums: EvidenceSums
) -> Array:
    """Share (H, K) of each row's information that the free-motion prediction would have given (T19)."""
    ticks = np.maximum(bank.effective_ticks, 1.0)[:, None]
    mean_gain = sums.gain / np.maximum(sums.ticks_after_onset, 1)[:, None]
    return np.asarray(scales.prior_predictive_share * model.needed / ticks * np.exp(-2.0 * mean_gain))
