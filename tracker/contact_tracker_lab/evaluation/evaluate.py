"""Evaluation of a segmentation against the ground truth of its recording."""

from dataclasses import dataclass

from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Poses
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker_lab.evaluation.answers import Answers
from contact_tracker_lab.evaluation.further import FurtherScore, score_further
from contact_tracker_lab.evaluation.geometry_errors import GeometryErrors, geometry_errors
from contact_tracker_lab.evaluation.metrics import Ints, Tally, tally
from contact_tracker_lab.evaluation.scoring import Scoring, scoring, tick_containing, tick_in_force


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
    geometry = geometry_errors(poses, truth, segmentation.segments)
    scored = scoring(poses.stamp_ns, truth)
    offline, online = segmentation.beliefs, segmentation.filtered
    contains = tick_containing(scored.stamp_ns, offline.stamp_ns)
    in_force = tick_in_force(scored.stamp_ns, online.stamp_ns)
    arrival = None
    if answers is not None:
        arrival = _tally(scored, tick_in_force(scored.stamp_ns, answers.arrival_ns), answers.beliefs)
    return Evaluation(
        _tally(scored, contains, offline),
        _tally(scored, in_force, online),
        arrival,
        geometry,
        score_further(scored, truth, contains, offline),
        score_further(scored, truth, in_force, online),
    )


def _tally(scored: Scoring, tick: Ints, beliefs: Beliefs) -> Tally:
    return tally(scored, tick, beliefs.rows["contact"], beliefs.probability)
