"""Calibration on all recordings, cross-validation, and their report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any, Final, NamedTuple

import numpy as np

from contact_tracker.config.parameters import Model, Transitions
from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import NoPoses, NoTruth
from contact_tracker.ground_truth import Truth
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.states import CONTACTS, STATES
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.tracking.transition_model import (
    REST_EXPOSURE,
    destinations,
    initial,
    leave_per_s,
)
from contact_tracker_lab.calibration.parameters import (
    How,
    Searched,
    coordinate_search,
    rounded,
    value_of,
    with_value,
)
from contact_tracker_lab.calibration.residuals import (
    FEWEST,
    ContactSegment,
    Floor,
    fit_contact_segments,
    learn_contact_errors,
    learn_floors,
    observe,
)
from contact_tracker_lab.calibration.transitions import (
    UNKNOWN,
    Chain,
    EstimatedStates,
    KnownStates,
    learn_transitions,
)
from contact_tracker_lab.calibration.trellis import RecordedPass
from contact_tracker_lab.evaluation.evaluate import Evaluation, evaluate
from contact_tracker_lab.evaluation.metrics import ratio
from contact_tracker_lab.evaluation.scoring import scoring
from contact_tracker_lab.evaluation.tables import number, table

Run = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]
"""Calls a function with the arguments of each job; returns the results in order."""

CONFIDENT: Final = 0.95
"""Smoothed probability from which a segment counts as its contact if there is no truth."""
FLOOR_NOTE: Final = """\
Floor of each contact alone, beyond the sensor's noise; - with too few residuals."""
ERROR_NOTE: Final = """\
Floor of each contact beyond the common one (m, rad), in quadrature."""
RATE_NOTE: Final = """\
Seen: seconds in motion and changes out of each state; rates per second of motion. Begins: probability that
a recording begins in the state."""
SPLIT_NOTE: Final = """\
Distribution of the next state, in percent, by the state that ends (row); of a contact to itself: to other
elements."""
HELD_OUT_NOTE: Final = """\
Scores of each recording by the initial model and by one learned without its fold. Log-loss in nats; ECE:
expected calibration error."""
LEFT_OUT_FIRST: Final = (How.RESIDUALS, How.CONTACTS)
"""If learning makes held-out recordings worse, parameters from residuals of estimated contacts are left out
first."""


@dataclass(frozen=True)
class Source:
    """A selection of poses of a file, with its map; ``use_truth``: learn from its ground truth, if any."""

    name: str
    topic: str | None = None
    frame: str | None = None
    use_truth: bool = True
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


class ModelScore(NamedTuple):
    """Scores of a model on a recording: against ground truth, if any, and its log evidence (nats)."""

    evaluation: Evaluation | None
    log_evidence: float


@dataclass(frozen=True, eq=False)
class Study:
    """The statistics of one recording for learning.

    ``labelled``: ``chain`` and ``segments`` are from ground truth, not from beliefs; ``has_truth``: the
    recording has ground truth for scores; ``score``: that of the initial model, None if no pass was needed;
    ``damage``: damage of the file, if any.
    """

    name: str
    labelled: bool
    seconds: float
    sigma_position_m: float
    sigma_rotation_rad: float
    chain: Chain
    segments: tuple[ContactSegment, ...]
    has_truth: bool
    score: ModelScore | None
    damage: str | None


