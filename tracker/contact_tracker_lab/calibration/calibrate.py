"""Calibration on all recordings, cross-validation, and their report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any, Final

import numpy as np

from contact_tracker.config.parameters import Model, Transitions
from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import NoPoses, NoTruth
from contact_tracker.ground_truth import Truth
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.poses import Poses, batches
from contact_tracker.motion.tick_averaging import tick_variances
from contact_tracker.motion.window import window_of
from contact_tracker.recording import open_log, read_truth
from contact_tracker.states import STATES
from contact_tracker.tracking.contact_filter import ticks_of
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.transition_model import destinations, initial, leave_per_s
from contact_tracker_lab.calibration.parameters import COUNTS, SIGMAS
from contact_tracker_lab.calibration.transitions import Counts, count_transitions
from contact_tracker_lab.evaluation.evaluate import Evaluation, evaluate
from contact_tracker_lab.evaluation.metrics import ratio
from contact_tracker_lab.evaluation.scoring import scoring
from contact_tracker_lab.evaluation.tables import number, table

Run = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]
"""Calls a function with the arguments of each job; returns the results in order."""

RATE_NOTE: Final = """\
Seen: seconds in motion and changes out of each state; rates per second of motion. Begins: probability that
a recording begins in the state."""
SPLIT_NOTE: Final = """\
Distribution of the next state, in percent, by the state that ends (row); of a contact to itself: to other
elements."""
HELD_OUT_NOTE: Final = """\
Scores of each recording by the initial model and by one learned without its fold. Log-loss in nats; ECE:
expected calibration error."""


@dataclass(frozen=True)
class Source:
    """A selection of poses of a file, with its map."""

    name: str
    topic: str | None = None
    frame: str | None = None
    known_map: Map = EMPTY_MAP
    relative_to: str | None = None
    table: TableReading = AS_NAMED

    def read(self) -> tuple[Poses, Truth | None, str | None]:
        """The poses, the truth, if any, and the damage of the file, if any."""
        truth = read_truth(self.name)
        log = open_log(self.name, self.topic, self.frame, relative_to=self.relative_to, table=self.table)
        poses = Poses.collect(log)
        if not len(poses):
            raise NoPoses(f"{self.name}: no pose that can be used")
        return poses, truth, log.damage


@dataclass(frozen=True, eq=False)
class Study:
    """The statistics of one recording for learning.

    ``sigma``: noise of a pose (m, rad); ``counts``: of the true states, None without truth; ``score``: that
    of the initial model, if asked for and there is truth; ``damage``: damage of the file, if any.
    """

    name: str
    seconds: float
    sigma: tuple[float, float]
    counts: Counts | None
    score: Evaluation | None
    damage: str | None


def study_recording(source: Source, model: Model, score_it: bool) -> Study:
    """Read a recording; ``score_it``: score ``model`` by the ground truth.

    Raises
    ------
    InputError, ChoiceError
        The recording cannot be used.
    """
    poses, truth, damage = source.read()
    ticks, counts = list(ticks_of(batches(poses), model)), None
    if truth is not None:
        variance = [tick_variances(tick.noise, np.array(float(tick.count)), model) for tick in ticks]
        activity = replace(window_of(ticks, model), variance=np.array(variance)).motion_ratio
        middle_ns = np.array([(tick.start_ns + tick.stamp_ns) // 2 for tick in ticks], np.int64)
        label = scoring(middle_ns, truth).truth.astype(np.int64)
        counts = count_transitions(label, activity, model.tick_s)
    return Study(
        source.name,
        float(poses.stamp_ns[-1] - poses.stamp_ns[0]) * 1e-9,
        (ticks[-1].noise.sigma_position_m, ticks[-1].noise.sigma_rotation_rad),
        counts,
        score_model(source, model) if score_it else None,
        damage,
    )


def score_model(source: Source, model: Model) -> Evaluation | None:
    """Score ``model`` on a recording; None if it has no truth."""
    poses, truth, _ = source.read()
    return (
        None if truth is None else evaluate(poses, truth, segment(poses, model, known_map=source.known_map))
    )


@dataclass(frozen=True)
class Plan:
    """Settings of a calibration: the ``keys`` to learn; with ``folds`` 0 nothing is held out."""

    sources: tuple[Source, ...]
    start: Model
    keys: tuple[str, ...]
    folds: int


@dataclass(frozen=True, eq=False)
class Calibration:
    """The model learned from all recordings, its data, and the scores of held-out recordings with truth, by
    the initial model and by one learned from other recordings."""

    plan: Plan
    studies: tuple[Study, ...]
    model: Model
    held_out: tuple[tuple[Evaluation, Evaluation], ...]

    @property
    def log_loss(self) -> tuple[float, float] | None:
        """Log-loss (nats) of filtered and smoothed beliefs before and after, on held-out recordings."""
        if not self.held_out:
            return None
        before, after = (
            [tally for scores in self.held_out for tally in (scores[i].online, scores[i].offline)]
            for i in (0, 1)
        )
        losses = [
            ratio(sum(t.log_loss_s for t in tallies), sum(t.seconds() for t in tallies))
            for tallies in (before, after)
        ]
        return losses[0], losses[1]


def calibrate(plan: Plan, run: Run) -> Calibration:
    """Learn from all recordings, and in folds: fold k holds out each ``folds``-th of them from the k-th on.

    Raises
    ------
    InputError, ChoiceError
        A recording cannot be used.
    NoTruth
        Transitions are to be learned, and no recording has truth.
    """
    studies = run(study_recording, [(source, plan.start, plan.folds > 0) for source in plan.sources])
    if COUNTS in plan.keys and not any(study.counts for study in studies):
        raise NoTruth("transitions are learned from true states, and no recording has truth: --only noise")
    model, rows = _learn(plan, studies), range(len(studies)) if plan.folds else ()
    models = [
        _learn(plan, [studies[row] for row in rows if row % plan.folds != fold]) for fold in range(plan.folds)
    ]
    scores = run(score_model, [(plan.sources[row], models[row % plan.folds]) for row in rows])
    pairs = ((study.score, score) for study, score in zip(studies, scores, strict=False))
    held_out = tuple((before, after) for before, after in pairs if before is not None and after is not None)
    return Calibration(plan, tuple(studies), model, held_out)


def _learn(plan: Plan, studies: Sequence[Study]) -> Model:
    """The model learned from these recordings; other parameters are those of the plan's start."""
    model = plan.start
    sigma = np.exp(np.mean(np.log([study.sigma for study in studies]), axis=0)).tolist()
    learned: dict[str, Any] = {
        key.partition(".")[2]: float(f"{value:.3g}")  # as in the file
        for key, value in zip(SIGMAS, sigma, strict=True)
        if key in plan.keys
    }
    model = replace(model, noise=replace(model.noise, **learned))
    counts = [study.counts for study in studies if study.counts is not None]
    if COUNTS not in plan.keys or not counts:
        return model
    total = Counts(*(np.sum(parts, axis=0) for parts in zip(*counts, strict=True)))
    return replace(model, transitions=replace(model.transitions, counts=total.rounded))


