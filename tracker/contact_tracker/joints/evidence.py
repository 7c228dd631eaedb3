"""Evidence of joints against free motion and against contacts (docs/theory.md, T44)."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.formations.conditional import ConditionalMotion
from contact_tracker.formations.further import SURE_NATS, KnownContact
from contact_tracker.formations.price import price
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.joints.models import JOINT_MODELS, PITCH, JointFrames, JointKind, JointModel, Residual
from contact_tracker.motion.lifted_pose import NOISE_OF_PERTURBATION
from contact_tracker.motion.used_directions import used_directions
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]

MOST_DIRECTIONS: Final = 3
"""Motion in more directions is that of no joint."""
LEAST_TICKS: Final = 20
LEAST_ACTIVITY: Final = 10.0
"""Least number of ticks with motion: smooth motion of a hand may follow a joint by chance for a while."""
PLAYS: Final = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Factors of the noise that are tried for motion of one degree of freedom, because joints have play and
markers bend, and for contacts as well."""
STEPS: Final = 12
FIRST_DAMPING: Final = 1e-3
DAMPING: Final = (0.2, 10.0)
"""Factors of the damping after a step that has lowered the cost, and after one that has not."""
CONVERGED: Final = 1e-6
PITCH_M: Final = 0.05
"""Prior standard deviation of the pitch (m/rad); that of turns is one radian, that of points the usual
reach."""
JITTER: Final = 1e-9


class FittedJoint(NamedTuple):
    """A joint at its greatest likelihood: ``covariance`` (P, P) of its free parameters and ``log_evidence``
    against free motion (nats), with ``play`` times the noise."""

    model: JointModel
    frames: JointFrames
    covariance: Array
    log_evidence: float
    play: float


class FoundJoint(NamedTuple):
    """The most probable joint, with its ``log_odds`` (nats) against all other explanations, other joints
    included."""

    fitted: FittedJoint
    log_odds: float


def find_joint(
    window: Window, scales: EvidenceParameters, contacts: Sequence[KnownContact], constraints: int
) -> FoundJoint | None:
    """The joint that explains the ticks of ``window`` better than contacts and free motion; None without any.

    Parameters
    ----------
    contacts : the rival contacts, each with its best geometry.
    constraints : number of constraints of the labelled contacts; joints with fewer are left out.
    """
    if len(window) < LEAST_TICKS or float(window.motion_ratio.sum()) < LEAST_ACTIVITY:
        return None
    used = used_directions(window)
    if not 0 < used <= MOST_DIRECTIONS:
        return None
    some = [
        one
        for one in JOINT_MODELS
        if one.kind.constraints >= constraints and (used == 1 or one.kind is JointKind.BALL)
    ]
    plays = PLAYS if used == 1 else PLAYS[:1]
    fitted = [fit_joint(model, window, scales, plays) for model in some]
    best = max(fitted, key=lambda one: one.log_evidence, default=None)
    if best is None or best.log_evidence <= SURE_NATS:
        return None
    rivals = [0.0, *(contact_evidence(one, window, scales, plays) for one in contacts)]
    if best.log_evidence - max(rivals) <= SURE_NATS:
        return None
    rivals += [one.log_evidence for one in fitted if one is not best]
    return FoundJoint(best, best.log_evidence - float(np.logaddexp.reduce(rivals)))


def fit_joint(
    model: JointModel, window: Window, scales: EvidenceParameters, plays: tuple[float, ...] = PLAYS[:1]
) -> FittedJoint:
    """Fit a joint to a window: start from moments of the ticks, then damped Gauss-Newton with each tick's
    noise."""
    noise_sd, moved_sd = _deviations_of(window)
    deviation = _deviations(scales)[model.free]
    frames, damping = model.start(window.zeta), FIRST_DAMPING
    at = _whitened(model.residual(frames, window.zeta), noise_sd, scales)
    for _ in range(STEPS):
        hessian, gradient = at.normal()
        damped = hessian + np.diag(damping * hessian.diagonal() + deviation**-2.0)
        step = np.asarray(-np.linalg.solve(damped, gradient), np.float64)
        there = model.moved(frames, step)
        then = _whitened(model.residual(there, window.zeta), noise_sd, scales)
        gained = at.cost - then.cost
        damping = max(damping * DAMPING[0 if gained > 0.0 else 1], JITTER)
        if gained > 0.0:
            frames, at = there, then
        if abs(gained) < CONVERGED * (1.0 + at.cost):
            break
    hessian = at.normal()[0]
    ticks = _Ticks.of(model.residual(frames, window.zeta), noise_sd, moved_sd, scales)
    evidence = [ticks.log_ratio(play) - _price(hessian / play**2, deviation) for play in plays]
    best = int(np.argmax(evidence))
    precision = hessian / plays[best] ** 2 + np.diag(deviation**-2.0)
    covariance = np.asarray(np.linalg.inv(precision), np.float64)
    return FittedJoint(model, frames, covariance, scales.likelihood_exponent * evidence[best], plays[best])


