"""Offline: as much of a recording as decides on ticks and noise, then all of it with these."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import replace
from itertools import chain
from typing import Final

import numpy as np

from contact_tracker.adaptation import online
from contact_tracker.adaptation.mixture import spread_out
from contact_tracker.adaptation.report import Report, report
from contact_tracker.config.parameters import Model
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.motion.pose_validation import require_valid
from contact_tracker.motion.poses import Pose, Poses, batches
from contact_tracker.tracking import offline_smoother
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.wrenches.contact_evidence import WrenchEvidence

MOST_POSES: Final = 1_000_000
"""After so many the best model so far is taken: poses are kept in memory meanwhile."""
INITIAL_AUTOCORRELATION: Final = 0.5
"""Offline, the prediction errors of free motion are taken to be correlated until they are known: nearly as
much as in any recorded motion, so that smooth free motion at the start is not taken for a contact. Online
that would delay labels; and where wrenches are measured, these show whether anything touches at the start."""


class OfflineTracker:
    """Segments one recording piece by piece; afterwards ``report`` says what it was adapted to."""

    def __init__(
        self,
        model: Model,
        knowledge: PriorMap = EMPTY_MAP,
        executor: Executor | None = None,
        wrenches: WrenchEvidence | None = None,
    ) -> None:
        self._knowledge = knowledge
        self._wrenches = wrenches
        self._executor = executor
        self._state = online.start(model, knowledge=knowledge)

    @property
    def report(self) -> Report | None:
        """None of a recording without poses."""
        return report(self._state)

    def pieces(
        self,
        poses: Iterable[Pose],
        progress: Callable[[int], None] | None = None,
        detail: Detail = Detail.SHARED,
    ) -> Iterator[Segmentation]:
        """As ``offline_smoother.pieces``; ``detail`` is that of the beliefs that are ``filtered``.

        Raises
        ------
        InvalidPose
            While iterating, where poses did not pass the gate.
        """
        looked_at, rest, early = self._choose(_valid(batches(poses)), detail)
        best = self._state.best
        if best is None:
            yield Segmentation()
            return
        everything = _Stream(chain(looked_at, self._inspected(rest)))
        others = self._knowledge, self._executor, None, detail, self._wrenches
        may_begin_free = self._wrenches is None or self._wrenches.begins_free()
        model = _cautious_at_first(best.model) if may_begin_free else best.model
        found = offline_smoother.pieces(everything, model, progress, *others)
        waiting = early  # beliefs from before the model was chosen
        for piece in found:
            count = min(len(waiting), len(piece.filtered))
            said, waiting = waiting[:count], waiting[count:]
            piece = replace(piece, filtered=piece.filtered[count:])
            if self._state.is_in_doubt:
                piece = _doubted(piece)
            yield replace(piece, filtered=Beliefs.join([said, piece.filtered]))

    def _inspected(self, stream: Iterator[Poses]) -> Iterator[Poses]:
        """Poses on their way, looked at and compared with what is given."""
        for poses in stream:
            self._state = online.compare(online.look_at(self._state, poses), poses)
            yield poses

    def _choose(
        self, stream: Iterator[Poses], detail: Detail
    ) -> tuple[Iterator[Poses], Iterator[Poses], Beliefs]:
        """Poses until the model is chosen, the rest, and the online beliefs until then, if they have enough
        ``detail``."""
        looked_at, beliefs, count = list[Poses](), list[Beliefs](), 0
        for some in stream:
            used = 0
            while used < len(some) and not self._state.is_decided:
                part = some[used : used + online.TOGETHER]
                self._state, said = online.advance(self._state, part, detail)
                beliefs.append(_kept(said, detail))
                used += len(part)
            looked_at.append(some[:used])
            count += used
            if self._state.is_decided or count >= MOST_POSES:
                stream = chain([some[used:]] if used < len(some) else [], stream)
                break
        else:
            self._state, said = online.finish(self._state)
            beliefs.append(_kept(said, detail))
        return _released(looked_at), stream, Beliefs.join(beliefs)


def _kept(said: list[Belief], detail: Detail) -> Beliefs:
    """The beliefs in columns, if detailed enough: it may take hours until the model is chosen."""
    return Beliefs.of(said if detail >= Detail.SHARED else ())


def _cautious_at_first(model: Model) -> Model:
    assumed = max(model.motion.initial_autocorrelation, INITIAL_AUTOCORRELATION)
    return replace(model, motion=replace(model.motion, initial_autocorrelation=assumed))


def _valid(stream: Iterator[Poses]) -> Iterator[Poses]:
    """Poses on their way, checked."""
    last_ns: int | None = None
    for poses in stream:
        if len(poses):
            require_valid(poses, last_ns)
            last_ns = int(poses.stamp_ns[-1])
        yield poses


def _doubted(piece: Segmentation) -> Segmentation:
    """Of which nothing is sure."""
    return replace(
        piece,
        segments=tuple(
            replace(one, probability=float(spread_out(np.array(one.probability)))) for one in piece.segments
        ),
        beliefs=piece.beliefs.with_probability(spread_out(piece.beliefs.probability)),
        filtered=piece.filtered.with_probability(spread_out(piece.filtered.probability)),
    )


class _Stream:
    """Poses in columns, as ``poses.Batched``."""

    def __init__(self, columns: Iterator[Poses]) -> None:
        self._columns = columns

    def batches(self) -> Iterator[Poses]:
        return self._columns

    def __iter__(self) -> Iterator[Pose]:
        return (pose for some in self._columns for pose in some)


def _released(parts: list[Poses]) -> Iterator[Poses]:
    """Each once, and then no longer kept."""
    parts.reverse()
    while parts:
        yield parts.pop()


def segment(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    knowledge: PriorMap = EMPTY_MAP,
) -> Segmentation:
    """Segment a whole recording, as ``offline_smoother.segment`` does, adapted to its stream.

    Raises
    ------
    InvalidPose
        Poses that did not pass the gate: take ``gate`` of ``motion.pose_validation`` first.
    """
    found = OfflineTracker(model, knowledge).pieces(poses, progress, Detail.GEOMETRY)
    return Segmentation.join(list(found))
