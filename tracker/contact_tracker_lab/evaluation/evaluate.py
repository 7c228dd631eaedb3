"""Evaluation of a segmentation, and of the answers of ``live``, against the ground truth of a recording."""

from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise, permutations
from operator import add
from typing import Any, Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Bools, Ints
from contact_tracker.config.parameters import Model
from contact_tracker.ground_truth import Truth
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.pose_validation import Arrival, PoseGate
from contact_tracker.motion.poses import AS_GIVEN, Pose, Poses, ReadAs
from contact_tracker.states import STATES, Contact
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker_lab.evaluation.geometry_errors import GeometryErrors, geometry_errors
from contact_tracker_lab.evaluation.metrics import Tally, ratio, tally
from contact_tracker_lab.evaluation.scoring import Scoring, Subset, scoring, tick_containing, tick_in_force


class Answers(NamedTuple):
    """Online ``beliefs`` in their order, and the time of the stream (T,) at which each was given out: later
    than its stamp by the time for which poses are held back, and the wait of a tick for its last pose."""

    beliefs: Beliefs
    arrival_ns: Ints


class Answering:
    """Tracks a stream online while it passes through.

    Parameters
    ----------
    read_as : how poses were read, as the user asked.
    """

    def __init__(
        self, model: Model, known_map: Map = EMPTY_MAP, read_as: ReadAs = AS_GIVEN, lag_s: float = 0.0
    ) -> None:
        self._tracker = Tracker.start(model, lag_s, known_map, read_as)
        self._parts: list[Beliefs] = []
        self._arrival_ns = array("q")

    def through(self, arrivals: Iterable[Arrival]) -> Iterator[Pose]:
        """The poses of the stream, after they were tracked."""
        for arrival in arrivals:
            self._note(self._tracker.update(arrival, Detail.SHARED), arrival.time_ns)
            yield from arrival.poses

    def finish(self) -> Answers:
        """All answers, at the end of the stream."""
        self._note(self._tracker.finish(), self._tracker.last_ns)
        return Answers(Beliefs.join(self._parts), np.array(self._arrival_ns, np.int64))

    def _note(self, beliefs: list[Belief], time_ns: int | None) -> None:
        if beliefs:
            self._parts.append(Beliefs.of(beliefs))
            self._arrival_ns.extend([time_ns or beliefs[-1].stamp_ns] * len(beliefs))


def answers_to(
    poses: Iterable[Pose], model: Model, known_map: Map = EMPTY_MAP, lag_s: float = 0.0
) -> Answers:
    """The answers to ``poses`` as measured, passed through the gate one by one."""
    gate, answering = PoseGate(), Answering(model, known_map, lag_s=lag_s)

    def arrivals() -> Iterator[Arrival]:
        yield from map(gate.arrive, poses)
        yield gate.end()

    for _ in answering.through(arrivals()):
        pass
    return answering.finish()


NONE: Final = -1
"""Index for no tick, or no label."""
Kinds = tuple[tuple[Contact, ...], ...]
"""The kind of each further contact, and those that the motion does not distinguish from it."""


@dataclass(frozen=True)
class FurtherScore:
    """Score of one recording or (``a + b``) of several, in scored seconds.

    Parameters
    ----------
    several_s : several contacts hold.
    right_s : part of ``several_s`` with exactly the true kinds reported.
    open_s : part of ``several_s`` with a true kind only reported as inseparable from a further contact.
    alone_s : one contact holds, or none.
    false_s : part of ``alone_s`` with a further contact reported.
    """

    several_s: float = 0.0
    right_s: float = 0.0
    open_s: float = 0.0
    alone_s: float = 0.0
    false_s: float = 0.0

    def __add__(self, score: "FurtherScore") -> "FurtherScore":
        return FurtherScore(*map(add, vars(self).values(), vars(score).values()))

    @property
    def right(self) -> float:
        """Share of the time with several contacts in which exactly these are reported, or nan."""
        return ratio(self.right_s, self.several_s)

    @property
    def open(self) -> float:
        """Share of this time in which a true kind is only reported as inseparable."""
        return ratio(self.open_s, self.several_s)

    @property
    def false(self) -> float:
        """Share of the time without a further contact in which one is reported, or nan."""
        return ratio(self.false_s, self.alone_s)


