"""Evidence of joints against free motion and against contacts (docs/theory.md, T44)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, Self

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.contacts.task_frame import TaskFrame, joint_frame
from contact_tracker.explanations.conditional_contact import (
    ConditionalMotion,
    ExplainedTicks,
    KnownContact,
    against_free,
    noise_factors,
)
from contact_tracker.explanations.further_contacts import MIN_TICKS, SURE_NATS, elements_complexity
from contact_tracker.explanations.joint_misfit import MOST_PLAY, course_functions, misfit_log_likelihood
from contact_tracker.explanations.joint_models import (
    BODY,
    BODY_POINT,
    CYLINDER,
    JOINT_MODELS,
    PITCH,
    S_Z,
    WORLD,
    WORLD_POINT,
    JointFrames,
    JointKind,
    JointModel,
    Residual,
)
from contact_tracker.geometry.elements import Element, Line, Point, by_foot, shifted
from contact_tracker.geometry.lifted_pose import NOISE_OF_PERTURBATION, R, T
from contact_tracker.geometry.linalg import adapted
from contact_tracker.hypotheses.observability import added_covariance, representatives
from contact_tracker.motion.window import DIRECTIONS, used_directions

STEPS: Final = 12
FIRST_DAMPING: Final = 1e-3
CONVERGED: Final = 1e-6
MOST_ERRORS: Final = 0.1
"""Largest errors of a joint, as a share of its motion (root mean squares, in units of the noise). Otherwise a
shift along a bent curve is a slider or a hinge with large play. With 0.2 instead, 33 instead of 2 of the 81
curves of ``joint_play.py`` are sure to be a joint, and 220 instead of 207 of its 297 hinges are named."""
PITCH_M: Final = 0.05
"""Prior standard deviation of the pitch (m/rad). Turns have one radian, points the usual reach."""


@dataclass(frozen=True, eq=False)
class Misfit:
    """What a joint or a contact leaves unexplained of the motion in ``ticks``: its ``residual``."""

    ticks: ExplainedTicks
    residual: Residual

    @cached_property
    def lower(self) -> Array:
        """Cholesky factors (W, K, K) of the covariance of the residuals by noise."""
        return noise_factors(self.residual.by_pose * self.ticks.noise_sd[:, None])

    @cached_property
    def columns(self) -> Array:
        """Innovations of the residuals and their derivatives (W, K, 1 + P), of unit variance."""
        columns = np.concatenate([self.residual.value[..., None], self.residual.by_x], axis=2)
        white: Array = np.linalg.solve(self.lower, self.ticks.scales.innovations(columns)).astype(float)
        return white

    @property
    def white(self) -> Array:
        """Innovations (W, K) of the residuals, of unit variance."""
        return self.columns[..., 0]

    @property
    def play(self) -> Array:
        """Symmetric matrix (K, K): their standard deviation in each of their principal directions, at least
        1."""
        variance, axes = np.linalg.eigh(self.white.T @ self.white / len(self.white))
        deviation = np.clip(np.sqrt(np.maximum(variance, 0.0)), 1.0, MOST_PLAY)
        return np.asarray((axes * deviation) @ axes.T)

    @cached_property
    def against_free(self) -> tuple[float, float]:
        """Half the log ratio of their variances in free motion to those by noise, and their quadratic form in
        free motion."""
        window, value = self.ticks.window, self.ticks.scales.innovations(self.residual.value)
        moved_sd = np.sqrt(window.displacement_variance[:, NOISE_OF_PERTURBATION])
        _, gain, form = against_free(self.lower, value, self.residual.by_pose * moved_sd[:, None])
        return float(gain.sum()), float(form.sum())

    def log_ratio(self, course: Array | None, free: float) -> float:
        """Log-likelihood ratio, if their errors may follow the ``course`` (W, M) of the motion, against free
        motion (T44).

        The quadratic form of free motion is at most ``free``, the least of all joints that are compared: free
        motion is the same for all, and one that fits badly must not gain by its own misfit.
        """
        gain, free_form = self.against_free
        limit = min(free_form, free, self.white.size)  # free motion can follow smooth motion
        return gain + misfit_log_likelihood(self.white, course) + 0.5 * limit


@dataclass(frozen=True, eq=False)
class FittedJoint:
    """A joint in ``ticks``: the ``play`` (K, K) of its constraints; the functions ``course`` (W, M) of its
    motion whose sums are its errors; its ``log_evidence`` against free motion (nats); and, for the most
    probable joint, its ``log_odds`` (nats) against all other explanations, other joints included."""

    ticks: ExplainedTicks
    model: JointModel
    frames: JointFrames
    play: Array
    course: Array | None = None
    log_evidence: float = 0.0
    log_odds: float = 0.0

    @classmethod
    def without_play(cls, model: JointModel, ticks: ExplainedTicks) -> Self:
        """The joint at its greatest likelihood, if its errors are noise alone."""
        return cls(ticks, model, model.start(ticks.window.zeta), np.eye(len(model.rows))).minimised()

    @classmethod
    def fitted(cls, model: JointModel, ticks: ExplainedTicks) -> Self:
        """The joint at its greatest likelihood, with the play that it shows."""
        fit = cls.without_play(model, ticks)
        if not model.has_play:
            return fit
        fit = fit.with_play().minimised().with_play()
        return replace(fit, course=ticks.scales.innovations(course_functions(fit.travelled)))

    @cached_property
    def misfit(self) -> Misfit:
        """What it leaves unexplained."""
        return Misfit(self.ticks, self.model.residual(self.frames, self.ticks.window.zeta))

    @property
    def travelled(self) -> Array:
        """Way (W,) travelled by the joint: an angle (rad), for a slider a distance (m)."""
        return self.model.travelled(self.frames, self.ticks.window.zeta)

    @property
    def normal(self) -> tuple[Array, Array]:
        """The Hessian (P, P) and the gradient (P,) of the cost."""
        return _normal(self.misfit, self.play)

    @property
    def cost(self) -> float:
        """Half the sum of squares of the residuals over noise and play."""
        return 0.5 * float(np.square(np.linalg.solve(self.play, self.misfit.white.T)).sum())

    @cached_property
    def prior_sd(self) -> Array:
        """Prior standard deviations (P,) of the parameters."""
        deviation = np.ones(PITCH + 1)
        deviation[[*BODY_POINT, *WORLD_POINT]], deviation[PITCH] = self.ticks.scales.reach_m, PITCH_M
        return deviation[self.model.free]

    def minimised(self) -> Self:
        """The joint after damped Gauss-Newton steps, with the noise of each tick and its play."""
        fit, damping, precision = self, np.array(FIRST_DAMPING), self.prior_sd**-2.0
        for _ in range(STEPS):
            hessian, gradient = fit.normal
            damped = hessian + np.diag(damping * hessian.diagonal() + precision)
            step = np.asarray(-np.linalg.solve(damped, gradient), np.float64)
            trial = replace(fit, frames=fit.frames.moved(step, self.model.free))
            gained, cost = fit.cost - trial.cost, fit.cost
            damping = adapted(damping, gained > 0.0)
            if gained > 0.0:
                fit = trial
            if abs(gained) < CONVERGED * (1.0 + cost):
                break
        return fit

    def with_play(self) -> Self:
        """The joint with play as large as the errors that it shows."""
        return replace(self, play=self.misfit.play)

    def with_evidence(self, free: float) -> Self:
        """The joint with its evidence; ``free`` as for ``Misfit.log_ratio``."""
        evidence = self.misfit.log_ratio(self.course, free) - self.complexity
        # a slider is also a screw of far too much pitch
        evidence -= 0.5 * (self.frames.pitch_m / PITCH_M) ** 2
        return replace(self, log_evidence=self.ticks.scales.likelihood_exponent * evidence)

    @property
    def complexity(self) -> float:
        """Nats that the joint costs as its ticks determine its parameters."""
        scaled = self.normal[0] * self.prior_sd[:, None] * self.prior_sd
        return 0.5 * float(np.linalg.slogdet(np.eye(len(scaled)) + scaled)[1])

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood (nats) of the residuals, up to a constant that depends on the ticks alone."""
        volume = float(np.log(np.diagonal(self.misfit.lower, axis1=1, axis2=2)).sum())
        return misfit_log_likelihood(self.misfit.white, self.course) - volume

    @property
    def errors_share(self) -> float:
        """Root mean square of the errors of the joint beyond the noise, as a share of that of its motion."""
        white, window = self.misfit.white, self.ticks.window
        errors = max(float(np.square(white).sum()) - white.size, 0.0)
        moved = np.square(self.ticks.scales.innovations(window.zeta - window.zeta.mean(axis=0)))
        by_noise = np.column_stack([moved[:, T].sum(axis=1), 0.5 * moved[:, R].sum(axis=1)]) / window.variance
        return float(np.sqrt(errors / by_noise.sum()))

    @cached_property
    def covariance(self) -> Array:
        """Covariance (P, P) of the parameters, by play and by the systematic errors of the poses (T45)."""
        prior, errors = np.diag(self.prior_sd**-2.0), self.ticks.systematic
        covariance = np.asarray(np.linalg.inv(self.normal[0] + prior), np.float64)
        if not errors.are_given:
            return covariance
        window, count = representatives(self.ticks.window)
        some = replace(self, ticks=replace(self.ticks, window=window)).misfit
        derivatives = np.concatenate([some.residual.by_x, some.residual.by_pose], axis=2)
        white = np.linalg.solve(self.play, np.linalg.solve(some.lower, derivatives))
        slope, change = np.split(white, [len(prior)], axis=2)
        information = np.einsum("w,wkp,wkq->pq", count, slope, slope)
        by_error = np.einsum("w,wkp,wkd->dpw", count, slope, change)
        return covariance + added_covariance(information, prior, by_error, window.zeta, errors)


