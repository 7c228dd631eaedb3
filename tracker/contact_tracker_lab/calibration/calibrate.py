"""Calibration on all recordings, and cross-validation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from contact_tracker.config.parameters import Model
from contact_tracker.errors import NoTruth
from contact_tracker.processes import Runner
from contact_tracker_lab.calibration.learn import LearnedModel, learn
from contact_tracker_lab.calibration.learned import How, Learned
from contact_tracker_lab.calibration.study import ModelScore, Source, Study, score_model, study_recording
from contact_tracker_lab.evaluation.evaluate import Evaluation

LEFT_OUT_FIRST: Final = (How.RESIDUALS, How.CONTACTS)
"""If learning makes held-out recordings worse, parameters from residuals of estimated contacts are left out
first."""


@dataclass(frozen=True)
class Plan:
    """Settings of a calibration; with ``folds`` 0 nothing is held out."""

    sources: tuple[Source, ...]
    start: Model
    wanted: tuple[Learned, ...]
    folds: int

    def wants(self, how: How) -> bool:
        return any(learned.how is how for learned in self.wanted)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Scores of a held-out recording by the initial model and by one learned from other recordings.

    ``chain`` is the log probability of its true states, if known, under the transitions of both.
    """

    before: ModelScore
    after: ModelScore
    chain: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class Calibration:
    """The model learned from all recordings, its data, and the results on held-out recordings, if any."""

    plan: Plan
    studies: tuple[Study, ...]
    learned: LearnedModel
    held_out: tuple[HeldOut, ...]
    left_out: tuple[str, ...]
    """Keys that were not learned, because without truth they make held-out recordings less probable."""

    @property
    def log_loss(self) -> tuple[float, float] | None:
        """Log-loss (nats) before and after, on held-out recordings with truth, of filtered and smoothed
        beliefs."""
        before = [h.before.evaluation for h in self.held_out if h.before.evaluation is not None]
        after = [h.after.evaluation for h in self.held_out if h.after.evaluation is not None]
        return (mean_log_loss(before), mean_log_loss(after)) if before else None


def calibrate(plan: Plan, run: Runner) -> Calibration:
    """Learn from all recordings, and in folds.

    Raises
    ------
    InputError, ChoiceError
        A recording cannot be used.
    NoTruth
        The log-loss is to be searched, and there is no truth.
    """
    fit = plan.wants(How.RESIDUALS) or plan.wants(How.CONTACTS)
    studies = run(study_recording, [(source, plan.start, plan.folds > 0, fit) for source in plan.sources])
    if plan.wants(How.SEARCH) and not any(study.has_truth for study in studies):
        raise NoTruth("a search is for the least log-loss: that needs recordings with truth")
    left_out: tuple[str, ...] = ()
    while True:
        held_out = _hold_out(plan, studies, run)
        if any(study.labelled for study in studies) or not _is_worse(held_out) or not plan.wanted:
            break
        harmful = [learned for learned in plan.wanted if learned.how in LEFT_OUT_FIRST] or list(plan.wanted)
        left_out += tuple(learned.key for learned in harmful)
        plan = replace(plan, wanted=tuple(learned for learned in plan.wanted if learned not in harmful))
    learned = _learn(plan, studies, range(len(studies)), run)
    return Calibration(plan, tuple(studies), learned, tuple(held_out), left_out)


def _is_worse(held_out: Sequence[HeldOut]) -> bool:
    """Whether held-out recordings are less probable than before."""
    return sum(one.after.log_evidence - one.before.log_evidence for one in held_out) < 0.0


def mean_log_loss(evaluations: Sequence[Evaluation]) -> float:
    """Log-loss in nats over filtered and smoothed beliefs of all scored time; nan without any."""
    tallies = [tally for e in evaluations for tally in (e.online, e.offline)]
    seconds = sum(tally.seconds() for tally in tallies)
    return sum(tally.log_loss_s for tally in tallies) / seconds if seconds else float("nan")


def _learn(plan: Plan, studies: Sequence[Study], rows: Sequence[int], run: Runner) -> LearnedModel:
    """Learn from the recordings in ``rows``."""

    def loss(model: Model) -> float:
        scores = run(score_model, [(plan.sources[row], model) for row in rows if studies[row].has_truth])
        return mean_log_loss([j.evaluation for j in scores if j.evaluation is not None])

    return learn(plan.start, [studies[row] for row in rows], plan.wanted, loss)


def _hold_out(plan: Plan, studies: Sequence[Study], run: Runner) -> list[HeldOut]:
    """Every recording once, in order; fold k holds out each ``folds``-th from the k-th on."""
    if not plan.folds:
        return []
    everything = range(len(studies))
    models = [
        _learn(plan, studies, [row for row in everything if row % plan.folds != fold], run).model
        for fold in range(plan.folds)
    ]
    after = run(score_model, [(plan.sources[row], models[row % plan.folds]) for row in everything])
    held_out = []
    for row, study in enumerate(studies):
        chain = None
        if study.labelled:
            learned = models[row % plan.folds]
            chain = (study.chain.expect(plan.start).log_evidence, study.chain.expect(learned).log_evidence)
        assert study.score is not None
        held_out.append(HeldOut(study.score, after[row], chain))
    return held_out