def contact_evidence(
    contact: KnownContact, window: Window, scales: EvidenceParameters, plays: tuple[float, ...] = PLAYS[:1]
) -> float:
    """Log evidence of a contact against the same free motion as for joints, with the best of the same
    ``plays``."""
    motion, c = ConditionalMotion.of(window, scales), contact.c
    value = window.zeta @ c.T
    residual = Residual(value, motion.gradients(c), np.zeros((*value.shape, 0)))
    ticks = _Ticks.of(residual, *_deviations_of(window), scales)
    evidence = [
        ticks.log_ratio(play) - price(contact.model, contact.x, motion, window, scales, play)
        for play in plays
    ]
    return scales.likelihood_exponent * max(evidence)


def _deviations_of(window: Window) -> tuple[Array, Array]:
    """Standard deviations (W, 6) of the noise and of the displacement in each tick."""
    return np.sqrt(window.variance[:, NOISE_OF_PERTURBATION]), np.sqrt(
        window.displacement_variance[:, NOISE_OF_PERTURBATION]
    )


def _deviations(scales: EvidenceParameters) -> Array:
    """Prior standard deviations (13,) of all parameters of a joint."""
    deviation = np.ones(PITCH + 1)
    deviation[:6], deviation[PITCH] = scales.reach_m, PITCH_M
    return deviation


class _Whitened(NamedTuple):
    """Residuals (n,) of unit variance, and their derivatives (n, P)."""

    residual: Array
    slope: Array

    @property
    def cost(self) -> float:
        return 0.5 * float(self.residual @ self.residual)

    def normal(self) -> tuple[Array, Array]:
        """The Hessian (P, P) and the gradient (P,) of the cost."""
        return self.slope.T @ self.slope, self.slope.T @ self.residual


def _held(by_pose: Array, noise_sd: Array) -> Array:
    """Covariance (W, K, K) of the residuals due to noise."""
    rows = by_pose * noise_sd[:, None]
    return np.asarray(rows @ np.swapaxes(rows, 1, 2))


def _whitened(residual: Residual, noise_sd: Array, scales: EvidenceParameters) -> _Whitened:
    lower = np.linalg.cholesky(_held(residual.by_pose, noise_sd))
    both = np.concatenate([residual.value[..., None], residual.by_x], axis=2)
    white = np.linalg.solve(lower, scales.innovations(both))
    return _Whitened(white[..., 0].ravel(), white[..., 1:].reshape(-1, white.shape[2] - 1))


def _price(hessian: Array, deviation: Array) -> float:
    """Complexity (nats) of parameters with this ``hessian`` (P, P) and prior ``deviation`` (P,)."""
    scaled = hessian * deviation[:, None] * deviation
    return 0.5 * float(np.linalg.slogdet(np.eye(len(scaled)) + scaled)[1])


class _Ticks(NamedTuple):
    """Sums over the ticks: ``gain``, half the log determinants of free motion over noise; squared residuals
    over noise (``held``) and over free motion (``loose``); the number of ``rows``."""

    gain: float
    held: float
    loose: float
    rows: int

    @classmethod
    def of(cls, residual: Residual, noise_sd: Array, moved_sd: Array, scales: EvidenceParameters) -> "_Ticks":
        scale = np.sqrt(np.square(residual.by_pose * noise_sd[:, None]).sum(axis=2)) + JITTER**2
        rows = residual.by_pose / scale[..., None]  # the result does not depend on the units of a row
        held = _held(rows, noise_sd) + JITTER * np.eye(rows.shape[1])
        loose = held + _held(rows, moved_sd)
        new = (scales.innovations(residual.value) / scale)[..., None]
        gain = 0.5 * float((np.linalg.slogdet(loose)[1] - np.linalg.slogdet(held)[1]).sum())
        return cls(
            gain,
            float((new * np.linalg.solve(held, new)).sum()),
            float((new * np.linalg.solve(loose, new)).sum()),
            residual.value.size,
        )

    def log_ratio(self, play: float) -> float:
        """Log-likelihood ratio against free motion, with ``play`` times the noise."""
        loose = min(self.loose, self.rows)  # free motion can follow smooth motion
        misfit = 0.5 * (self.held / play**2 - loose)
        return self.gain - self.rows * float(np.log(play)) - misfit