def _normal(misfit: Misfit, play: Array) -> tuple[Array, Array]:
    """The Hessian (P, P) and the gradient (P,) of half the sum of squares of residuals with ``play``."""
    columns = np.linalg.solve(play, misfit.columns)
    slope = columns[..., 1:].reshape(-1, columns.shape[2] - 1)
    return np.asarray(slope.T @ slope), np.asarray(slope.T @ columns[..., 0].ravel())


def likeliest_joint(
    ticks: ExplainedTicks, contacts: Sequence[KnownContact], constraints: int
) -> FittedJoint | None:
    """The one joint that explains all ticks better than contacts and free motion; None without any.

    Parameters
    ----------
    contacts : the rival contacts, each with its best geometry.
    constraints : number of constraints of the labelled contacts; joints with fewer are left out.
    """
    used, moved_ticks = used_directions(ticks.window), float(ticks.window.motion_ratio.sum())
    if len(ticks) < MIN_TICKS or moved_ticks < 0.5 * MIN_TICKS:  # a hand may follow a joint for a while
        return None
    if not 0 < used <= DIRECTIONS - JointKind.BALL.constraints:
        return None
    models = (model for model in JOINT_MODELS if model.kind.constraints >= constraints)
    fits = [FittedJoint.fitted(model, ticks) for model in models]
    free = min((fit.misfit.against_free[1] for fit in fits), default=np.inf)
    evident = _with_shifted_hinge([fit.with_evidence(free) for fit in fits])
    best = max(evident, key=lambda fit: fit.log_evidence, default=None)
    if best is None or best.log_evidence <= SURE_NATS or best.errors_share > MOST_ERRORS:
        return None
    along = max((fit for fit in evident if fit.course is not None), key=lambda fit: fit.log_evidence)
    course = along.course if used == 1 else None
    rivals = [0.0, FittedJoint.fitted(CYLINDER, ticks).with_evidence(free).log_evidence]
    rivals += [contact_evidence(contact, ticks, course, free) for contact in contacts]
    if best.log_evidence - max(rivals) <= SURE_NATS:
        return None
    rivals += [fit.log_evidence for fit in evident if fit is not best]
    return replace(best, log_odds=best.log_evidence - float(np.logaddexp.reduce(rivals)))


