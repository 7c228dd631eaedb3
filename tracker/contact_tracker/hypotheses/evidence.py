"""How much better than free motion does a contact explain a window? (docs/theory.md, T17, T19)

Per tick and constraint, a residual r is N(0, V) if the contact holds and N(0, S) under free motion, where
V is the noise of the residual and S - V the unpredictable motion in its direction. The log-likelihood ratio

    1/2 log(S / V) - 1/2 r^2 (1 / V - 1 / S)

is the gain minus the misfit: zero at rest, where S = V. What is left is the price of geometry fitted to the
window: the Laplace approximation of the integral over it.
"""

from dataclasses import dataclass
from math import log, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.family import Family, Measurement
from contact_tracker.geometry.vectors import dot
from contact_tracker.hypotheses.quadratic_prior import Prior
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]

AS_WELL: Final = 1.2
"""A contact fits as well if its whitened residual is no more than this times the best's, or the noise."""
DECISIVE: Final = log(20.0)
"""Evidence (nats) that tells two contacts apart: twenty to one."""
_I, _J = np.triu_indices(3)  # entries of a symmetric (3, 3) ...
_OFTEN = np.where(_I == _J, 1.0, 2.0)  # ... and how often each counts


@dataclass(frozen=True)
class EvidenceParameters:
    """Lengths of the weak priors (m), what free motion foretells of the geometry (share of T19's last term),
    how much of what a tick says is new, the tick (s), and the ``correlation`` of errors from tick to tick."""

    reach_m: float
    body_radius_m: float
    prior_predictive_share: float
    likelihood_exponent: float
    tick_s: float
    correlation: float = 0.0

    @property
    def alone(self) -> float:
        """By what a tick without one before it is scaled, to have the noise of the others (T34)."""
        return sqrt(1.0 - self.correlation**2)


@dataclass(frozen=True, eq=False)
class Ratio:
    """Log-likelihood ratios (B, W) of B hypotheses against free motion, tick by tick, and what the fit needs.

    ``gain`` (B, W, K) of each constraint; ``chi_sq`` (B, W, K) squared residuals over their noise;
    ``row_weight`` (B, W, K) precisions of the rows.
    """

    log_ratio: Array
    gain: Array
    chi_sq: Array
    row_weight: Array


def log_ratio(
    model: ContactModel,
    x: Array,
    window: Window,
    scales: EvidenceParameters,
    certain: NDArray[np.bool_] | None = None,
    onset: NDArray[np.int64] | None = None,
) -> Ratio:
    """Evaluate hypotheses x (B, S) exactly on each tick of the window.

    Elements that are fitted follow smooth motion, so that free motion is measured by what is unpredictable in
    it. Those of ``certain`` hypotheses (B,) are known and cannot: there, whatever moves the object would take
    it away from the constraint.
    """
    measurement = model.measure(x, window.zeta)
    if scales.correlation:
        measurement = _whitened(model, x, measurement, window, scales, onset)
    noise = residual_noise(measurement, window)
    excess = np.empty_like(noise)
    known = np.zeros(len(x), bool) if certain is None else certain
    for rows, free in zip(
        (~known, known), (window.innovation_excess, window.displacement_variance), strict=True
    ):
        free_position, free_rotation = free.T
        excess[rows, :-1] = free_rotation
        lever_sq = measurement.lever_sq[rows] + scales.body_radius_m**2
        excess[rows, -1] = free_position + free_rotation * lever_sq
    square = measurement.residual**2
    ratio = excess / noise
    gain = 0.5 * np.log1p(ratio)
    misfit = 0.5 * square / noise * (ratio / (1.0 + ratio))
    # the touching point is a point of the body: one look per second, since it hardly moves within a tick
    reach_penalty = 0.5 * measurement.reach_sq / (2.0 * scales.reach_m) ** 2 * scales.tick_s
    return Ratio(
        (gain - misfit).sum(axis=1) - np.where(window.innovation_excess[:, 0] > 0, reach_penalty, 0.0),
        np.swapaxes(gain, 1, 2),
        np.swapaxes(square / noise, 1, 2),
        np.swapaxes(1.0 / noise, 1, 2),
    )


