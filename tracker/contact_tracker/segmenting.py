"""Segments a recording: ticks and noise are chosen on its first part, then it is gone over as a whole."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import replace
from itertools import chain, compress
from typing import Final

import numpy as np

from contact_tracker.checks.map_use import FaceNameDelay
from contact_tracker.config.parameters import Model
from contact_tracker.geometry.elements import Array
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.pose_validation import require_valid
from contact_tracker.motion.poses import AS_GIVEN, NO_OUTLIERS, Batched, Pose, Poses, ReadAs, batches
from contact_tracker.motion.sensor_noise import independent_point
from contact_tracker.states import STATES, Contact
from contact_tracker.tracker import BATCH_POSES, Tracker
from contact_tracker.tracking.belief import Belief, Detail, Segment
from contact_tracker.tracking.contact_filter import ContactFilter, ticks_of
from contact_tracker.tracking.filter_bank import (
    Report,
    map_findings,
    map_use,
    mixed_with_uniform,
    period_for_all_s,
)
from contact_tracker.tracking.map_passes import with_map
from contact_tracker.tracking.offline_smoother import PassRecord, Segmenter, pieces
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.wrenches.contact_evidence import WrenchEvidence

AHEAD_POSES: Final = 100_000
"""Number of poses whose periods decide the ticks; they are kept in memory until then."""
MOST_POSES: Final = 1_000_000
"""Number of poses after which the best model so far is chosen; until then all are kept in memory."""
INITIAL_AUTOCORRELATION: Final = 0.5
"""Autocorrelation of the prediction errors of free motion, offline, until it is estimated: nearly that of any
recorded motion, so that smooth free motion at the start is not confused with contact. Online it would delay
labels; it is not needed where a wrench shows a contact force at the start."""


class OfflineTracker:
    """Segments one recording piece by piece; ``report`` then has the chosen ticks and noise, ``outliers`` the
    number of poses left out.

    ``read_as``: how the poses were read, as the user asked. ``uses_map``: whether a map of the recording is
    made, and passes with it follow the first one where neither elements nor wrenches are given.
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
        self._has_passes = uses_map and not known_map.lists_elements and wrenches is None
        self._record = PassRecord(keeps_ticks=self._has_passes) if uses_map else None
        self.outliers = NO_OUTLIERS

    def pieces(
        self,
        poses: Iterable[Pose] | Batched,
        progress: Callable[[int], None] | None = None,
        detail: Detail = Detail.SHARED,
    ) -> Iterator[Segmentation]:
        """As ``offline_smoother.pieces``, but in one piece at the end where passes with a map may follow;
        ``detail`` is that of the ``filtered`` beliefs.

        Raises
        ------
        InvalidPose
            While iterating, where poses did not pass the gate.
        """
        stream = self._with_usual_period(_validated(batches(poses)))  # ticks that suit the whole recording
        stream, early = self._choose_noise(stream, detail)  # by the tracker, on the first part
        if self._tracker.best is None:
            yield Segmentation()
            return
        one = ContactFilter.start(self._model, known_map=self._known_map)
        ticks = ticks_of(stream, self._model, progress, self._tracker.filters.body_m)
        segmenter = Segmenter(self._executor, self._wrenches, self._record)
        found = pieces(ticks, one, segmenter, detail)  # filter, smooth, decode, fit each segment
        if self._record is not None and self._has_passes:
            found = with_map(found, self._record, self._executor)  # again with its map until that stands
        yield from self._checked(found, early)

    @property
    def map(self) -> GrowingMap | None:
        """The elements that the contacts have touched; None if the recording has no poses."""
        return None if self._record is None else self._record.map

    @property
    def report(self) -> Report | None:
        """None if the recording has no poses."""
        found = self._tracker.report
        if found is None or self._record is None or self._record.state is None or not self._has_passes:
            return found
        others = (one for one in found.findings if one.kind != "map")
        world = self._record.state.map
        findings = (*others, *map_findings(world))
        return found._replace(
            findings=findings, map_use=map_use((self.map if world.prior else None) or world)
        )

    @property
    def _model(self) -> Model:
        """The chosen model."""
        assert self._tracker.best is not None
        model = self._tracker.best.model
        may_begin_free = self._wrenches is None or not self._wrenches.shows_contact_at_start()
        return _with_initial_autocorrelation(model) if may_begin_free else model

    def _with_usual_period(self, stream: Iterator[Poses]) -> Iterator[Poses]:
        """The same stream, after the ticks and the tracked point have been chosen by its first
        ``AHEAD_POSES``."""
        ahead = _read_ahead(stream)
        if ahead:
            filters = self._tracker.filters
            first = Poses.join(ahead)
            filters.period_s = period_for_all_s(first.stamp_ns, filters.model)
            if self._wrenches is None:  # moments are about the body's origin
                filters.body_m = independent_point(first)
        return chain(_released(ahead), stream)

    def _choose_noise(self, stream: Iterator[Poses], detail: Detail) -> tuple[Iterator[Poses], Beliefs]:
        """The stream from its beginning, which is read until the model is chosen, and the online beliefs
        until then, if ``detail`` is enough. The conventions of the poses are tested on as many as that
        takes."""
        tracker = self._tracker
        inspected, ahead, beliefs, count = list[Poses](), list[Poses](), list[Beliefs](), 0
        for some in stream:
            used = 0
            while used < len(some) and not tracker.is_decided:
                part = some[used : used + BATCH_POSES]
                beliefs.append(_in_columns(tracker.add(part, detail), detail))
                used += len(part)
            tracker.inspect_added()  # what follows is inspected without the filters
            inspected.append(some[:used])
            count += len(some)
            if used < len(some):
                tracker.check("conventions", some[used:])
                ahead.append(some[used:])
            is_known = tracker.is_decided and tracker.checks.conventions.is_settled
            if is_known or count >= MOST_POSES:
                break
        if not tracker.is_decided and count < MOST_POSES:
            beliefs.append(_in_columns(tracker.finish(), detail))
        rest = self._inspected(chain(_released(ahead), stream))
        return chain(_released(inspected), rest), Beliefs.join(beliefs)

    def _inspected(self, stream: Iterator[Poses]) -> Iterator[Poses]:
        """Pass poses on, after inspection and the test of the map."""
        for poses in stream:
            self._tracker.inspect_poses(poses)
            self._tracker.check("contradiction", poses)
            yield poses

    def _checked(self, found: Iterator[Segmentation], early: Beliefs) -> Iterator[Segmentation]:
        """The pieces after the checks of segments, with the ``early`` online beliefs instead of their own."""
        waiting = FaceNameDelay(self._known_map)
        for piece in found:
            count = min(len(early), len(piece.filtered))
            reported, early = early[:count], early[count:]
            self.outliers = self.outliers.joined(piece.outliers)
            piece = replace(piece, filtered=piece.filtered[count:])
            self._tracker.check_segments(piece.segments)
            if self._tracker.is_in_doubt:
                piece = _in_doubt(piece, self._known_map.allowed)
            piece = replace(piece, filtered=Beliefs.join([reported, piece.filtered]))
            yield from waiting.release(piece, self._tracker.checks.map_use)
        yield from waiting.finish(self._tracker.checks.map_use)


