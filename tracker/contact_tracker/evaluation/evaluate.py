"""One recording judged: what ``evaluate`` and the benchmark compute."""

from dataclasses import dataclass

import numpy as np

from contact_tracker.evaluation.geometry_errors import GeometryErrors, geometry_errors
from contact_tracker.evaluation.metrics import Ints, Tally, tally
from contact_tracker.evaluation.scoring import Scoring, scoring, tick_containing, tick_in_force
from contact_tracker.poses import Poses
from contact_tracker.segmentation import Beliefs, Segmentation
from contact_tracker.truth import Truth


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Of one recording, or (``a + b``) of several: offline and online against the same truth.

    Offline is the Viterbi label and the smoothed posterior, a frame taking the belief of the tick that
    contains it. Online is what had been reported at the frame's time: the latest belief not after it.
    The geometry is that of the offline segments.
    """

    offline: Tally
    online: Tally
    geometry: GeometryErrors

    def __add__(self, other: "Evaluation") -> "Evaluation":
        return Evaluation(
            self.offline + other.offline, self.online + other.online, self.geometry + other.geometry
        )


def evaluate(poses: Poses, truth: Truth, segmentation: Segmentation) -> Evaluation:
    """Judge ``segmentation`` of ``poses`` (at least one) by ``truth``.

    Raises
    ------
    NoTruth
        The truth's elements are not of the kinds that its contact has.
    """
    scored = scoring(poses.stamp_ns, truth)
    offline = tick_containing(poses.stamp_ns, segmentation.beliefs.stamp_ns)
    online = tick_in_force(poses.stamp_ns, segmentation.filtered.stamp_ns)
    return Evaluation(
        _tally(scored, offline, segmentation.beliefs),
        _tally(scored, online, segmentation.filtered),
        geometry_errors(poses, truth, segmentation.segments),
    )


def _tally(scored: Scoring, tick: Ints, beliefs: Beliefs) -> Tally:
    return tally(scored, tick, beliefs.rows["contact"].astype(np.int64), beliefs.probability)