def study_recording(source: Source, model: Model, score_it: bool, fit_it: bool) -> Study:
    """Read a recording; ``score_it``: score ``model`` (always if there is no ground truth); ``fit_it``: fit
    contact segments.

    Raises
    ------
    InputError, ChoiceError
        The recording cannot be used.
    """
    poses, truth, damage = source.read()
    observed = observe(poses, model)
    chain: Chain | None = None
    score, label = None, np.full(len(observed.activity), UNKNOWN, np.int64)
    if truth is not None and source.use_truth:
        label = scoring(observed.middle_ns, truth).truth.astype(np.int64)
        chain = KnownStates(label, np.array([max(a, REST_EXPOSURE) for a in observed.activity]))
    labelled = chain is not None
    if score_it or chain is None:
        score, believed, segmentation = _pass(poses, truth, model, source.known_map)
        if chain is None:
            chain = believed
            for span in segmentation.segments:
                if span.probability >= CONFIDENT:
                    first, end = np.searchsorted(observed.middle_ns, [span.start_ns, span.end_ns])
                    label[first:end] = STATES.index(span.contact)
    return Study(
        source.name,
        labelled,
        float(poses.stamp_ns[-1] - poses.stamp_ns[0]) * 1e-9,
        observed.sigma_position_m,
        observed.sigma_rotation_rad,
        chain,
        tuple(fit_contact_segments(observed, label, model)) if fit_it else (),
        truth is not None,
        score,
        damage,
    )


def score_model(source: Source, model: Model) -> ModelScore:
    """Score ``model`` on a recording."""
    return _pass(*source.read()[:2], model, source.known_map)[0]


def _pass(
    poses: Poses, truth: Truth | None, model: Model, known_map: Map
) -> tuple[ModelScore, EstimatedStates, Segmentation]:
    recorded = RecordedPass()
    segmentation = segment(poses, model, known_map=known_map, watch=recorded.note)
    evaluation = None if truth is None else evaluate(poses, truth, segmentation)
    believed = EstimatedStates.of(recorded.trellis, recorded.exposure, model)
    return ModelScore(evaluation, believed.expect(model).log_evidence), believed, segmentation


@dataclass(frozen=True)
class Plan:
    """Settings of a calibration; with ``folds`` 0 nothing is held out."""

    sources: tuple[Source, ...]
    start: Model
    ways: Mapping[str, How]
    folds: int

    def keys(self, how: How) -> list[str]:
        """Keys of the parameters that are learned in this way."""
        return [key for key, way in self.ways.items() if way is how]


class LearnedModel(NamedTuple):
    """A learned model with its derivation: ``floors`` by contact, log posterior by round of EM (empty if
    transitions were not learned), ``searched`` parameters."""

    model: Model
    floors: tuple[Floor, ...]
    rounds: tuple[float, ...]
    searched: tuple[Searched, ...]


