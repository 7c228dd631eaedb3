"""Whether one joint, or one joint each, moves the parts of a motion between rests (docs/theory.md, T44)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Bools, Ints
from contact_tracker.explanations.conditional_contact import ExplainedTicks, KnownContact
from contact_tracker.explanations.further_contacts import SURE_NATS
from contact_tracker.explanations.joint_evidence import (
    MOST_ERRORS,
    FittedJoint,
    contact_evidence,
    likeliest_joint,
)
from contact_tracker.explanations.joint_misfit import drift_functions, turns_back
from contact_tracker.explanations.joint_models import SCREW, JointKind, JointModel

MOST_ERRORS_ONCE: Final = 0.015
"""``MOST_ERRORS`` of a joint that never comes again to where it was: any single motion is a function of its
way, as a slide with a turn by hand. Real drawers that are pulled once have up to 0.007; slides in recordings
that would be named a joint have 0.028 to 0.1. With 0.01, 0.02 and 0.1 instead, 18, 44 and 81 instead of 33 of
the 81 slides of ``joint_play.py`` are named a joint, and 84, 110 and 135 instead of 99 of its 135 hinges that
turn once."""
MOST_COMPARED: Final = 8
"""Largest number of the latest parts of a joint with which the next part is compared: time grows with it. Of
16 recordings of 12 turns about each of two axes, 3 or 10 mm apart, and again about the first one, all are
divided rightly with 4, 8 and all parts, and 14 with 2."""


class _Part(NamedTuple):
    """Rows ``first`` to ``end`` (excluded) of ticks; the object rests before the row ``moves``."""

    first: int
    moves: int
    end: int


def find_joints(
    ticks: ExplainedTicks, rests: Ints, contacts: Sequence[KnownContact], constraints: int
) -> list[FittedJoint]:
    """The joint that explains the ticks best, or the joints in which the object moves one after another, each
    of its own ticks; empty without any.

    That one joint does not fit exactly is explained by its play, or by several joints, between which the
    object rests. A joint with play shows it in each part; so several joints are the explanation if they have
    none.

    Parameters
    ----------
    rests : (R, 2) of the whole segment, of which there may not be all ticks, as from ``rests_in``.
    contacts, constraints : as for ``likeliest_joint``.
    """
    whole, parts = likeliest_joint(ticks, contacts, constraints), _parts(ticks.window.index, rests)
    if whole is None:
        joints = _unlike_joints(ticks, parts, contacts, constraints)
    else:
        joints = [whole] if len(parts) < 2 else _alike_joints(whole, parts)
    return joints if all(map(_is_credible, joints)) else []


def _alike_joints(whole: FittedJoint, parts: Sequence[_Part]) -> list[FittedJoint]:
    """The joint ``whole`` of all ``parts``, or joints of its kind in which the object moves one after
    another."""
    model, ticks = whole.model, whole.ticks
    lead = ticks.scales.likelihood_exponent * _lead_of_own_joints(model, ticks, parts)
    others, rival = whole.log_evidence - whole.log_odds, whole.log_evidence + lead
    if lead <= 0.0:
        return [replace(whole, log_odds=whole.log_evidence - float(np.logaddexp(rival, others)))]
    log_odds = rival - float(np.logaddexp(whole.log_evidence, others))
    log_odds = min(log_odds, whole.log_odds)  # their kind is no surer
    groups = _grouped([model] * len(parts), ticks, parts)
    fits = (FittedJoint.without_play(model, ticks.cut(group.first, group.end)) for group in groups)
    return [replace(fit.with_play(), log_odds=log_odds) for fit in fits]  # covariances have play


def _unlike_joints(
    ticks: ExplainedTicks, parts: Sequence[_Part], contacts: Sequence[KnownContact], constraints: int
) -> list[FittedJoint]:
    """The joints in which the object moves one after another, where none explains all ``parts``; empty if a
    part has none, or if one contact explains all parts as well."""
    if len(parts) < 2:
        return []
    own = list[FittedJoint]()
    for part in parts:
        fit = likeliest_joint(ticks.cut(part.first, part.end), contacts, constraints)
        if fit is None or not _is_credible(fit):
            return []
        own.append(fit)
    rivals = [0.0, *(contact_evidence(contact, ticks) for contact in contacts)]
    lead = sum(fit.log_evidence for fit in own) - float(np.logaddexp.reduce(rivals))
    groups = _grouped([fit.model for fit in own], ticks, parts)
    fits = [likeliest_joint(ticks.cut(group.first, group.end), contacts, constraints) for group in groups]
    joints = [replace(fit, log_odds=min(lead, fit.log_odds)) for fit in fits if fit is not None]
    return joints if lead > SURE_NATS and 1 < len(joints) == len(groups) else []


def _is_credible(fit: FittedJoint) -> bool:
    """Whether the errors of a joint are as small as those of real ones."""
    goes_round = fit.model.kind is not JointKind.SLIDER and np.ptp(fit.travelled) > 2.0 * np.pi
    comes_again = not fit.model.has_play or goes_round or turns_back(fit.travelled)
    return fit.errors_share <= (MOST_ERRORS if comes_again else MOST_ERRORS_ONCE)


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


def _lead_of_own_joints(model: JointModel, ticks: ExplainedTicks, parts: Sequence[_Part]) -> float:
    """Log evidence (nats) of a joint without play for each part, over that of one joint with play in all of
    them.

    Each joint after the first holds where the object rests before it moves: of its parameters only those that
    this rest does not determine are free. The place of the one joint may drift, as that of trackers does.
    """
    together = FittedJoint.fitted(model, ticks.cut(parts[0].first, parts[-1].end))
    if together.course is not None:
        drift = ticks.scales.innovations(drift_functions(together.ticks.window.index))
        together = replace(together, course=np.column_stack([together.course, drift]))
    lead = together.complexity - together.log_likelihood
    for number, part in enumerate(parts):
        own = FittedJoint.without_play(model, ticks.cut(part.first, part.end))
        lead += own.log_likelihood - own.complexity
        if number and part.moves > part.first:
            lead += replace(own, ticks=ticks.cut(part.first, part.moves)).complexity
    return lead


def _grouped(models: Sequence[JointModel], ticks: ExplainedTicks, parts: Sequence[_Part]) -> list[_Part]:
    """The parts, each with the model of its joint, of which successive ones with the same joint are one
    part."""
    groups = [[parts[0]]]
    for before, after, part in zip(models, models[1:], parts[1:], strict=False):
        group, model = _joined(groups[-1][-MOST_COMPARED:]), _common(before, after)
        if model is not None and _lead_of_own_joints(model, ticks, [group, part]) <= 0.0:
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
