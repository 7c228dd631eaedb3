"""Evidence of joints against free motion and against contacts (docs/theory.md, T44)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.contacts.task_frame import TaskFrame, joint_frame
from contact_tracker.explanations.conditional_contact import ConditionalMotion, ExplainedTicks, KnownContact
from contact_tracker.explanations.further_contacts import SURE_NATS, elements_complexity
from contact_tracker.explanations.joint_misfit import (
    JITTER,
    MOST_PLAY,
    course_functions,
    misfit_log_likelihood,
)
from contact_tracker.explanations.joint_models import (
    BODY_POINT,
    BODY_TURN,
    CYLINDER,
    JOINT_MODELS,
    PITCH,
    S_Z,
    WORLD_POINT,
    WORLD_TURN,
    JointFrames,
    JointKind,
    JointModel,
    Residual,
)
from contact_tracker.geometry.elements import Element, Line, Origins, Point, by_foot, shifted
from contact_tracker.geometry.lifted_pose import NOISE_OF_PERTURBATION, R, T
from contact_tracker.geometry.linalg import adapted
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.hypotheses.observability import added_covariance, representatives
from contact_tracker.motion.window import Window, used_directions

MOST_DIRECTIONS: Final = 3
"""Largest number of directions of motion of a joint."""
LEAST_TICKS: Final = 20
LEAST_ACTIVITY: Final = 10.0
"""Least number of ticks with motion; a hand's smooth motion may follow a joint by chance for a while."""
FITS: Final = 2
"""Number of fits of a joint with play: with the noise alone, then with the play that the first one shows."""
STEPS: Final = 12
FIRST_DAMPING: Final = 1e-3
CONVERGED: Final = 1e-6
MOST_ERRORS: Final = 0.1
"""Largest errors of a joint, as a share of its motion (root mean squares, in units of the noise). Otherwise a
shift along a bent curve is a slider or a hinge with large play. With 0.2 instead, 33 instead of 2 of the 81
curves of ``joint_play.py`` are sure to be a joint, and 220 instead of 207 of its 297 hinges are named."""
MOST_ERRORS_ONCE: Final = 0.015
"""The same of a joint that never comes again to where it was: any single motion is a function of its way, as
a slide with a turn by hand. Real drawers that are pulled once have up to 0.007; slides in recordings that
would be named a joint have 0.028 to 0.1. With 0.01, 0.02 and 0.1 instead, 18, 44 and 81 instead of 33 of the
81 slides of ``joint_play.py`` are named a joint, and 84, 110 and 135 instead of 99 of its 135 hinges that
turn once."""
PITCH_M: Final = 0.05
"""Prior standard deviation of the pitch (m/rad). Turns have one radian, points the usual reach."""


class FittedJoint(NamedTuple):
    """A joint at its greatest likelihood: its ``residual``; the ``play`` (K, K) of its constraints; the
    functions ``course`` (W, M) of its motion whose sums are its errors; the ``covariance`` (P, P) of its free
    parameters; its ``log_evidence`` against free motion (nats); and, for the most probable joint, its
    ``log_odds`` (nats) against all other explanations, other joints included."""

    model: JointModel
    frames: JointFrames
    residual: Residual
    play: Array
    course: Array | None
    covariance: Array = np.zeros((0, 0))
    log_evidence: float = 0.0
    log_odds: float = 0.0


def likeliest_joint(
    window: Window,
    scales: EvidenceParameters,
    contacts: Sequence[KnownContact],
    constraints: int,
    errors: SystematicErrors,
) -> FittedJoint | None:
    """The one joint that explains all ticks of ``window`` better than contacts and free motion; None without
    any.

    Parameters
    ----------
    contacts : the rival contacts, each with its best geometry.
    constraints : number of constraints of the labelled contacts; joints with fewer are left out.
    errors : systematic errors of the poses, which the covariance of the joint includes.
    """
    if len(window) < LEAST_TICKS or float(window.motion_ratio.sum()) < LEAST_ACTIVITY:
        return None
    used = used_directions(window)
    if not 0 < used <= MOST_DIRECTIONS:
        return None
    fits = [fitted(model, window, scales) for model in JOINT_MODELS if model.kind.constraints >= constraints]
    free = min((_against_free(fit.residual, window, scales)[2] for fit in fits), default=np.inf)
    evident = [_evident(fit, window, scales, free) for fit in fits]
    evident = _with_shifted_hinge(evident, window, scales, errors)
    best = max(evident, key=lambda fit: fit.log_evidence, default=None)
    if best is None or best.log_evidence <= SURE_NATS or errors_share(best, window, scales) > MOST_ERRORS:
        return None
    along = max((fit for fit in evident if fit.course is not None), key=lambda fit: fit.log_evidence)
    course = along.course if used == 1 else None
    cylinder = _evident(fitted(CYLINDER, window, scales), window, scales, free)
    rivals = [0.0, cylinder.log_evidence]
    rivals += [contact_evidence(contact, window, scales, course, free) for contact in contacts]
    if best.log_evidence - max(rivals) <= SURE_NATS:
        return None
    rivals += [fit.log_evidence for fit in evident if fit is not best]
    log_odds = best.log_evidence - float(np.logaddexp.reduce(rivals))
    return with_systematic_errors(best, window, scales, errors)._replace(log_odds=log_odds)


