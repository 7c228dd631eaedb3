"""Runs in which a further contact holds: a two-state hidden Markov model (docs/theory.md, T37)."""

from math import log
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AT_FIRST: Final = 0.1
"""Probability that it is present when the first contact begins."""


class Run(NamedTuple):
    """Ticks ``first`` to ``end`` (excluded) in which a contact holds."""

    first: int
    end: int

    def overlaps(self, other: "Run") -> bool:
        """Whether the runs share a tick."""
        return self.first < other.end and other.first < self.end


class Presence(NamedTuple):
    """The most probable ``runs``, and their log odds (nats) against no run."""

    runs: tuple[Run, ...]
    log_odds: float


def most_probable(log_ratio: Array, log_change: Array) -> Presence:
    """Viterbi path over the states absent and present.

    Parameters
    ----------
    log_ratio : (W,) evidence of each tick for the contact.
    log_change : (W,) log probability that it begins or ends right before a tick.
    """
    absent, present = log(1.0 - AT_FIRST), log(AT_FIRST)
    came_from_present, came_from_absent = [], []  # of absent, of present
    stays = np.log1p(-np.exp(log_change)).tolist()
    none = absent + float(np.sum(stays[1:]))
    for tick, (ratio, change, stay) in enumerate(
        zip(log_ratio.tolist(), log_change.tolist(), stays, strict=True)
    ):
        left = joined = False
        if tick:
            left, joined = present + change > absent + stay, absent + change > present + stay
            absent, present = (
                present + change if left else absent + stay,
                absent + change if joined else present + stay,
            )
        present += ratio
        came_from_present.append(left)
        came_from_absent.append(joined)
    best = max(absent, present)
    return Presence(_runs(present >= absent, came_from_present, came_from_absent), best - none)


def _runs(is_present: bool, came_from_present: list[bool], came_from_absent: list[bool]) -> tuple[Run, ...]:
    """The runs of the path that ends in the state ``is_present``, by backtracking."""
    runs, end = list[Run](), len(came_from_present)
    for tick in range(len(came_from_present) - 1, -1, -1):
        if is_present and came_from_absent[tick]:
            runs.append(Run(tick, end))
            is_present = False
        elif not is_present and came_from_present[tick]:
            end, is_present = tick, True
    if is_present:
        runs.append(Run(0, end))
    return tuple(reversed(runs))
