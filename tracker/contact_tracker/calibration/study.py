"""Statistics of one recording for learning, and scores of a model on it; computed in one process."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker import hmm
from contact_tracker.calibration.e_step import EstimatedStates, KnownStates
from contact_tracker.calibration.segment_residuals import ContactSegment, fit_contact_segments
from contact_tracker.calibration.tick_stream import UNKNOWN, Observed, labels, observe
from contact_tracker.config.parameters import Model
from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import NoPoses
from contact_tracker.evaluation.evaluate import Evaluation, evaluate
from contact_tracker.ground_truth import Truth
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.states import STATES
from contact_tracker.tracking.forward_pass import RecordedPass
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.tracking.transition_model import hazard_exposure, log_initial, tick_transitions

Ints = NDArray[np.int64]

CONFIDENT: Final = 0.95
"""Smoothed probability above which a segment counts as its contact where there is no truth."""


@dataclass(frozen=True)
class Source:
    """A selection of poses of a file; ``use_truth``: whether to learn from its ground truth, if any;
    ``knowledge``: prior map."""

    name: str
    topic: str | None = None
    frame: str | None = None
    use_truth: bool = True
    knowledge: PriorMap = EMPTY_MAP
    relative_to: str | None = None
    table: TableReading = AS_NAMED


@dataclass(frozen=True, eq=False)
class ModelScore:
    """Scores of a model on a recording of ``seconds``: against any ground truth, and its evidence (nats)."""

    evaluation: Evaluation | None
    log_evidence: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Study:
    """The statistics of one recording for learning.

    ``labelled``: ``chain`` and ``segments`` are from ground truth, not from beliefs; ``has_truth``: the
    recording has ground truth for scores; ``score`` is that of the initial model, None if no pass was needed;
    ``damage`` of the file, if any.
    """

    name: str
    labelled: bool
    seconds: float
    sigma_position_m: float
    sigma_rotation_rad: float
    chain: KnownStates | EstimatedStates
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
    poses, truth, damage = _read(source)
    observed = observe(poses, model)
    assert observed is not None
    used_truth = truth if source.use_truth else None
    chain: KnownStates | EstimatedStates | None = None
    score, label = None, np.full(len(observed.activity), UNKNOWN, np.int64)
    if used_truth is not None:
        label = labels(observed.middle_ns, used_truth)
        chain = KnownStates(label, np.array([hazard_exposure(a) for a in observed.activity]))
    if score_it or chain is None:
        score, belief, found = _pass(poses, truth, model, source.knowledge)
        if chain is None:
            chain, label = belief, _confident(found, observed)
    return Study(
        source.name,
        used_truth is not None,
        _duration_s(poses),
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
    poses, truth, _ = _read(source)
    return _pass(poses, truth, model, source.knowledge)[0]


def _read(source: Source) -> tuple[Poses, Truth | None, str | None]:
    truth = read_truth(source.name)
    log = open_log(
        source.name, source.topic, source.frame, relative_to=source.relative_to, table=source.table
    )
    poses = Poses.collect(log)
    if not len(poses):
        raise NoPoses(f"{source.name}: no pose that can be used")
    return poses, truth, log.damage


def _pass(
    poses: Poses, truth: Truth | None, model: Model, knowledge: PriorMap
) -> tuple[ModelScore, EstimatedStates, Segmentation]:
    recorded = RecordedPass()
    found = segment(poses, model, knowledge=knowledge, watch=recorded.note)
    steps = np.array([tick_transitions(model, exposed).log_transition for exposed in recorded.exposure])
    trellis = recorded.trellis
    _, log_evidence = hmm.smooth(trellis, log_initial(model), steps)
    evaluation = None if truth is None else evaluate(poses, truth, found)
    belief = EstimatedStates.of(trellis, recorded.exposure, model)
    return ModelScore(evaluation, log_evidence, _duration_s(poses)), belief, found


def _duration_s(poses: Poses) -> float:
    return float(poses.stamp_ns[-1] - poses.stamp_ns[0]) * 1e-9


def _confident(found: Segmentation, observed: Observed) -> Ints:
    """Label (T,) of each tick in a segment with a probability of at least ``CONFIDENT``; else ``UNKNOWN``."""
    label = np.full(len(observed.middle_ns), UNKNOWN, np.int64)
    for one in found.segments:
        if one.probability >= CONFIDENT:
            first, end = np.searchsorted(observed.middle_ns, [one.start_ns, one.end_ns])
            label[first:end] = STATES.index(one.contact)
    return label
