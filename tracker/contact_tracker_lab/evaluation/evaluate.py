"""Evaluation of a segmentation, and of the answers of ``live``, against the ground truth of a recording."""

from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import add
from typing import Any, NamedTuple

import numpy as np

from contact_tracker.arrays import Bools, Ints
from contact_tracker.config.parameters import Model
from contact_tracker.ground_truth import Truth
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.pose_validation import Arrival, PoseGate
from contact_tracker.motion.poses import AS_GIVEN, Pose, Poses, ReadAs
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker_lab.evaluation.geometry_errors import GeometryErrors, geometry_errors
from contact_tracker_lab.evaluation.metrics import Tally, tally
from contact_tracker_lab.evaluation.scoring import Scoring, scoring, tick_containing, tick_in_force


class Answers(NamedTuple):
    """Online ``beliefs`` in their order, and the time of the stream (T,) at which each was given out: later
    than its stamp by the time for which poses are held back, and the wait of a tick for its last pose."""

    beliefs: Beliefs
    arrival_ns: Ints


def answers_to(
    arrivals: Iterable[Arrival],
    model: Model,
    known_map: Map = EMPTY_MAP,
    read_as: ReadAs = AS_GIVEN,
    lag_s: float = 0.0,
) -> Answers:
    """The answers to a stream, tracked online; ``read_as``: how its poses were read, as the user asked."""
    tracker, parts, arrival_ns = Tracker.start(model, lag_s, known_map, read_as), list[Beliefs](), array("q")

    def note(beliefs: list[Belief], time_ns: int | None) -> None:
        if beliefs:
            parts.append(Beliefs.of(beliefs))
            arrival_ns.extend([time_ns or beliefs[-1].stamp_ns] * len(beliefs))

    for arrival in arrivals:
        note(tracker.update(arrival, Detail.SHARED), arrival.time_ns)
    note(tracker.finish(), tracker.last_ns)
    return Answers(Beliefs.join(parts), np.array(arrival_ns, np.int64))


def gated(poses: Iterable[Pose]) -> Iterator[Arrival]:
    """The stream of ``poses`` as measured, passed through the gate one by one."""
    gate = PoseGate()
    yield from map(gate.arrive, poses)
    yield gate.end()


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Scores of one recording, or (``a + b``) of several: offline and online against the same truth.

    Offline: the Viterbi label and the smoothed posterior; each frame has the belief of the tick that contains
    it. Online: each frame has the latest belief up to its stamp. By arrival, if the answers of a stream are
    given: the latest belief that had been given out by then. The geometry is that of the offline segments.
    """

    offline: Tally
    online: Tally
    arrival: Tally | None
    geometry: GeometryErrors

    def __add__(self, evaluation: "Evaluation") -> "Evaluation":
        pairs = zip(vars(self).values(), vars(evaluation).values(), strict=True)
        sums: list[Any] = [None if None in pair else add(*pair) for pair in pairs]
        return Evaluation(*sums)


def evaluate(
    poses: Poses, truth: Truth, segmentation: Segmentation, answers: Answers | None = None
) -> Evaluation:
    """Evaluate ``segmentation`` of ``poses`` (at least one), and the ``answers`` in their order, against
    ``truth``.

    Raises
    ------
    NoTruth
        The truth's elements are not of the kinds that its contact has.
    """
    geometry = geometry_errors(poses, truth, segmentation.segments)
    scored = scoring(poses.stamp_ns, truth)
    offline, online = segmentation.beliefs, segmentation.filtered
    ends = [segment.end_ns for segment in segmentation.segments]
    are_open = np.array([*(bool(segment.inseparable) for segment in segmentation.segments), False])
    is_open = are_open[np.searchsorted(ends, offline.stamp_ns)]
    contains = tick_containing(scored.stamp_ns, offline.stamp_ns)
    in_force = tick_in_force(scored.stamp_ns, online.stamp_ns)
    arrival = None
    if answers is not None:
        arrival = _tally(scored, tick_in_force(scored.stamp_ns, answers.arrival_ns), answers.beliefs)
    tallies = _tally(scored, contains, offline, is_open), _tally(scored, in_force, online)
    return Evaluation(*tallies, arrival, geometry)


def _tally(scored: Scoring, tick: Ints, beliefs: Beliefs, is_open: Bools | None = None) -> Tally:
    """The tally of T beliefs; ``is_open`` (T,) of their segments, else as they say."""
    opens = np.asarray(beliefs.rows["inseparable"].any(axis=1)) if is_open is None else is_open
    return tally(scored, tick, beliefs.rows["contact"], beliefs.probability, opens)
