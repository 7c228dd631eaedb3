"""Labels and posteriors of a method for a recording, and their scores with confidence intervals.

Intervals are from a bootstrap over the true phases: frames of one phase are right or wrong together, so whole
phases are resampled, with replacement.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.motion.poses import Poses
from contact_tracker.states import STATES
from contact_tracker_lab.evaluation.metrics import Tally, tally
from contact_tracker_lab.evaluation.scoring import Scoring, Subset

OFFLINE: Final = math.inf
RESAMPLES: Final = 1000
BAND: Final = (0.05, 0.95)


class Method(NamedTuple):
    """A method and its lag: ``wait_s`` after the frame, infinite at the end of the recording.

    Without ``has_posterior`` it gives labels only.
    """

    name: str
    wait_s: float
    has_posterior: bool = True

    @property
    def when(self) -> str:
        """The lag in words."""
        if self.wait_s == OFFLINE:
            return "offline"
        return f"lag {self.wait_s:g} s" if self.wait_s else "online"


class Answer(NamedTuple):
    """Index ``tick`` (N,) of the tick of each frame (-1: none), ``label`` (T,) and ``probability`` (T, 7)."""

    tick: Ints
    label: Ints
    probability: Array

    @classmethod
    def most_probable(cls, tick: Ints, probability: Array) -> "Answer":
        """With the most probable states as labels."""
        return cls(tick, probability.argmax(axis=1).astype(np.int64), probability)

    @classmethod
    def certain(cls, tick: Ints, label: Ints) -> "Answer":
        """With probability 1 for the labels."""
        return cls(tick, label, np.eye(len(STATES))[label])


@dataclass(frozen=True, eq=False)
class Score:
    """Score of one recording or (``a + b``) of several, on identifiable frames: not singular, nor at rest
    before any motion. ``main``: their tally; ``phase_s`` (Q, 2): seconds of each of Q true phases, and those
    with the right label."""

    main: Tally
    phase_s: Array

    def __add__(self, score: "Score") -> "Score":
        return Score(self.main + score.main, np.concatenate([self.phase_s, score.phase_s]))

    @classmethod
    def of(cls, answer: Answer, scored: Scoring) -> "Score":
        """Score an answer for all frames of a recording."""
        clear = scored.within(Subset.IDENTIFIABLE)
        clear_frames = clear.subsets[Subset.ALL]
        run = np.cumsum(np.append(0, np.diff(clear.truth) != 0))  # in each run one state lasts
        phase = np.unique(run[clear_frames], return_inverse=True)[1]
        right = np.append(answer.label, -1)[answer.tick[clear_frames]] == clear.truth[clear_frames]
        seconds = clear.seconds[clear_frames]
        phase_s = np.array([np.bincount(phase, weights) for weights in (seconds, seconds * right)], float)
        return cls(tally(clear, *answer), phase_s.T)

    def band(self) -> tuple[float, float]:
        """The quantiles ``BAND`` of the share of the time with the right label; nan without phases."""
        count = len(self.phase_s)
        if not count:
            return math.nan, math.nan
        drawn = np.random.default_rng(0).multinomial(count, np.full(count, 1.0 / count), RESAMPLES)
        seconds, right_s = (drawn @ self.phase_s).T
        is_scored = seconds > 0
        low, high = np.quantile(right_s[is_scored] / seconds[is_scored], BAND)
        return float(low), float(high)


Labelling = Callable[[Poses], Answer]
"""A method that needs no training: the answer for each of N poses."""
Scores = dict[Method, Score]