def score_further(scored: Scoring, truth: Truth, tick: Ints, beliefs: Beliefs) -> FurtherScore:
    """Compare the further contacts of T ``beliefs`` with the truth.

    Parameters
    ----------
    scored, truth : of N frames.
    tick : (N,) index of the belief that holds at each frame, -1 where there is none.
    """
    kinds = [tuple((c.contact, *c.inseparable) for c in further) for further in beliefs.formations]
    number_of = np.append(beliefs.rows["further"], NONE)[tick]
    labelled = np.append(beliefs.rows["contact"], NONE)[tick]
    total = FurtherScore()
    for true, frames in _true_sets(scored, truth):
        cells = np.stack([number_of[frames], labelled[frames]], axis=1)
        reported, cell = np.unique(cells, axis=0, return_inverse=True)
        seconds = np.bincount(cell.ravel(), scored.seconds[frames], len(reported)).tolist()
        for (number, column), reported_s in zip(reported.tolist(), seconds, strict=True):
            first = () if column == NONE else (STATES[column],)
            total += _score(true, first, () if number == NONE else kinds[number], reported_s)
    return total


def _true_sets(scored: Scoring, truth: Truth) -> Iterator[tuple[tuple[Contact, ...], Ints]]:
    """The true sets of contacts, the first one and further ones, with the indices of their scored frames."""
    stamp_ns = scored.stamp_ns
    bounds = np.searchsorted(truth.at(stamp_ns), np.arange(len(truth.intervals) + 1))
    for interval, (begin, end) in zip(truth.intervals, pairwise(bounds.tolist()), strict=True):
        frames = begin + np.flatnonzero(scored.subsets[Subset.ALL, begin:end])
        if interval.contact is None or not len(frames):
            continue
        frame_ns = stamp_ns[frames]
        holds = np.array([(c.start_ns <= frame_ns) & (frame_ns <= c.end_ns) for c in interval.further], bool)
        holds = holds.reshape(len(interval.further), len(frames)).T
        for present in np.unique(holds, axis=0):
            contacts = [interval.further[number].contact for number in np.flatnonzero(present)]
            yield (interval.contact, *contacts), frames[(holds == present).all(axis=1)]


def _score(
    true: tuple[Contact, ...], label: tuple[Contact, ...], further: Kinds, seconds: float
) -> FurtherScore:
    """Score of frames with one reported set of contacts; ``label`` is empty where there is no belief."""
    if len(true) == 1:
        return FurtherScore(alone_s=seconds, false_s=seconds if further else 0.0)
    first = tuple((contact,) for contact in label)
    is_right = _matches(true, (*first, *((kinds[0],) for kinds in further)))
    is_open = not is_right and _matches(true, (*first, *further))
    return FurtherScore(seconds, seconds * is_right, seconds * is_open)


def _matches(true: tuple[Contact, ...], reported: Kinds) -> bool:
    """Whether true and reported contacts can be assigned to each other one to one."""
    if len(true) != len(reported):
        return False
    pairings = (zip(order, reported, strict=True) for order in permutations(true))
    return any(all(contact in kinds for contact, kinds in pairing) for pairing in pairings)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Scores of one recording, or (``a + b``) of several: offline and online against the same truth.

    Offline: the Viterbi label and the smoothed posterior; each frame has the belief of the tick that contains
    it. Online: each frame has the latest belief up to its stamp. By arrival, if the answers of a stream are
    given: the latest belief that had been given out by then. The geometry is that of the offline segments.
    Further contacts have their own scores, online only where beliefs have them (``Detail.FORMATION``).
    """

    offline: Tally
    online: Tally
    arrival: Tally | None
    geometry: GeometryErrors
    further_offline: FurtherScore
    further_online: FurtherScore

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
    further = (score_further(scored, truth, *mode) for mode in ((contains, offline), (in_force, online)))
    tallies = _tally(scored, contains, offline, is_open), _tally(scored, in_force, online)
    return Evaluation(*tallies, arrival, geometry, *further)


def _tally(scored: Scoring, tick: Ints, beliefs: Beliefs, is_open: Bools | None = None) -> Tally:
    """The tally of T beliefs; ``is_open`` (T,) of their segments, else as they say."""
    opens = np.asarray(beliefs.rows["inseparable"].any(axis=1)) if is_open is None else is_open
    return tally(scored, tick, beliefs.rows["contact"], beliefs.probability, opens)
