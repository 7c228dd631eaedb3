"""Evaluation of a segmentation against the ground truth of its recording."""

from array import array
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.pose_buffer import PoseBuffer
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker_lab.evaluation.answers import Answers
from contact_tracker_lab.evaluation.further import FurtherScore, FurtherTicks
from contact_tracker_lab.evaluation.geometry_errors import GeometryErrors, geometry_errors
from contact_tracker_lab.evaluation.metrics import Ints, Tally
from contact_tracker_lab.evaluation.scoring import Scoring, scoring, tick_containing, tick_in_force
from contact_tracker_lab.evaluation.tallying import tally

_SCORED: Final = np.dtype([("stamp_ns", np.int64), ("contact", np.int8), ("probability", np.float64, 7)])
BeliefRows = NDArray[np.void]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Of one recording, or (``a + b``) of several: offline and online against the same truth.

    Offline: the Viterbi label and the smoothed posterior; each frame has the belief of the tick that
    contains it. Online: each frame has the latest belief up to its stamp. By arrival, if the answers of a
    stream are given: the latest belief that had been given out by then. The geometry is that of the offline
    segments. Further contacts have scores of their own, online only where beliefs have them
    (``Detail.FORMATION``).
    """

    offline: Tally
    online: Tally
    arrival: Tally | None
    geometry: GeometryErrors
    further_offline: FurtherScore
    further_online: FurtherScore

    def __add__(self, other: "Evaluation") -> "Evaluation":
        return Evaluation(
            self.offline + other.offline,
            self.online + other.online,
            None if self.arrival is None or other.arrival is None else self.arrival + other.arrival,
            self.geometry + other.geometry,
            self.further_offline + other.further_offline,
            self.further_online + other.further_online,
        )


def evaluate(
    poses: Poses, truth: Truth, segmentation: Segmentation, answers: Answers | None = None
) -> Evaluation:
    """Evaluate ``segmentation`` of ``poses`` (at least one) against ``truth``, and the ``answers`` to them as
    they came.

    Raises
    ------
    NoTruth
        The truth's elements are not of the kinds that its contact has.
    """
    evaluator = Evaluator(truth)
    evaluator.add_poses(poses)
    evaluator.add_piece(segmentation)
    return evaluator.finish(answers)


class Evaluator:
    """Evaluates a recording piece by piece, in 8 bytes for each pose and 150 for each tick.

    The geometry is compared as soon as the segments within a true contact are final. If that contact has more
    poses than ``pose_buffer.LIMIT``, an evenly thinned subset is used.

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
        self._segments: list[Segment] = []  # that may overlap true contacts not compared yet
        self._pose_buffer = PoseBuffer()  # likewise

    @property
    def frames(self) -> int:
        """Number of poses so far."""
        return len(self._stamp_ns)

    def add_poses(self, poses: Poses) -> None:
        """Add the next poses, before the piece that covers them."""
        self._stamp_ns.frombytes(poses.stamp_ns.tobytes())
        self._pose_buffer.extend(poses)

    def add_piece(self, found: Segmentation) -> None:
        """Add the next piece of the segmentation."""
        self._offline.append(_belief_rows(found.beliefs))
        self._online.append(_belief_rows(found.filtered))
        self._further_offline.add(found.beliefs)
        self._further_online.add(found.filtered)
        if found.segments:
            self._segments += found.segments
            self._compare(found.segments[-1].end_ns)

    def finish(self, answers: Answers | None = None) -> Evaluation:
        """The evaluation of the whole recording, which must have poses."""
        while self._true:
            self._compare_next()
        scored = scoring(np.frombuffer(self._stamp_ns, np.int64), self._truth)
        self._stamp_ns, stamp_ns = array("q"), scored.stamp_ns  # frees the second copy
        offline, online = _joined(self._offline), _joined(self._online)
        contains = tick_containing(stamp_ns, offline["stamp_ns"])
        in_force = tick_in_force(stamp_ns, online["stamp_ns"])
        return Evaluation(
            _tally(scored, contains, offline),
            _tally(scored, in_force, online),
            None if answers is None else _tally_by_arrival(scored, answers),
            self._geometry,
            self._further_offline.score(scored, self._truth, contains, offline["contact"]),
            self._further_online.score(scored, self._truth, in_force, online["contact"]),
        )

    def _compare(self, until_ns: int) -> None:
        while self._true and max(i.end_ns for i in self._true[0]) < until_ns:
            self._compare_next()
        since_ns = self._true[0][0].start_ns if self._true else until_ns
        self._segments = [segment for segment in self._segments if segment.end_ns >= since_ns]
        self._pose_buffer.drop(int(np.searchsorted(self._pose_buffer.poses.stamp_ns, since_ns)))

    def _compare_next(self) -> None:
        truth = Truth(self._true.popleft())
        self._geometry += geometry_errors(self._pose_buffer.poses, truth, self._segments)


def _groups(truth: Truth) -> Iterator[tuple[TruthInterval, ...]]:
    """Groups of successive intervals of one contact, which may be one true segment."""
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
    """The columns that are scored."""
    rows = np.empty(len(beliefs), _SCORED)
    for name in _SCORED.names or ():
        rows[name] = beliefs.rows[name]
    return rows


def _joined(parts: list[BeliefRows]) -> BeliefRows:
    """Concatenate the parts, and clear the list."""
    whole = np.concatenate([np.empty(0, _SCORED), *parts])
    parts.clear()
    return whole


def _tally_by_arrival(scored: Scoring, answers: Answers) -> Tally:
    rows = _belief_rows(answers.beliefs)
    return _tally(scored, tick_in_force(scored.stamp_ns, answers.arrival_ns), rows)


def _tally(scored: Scoring, tick: Ints, beliefs: BeliefRows) -> Tally:
    return tally(scored, tick, beliefs["contact"], beliefs["probability"])