def fitted(model: JointModel, window: Window, scales: EvidenceParameters) -> FittedJoint:
    """The joint without its covariance and evidence."""
    fit = without_play(model, window, scales)
    if not model.has_play:
        return fit
    fit = with_play(fit, window, scales)
    for _ in range(FITS - 1):
        fit = with_play(minimise(fit, window, scales), window, scales)
    travelled = model.travelled(fit.frames, window.zeta)
    return fit._replace(course=scales.innovations(course_functions(travelled)))


def without_play(model: JointModel, window: Window, scales: EvidenceParameters) -> FittedJoint:
    """The joint whose errors are noise alone."""
    frames = model.start(window.zeta)
    start = FittedJoint(model, frames, model.residual(frames, window.zeta), np.eye(len(model.rows)), None)
    return minimise(start, window, scales)


def with_play(fit: FittedJoint, window: Window, scales: EvidenceParameters) -> FittedJoint:
    """The joint with play as large as the errors that it shows."""
    return fit._replace(play=_play_of(whitened(fit.residual, window, scales).residual))


def _evident(fit: FittedJoint, window: Window, scales: EvidenceParameters, free: float) -> FittedJoint:
    """The joint with its evidence; ``free``: upper bound of the quadratic form of free motion."""
    evidence = _log_ratio(fit.residual, window, scales, fit.course, free) - complexity(fit, window, scales)
    evidence -= 0.5 * (fit.frames.pitch_m / PITCH_M) ** 2  # a slider is also a screw with far too much pitch
    log_evidence = scales.likelihood_exponent * evidence
    return with_covariance(fit, window, scales)._replace(log_evidence=log_evidence)


def with_covariance(fit: FittedJoint, window: Window, scales: EvidenceParameters) -> FittedJoint:
    """The joint with the covariance of its parameters, by its play."""
    hessian = whitened(fit.residual, window, scales, fit.play).normal()[0]
    precision = np.diag(deviations(scales)[fit.model.free] ** -2.0)
    return fit._replace(covariance=np.asarray(np.linalg.inv(hessian + precision), np.float64))


def complexity(fit: FittedJoint, window: Window, scales: EvidenceParameters) -> float:
    """Nats that a joint costs as the ticks of ``window`` determine its parameters."""
    residual = fit.model.residual(fit.frames, window.zeta)
    hessian = whitened(residual, window, scales, fit.play).normal()[0]
    deviation = deviations(scales)[fit.model.free]
    scaled = np.eye(len(hessian)) + hessian * deviation[:, None] * deviation
    return 0.5 * float(np.linalg.slogdet(scaled)[1])


def errors_share(fit: FittedJoint, window: Window, scales: EvidenceParameters) -> float:
    """Root mean square of the errors of a joint beyond the noise, as a share of that of its motion."""
    white = whitened(fit.residual, window, scales).residual
    errors = max(float(np.square(white).sum()) - white.size, 0.0)
    moved = np.square(scales.innovations(window.zeta - window.zeta.mean(axis=0)))
    by_noise = np.column_stack([moved[:, T].sum(axis=1), 0.5 * moved[:, R].sum(axis=1)]) / window.variance
    return float(np.sqrt(errors / by_noise.sum()))


