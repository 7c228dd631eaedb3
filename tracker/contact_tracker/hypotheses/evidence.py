"""Evidence of a contact against free motion in a window (docs/theory.md, T17, T19).

Per tick and constraint, a residual r is N(0, V) if the contact holds and N(0, S) under free motion, where
V is the noise variance of the residual and S - V the innovation excess in its direction. The log-likelihood
ratio

    1/2 log(S / V) - 1/2 r^2 (1 / V - 1 / S)

is the gain minus the misfit: zero at rest, where S = V. The complexity of the geometry fitted to the window
is subtracted: the Laplace approximation of the integral over it.
"""

from dataclasses import dataclass
from math import log, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array, Ints
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.family import Family, Measurement
from contact_tracker.geometry.linalg import dot
from contact_tracker.hypotheses.gauss_newton import Prior
from contact_tracker.motion.window import Window

SAME_FIT_RATIO: Final = 1.2
"""A contact fits as well if its whitened residual is at most this times the best one's, or the noise. A
hypothesis fits if its own is: it does not search, although that might gain some nats."""
DECISIVE: Final = log(20.0)
"""Evidence (nats) that distinguishes two contacts: twenty to one."""
_I, _J = np.triu_indices(3)  # entries of a symmetric (3, 3) ...
_OFTEN = np.where(_I == _J, 1.0, 2.0)  # ... and how often each counts


@dataclass(frozen=True)
class EvidenceParameters:
    """Parameters of the evidence."""

    reach_m: float
    """Standard deviation of the weak prior on touching points."""
    body_radius_m: float
    """Lever arm with which free rotation moves a point of the body."""
    prior_predictive_share: float
    """Share of the last term of T19: the information on the geometry that free motion predicts."""
    likelihood_exponent: float
    """Power of the likelihood: ticks are not fully independent."""
    tick_s: float
    """Duration of a tick."""
    correlation: float = 0.0
    """Correlation of errors from tick to tick (T34)."""

    @property
    def alone(self) -> float:
        """Scale of the residual of a tick without predecessor, so that it has the variance of innovations
        (T34)."""
        return sqrt(1.0 - self.correlation**2)

    def innovations(self, values: Array, before: Array | None = None) -> Array:
        """Innovations of values (W, ...) tick by tick (T34), given those (...) of the tick ``before`` the
        first."""
        innovation = values * self.alone
        if self.correlation:
            innovation[1:] = values[1:] - self.correlation * values[:-1]
            if before is not None:
                innovation[0] = values[0] - self.correlation * before
        return innovation


@dataclass(frozen=True, eq=False)
class Ratio:
    """Log-likelihood ratios of B hypotheses against free motion in each of W ticks, with their parts."""

    log_ratio: Array
    """(B, W) in nats."""
    gain: Array
    """(B, W, K) gain of each constraint."""
    chi_sq: Array
    """(B, W, K) squared residuals over their noise variance."""
    row_weight: Array
    """(B, W, K) precision of the residuals."""


def log_ratio(
    model: ContactModel,
    x: Array,
    window: Window,
    scales: EvidenceParameters,
    certain: NDArray[np.bool_] | None = None,
    onset: NDArray[np.int64] | None = None,
) -> Ratio:
    """Evaluate hypotheses x (B, S) on each tick of the window, without linearisation.

    Fitted elements can follow smooth motion, so the variance of free motion is its innovation excess.
    Elements of ``certain`` hypotheses (B,) are known and cannot: there it is the variance of the whole
    displacement.
    """
    measurement = model.measure(x, window.zeta)
    if scales.correlation:
        measurement = _whitened(model, x, measurement, window, scales, onset)
    noise = residual_noise(measurement, window)
    excess = np.empty_like(noise)
    is_certain = np.zeros(len(x), bool) if certain is None else certain
    for rows, free in zip(
        (~is_certain, is_certain), (window.innovation_excess, window.displacement_variance), strict=True
    ):
        free_position, free_rotation = free.T
        excess[rows, :-1] = free_rotation
        lever_sq = measurement.lever_sq[rows] + scales.body_radius_m**2
        excess[rows, -1] = free_position + free_rotation * lever_sq
    square = measurement.residual**2
    gain, misfit = gain_and_misfit(square, noise, excess)
    # the touching point hardly moves within a tick: its distance counts once a second
    reach_penalty = 0.5 * measurement.reach_sq / (2.0 * scales.reach_m) ** 2 * scales.tick_s
    return Ratio(
        (gain - misfit).sum(axis=1) - np.where(window.innovation_excess[:, 0] > 0, reach_penalty, 0.0),
        np.swapaxes(gain, 1, 2),
        np.swapaxes(square / noise, 1, 2),
        np.swapaxes(1.0 / noise, 1, 2),
    )