def _with_shifted_hinge(fits: Sequence[FittedJoint]) -> list[FittedJoint]:
    """The joints, with the evidence of the hinge raised to that of the screw less what play (T44) and
    systematic errors (T45) leave as evidence of the pitch.

    A hinge with play shifts along its axis with the angle, over a small swing as a screw does. Errors that
    depend on the place shift it as well.
    """
    by_kind = {fit.model.kind: fit for fit in fits}
    screw = by_kind.get(JointKind.SCREW)
    if screw is None:
        return list(fits)
    angle = screw.travelled - screw.travelled.mean()
    play_evidence = _log_evidence_of_shift(screw, np.sin(angle), 1.0 - np.cos(angle))
    lead = screw.ticks.scales.likelihood_exponent * (_log_evidence_of_shift(screw, angle) - play_evidence)
    if screw.ticks.systematic.are_given:
        sd_m = float(np.sqrt(screw.covariance[-1, -1]))  # the pitch is the last parameter
        lead = min(lead, 0.5 * (screw.frames.pitch_m / sd_m) ** 2 - float(np.log(PITCH_M / sd_m)))
    hinge = by_kind[JointKind.HINGE]
    by_kind[JointKind.HINGE] = replace(hinge, log_evidence=max(hinge.log_evidence, screw.log_evidence - lead))
    return [*by_kind.values()]