class HeldOut(NamedTuple):
    """Scores of a held-out recording by the initial model and by one learned from other recordings.

    ``chain``: log probabilities of its true states by the transitions of both, if the states are known.
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
    """Keys that were not learned, because without truth they lower the evidence of held-out recordings."""

    @property
    def log_loss(self) -> tuple[float, float] | None:
        """Log-loss (nats) of filtered and smoothed beliefs before and after, on held-out recordings with
        truth."""
        initial_scores = [h.before for h in self.held_out if h.before.evaluation is not None]
        learned_scores = [h.after for h in self.held_out if h.after.evaluation is not None]
        return (mean_log_loss(initial_scores), mean_log_loss(learned_scores)) if initial_scores else None


def calibrate(plan: Plan, run: Run) -> Calibration:
    """Learn from all recordings, and in folds.

    Raises
    ------
    InputError, ChoiceError
        A recording cannot be used.
    NoTruth
        The log-loss is to be searched, and there is no truth.
    """
    fit = bool(plan.keys(How.RESIDUALS) or plan.keys(How.CONTACTS))
    studies = run(study_recording, [(source, plan.start, plan.folds > 0, fit) for source in plan.sources])
    if plan.keys(How.SEARCH) and not any(study.has_truth for study in studies):
        raise NoTruth("a search is for the least log-loss: that needs recordings with truth")
    left_out = tuple[str, ...]()
    while True:
        held_out = _hold_out(plan, studies, run)
        is_worse = sum(scores.after.log_evidence - scores.before.log_evidence for scores in held_out) < 0.0
        if any(study.labelled for study in studies) or not is_worse or not plan.ways:
            break
        harmful = [key for how in LEFT_OUT_FIRST for key in plan.keys(how)] or list(plan.ways)
        left_out += tuple(harmful)
        plan = replace(plan, ways={key: how for key, how in plan.ways.items() if key not in harmful})
    learned = _learn(plan, studies, range(len(studies)), run)
    return Calibration(plan, tuple(studies), learned, tuple(held_out), left_out)


def _hold_out(plan: Plan, studies: Sequence[Study], run: Run) -> list[HeldOut]:
    """Scores of every recording in order; fold k holds out each ``folds``-th of them from the k-th on."""
    all_rows = range(len(studies)) if plan.folds else ()
    models = [
        _learn(plan, studies, [row for row in all_rows if row % plan.folds != fold], run).model
        for fold in range(plan.folds)
    ]
    scores = run(score_model, [(plan.sources[row], models[row % plan.folds]) for row in all_rows])
    held_out = []
    for row, score in zip(all_rows, scores, strict=True):
        study, compared = studies[row], (plan.start, models[row % plan.folds])
        chain = [study.chain.expect(model).log_evidence for model in compared]
        assert study.score is not None
        held_out.append(HeldOut(study.score, score, (chain[0], chain[1]) if study.labelled else None))
    return held_out


def mean_log_loss(scores: Sequence[ModelScore]) -> float:
    """Log-loss in nats over filtered and smoothed beliefs of all scored time; nan without any."""
    evaluations = [score.evaluation for score in scores if score.evaluation is not None]
    tallies = [tally for evaluation in evaluations for tally in (evaluation.online, evaluation.offline)]
    return ratio(sum(t.log_loss_s for t in tallies), sum(t.seconds() for t in tallies))


def _learn(plan: Plan, studies: Sequence[Study], rows: Sequence[int], run: Run) -> LearnedModel:
    """Learn from the recordings in ``rows``: first closed forms, in turn, then the search; other parameters
    are those of the plan's start."""

    def loss(model: Model) -> float:
        return mean_log_loss(
            run(score_model, [(plan.sources[row], model) for row in rows if studies[row].has_truth])
        )

    learning = [studies[row] for row in rows]
    model = plan.start
    floors, rounds = tuple[Floor, ...](), tuple[float, ...]()
    for key in plan.keys(How.STREAM):
        deviations = [vars(study)[key.rpartition(".")[2]] for study in learning]
        model = with_value(model, key, float(np.exp(np.mean(np.log(deviations)))))
    segments = [segment for study in learning for segment in study.segments]
    if plan.keys(How.RESIDUALS):
        model, floors = learn_floors(model, segments, plan.keys(How.RESIDUALS))
    for key in (*plan.keys(How.STREAM), *plan.keys(How.RESIDUALS)):
        model = with_value(model, key, rounded(value_of(model, key)))
    model = learn_contact_errors(model, segments, plan.keys(How.CONTACTS))
    if plan.keys(How.COUNTS):
        model, rounds = learn_transitions(model, [study.chain for study in learning])
    model, searched = coordinate_search(model, plan.keys(How.SEARCH), loss)
    return LearnedModel(model, floors, rounds, searched)


def to_text(calibration: Calibration) -> str:
    """The report: data, changes, and their effect on held-out recordings; without a trailing newline."""
    plan, learned = calibration.plan, calibration.learned
    before, after = plan.start, learned.model
    blocks = [_source(calibration), _scalars(plan, learned)]
    if learned.floors:
        rows = [[f.key, f.contacts, _short(f.value), str(f.residuals)] for f in learned.floors]
        blocks += [table(["floor", "contacts", "value", "residuals"], rows, left=2), FLOOR_NOTE]
    if plan.keys(How.CONTACTS):
        errors = zip(after.noise.contact_position_m, after.noise.contact_rotation_rad, strict=True)
        named = zip(CONTACTS, errors, strict=False)
        rows = [[contact.value, *map(_short, sizes)] for contact, sizes in named]
        blocks += [table(["contact", "contact_position_m", "contact_rotation_rad"], rows), ERROR_NOTE]
    if plan.keys(How.COUNTS):
        blocks += [_rates(before.transitions, after.transitions), RATE_NOTE]
        shares = zip(STATES, 100.0 * destinations(after.transitions), strict=True)
        rows = [[state, *(number(p, 1) if p else "." for p in row)] for state, row in shares]
        blocks += [table(["", *STATES], rows), SPLIT_NOTE]
    if calibration.held_out:
        blocks += [*_held_out(calibration), HELD_OUT_NOTE]
    return "\n\n".join(blocks)


