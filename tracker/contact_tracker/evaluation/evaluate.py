"""One recording judged: what ``evaluate`` and the benchmark compute."""

from array import array
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.evaluation.further import FurtherScore, FurtherTicks
from contact_tracker.evaluation.geometry_errors import GeometryErrors, geometry_errors
from contact_tracker.evaluation.metrics import Ints, Tally
from contact_tracker.evaluation.scoring import Scoring, scoring, tick_containing, tick_in_force
from contact_tracker.evaluation.tallying import tally
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.pose_buffer import Waiting
from contact_tracker.tracking.segmentation import Beliefs, Segmentation

_JUDGED: Final = np.dtype([("stamp_ns", np.int64), ("contact", np.int8), ("probability", np.float64, 7)])
BeliefRows = NDArray[np.void]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Of one recording, or (``a + b``) of several: offline and online against the same truth.

    Offline is the Viterbi label and the smoothed posterior, a frame taking the belief of the tick that
    contains it. Online is what had been reported at the frame's time: the latest belief not after it.
    The geometry is that of the offline segments. Contacts beside the first are scored by themselves,
    online as far as beliefs tell them (``Detail.FORMATION``).
    """

    offline: Tally
    online: Tally
    geometry: GeometryErrors
    further_offline: FurtherScore
    further_online: FurtherScore

    def __add__(self, other: "Evaluation") -> "Evaluation":
        return Evaluation(
            self.offline + other.offline,
            self.online + other.online,
            self.geometry + other.geometry,
            self.further_offline + other.further_offline,
            self.further_online + other.further_online,
        )


def evaluate(poses: Poses, truth: Truth, segmentation: Segmentation) -> Evaluation:
    """Judge ``segmentation`` of ``poses`` (at least one) by ``truth``.

    Raises
    ------
    NoTruth
        The truth's elements are not of the kinds that its contact has.
    """
    judge = Judge(truth)
    judge.poses(poses)
    judge.piece(segmentation)
    return judge.finish()


class Judge:
    """Judges a recording piece by piece. Of each pose it keeps 8 bytes, of each tick 150.

    The geometry is compared as soon as the segments of a true contact are concluded. Where that lasts for
    more poses than ``pose_buffer.LIMIT``, some of them stand for all.

    Raises
    ------
    NoTruth
        The truth's elements are not of the kinds that its contact has.
    """

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._stamp_ns = array("q")
        self._offline: list[BeliefRows] = []
        self._online: list[BeliefRows] = []
        self._further_offline, self._further_online = FurtherTicks(), FurtherTicks()
        self._geometry = geometry_errors(Poses.collect([]), truth, ())
        self._true = deque(_groups(truth))
        self._segments: list[Segment] = []  # those that may lie in what is not yet compared
        self._waiting = Waiting()  # as well

    @property
    def frames(self) -> int:
        """How many poses there were."""
        return len(self._stamp_ns)

    def poses(self, poses: Poses) -> None:
        """The next poses, before the piece that is about them."""
        self._stamp_ns.frombytes(poses.stamp_ns.tobytes())
        self._waiting.extend(poses)

    def piece(self, found: Segmentation) -> None:
        """What was concluded next."""
        self._offline.append(_belief_rows(found.beliefs))
        self._online.append(_belief_rows(found.filtered))
        self._further_offline.add(found.beliefs)
        self._further_online.add(found.filtered)
        if found.segments:
            self._segments += found.segments
            self._compare(found.segments[-1].end_ns)

    def finish(self) -> Evaluation:
        """Of the whole; there must have been poses."""
        while self._true:
            self._compare_next()
        scored = scoring(np.frombuffer(self._stamp_ns, np.int64), self._truth)
        self._stamp_ns, stamp_ns = array("q"), scored.stamp_ns  # not twice
        offline, online = _joined(self._offline), _joined(self._online)
        contains = tick_containing(stamp_ns, offline["stamp_ns"])
        in_force = tick_in_force(stamp_ns, online["stamp_ns"])
        return Evaluation(
            _tally(scored, contains, offline),
            _tally(scored, in_force, online),
            self._geometry,
            self._further_offline.score(scored, self._truth, contains, offline["contact"]),
            self._further_online.score(scored, self._truth, in_force, online["contact"]),
        )

    def _compare(self, until_ns: int) -> None:
        while self._true and max(i.end_ns for i in self._true[0]) < until_ns:
            self._compare_next()
        since_ns = self._true[0][0].start_ns if self._true else until_ns
        self._segments = [segment for segment in self._segments if segment.end_ns >= since_ns]
        self._waiting.drop(int(np.searchsorted(self._waiting.poses.stamp_ns, since_ns)))

    def _compare_next(self) -> None:
        truth = Truth(self._true.popleft())
        self._geometry += geometry_errors(self._waiting.poses, truth, self._segments)


def _groups(truth: Truth) -> Iterator[tuple[TruthInterval, ...]]:
    """Intervals that may be one true segment, each group for itself: of one contact, one after the other."""
    group: list[TruthInterval] = []
    for interval in truth.intervals:
        if group and (interval.geometry is None or interval.contact is not group[-1].contact):
            yield tuple(group)
            group = []
        if interval.geometry is not None:
            group.append(interval)
    if group:
        yield tuple(group)


def _belief_rows(beliefs: Beliefs) -> BeliefRows:
    """The columns that are judged."""
    beliefs_of_ticks = np.empty(len(beliefs), _JUDGED)
    for name in _JUDGED.names or ():
        beliefs_of_ticks[name] = beliefs.rows[name]
    return beliefs_of_ticks


def _joined(parts: list[BeliefRows]) -> BeliefRows:
    """Concatenate the parts, which are cleared."""
    whole = np.concatenate([np.empty(0, _JUDGED), *parts])
    parts.clear()
    return whole


def _tally(scored: Scoring, tick: Ints, beliefs_of_ticks: BeliefRows) -> Tally:
    return tally(scored, tick, beliefs_of_ticks["contact"], beliefs_of_ticks["probability"])