def with_systematic_errors(
    fitted: FittedJoint, window: Window, scales: EvidenceParameters, errors: SystematicErrors
) -> FittedJoint:
    """The joint with the systematic errors of the poses in its covariance (T45)."""
    if not errors.are_given:
        return fitted
    ticks, count = representatives(window)
    residual = fitted.model.residual(fitted.frames, ticks.zeta)
    scale, lower = factors(residual, ticks)
    derivatives = np.concatenate([residual.by_x, residual.by_pose], axis=2) / scale[..., None]
    white = np.linalg.solve(fitted.play, np.linalg.solve(lower, derivatives))
    slope, change = np.split(white, [len(fitted.covariance)], axis=2)
    prior = np.diag(deviations(scales)[fitted.model.free] ** -2.0)
    information = np.einsum("w,wkp,wkq->pq", count, slope, slope)
    by_error = np.einsum("w,wkp,wkd->dpw", count, slope, change)
    added = added_covariance(information, prior, by_error, ticks.zeta, errors)
    return fitted._replace(covariance=fitted.covariance + added)


def _with_shifted_hinge(
    fitted: Sequence[FittedJoint], window: Window, scales: EvidenceParameters, errors: SystematicErrors
) -> list[FittedJoint]:
    """The joints, with the evidence of the hinge raised to that of the screw less what play (T44) and
    systematic errors (T45) leave as evidence of the pitch.

    A hinge with play shifts along its axis with the angle, over a small swing as a screw does. Errors that
    depend on the place shift it as well.
    """
    screw = next((fit for fit in fitted if fit.model.kind is JointKind.SCREW), None)
    if screw is None:
        return list(fitted)
    angle, pitch_m = screw.model.travelled(screw.frames, window.zeta), screw.frames.pitch_m
    angle -= angle.mean()
    play_evidence = _log_evidence_of_shift(screw, (np.sin(angle), 1.0 - np.cos(angle)), window, scales)
    pitch_evidence = _log_evidence_of_shift(screw, (angle,), window, scales)
    lead = scales.likelihood_exponent * (pitch_evidence - play_evidence)
    if errors.are_given:
        covariance = with_systematic_errors(screw, window, scales, errors).covariance
        sd_m = float(np.sqrt(covariance[-1, -1]))  # the pitch is the last parameter
        lead = min(lead, 0.5 * (pitch_m / sd_m) ** 2 - float(np.log(PITCH_M / sd_m)))
    least = screw.log_evidence - lead
    return [
        fit._replace(log_evidence=max(fit.log_evidence, least)) if fit.model.kind is JointKind.HINGE else fit
        for fit in fitted
    ]


def _log_evidence_of_shift(
    screw: FittedJoint, functions: tuple[Array, ...], window: Window, scales: EvidenceParameters
) -> float:
    """Log evidence (nats), against no shift, that the screw shifts along its axis by ``functions`` (W,) of
    the angle, with the prior amplitude of a pitch."""
    columns = np.column_stack([np.ones(len(window)), *(PITCH_M * function for function in functions)])
    value, by_x = screw.residual.value.copy(), np.zeros((*screw.residual.value.shape, columns.shape[1]))
    value[:, S_Z] += screw.frames.pitch_m * screw.model.travelled(screw.frames, window.zeta)
    by_x[:, S_Z] = columns
    shifted_by = screw.residual._replace(value=value, by_x=by_x)
    hessian, gradient = whitened(shifted_by, window, scales, screw.play).normal()
    hessian += np.eye(len(hessian))
    return 0.5 * float(gradient @ np.linalg.solve(hessian, gradient) - np.linalg.slogdet(hessian)[1])


def minimise(fit: FittedJoint, window: Window, scales: EvidenceParameters) -> FittedJoint:
    """Damped Gauss-Newton steps, with the noise of each tick and the play of the fit."""
    model, frames, point = fit.model, fit.frames, whitened(fit.residual, window, scales, fit.play)
    damping, precision = np.array(FIRST_DAMPING), deviations(scales)[model.free] ** -2.0
    for _ in range(STEPS):
        hessian, gradient = point.normal()
        damped = hessian + np.diag(damping * hessian.diagonal() + precision)
        step = np.asarray(-np.linalg.solve(damped, gradient), np.float64)
        moved = model.moved(frames, step)
        trial = whitened(model.residual(moved, window.zeta), window, scales, fit.play)
        gained = point.cost - trial.cost
        damping = adapted(damping, gained > 0.0)
        if gained > 0.0:
            frames, point = moved, trial
        if abs(gained) < CONVERGED * (1.0 + point.cost):
            break
    return fit._replace(frames=frames, residual=model.residual(frames, window.zeta))