def to_text(calibration: Calibration) -> str:
    """The report: data, changes, and their effect on held-out recordings; without a trailing newline."""
    plan, before, after = calibration.plan, calibration.plan.start, calibration.model
    labelled = sum(study.counts is not None for study in calibration.studies)
    seconds = sum(study.seconds for study in calibration.studies)
    blocks = [f"{len(calibration.studies)} recordings, {seconds:.0f} s; {labelled} with truth"]
    rows = [
        [key, *(f"{vars(model.noise)[key.partition('.')[2]]:.3g}" for model in (before, after))]
        for key in SIGMAS
        if key in plan.keys
    ]
    blocks += [table(["parameter", "before", "after"], rows)] if rows else []
    if COUNTS in plan.keys:
        prior = f"{after.transitions.prior_changes:g} changes out of each state"
        blocks.append(f"prior of the transitions: the lattice, as much as {prior}")
        blocks += [_rates(before.transitions, after.transitions), RATE_NOTE]
        shares = zip(STATES, 100.0 * destinations(after.transitions), strict=True)
        rows = [[state, *(number(p, 1) if p else "." for p in row)] for state, row in shares]
        blocks += [table(["", *STATES], rows), SPLIT_NOTE]
    if calibration.held_out:
        blocks += [_held_out(calibration), HELD_OUT_NOTE]
    return "\n\n".join(blocks)


def _rates(start: Transitions, learned: Transitions) -> str:
    counted = learned.counts.moving_s, np.array(learned.counts.changes).sum(axis=1)
    values = leave_per_s(start), leave_per_s(learned), initial(start), initial(learned)
    columns = [[number(n, 1) for n in column] for column in counted]
    columns += [[number(value) for value in column] for column in values]
    rows = list(zip(STATES, *columns, strict=True))
    return table(["state", "seen s", "changes", "leave 1/s", "after", "begins", "after"], rows)


def _held_out(calibration: Calibration) -> str:
    rows = []
    for stage, evaluations in zip(("before", "after"), zip(*calibration.held_out, strict=True), strict=True):
        for name, mode in (("smoothed", "offline"), ("filtered", "online")):
            t = reduce(add, (getattr(evaluation, mode) for evaluation in evaluations))
            values = t.accuracy(), t.macro_f1, t.log_loss, t.brier, t.calibration_error, t.sure_wrong
            rows.append([name, stage, *map(number, values)])
    header = ["held out", "", "accuracy", "F1", "log-loss", "Brier", "ECE", "sure & wrong"]
    return table(header, rows, left=2)
