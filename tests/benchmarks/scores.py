"""Labels and posteriors of a method for a recording, and their scores."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.states import STATES
from contact_tracker_lab.evaluation.metrics import Tally, tally
from contact_tracker_lab.evaluation.scoring import Scoring, Subset
from resampling import Phases

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

OFFLINE: Final = math.inf
LAGS_S: Final = (1.0, 0.5)


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
    """Tallies of identifiable frames, and ``apart`` of the others: singular, or at rest before any motion.

    ``phases`` are those of identifiable frames, for confidence intervals.
    """

    main: Tally
    apart: Tally
    phases: Phases

    def __add__(self, other: "Score") -> "Score":
        return Score(self.main + other.main, self.apart + other.apart, self.phases + other.phases)

    @classmethod
    def of(cls, answer: Answer, scored: Scoring) -> "Score":
        """Score an answer for all frames of a recording."""
        clear, ambiguous = (scored.within(s) for s in (Subset.IDENTIFIABLE, Subset.AMBIGUOUS))
        return cls(tally(clear, *answer), tally(ambiguous, *answer), Phases.of(clear, *answer))


Scores = dict[Method, Score]