def contact_evidence(
    contact: KnownContact, window: Window, scales: EvidenceParameters, course: Array | None, free: float
) -> float:
    """Log evidence of a contact against the same free motion, and with the same kind of play, as for joints;
    ``course`` and ``free`` as in ``_log_ratio``."""
    motion, c = ConditionalMotion.of(ExplainedTicks(window, scales)), contact.c
    value = window.zeta @ c.T
    residual = Residual(value, motion.gradients(c), np.zeros((*value.shape, 0)))
    factor = 1.0
    if course is not None:
        play = _play_of(whitened(residual, window, scales).residual)
        factor = float(np.exp(np.linalg.slogdet(play)[1] / len(play)))  # geometric mean over the directions
    gain = float(motion.evidence(c).gain.mean())
    cost = elements_complexity(contact, motion, gain, factor)
    return scales.likelihood_exponent * (_log_ratio(residual, window, scales, course, free) - cost)


def deviations(scales: EvidenceParameters) -> Array:
    """Prior standard deviations (13,) of all parameters of a joint."""
    deviation = np.ones(PITCH + 1)
    deviation[:6], deviation[PITCH] = scales.reach_m, PITCH_M
    return deviation


class _Whitened(NamedTuple):
    """Innovations of the residuals (W, K), of unit variance, and their derivatives (W, K, P)."""

    residual: Array
    slope: Array

    @property
    def cost(self) -> float:
        return 0.5 * float(np.square(self.residual).sum())

    def normal(self) -> tuple[Array, Array]:
        """The Hessian (P, P) and the gradient (P,) of the cost."""
        slope = self.slope.reshape(-1, self.slope.shape[2])
        return slope.T @ slope, slope.T @ self.residual.ravel()


def factors(residual: Residual, window: Window) -> tuple[Array, Array]:
    """Standard deviations (W, K) of the residuals by noise, and Cholesky factors (W, K, K) of their
    correlation."""
    noise_sd = np.sqrt(window.variance[:, NOISE_OF_PERTURBATION])
    scale = np.sqrt(np.square(residual.by_pose * noise_sd[:, None]).sum(axis=2)) + JITTER**2
    rows = residual.by_pose / scale[..., None] * noise_sd[:, None]
    lower = np.linalg.cholesky(rows @ np.swapaxes(rows, 1, 2) + JITTER * np.eye(rows.shape[1]))
    return np.asarray(scale, np.float64), np.asarray(lower, np.float64)


def whitened(
    residual: Residual, window: Window, scales: EvidenceParameters, play: Array | None = None
) -> _Whitened:
    scale, lower = factors(residual, window)
    columns = np.concatenate([residual.value[..., None], residual.by_x], axis=2) / scale[..., None]
    white: Array = np.linalg.solve(lower, scales.innovations(columns)).astype(float)
    if play is not None:
        white = np.linalg.solve(play, white).astype(float)
    return _Whitened(white[..., 0], white[..., 1:])


def _play_of(white: Array) -> Array:
    """Symmetric matrix (K, K): the standard deviation of whitened residuals (W, K) in each of their principal
    directions, at least 1."""
    variance, axes = np.linalg.eigh(white.T @ white / len(white))
    return np.asarray((axes * np.clip(np.sqrt(np.maximum(variance, 0.0)), 1.0, MOST_PLAY)) @ axes.T)


def _against_free(
    residual: Residual, window: Window, scales: EvidenceParameters
) -> tuple[Array, float, float]:
    """Whitened residuals (W, K), half the log ratio of their variances under free motion to those of the
    noise, and their quadratic form under free motion."""
    moved_sd = np.sqrt(window.displacement_variance[:, NOISE_OF_PERTURBATION])
    white, (scale, lower) = whitened(residual, window, scales).residual, factors(residual, window)
    moved = np.linalg.solve(lower, residual.by_pose / scale[..., None] * moved_sd[:, None])
    loose = np.eye(white.shape[1]) + moved @ np.swapaxes(moved, 1, 2)
    free_form = float((white * np.linalg.solve(loose, white[..., None])[..., 0]).sum())
    return white, 0.5 * float(np.linalg.slogdet(loose)[1].sum()), free_form


