"""Input and output of the update of the hypothesis banks by a tick."""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.pruning import Births
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class LiveHypotheses(NamedTuple):
    """The hypotheses (A,) of all banks after a tick, free motion last."""

    state: Index
    onset: Index
    log_likelihood: Array

    @classmethod
    def of(cls, banks: Sequence[Bank], now: int) -> Self:
        """The hypotheses of ``banks``, and free motion in the tick ``now``."""
        return cls(
            np.arange(len(banks) + 1).repeat([*map(len, banks), 1]),
            np.append(Bank.of_all(banks, "onset"), now),
            np.append(Bank.of_all(banks, "log_likelihood"), 0.0),
        )

    def held(self, now: int) -> Self:
        """The same hypotheses in the tick ``now``, which carries no information."""
        onset = self.onset.copy()
        onset[-1] = now
        return self._replace(onset=onset)


class TickInput(NamedTuple):
    """Input of the update by one tick."""

    births: Births
    """Hypotheses that begin with the tick."""
    window: Window
    """The latest ticks, this one included."""
    before: Window
    """The window before this tick."""
    log_survival: Array
    """(7,) log probabilities of staying in each state through it."""


class TickWeights(NamedTuple):
    """Weights of states and hypotheses after a tick."""

    log_birth_weight: Array
    """(7,) log birth weight of each state."""
    log_state_weight: Array
    """(7,) log weight of each state relative to the best hypothesis; -inf for an empty bank."""
    residual: Array
    """(6,) whitened residual of each contact."""
    best_rows: Index
    """(6,) row of the best hypothesis of each bank; -1 for an empty one."""
    live_hypotheses: LiveHypotheses
