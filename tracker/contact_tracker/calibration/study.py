"""One recording, looked at by one process: what learning needs of it, and how a model does on it."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker import hmm
from contact_tracker.calibration.e_step import BelievedStates, KnownStates
from contact_tracker.calibration.segment_residuals import Stretch, find_stretches
from contact_tracker.calibration.tick_stream import UNKNOWN, Observed, labels, observe
from contact_tracker.config.parameters import Model
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
    """Which poses of which file; ``believe_truth`` says that its truth, if it has one, is learned from, and
    ``knowledge`` what is known of object and surroundings."""

    name: str
    topic: str | None = None
    frame: str | None = None
    believe_truth: bool = True
    knowledge: PriorMap = EMPTY_MAP
    relative_to: str | None = None
    time_unit: str | None = None


@dataclass(frozen=True, eq=False)
class Judged:
    """How a model does on a recording of ``seconds``: against the truth if there is one, and by itself."""

    evaluation: Evaluation | None
    log_evidence: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Study:
    """What learning needs of one recording.

    ``labelled`` says that ``chain`` and ``stretches`` are from truth, not from belief; ``has_truth`` that it
    can be judged by truth all the same; ``judged`` is by the
    model that calibration starts from, None where no pass was needed; ``damage`` of the file, if any.
    """

    name: str
    labelled: bool
    seconds: float
    sigma_position_m: float
    sigma_rotation_rad: float
    chain: KnownStates | BelievedStates
    stretches: tuple[Stretch, ...]
    has_truth: bool
    judged: Judged | None
    damage: str | None


def look(source: Source, model: Model, judge_it: bool, fit_it: bool) -> Study:
    """Read a recording; ``judge_it`` by a pass of ``model`` (without truth there is one anyway), ``fit_it``
    where stretches of contact are wanted.

    Raises
    ------
    InputError, AmbiguousSource
        The recording cannot be used.
    """
    poses, truth, damage = _read(source)
    observed = observe(poses, model)
    assert observed is not None
    believed = truth if source.believe_truth else None
    chain: KnownStates | BelievedStates | None = None
    judged, label = None, np.full(len(observed.activity), UNKNOWN, np.int64)
    if believed is not None:
        label = labels(observed.middle_ns, believed)
        chain = KnownStates(label, np.array([hazard_exposure(a) for a in observed.activity]))
    if judge_it or chain is None:
        judged, belief, found = _pass(poses, truth, model, source.knowledge)
        if chain is None:
            chain, label = belief, _confident(found, observed)
    return Study(
        source.name,
        believed is not None,
        _duration_s(poses),
        observed.sigma_position_m,
        observed.sigma_rotation_rad,
        chain,
        tuple(find_stretches(observed, label, model)) if fit_it else (),
        truth is not None,
        judged,
        damage,
    )


def judge(source: Source, model: Model) -> Judged:
    """How ``model`` does on a recording."""
    poses, truth, _ = _read(source)
    return _pass(poses, truth, model, source.knowledge)[0]


def _read(source: Source) -> tuple[Poses, Truth | None, str | None]:
    truth = read_truth(source.name)
    log = open_log(
        source.name, source.topic, source.frame, relative_to=source.relative_to, time_unit=source.time_unit
    )
    poses = Poses.collect(log)
    if not len(poses):
        raise NoPoses(f"{source.name}: no pose that can be used")
    return poses, truth, log.damage


def _pass(
    poses: Poses, truth: Truth | None, model: Model, knowledge: PriorMap
) -> tuple[Judged, BelievedStates, Segmentation]:
    recorded = RecordedPass()
    found = segment(poses, model, knowledge=knowledge, watch=recorded.note)
    steps = np.array([tick_transitions(model, exposed).log_transition for exposed in recorded.exposure])
    trellis = recorded.trellis
    _, log_evidence = hmm.smooth(trellis, log_initial(model), steps)
    evaluation = None if truth is None else evaluate(poses, truth, found)
    belief = BelievedStates.of(trellis, recorded.exposure, model)
    return Judged(evaluation, log_evidence, _duration_s(poses)), belief, found


def _duration_s(poses: Poses) -> float:
    return float(poses.stamp_ns[-1] - poses.stamp_ns[0]) * 1e-9


def _confident(found: Segmentation, observed: Observed) -> Ints:
    """Label (T,) of each tick that lies in a segment of which the smoother is sure."""
    label = np.full(len(observed.middle_ns), UNKNOWN, np.int64)
    for one in found.segments:
        if one.probability >= CONFIDENT:
            first, end = np.searchsorted(observed.middle_ns, [one.start_ns, one.end_ns])
            label[first:end] = STATES.index(one.contact)
    return label