def _read_ahead(stream: Iterator[Poses]) -> list[Poses]:
    """The first ``AHEAD_POSES`` poses."""
    ahead, count = list[Poses](), 0
    for some in stream:
        ahead.append(some)
        count += len(some)
        if count >= AHEAD_POSES:
            break
    return ahead


def _in_columns(beliefs: list[Belief], detail: Detail) -> Beliefs:
    """The beliefs in columns, to save memory, as the choice may take hours; none if ``detail`` is too low."""
    return Beliefs.of(beliefs if detail >= Detail.SHARED else ())


def _with_initial_autocorrelation(model: Model) -> Model:
    assumed = max(model.motion.initial_autocorrelation, INITIAL_AUTOCORRELATION)
    return replace(model, motion=replace(model.motion, initial_autocorrelation=assumed))


def _validated(stream: Iterator[Poses]) -> Iterator[Poses]:
    """Pass poses on if they are valid."""
    last_ns: int | None = None
    for poses in stream:
        if len(poses):
            require_valid(poses, last_ns)
            last_ns = int(poses.stamp_ns[-1])
        yield poses


def _in_doubt(piece: Segmentation, possible: tuple[Contact, ...]) -> Segmentation:
    """The piece with its probabilities mixed with uniform ones, and its contacts open: the motion, as it was
    read, tells nothing for sure."""
    states = np.array([state is Contact.FREE or state in possible for state in STATES])

    def mixed(probability: Array) -> Array:
        return mixed_with_uniform(probability, possible)

    def doubted(one: Segment) -> Segment:
        at_label = np.full(len(STATES), one.probability)
        others = tuple(state for state in compress(STATES, states) if state is not one.contact)
        return replace(one, probability=float(mixed(at_label)[one.contact.column]), inseparable=others)

    return replace(
        piece,
        segments=tuple(map(doubted, piece.segments)),
        beliefs=piece.beliefs.with_probability(mixed(piece.beliefs.probability), states),
        filtered=piece.filtered.with_probability(mixed(piece.filtered.probability)),
    )


def _released(parts: list[Poses]) -> Iterator[Poses]:
    """Yield each part and drop it, to free its memory."""
    parts.reverse()
    while parts:
        yield parts.pop()


def segment(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    known_map: Map = EMPTY_MAP,
) -> Segmentation:
    """Segment a whole recording, as ``offline_smoother.segment``, adapted to its stream.

    Raises
    ------
    InvalidPose
        Poses that did not pass the gate: apply ``gate`` of ``motion.pose_validation`` first.
    """
    found = OfflineTracker(model, known_map).pieces(poses, progress, Detail.GEOMETRY)
    return Segmentation.join(list(found))