def _whitened(
    model: ContactModel,
    x: Array,
    measurement: Measurement,
    window: Window,
    scales: EvidenceParameters,
    onset: NDArray[np.int64] | None,
) -> Measurement:
    """What is new in the residuals of each tick; where a hypothesis begins (B,), or nothing is known of the
    tick before, all of it is, scaled to the same noise."""
    residual, correlation = measurement.residual, scales.correlation
    alone = residual * scales.alone
    new = alone.copy()
    new[:, :, 1:] = residual[:, :, 1:] - correlation * residual[:, :, :-1]
    if window.before is not None and len(window):
        new[:, :, 0] = (
            residual[:, :, 0] - correlation * model.measure(x, window.before[None]).residual[:, :, 0]
        )
    if onset is not None:
        begins = (window.index == onset[:, None])[:, None]
        new = np.where(begins, alone, new)
    return measurement._replace(residual=new)


def residual_noise(measurement: Measurement, window: Window) -> Array:
    """Noise variances (B, K, W) of residuals: an angle has that of rotation, a distance that of the position
    along it and that of rotation on its lever arm."""
    position, rotation = window.variance.T
    noise = np.empty_like(measurement.residual)
    noise[:, :-1], noise[:, -1] = rotation, position + rotation * measurement.lever_sq
    if window.position_anisotropy is not None:
        square = measurement.along[..., _I] * measurement.along[..., _J]
        uneven = window.position_anisotropy[:, _I, _J] * _OFTEN
        same = square.shape[1] == 1
        noise[:, -1] += square[:, 0] @ uneven.T if same else np.einsum("btk,tk->bt", square, uneven)
    return noise


def weak_prior(family: Family, anchors: Array, reach_m: float) -> Prior:
    """Touching points lie within reach of the body (anchors (B, 6)); directions are anything."""
    mean, pull = family.place(anchors), family.SPREAD / reach_m**2
    precision = np.broadcast_to(np.diag(pull), (len(anchors), len(pull), len(pull)))
    information = pull * mean
    return Prior(precision, information, 0.5 * dot(information, mean), 1.0 - family.SPREAD)


def complexity(
    family: Family,
    x: Array,
    at: Array,
    anchors: Array,
    hessian: Array,
    given: Array,
    predicted_share: Array,
    prior: Prior,
) -> Array:
    """Price (B,) in nats of geometry that was fitted: Laplace's volume ratio and the distance from the prior.

    What is not paid for: ``given`` (B, P, P), the information of the first tick (that a contact begins now
    says that its elements touch now); and ``predicted_share`` (B, K), the share of each row's information
    ``hessian`` (B, K, P, P) that free motion itself would have given of where the object will be. All that is
    told ``at`` (B, S), which is x (B, S) or near it.
    """
    tangent = family.tangent(at, anchors)
    along = np.swapaxes(tangent, -1, -2)
    before = along @ (prior.precision + np.diag(prior.flat)) @ tangent
    before = before + np.einsum("bk,bkpq->bpq", predicted_share, hessian)
    volume = np.linalg.slogdet(hessian.sum(axis=1) + before)[1] - np.linalg.slogdet(given + before)[1]
    return np.asarray(0.5 * volume + prior.cost(x))


Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class EvidenceSums:
    """Sums over the ticks of a window from the onset on, and for some without the onset, which is given.

    ``log_ratio`` (B,) and ``gain`` (B, K) after the onset (see ``evidence.Ratio``); ``precision`` (B, K) of
    the residuals relative to that of the position; ``chi_sq`` (B,) squared residuals over their noise;
    ``ticks`` (B,) how many there are, ``after`` (B,) without the onset.
    """

    log_ratio: Array
    gain: Array
    precision: Array
    chi_sq: Array
    ticks: Index
    after: Index


def sum_evidence(
    model: ContactModel,
    x: Array,
    onset: Index,
    window: Window,
    scales: EvidenceParameters,
    certain: NDArray[np.bool_],
) -> EvidenceSums:
    """Evaluate hypotheses x (B, S) that begin at ``onset`` (B,) as ``evidence.log_ratio`` does."""
    ratio = log_ratio(model, x, window, scales, certain, onset)
    mine, after = window.index >= onset[:, None], window.index > onset[:, None]
    relative = ratio.row_weight * window.variance[:, :1]  # the moments' own weight is 1 over that
    return EvidenceSums(
        np.where(after, ratio.log_ratio, 0.0).sum(axis=1),
        np.where(after[..., None], ratio.gain, 0.0).sum(axis=1),
        np.where(mine[..., None], relative, 0.0).sum(axis=1),
        np.where(mine[..., None], ratio.chi_sq, 0.0).sum(axis=(1, 2)),
        mine.sum(axis=1),
        after.sum(axis=1),
    )