def gain_and_misfit(square: Array, noise: Array, excess: Array) -> tuple[Array, Array]:
    """The gain of constraints whose residuals have the variance ``noise``, and ``noise + excess`` under free
    motion, and the misfit of squared residuals (T17), in nats."""
    ratio = excess / noise
    return 0.5 * np.log1p(ratio), 0.5 * square / noise * (ratio / (1.0 + ratio))


def _whitened(
    model: ContactModel,
    x: Array,
    measurement: Measurement,
    window: Window,
    scales: EvidenceParameters,
    onset: NDArray[np.int64] | None,
) -> Measurement:
    """The measurement with its residuals whitened from tick to tick. Without a predecessor, or at the
    ``onset`` (B,), they are only scaled to the same noise."""
    residual, before = np.moveaxis(measurement.residual, -1, 0), None
    if window.before is not None and len(window):
        before = model.measure(x, window.before[None]).residual[:, :, 0]
    innovation = scales.innovations(residual, before)
    if onset is not None:
        begins = (window.index[:, None] == onset)[..., None]
        innovation = np.where(begins, residual * scales.alone, innovation)
    return measurement._replace(residual=np.ascontiguousarray(np.moveaxis(innovation, 0, -1)))


def residual_noise(measurement: Measurement, window: Window) -> Array:
    """Noise variances (B, K, W) of residuals. An angle has that of rotation; a distance that of position in
    its direction, plus that of rotation times the squared lever arm."""
    position, rotation = window.variance.T
    noise = np.empty_like(measurement.residual)
    noise[:, :-1], noise[:, -1] = rotation, position + rotation * measurement.lever_sq
    if window.position_anisotropy is not None:
        square = measurement.along[..., _I] * measurement.along[..., _J]
        uneven = window.position_anisotropy[:, _I, _J] * _OFTEN
        is_shared = square.shape[1] == 1
        noise[:, -1] += square[:, 0] @ uneven.T if is_shared else np.einsum("btk,tk->bt", square, uneven)
    return noise


def weak_prior(family: Family, anchors: Array, reach_m: float) -> Prior:
    """Prior: touching points lie within reach of the body (anchors (B, 6)); directions are uniform."""
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
    onset: Array,
    predicted_share: Array,
    prior: Prior,
) -> Array:
    """Complexity (B,) in nats of fitted geometry: Laplace's volume ratio plus the cost under the prior.

    Two kinds of information reduce it: that of the ``onset`` tick (B, P, P), because a contact that begins
    there touches there; and ``predicted_share`` (B, K), the share of each row's information
    ``hessian`` (B, K, P, P) that the prediction of free motion would have given. All are evaluated ``at`` (B,
    S), which is x (B, S) or near it.
    """
    tangent = family.tangent(at, anchors)
    along = np.swapaxes(tangent, -1, -2)
    initial = along @ (prior.precision + np.diag(prior.flat)) @ tangent
    initial = initial + np.einsum("bk,bkpq->bpq", predicted_share, hessian)
    volume = np.linalg.slogdet(hessian.sum(axis=1) + initial)[1] - np.linalg.slogdet(onset + initial)[1]
    return np.asarray(0.5 * volume + prior.cost(x))


@dataclass(frozen=True, eq=False)
class EvidenceSums:
    """Sums of the terms of ``Ratio`` over the ticks of a window since the onset."""

    log_ratio: Array
    """(B,) without the onset tick, which the hypothesis takes as given."""
    gain: Array
    """(B, K) without the onset tick."""
    precision: Array
    """(B, K) of the residuals, relative to that of the position."""
    chi_sq: Array
    """(B,) squared residuals over their noise variance."""
    ticks: Ints
    """(B,) number of ticks."""
    ticks_after_onset: Ints
    """(B,) number of ticks without the onset."""


def sum_evidence(
    model: ContactModel,
    x: Array,
    onset: Ints,
    window: Window,
    scales: EvidenceParameters,
    certain: NDArray[np.bool_],
) -> EvidenceSums:
    """Sum ``log_ratio`` and its parts for hypotheses x (B, S) with ``onset`` (B,)."""
    ratio = log_ratio(model, x, window, scales, certain, onset)
    since_onset, after_onset = window.index >= onset[:, None], window.index > onset[:, None]
    relative = ratio.row_weight * window.variance[:, :1]  # moments are weighted by one over this variance
    return EvidenceSums(
        np.where(after_onset, ratio.log_ratio, 0.0).sum(axis=1),
        np.where(after_onset[..., None], ratio.gain, 0.0).sum(axis=1),
        np.where(since_onset[..., None], relative, 0.0).sum(axis=1),
        np.where(since_onset[..., None], ratio.chi_sq, 0.0).sum(axis=(1, 2)),
        since_onset.sum(axis=1),
        after_onset.sum(axis=1),
    )