def _source(calibration: Calibration) -> str:
    studies, rounds = calibration.studies, calibration.learned.rounds
    labelled, seconds = sum(s.labelled for s in studies), sum(s.seconds for s in studies)
    head = f"{len(studies)} recordings, {seconds:.0f} s; learned from the truth of {labelled}"
    if not rounds:
        return head
    gained = f"{rounds[-1] - rounds[0]:.1f} nats"
    return f"{head}; transitions after {len(rounds)} rounds, log posterior {gained} higher"


def _scalars(plan: Plan, learned: LearnedModel) -> str:
    residuals = {floor.key: floor.residuals for floor in learned.floors if floor.contacts == "all"}
    searched = {search.key: search for search in learned.searched}
    rows = []
    for key, how in plan.ways.items():
        if how in (How.COUNTS, How.CONTACTS):
            continue
        origin = str(how)
        if how is How.RESIDUALS:
            origin = f"{residuals[key]} {how}{'' if residuals[key] >= FEWEST else ': too few, kept'}"
        elif how is How.SEARCH:
            search = searched[key]
            origin = f"log-loss {number(search.before)} to {number(search.after)} in {len(search.tried)} runs"
        rows.append([key, *(_short(value_of(model, key)) for model in (plan.start, learned.model)), origin])
    prior = learned.model.transitions.prior_changes
    text = f"prior of the transitions: the lattice, as much as {prior:g} changes out of each state"
    return "\n".join([*([table(["parameter", "before", "after", "from"], rows)] if rows else []), text])


def _rates(start: Transitions, learned: Transitions) -> str:
    counted = learned.counts.moving_s, np.array(learned.counts.changes).sum(axis=1)
    values = leave_per_s(start), leave_per_s(learned), initial(start), initial(learned)
    columns = [[number(n, 1) for n in column] for column in counted]
    columns += [[number(value) for value in column] for column in values]
    rows = list(zip(STATES, *columns, strict=True))
    return table(["state", "seen s", "changes", "leave 1/s", "after", "begins", "after"], rows)


def _held_out(calibration: Calibration) -> list[str]:
    held_out, blocks, rows = calibration.held_out, [], []
    for stage in ("before", "after"):
        evaluations = [e for h in held_out if (e := getattr(h, stage).evaluation) is not None]
        for name, mode in (("smoothed", "offline"), ("filtered", "online")) if evaluations else ():
            t = reduce(add, (getattr(evaluation, mode) for evaluation in evaluations))
            values = t.accuracy(), t.macro_f1, t.log_loss, t.brier, t.calibration_error, t.sure_wrong
            rows.append([name, stage, *map(number, values)])
    if rows:
        header = ["held out", "", "accuracy", "F1", "log-loss", "Brier", "ECE", "sure & wrong"]
        blocks.append(table(header, rows, left=2))
    chains = [h.chain for h in held_out if h.chain is not None]
    if chains:
        b, a = np.sum(chains, axis=0)
        blocks.append(f"log probability of the true states by the transitions: {b:.1f} before, {a:.1f} after")
    seconds = sum(study.seconds for study in calibration.studies)
    b, a = np.sum([[h.before.log_evidence, h.after.log_evidence] for h in held_out], axis=0) / seconds
    blocks.append(f"log evidence against free motion: {b:.3f} nats/s before, {a:.3f} after")
    return blocks


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
