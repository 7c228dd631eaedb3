"""What a method answers about a recording, and how that scores."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.evaluation.metrics import Tally
from contact_tracker.evaluation.scoring import Scoring, Subset
from contact_tracker.evaluation.tallying import tally
from contact_tracker.states import STATES
from resampling import Phases

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

OFFLINE: Final = math.inf
LAGS_S: Final = (1.0, 0.5)


class Method(NamedTuple):
    """Who answers, and when: ``wait_s`` after the frame, infinite at the end of the recording.

    One that does not ``believe`` gives labels without probabilities.
    """

    name: str
    wait_s: float
    believes: bool = True

    @property
    def when(self) -> str:
        """The wait in words."""
        if self.wait_s == OFFLINE:
            return "offline"
        return f"lag {self.wait_s:g} s" if self.wait_s else "online"


class Answer(NamedTuple):
    """``tick`` (N,) that holds at each frame (-1: no answer), ``label`` (T,) and ``probability`` (T, 7)."""

    tick: Ints
    label: Ints
    probability: Array

    @classmethod
    def most_probable(cls, tick: Ints, probability: Array) -> "Answer":
        """The label is the most probable state."""
        return cls(tick, probability.argmax(axis=1).astype(np.int64), probability)

    @classmethod
    def certain(cls, tick: Ints, label: Ints) -> "Answer":
        """Only labels."""
        return cls(tick, label, np.eye(len(STATES))[label])


@dataclass(frozen=True, eq=False)
class Score:
    """Tallies of what can be told, and ``apart`` of what cannot: singular, or at rest before any motion.

    ``phases`` of what can be told, for the intervals.
    """

    main: Tally
    apart: Tally
    phases: Phases

    def __add__(self, other: "Score") -> "Score":
        return Score(self.main + other.main, self.apart + other.apart, self.phases + other.phases)

    @classmethod
    def of(cls, answer: Answer, scored: Scoring) -> "Score":
        """Score an answer about all frames of a recording."""
        told, untold = (scored.within(s) for s in (Subset.IDENTIFIABLE, Subset.AMBIGUOUS))
        return cls(tally(told, *answer), tally(untold, *answer), Phases.of(told, *answer))


Scores = dict[Method, Score]
