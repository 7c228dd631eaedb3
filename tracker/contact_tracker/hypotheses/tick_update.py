"""What goes into the update of the hypothesis banks by a tick, and what comes of it."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.pruning import Births
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class LiveHypotheses(NamedTuple):
    """The hypotheses (A,) that are alive after a tick, free motion last."""

    state: Index
    onset: Index
    log_likelihood: Array

    @classmethod
    def of(cls, banks: Sequence[Bank], now: int) -> Self:
        """Those of all banks, and free motion in the tick ``now``."""
        return cls(
            np.arange(len(banks) + 1).repeat([*map(len, banks), 1]),
            np.append(Bank.of_all(banks, "onset"), now),
            np.append(Bank.of_all(banks, "log_likelihood"), 0.0),
        )


class TickInput(NamedTuple):
    """A tick, as the hypotheses of all contacts are updated by it."""

    births: Births
    """What begins with it."""
    stamp_ns: int
    """When it ends."""
    window: Window
    """The last ticks, this one included."""
    before: Window
    """The window without it."""
    log_transition: Array
    """(7, 7) log chances of a change of state at its beginning, from row to column."""
    log_survival: Array
    """(7,) log chances of lasting through it."""


class TickWeights(NamedTuple):
    """What a tick has made of the hypotheses."""

    log_birth_weight: Array
    """(7,) log weights with which states began."""
    log_state_weight: Array
    """(7,) log weight of each state against the best hypothesis, -inf of an empty bank."""
    residual: Array
    """(6,) whitened residual of each contact."""
    best_rows: Index
    """(6,) the best hypothesis in each bank, -1 of an empty one."""
    live_hypotheses: LiveHypotheses


class StopCondition(NamedTuple):
    """When the posterior has to be looked at: one contact is so probable, and its onset is not due later."""

    probability: float
    posterior_power: float
    """The posterior counts to this power (T31)."""
    due_ns: Mapping[int, int]
    """By onset (ns), when it may be looked at again."""


class BankUpdate(NamedTuple):
    """The hypotheses that are kept after one or several ticks."""

    banks: list[Bank]
    """Of each contact."""
    tick_weights: list[TickWeights]
    """Of each tick."""