def _log_ratio(
    residual: Residual, window: Window, scales: EvidenceParameters, course: Array | None, free: float
) -> float:
    """Log-likelihood ratio of the residuals, whose errors may follow the ``course`` (W, M) of the motion,
    against free motion (T44).

    The quadratic form of free motion is at most ``free``, the least of all joints that are compared: free
    motion is the same for all, and one that fits badly must not gain by its own misfit.
    """
    white, gain, free_form = _against_free(residual, window, scales)
    noise_alone = -0.5 * float(np.square(white).sum())
    joint_nats = noise_alone if course is None else misfit_log_likelihood(white, course)
    return gain + joint_nats + 0.5 * min(free_form, free, white.size)  # free motion can follow smooth motion


BODY_ROWS: Final = np.concatenate([BODY_TURN, BODY_POINT])
WORLD_ROWS: Final = np.concatenate([WORLD_TURN, WORLD_POINT])
_FREE: Final = {JointKind.SLIDER: "vz", JointKind.BALL: "wx wy wz"}
"""Free coordinates of the twist in the joint's frame; the turn about the axis for other kinds."""


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint that explains the motion of the object.

    Parameters
    ----------
    kind, probability : kind of the joint and its probability.
    object, environment : its axis in the body frame and in the world frame; of a ball joint its centre in
        both. A slider's axis is the line along which the body's origin moves.
    pitch_m_per_rad : translation along the axis per radian about it; zero for hinges, None for sliders and
        ball joints. ``pitch_sd_m_per_rad`` is its standard deviation, for screws.
    """

    kind: JointKind
    probability: float
    object: Element
    environment: Element
    pitch_m_per_rad: float | None
    pitch_sd_m_per_rad: float | None

    @property
    def task_frame(self) -> TaskFrame:
        """The frame in which the joint constrains the object's twist: on the axis, with z along it."""
        assert isinstance(self.environment, (Line, Point))
        free, pitch_m = _FREE.get(self.kind, "wz"), self.pitch_m_per_rad or 0.0
        return joint_frame(self.kind, self.environment, free, pitch_m)

    def to_json(self) -> dict[str, Any]:
        """The JSON object of key ``joint``."""
        return {
            "kind": self.kind.value,
            "probability": float(self.probability),
            "object": self.object.to_json(),
            "environment": self.environment.to_json(),
            "pitch_m_per_rad": self.pitch_m_per_rad,
            "pitch_sd_m_per_rad": self.pitch_sd_m_per_rad,
            "task_frame": self.task_frame.to_json(),
        }


def joint_of(fitted: FittedJoint, probability: float, near_m: Array, origins: Origins) -> Joint:
    """The joint with its elements in the user's frames.

    Parameters
    ----------
    near_m : (3,) mean position of the body's origin; the world axis is given by its nearest point.
    origins : of the ticks' coordinates.
    """
    frames, kind = fitted.frames, fitted.model.kind
    covariance = np.zeros((PITCH + 1, PITCH + 1))
    covariance[np.ix_(fitted.model.free, fitted.model.free)] = fitted.covariance
    # covariances (6, 6) of a frame's turns about and shifts along its own axes
    body_cov, world_cov = (covariance[np.ix_(rows, rows)] for rows in (BODY_ROWS, WORLD_ROWS))
    body = _element(kind, frames.body_axes, frames.body_point_m, body_cov)
    world = _element(kind, frames.world_axes, frames.world_point_m, world_cov)
    pitch = {JointKind.HINGE: 0.0, JointKind.SCREW: frames.pitch_m}.get(kind)
    deviation = float(np.sqrt(covariance[PITCH, PITCH])) if kind is JointKind.SCREW else None
    if kind is JointKind.SLIDER:  # the line of any point: here of the body's origin
        body = shifted(body, -origins.body_m)
        world = shifted(world, -frames.world_axes @ frames.body_axes.T @ origins.body_m)
    return Joint(
        kind,
        probability,
        by_foot(shifted(body, origins.body_m), np.zeros(3)),
        shifted(by_foot(world, near_m), origins.world_m),
        pitch,
        deviation,
    )


def _element(kind: JointKind, axes: Array, point_m: Array, covariance: Array) -> Element:
    if kind is JointKind.BALL:
        return Point(point_m, axes @ covariance[3:, 3:] @ axes.T)
    by_frame = np.zeros((6, 6))
    by_frame[0, 1], by_frame[1, 0] = 1.0, -1.0  # how the axis moves as the frame turns
    by_frame[3, 3] = by_frame[4, 4] = 1.0  # a shift along the axis does not move it
    by_frame = np.kron(np.eye(2), axes) @ by_frame
    return Line(axes[:, 2], point_m, by_frame @ covariance @ by_frame.T)
