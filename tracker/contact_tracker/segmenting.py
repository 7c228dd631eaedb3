"""Segments a recording: its first part decides ticks and noise, then all of it is filtered and smoothed.

With recorded wrenches a first pass labels by motion, and its ticks of free motion determine the load.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import replace
from itertools import chain, compress
from typing import Final

import numpy as np

from contact_tracker.checks.map_use import without_contradicted_names
from contact_tracker.config.parameters import Model
from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.geometry.elements import Array
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.pose_validation import require_valid
from contact_tracker.motion.poses import AS_GIVEN, NO_OUTLIERS, Batched, Pose, Poses, ReadAs, batches
from contact_tracker.motion.sensor_noise import independent_point
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.recording.log import PoseLog
from contact_tracker.recording.wrenches import WrenchLog, read_wrenches
from contact_tracker.states import STATES, Contact
from contact_tracker.tracker import BATCH_POSES, Tracker
from contact_tracker.tracking.belief import Belief, Detail, Segment
from contact_tracker.tracking.contact_filter import ContactFilter, ticks_of
from contact_tracker.tracking.filter_bank import (
    DOUBT,
    Report,
    map_findings,
    map_use,
    mixed_with_uniform,
    period_for_all_s,
)
from contact_tracker.tracking.map_passes import with_map
from contact_tracker.tracking.offline_smoother import PassRecord, Segmenter, pieces
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.trajectory import Trajectory
from contact_tracker.wrenches.contact_evidence import WrenchEvidence
from contact_tracker.wrenches.load import Load, NoLoad, require_load
from contact_tracker.wrenches.wrenches import Wrenches

AHEAD_POSES: Final = 100_000
"""Number of poses whose periods decide the length of the ticks; they stay in memory until then."""
MOST_POSES: Final = 1_000_000
"""Number of poses after which the best model so far is chosen; until then all stay in memory."""
INITIAL_AUTOCORRELATION: Final = 0.5
"""Autocorrelation of the prediction errors of free motion, offline, until it is estimated. It is near that of
all recorded motion, so that smooth free motion at the start is not confused with contact. Online it would
delay labels, and a wrench that shows a contact force at the start makes it needless."""


class OfflineTracker:
    """Segments one recording piece by piece; ``report`` then has the chosen ticks and noise, ``outliers`` the
    number of poses left out.

    Parameters
    ----------
    read_as : units and conventions in which the poses were read.
    uses_map : whether a map of the recording is made. Passes with the map (``map_passes.with_map``) follow
        the first pass, unless elements are fixed (``Map.fixes_elements``) or wrenches given.
    """

    def __init__(
        self,
        model: Model,
        known_map: Map = EMPTY_MAP,
        executor: Executor | None = None,
        wrenches: WrenchEvidence | None = None,
        read_as: ReadAs = AS_GIVEN,
        uses_map: bool = True,
    ) -> None:
        self._known_map = known_map
        self._wrenches = wrenches
        self._executor = executor
        self._tracker = Tracker.start(model, known_map=known_map, read_as=read_as)
        self._has_passes = uses_map and not known_map.shows_touch and wrenches is None
        self._record = PassRecord(keeps_ticks=self._has_passes) if uses_map else None
        self.outliers = NO_OUTLIERS
        self._has_ended = False

    def pieces(
        self,
        poses: Iterable[Pose] | Batched,
        progress: Callable[[int], None] | None = None,
        detail: Detail = Detail.SHARED,
    ) -> Iterator[Segmentation]:
        """The segmentation in pieces, as ``offline_smoother.pieces``, but in a single piece at the end where
        passes with a map may follow.

        Parameters
        ----------
        progress : called at intervals with the number of poses read so far.
        detail : of the ``filtered`` beliefs.

        Raises
        ------
        InvalidPose
            While iterating: poses did not pass the gate.
        """
        stream = self._with_usual_period(_validated(batches(poses)))  # ticks that suit the whole recording
        stream, early = self._choose_noise(stream, detail)  # by the tracker, on the first part
        if self._tracker.best is None:
            yield Segmentation()
            return
        filter_ = ContactFilter.start(self._model, known_map=self._known_map)
        ticks = ticks_of(stream, self._model, progress, self._tracker.filters.body_m)
        segmenter = Segmenter(self._executor, self._wrenches, self._record)
        parts = pieces(ticks, filter_, segmenter, detail)  # filter, smooth, decode, fit each segment
        if self._record is not None and self._has_passes:
            parts = with_map(parts, self._record, self._executor)  # passes while they explain more
        yield from self._checked(parts, early)

    @property
    def map(self) -> GrowingMap | None:
        """The elements that the contacts have touched; None if the recording has no poses."""
        return None if self._record is None else self._record.map

    @property
    def report(self) -> Report | None:
        """Ticks, noise and findings of the recording; None if it has no poses."""
        report = self._tracker.report
        if report is None or self._record is None or self._record.state is None or not self._has_passes:
            return report
        world = self._record.state.map  # which judges the map of another recording
        findings = (finding for finding in report.findings if finding.kind != "map")
        about_map = map_findings(world, self._known_map)
        return report._replace(findings=(*findings, *about_map), map_use=map_use(world, self._known_map))

    @property
    def _model(self) -> Model:
        """The chosen model."""
        assert self._tracker.best is not None
        model = self._tracker.best.model
        if self._wrenches is not None and self._wrenches.shows_contact_at_start():
            return model
        assumed = max(model.motion.initial_autocorrelation, INITIAL_AUTOCORRELATION)
        return replace(model, motion=replace(model.motion, initial_autocorrelation=assumed))

    def _with_usual_period(self, stream: Iterator[Poses]) -> Iterator[Poses]:
        """The same stream; its first ``AHEAD_POSES`` decide the length of ticks and the tracked point."""
        ahead = _read_ahead(stream)
        if ahead:
            filters = self._tracker.filters
            poses = Poses.join(ahead)
            filters.period_s = period_for_all_s(poses.stamp_ns, filters.model)
            if self._wrenches is None:  # moments are about the body's origin
                filters.body_m = independent_point(poses)
        return chain(_released(ahead), stream)

    def _choose_noise(self, stream: Iterator[Poses], detail: Detail) -> tuple[Iterator[Poses], Beliefs]:
        """The stream from its beginning and the online beliefs, if ``detail`` is enough, up to the choice of
        the model. The stream is read until model and conventions of the poses are decided."""
        tracker = self._tracker
        inspected, ahead, beliefs, count = list[Poses](), list[Poses](), list[Beliefs](), 0
        for poses in stream:
            used = 0
            while used < len(poses) and not tracker.is_decided:
                part = poses[used : used + BATCH_POSES]
                beliefs.append(_in_columns(tracker.add(part, detail), detail))
                used += len(part)
            tracker.inspect_added()  # later poses are inspected without the filters
            inspected.append(poses[:used])
            count += len(poses)
            if used < len(poses):
                tracker.check("conventions", poses[used:])
                ahead.append(poses[used:])
            is_settled = tracker.is_decided and tracker.checks.conventions.is_settled
            if is_settled or count >= MOST_POSES:
                break
        if not tracker.is_decided and count < MOST_POSES:
            beliefs.append(_in_columns(tracker.finish(), detail))
        following = self._inspected(chain(_released(ahead), stream))
        return chain(_released(inspected), following), Beliefs.join(beliefs)

    def _inspected(self, stream: Iterator[Poses]) -> Iterator[Poses]:
        """The same poses, after inspection and the test of the map."""
        for poses in stream:
            self._tracker.inspect_poses(poses)
            self._tracker.check("contradiction", poses)
            yield poses
        self._has_ended = True

    def _checked(self, parts: Iterator[Segmentation], early: Beliefs) -> Iterator[Segmentation]:
        """The pieces after the checks of segments; the ``early`` online beliefs replace their first ones."""
        for piece in parts:
            count = min(len(early), len(piece.filtered))
            reported, early = early[:count], early[count:]
            self.outliers = self.outliers.joined(piece.outliers)
            piece = replace(piece, filtered=piece.filtered[count:])
            self._tracker.check_segments(piece.segments)
            report = self.report if self._has_ended else self._tracker.report_so_far
            if report is not None and any(finding.doubts_labels for finding in report.findings):
                piece = _in_doubt(piece, self._known_map.allowed)
            piece = replace(piece, filtered=Beliefs.join([reported, piece.filtered]))
            listed, use = self._known_map.listed_environment, self._tracker.checks.map_use
            yield without_contradicted_names(piece, listed, use)


def _read_ahead(stream: Iterator[Poses]) -> list[Poses]:
    """The first ``AHEAD_POSES`` poses."""
    ahead, count = list[Poses](), 0
    for poses in stream:
        ahead.append(poses)
        count += len(poses)
        if count >= AHEAD_POSES:
            break
    return ahead


def _in_columns(beliefs: list[Belief], detail: Detail) -> Beliefs:
    """The beliefs in columns, to save memory, as the choice may take hours; none if ``detail`` is too low."""
    return Beliefs.of(beliefs if detail >= Detail.SHARED else ())


def _validated(stream: Iterator[Poses]) -> Iterator[Poses]:
    """The same poses; raises InvalidPose if they did not pass the gate."""
    last_ns: int | None = None
    for poses in stream:
        if len(poses):
            require_valid(poses, last_ns)
            last_ns = int(poses.stamp_ns[-1])
        yield poses


def _in_doubt(piece: Segmentation, possible: tuple[Contact, ...]) -> Segmentation:
    """The piece with probabilities mixed with uniform ones, all contacts open, and no joint sure: its poses
    are doubtful."""
    states = np.array([state is Contact.FREE or state in possible for state in STATES])

    def mixed(probability: Array) -> Array:
        return mixed_with_uniform(probability, possible)

    def doubted(segment: Segment) -> Segment:
        label = segment.contact
        p_label = float(mixed(np.full(len(STATES), segment.probability))[label.column])
        alternatives = tuple(state for state in compress(STATES, states) if state is not label)
        joint = None if segment.joint is None else doubted_joint(segment.joint)
        posterior = None if segment.posterior is None else mixed(segment.posterior)
        return replace(
            segment, probability=p_label, inseparable=alternatives, joint=joint, posterior=posterior
        )

    def doubted_joint(joint: Joint) -> Joint:
        return replace(joint, probability=(1.0 - DOUBT) * joint.probability)

    beliefs = piece.beliefs.with_probability(mixed(piece.beliefs.probability), states)
    return replace(
        piece,
        segments=tuple(map(doubted, piece.segments)),
        beliefs=replace(beliefs, joints=[*map(doubted_joint, beliefs.joints)]),
        filtered=piece.filtered.with_probability(mixed(piece.filtered.probability)),
    )


def _released(parts: list[Poses]) -> Iterator[Poses]:
    """The parts in order; each is dropped as it is passed on, to free its memory."""
    parts.reverse()
    while parts:
        yield parts.pop()


def segment(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    known_map: Map = EMPTY_MAP,
) -> Segmentation:
    """Segment a whole recording, as ``offline_smoother.segment``, with ticks and noise chosen by its poses.

    Raises
    ------
    InvalidPose
        Poses that did not pass the gate: apply ``gate`` of ``motion.pose_validation`` first.
    """
    return Segmentation.join([*OfflineTracker(model, known_map).pieces(poses, progress, Detail.GEOMETRY)])


def segmented(
    trajectory: Trajectory,
    model: Model,
    known_map: Map = EMPTY_MAP,
    wrenches: WrenchEvidence | None = None,
    executor: Executor | None = None,
    progress: Callable[[int], None] | None = None,
    notes: Iterable[str] = (),
    detail: Detail = Detail.SHARED,
) -> Outcome:
    """Segment a trajectory; for the parameters see ``OfflineTracker`` and ``Outcome``."""
    tracker = OfflineTracker(model, known_map, executor, wrenches, trajectory.read_as)
    result = Segmentation.join(list(tracker.pieces(trajectory, progress, detail)))
    has_wrenches = wrenches is not None
    return Outcome(trajectory, result, tracker.report, tuple(notes), has_wrenches, known_map, tracker.map)


RecordedEvidence = tuple[WrenchEvidence | None, str, tuple[str, ...]]
"""The evidence, None if the wrenches are not usable; a line with the load, empty if it is unknown or part of
a warning; and warnings, if wrenches are not used."""


def recorded_evidence(
    path: str,
    topic: str,
    log: PoseLog,
    model: Model,
    known_map: Map,
    progress: Callable[[int], None] | None = None,
) -> RecordedEvidence:
    """Evidence of the wrenches on ``topic``, None for a recording without poses.

    Parameters
    ----------
    log : of the poses of the same recording, all of which are read.
    progress : called at intervals with the number of poses read so far.

    Raises
    ------
    ChoiceError
        The topic does not exist or cannot be used.
    """
    poses = Poses.join(list(log.batches()))
    if not len(poses):
        return None, "", ()
    wrench_log = read_wrenches(path, topic, log.source, poses, log.stamping.by_log_time)
    return evidence_of(wrench_log, topic, poses, model, known_map, progress)


def evidence_of(
    wrench_log: WrenchLog,
    name: str,
    poses: Poses,
    model: Model,
    known_map: Map,
    progress: Callable[[int], None] | None = None,
) -> RecordedEvidence:
    """Evidence of the wrenches of a log, as ``recorded_evidence``; messages call them ``name``."""
    noted = f"; {wrench_log.noted}" if wrench_log.noted else ""
    try:
        evidence, load = wrench_evidence(poses, wrench_log.wrenches, model, known_map, progress)
    except NoLoad as reason:
        return None, "", (f"{name} is not used: {reason}{noted}",)
    text = (
        f"{len(wrench_log.wrenches)} wrenches {wrench_log.taken}{noted}; "
        f"the hand carries {load.mass_kg:.3f} kg, by {load.ticks:.0f} ticks of free motion"
    )
    return (evidence, "", (text,)) if noted else (evidence, text, ())


def evidence_as_given(
    wrenches: Wrenches, name: str, poses: Poses, model: Model, known_map: Map
) -> RecordedEvidence:
    """Evidence of wrenches about the body's origin, in its axes, as ``evidence_of``."""
    valid = wrenches.valid
    wrench_log = WrenchLog(valid, len(wrenches) - len(valid), 0, 0, "", "as given")
    return evidence_of(wrench_log, name, poses, model, known_map)


def wrench_evidence(
    poses: Poses,
    wrenches: Wrenches,
    model: Model,
    known_map: Map = EMPTY_MAP,
    progress: Callable[[int], None] | None = None,
) -> tuple[WrenchEvidence, Load]:
    """Evidence of the wrenches of the hand on the object for its contacts, in a whole recording.

    Parameters
    ----------
    poses : all of them, validated.
    wrenches : about the body's origin, in its axes, on the clock of the poses.
    progress : called at intervals with the number of poses read so far.

    Raises
    ------
    NoLoad
        Wrenches and poses do not overlap, there is too little free motion to determine the load, or no load
        explains the wrenches.
    """
    by_motion = OfflineTracker(model, known_map, uses_map=False)
    result = Segmentation.join(list(by_motion.pieces(poses, progress, Detail.WEIGHTS)))
    beliefs, column = result.beliefs, Contact.FREE.column
    is_free, p_free = beliefs.rows["contact"] == column, beliefs.probability[:, column]
    ticks, load = require_load(poses, wrenches.valid, result.stamp_ns, is_free, p_free)
    return WrenchEvidence(ticks, load), load