def _log_evidence_of_shift(screw: FittedJoint, *functions: Array) -> float:
    """Log evidence (nats), against no shift, that the screw shifts along its axis by ``functions`` (W,) of
    the angle, with the prior amplitude of a pitch."""
    residual = screw.misfit.residual
    columns = np.column_stack([np.ones(len(functions[0])), *(PITCH_M * function for function in functions)])
    value, by_x = residual.value.copy(), np.zeros((*residual.value.shape, columns.shape[1]))
    value[:, S_Z] += screw.frames.pitch_m * screw.travelled
    by_x[:, S_Z] = columns
    shifted_by = Misfit(screw.ticks, Residual(value, residual.by_pose, by_x))
    hessian, gradient = _normal(shifted_by, screw.play)
    hessian += np.eye(len(hessian))
    return 0.5 * float(gradient @ np.linalg.solve(hessian, gradient) - np.linalg.slogdet(hessian)[1])


def contact_evidence(
    contact: KnownContact, ticks: ExplainedTicks, course: Array | None = None, free: float = np.inf
) -> float:
    """Log evidence of a contact against the same free motion, and with the same kind of play, as for joints;
    ``course`` and ``free`` as for ``Misfit.log_ratio``."""
    motion = ConditionalMotion.of(ticks)
    value = ticks.window.zeta @ contact.c.T
    misfit = Misfit(ticks, Residual(value, motion.gradients(contact.c), np.zeros((*value.shape, 0))))
    factor = 1.0
    if course is not None:  # geometric mean over the directions
        factor = float(np.exp(np.linalg.slogdet(misfit.play)[1] / len(misfit.play)))
    cost = elements_complexity(contact, motion, float(motion.evidence(contact.c).gain.mean()), factor)
    return ticks.scales.likelihood_exponent * (misfit.log_ratio(course, free) - cost)


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


def joint_of(fitted: FittedJoint, probability: float) -> Joint:
    """The joint with its elements in the user's frames; the world axis is given by its point nearest to the
    mean position of the body's origin."""
    frames, kind, origins = fitted.frames, fitted.model.kind, fitted.ticks.origins
    near_m = fitted.ticks.window.zeta[:, T].mean(axis=0)
    covariance = np.zeros((PITCH + 1, PITCH + 1))
    covariance[np.ix_(fitted.model.free, fitted.model.free)] = fitted.covariance
    body_cov, world_cov = (covariance[np.ix_(rows, rows)] for rows in (BODY, WORLD))
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
    """The axis or centre, by the ``covariance`` (6, 6) of a frame's turns about and shifts along its axes."""
    if kind is JointKind.BALL:
        return Point(point_m, axes @ covariance[3:, 3:] @ axes.T)
    by_frame = np.zeros((6, 6))
    by_frame[0, 1], by_frame[1, 0] = 1.0, -1.0  # how the axis moves as the frame turns
    by_frame[3, 3] = by_frame[4, 4] = 1.0  # a shift along the axis does not move it
    by_frame = np.kron(np.eye(2), axes) @ by_frame
    return Line(axes[:, 2], point_m, by_frame @ covariance @ by_frame.T)
