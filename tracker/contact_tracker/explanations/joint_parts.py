"""Whether one joint, or one joint each, moves the parts of a motion between rests (docs/theory.md, T44)."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Bools, Ints
from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.explanations.conditional_contact import KnownContact
from contact_tracker.explanations.further_contacts import SURE_NATS
from contact_tracker.explanations.joint_evidence import (
    MOST_ERRORS,
    MOST_ERRORS_ONCE,
    FittedJoint,
    complexity,
    contact_evidence,
    errors_share,
    factors,
    fitted,
    likeliest_joint,
    whitened,
    with_covariance,
    with_play,
    with_systematic_errors,
    without_play,
)
from contact_tracker.explanations.joint_misfit import drift_functions, misfit_log_likelihood, turns_back
from contact_tracker.explanations.joint_models import SCREW, JointKind, JointModel
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.motion.window import Window

MOST_COMPARED: Final = 8
"""Largest number of the latest parts of a joint with which the next part is compared: time grows with it. Of
16 recordings of 12 turns about each of two axes, 3 or 10 mm apart, and again about the first one, all are
divided rightly with 4, 8 and all parts, and 14 with 2."""


class JointOfTicks(NamedTuple):
    """A joint of the ticks in rows ``first`` to ``end`` (excluded) of a window."""

    first: int
    end: int
    fit: FittedJoint


class _Part(NamedTuple):
    """Rows ``first`` to ``end`` (excluded) of a window; the object rests before the row ``moves``."""

    first: int
    moves: int
    end: int


def find_joints(
    window: Window,
    rests: Ints,
    scales: EvidenceParameters,
    contacts: Sequence[KnownContact],
    constraints: int,
    errors: SystematicErrors,
) -> list[JointOfTicks]:
    """The joint that explains the ticks of ``window`` best, or the joints in which the object moves one after
    another; empty without any.

    That one joint does not fit exactly is explained by its play, or by several joints, between which the
    object rests. A joint with play shows it in each part; so several joints are the explanation if they have
    none.

    Parameters
    ----------
    rests : (R, 2) of the whole segment, of which the ``window`` may lack ticks, as from ``rests_in``.
    contacts, constraints, errors : as for ``likeliest_joint``.
    """
    whole = likeliest_joint(window, scales, contacts, constraints, errors)
    parts = _parts(window.index, rests)
    if whole is None:
        joints = _unlike_joints(window, parts, scales, contacts, constraints, errors)
    else:
        joints = [JointOfTicks(0, len(window), whole)]
        if len(parts) > 1:
            joints = _alike_joints(whole, window, parts, scales, errors)
    return joints if all(_is_credible(joint, window, scales) for joint in joints) else []


def _alike_joints(
    whole: FittedJoint,
    window: Window,
    parts: Sequence[_Part],
    scales: EvidenceParameters,
    errors: SystematicErrors,
) -> list[JointOfTicks]:
    """The joint ``whole`` of all ``parts``, or joints of its kind in which the object moves one after
    another."""
    lead = scales.likelihood_exponent * _lead_of_own_joints(whole.model, window, parts, scales)
    others = whole.log_evidence - whole.log_odds
    rival = whole.log_evidence + lead
    if lead <= 0.0:
        log_odds = whole.log_evidence - float(np.logaddexp(rival, others))
        return [JointOfTicks(0, len(window), whole._replace(log_odds=log_odds))]
    log_odds = rival - float(np.logaddexp(whole.log_evidence, others))
    log_odds = min(log_odds, whole.log_odds)  # their kind is no surer
    groups = _grouped([whole.model] * len(parts), window, parts, scales)
    return [_joint_of(whole.model, window, group, scales, errors, log_odds) for group in groups]


def _unlike_joints(
    window: Window,
    parts: Sequence[_Part],
    scales: EvidenceParameters,
    contacts: Sequence[KnownContact],
    constraints: int,
    errors: SystematicErrors,
) -> list[JointOfTicks]:
    """The joints in which the object moves one after another, where none explains all ``parts``; empty if a
    part has none, or if one contact explains all parts as well."""
    if len(parts) < 2:
        return []

    def joint_of(part: _Part) -> JointOfTicks | None:
        fit = likeliest_joint(window.cut(part.first, part.end), scales, contacts, constraints, errors)
        joint = None if fit is None else JointOfTicks(part.first, part.end, fit)
        return joint if joint is not None and _is_credible(joint, window, scales) else None

    log_evidence, models = 0.0, list[JointModel]()
    for part in parts:
        joint = joint_of(part)
        if joint is None:
            return []
        log_evidence += joint.fit.log_evidence
        models.append(joint.fit.model)
    rivals = [0.0, *(contact_evidence(contact, window, scales, None, np.inf) for contact in contacts)]
    lead = log_evidence - float(np.logaddexp.reduce(rivals))
    groups = _grouped(models, window, parts, scales)
    joints = [joint for joint in map(joint_of, groups) if joint is not None]
    if lead <= SURE_NATS or not 1 < len(joints) == len(groups):
        return []
    return [
        joint._replace(fit=joint.fit._replace(log_odds=min(lead, joint.fit.log_odds))) for joint in joints
    ]


def _is_credible(joint: JointOfTicks, window: Window, scales: EvidenceParameters) -> bool:
    """Whether the errors of a joint are as small as those of real ones."""
    ticks = window.cut(joint.first, joint.end)
    moves_once = joint.fit.model.has_play and not _comes_again(joint.fit, ticks)
    return errors_share(joint.fit, ticks, scales) <= (MOST_ERRORS_ONCE if moves_once else MOST_ERRORS)


def _comes_again(fit: FittedJoint, window: Window) -> bool:
    """Whether a joint comes again to where it was: it turns back, or by more than one turn."""
    way = fit.model.travelled(fit.frames, window.zeta)
    goes_round = fit.model.kind is not JointKind.SLIDER and np.ptp(way) > 2.0 * np.pi
    return bool(goes_round or turns_back(way))


def rests_in(index: Ints, resting: Bools) -> Ints:
    """The number of the first tick of each rest, and of the tick after its last one (R, 2), of the ticks with
    numbers ``index`` (W,), of which some are ``resting`` (W,)."""
    rows = np.flatnonzero(np.diff(resting, prepend=False, append=False)).reshape(-1, 2)
    return np.append(index, index[-1:] + 1)[rows]


def _parts(index: Ints, rests: Ints) -> list[_Part]:
    """The moved parts of the ticks with numbers ``index``, each with half of the rests beside it.

    Rests divide them also if their own ticks were left out.
    """
    begins, ends = np.searchsorted(index, rests).T
    middles = np.searchsorted(index, rests.sum(axis=1) // 2)
    rows = zip([0, *middles], [0, *ends], [*begins, len(index)], [*middles, len(index)], strict=True)
    return [_Part(int(first), int(moves), int(end)) for first, moves, stops, end in rows if moves < stops]


def _lead_of_own_joints(
    model: JointModel, window: Window, parts: Sequence[_Part], scales: EvidenceParameters
) -> float:
    """Log evidence (nats) of a joint without play for each part of ``window``, over that of one joint with
    play in all of them.

    Each joint after the first holds where the object rests before it moves: of its parameters only those that
    this rest does not determine are free. The place of the one joint may drift, as that of trackers does.
    """
    ticks = window.cut(parts[0].first, parts[-1].end)
    together = fitted(model, ticks, scales)
    lead = complexity(together, ticks, scales)
    if together.course is not None:
        drift = scales.innovations(drift_functions(ticks.index))
        together = together._replace(course=np.column_stack([together.course, drift]))
    lead -= _log_likelihood(together, ticks, scales)
    for number, part in enumerate(parts):
        ticks = window.cut(part.first, part.end)
        own = without_play(model, ticks, scales)
        lead += _log_likelihood(own, ticks, scales) - complexity(own, ticks, scales)
        if number and part.moves > part.first:
            lead += complexity(own, window.cut(part.first, part.moves), scales)
    return lead


def _grouped(
    models: Sequence[JointModel], window: Window, parts: Sequence[_Part], scales: EvidenceParameters
) -> list[_Part]:
    """The parts of a ``window``, each with the model of its joint, of which successive ones with the same
    joint are one part."""
    groups = [[parts[0]]]
    for before, after, part in zip(models, models[1:], parts[1:], strict=False):
        group, model = _joined(groups[-1][-MOST_COMPARED:]), _common(before, after)
        if model is not None and _lead_of_own_joints(model, window, [group, part], scales) <= 0.0:
            groups[-1].append(part)
        else:
            groups.append([part])
    return [_joined(group) for group in groups]


def _common(first: JointModel, second: JointModel) -> JointModel | None:
    """The model that contains both, if there is one: a hinge is a screw without pitch."""
    if first is second:
        return first
    kinds = {first.kind, second.kind}
    return SCREW if kinds == {JointKind.HINGE, JointKind.SCREW} else None


def _joined(parts: Sequence[_Part]) -> _Part:
    return parts[0]._replace(end=parts[-1].end)


def _joint_of(
    model: JointModel,
    window: Window,
    part: _Part,
    scales: EvidenceParameters,
    errors: SystematicErrors,
    log_odds: float,
) -> JointOfTicks:
    """The joint of a part; its covariance has errors as large as those that the part shows."""
    ticks = window.cut(part.first, part.end)
    fit = without_play(model, ticks, scales)
    fit = with_covariance(with_play(fit, ticks, scales), ticks, scales)
    fit = with_systematic_errors(fit, ticks, scales, errors)
    return JointOfTicks(part.first, part.end, fit._replace(log_odds=log_odds))


def _log_likelihood(fit: FittedJoint, ticks: Window, scales: EvidenceParameters) -> float:
    """Log-likelihood (nats) of the residuals of a joint, up to a constant that depends on the ticks alone."""
    white, (scale, lower) = whitened(fit.residual, ticks, scales).residual, factors(fit.residual, ticks)
    volume = float(np.log(scale).sum() + np.log(np.diagonal(lower, axis1=1, axis2=2)).sum())
    if fit.course is None:
        return -0.5 * float(np.square(white).sum()) - volume
    return misfit_log_likelihood(white, fit.course) - volume
