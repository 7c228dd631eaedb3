"""One recording judged: what ``evaluate`` and the benchmark compute."""

from dataclasses import dataclass

import numpy as np

from contact_tracker.belief import Belief, Segmentation
from contact_tracker.evaluation.geometry_errors import GeometryErrors, geometry_errors
from contact_tracker.evaluation.metrics import Ints, Tally, tally
from contact_tracker.evaluation.scoring import Scoring, scoring, tick_containing, tick_in_force
from contact_tracker.labels import STATES
from contact_tracker.poses import Poses
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
    offline = tick_containing(poses.stamp_ns, _stamps(segmentation.beliefs))
    online = tick_in_force(poses.stamp_ns, _stamps(segmentation.filtered))
    return Evaluation(
        _tally(scored, offline, segmentation.beliefs),
        _tally(scored, online, segmentation.filtered),
        geometry_errors(poses, truth, segmentation.segments),
    )


def _stamps(beliefs: tuple[Belief, ...]) -> Ints:
    return np.array([b.stamp_ns for b in beliefs], np.int64)


def _tally(scored: Scoring, tick: Ints, beliefs: tuple[Belief, ...]) -> Tally:
    label = np.array([b.contact.column for b in beliefs], np.int64)
    probability = np.array([b.probability for b in beliefs], float).reshape(-1, len(STATES))
    return tally(scored, tick, label, probability)
