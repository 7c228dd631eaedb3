"""Counts of the transitions between true states."""

from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.config.parameters import TransitionCounts
from contact_tracker.states import STATES
from contact_tracker.tracking.transition_model import REST_EXPOSURE
from contact_tracker_lab.evaluation.scoring import UNSCORED

LONGEST_UNKNOWN_S: Final = 1.0
"""Longer times without truth (s) separate the states before and after them."""


class Counts(NamedTuple):
    """Counts of one recording or several: ``begins`` (7,), ``moving_s`` (7,) and ``changes`` (7, 7), as in
    ``TransitionCounts``."""

    begins: Array
    moving_s: Array
    changes: Array

    @property
    def rounded(self) -> TransitionCounts:
        """The counts as they are in a file."""
        begins, moving_s, changes = (np.round(part, 2).tolist() for part in self)
        return TransitionCounts(tuple(begins), tuple(moving_s), tuple(map(tuple, changes)))


def count_transitions(label: Ints, activity: Array, tick_s: float) -> Counts:
    """Counts of the columns ``label`` (T,) of the true states, with ``activity`` (T,) in ticks of motion.

    A change is in the middle of a tick, or of a time without truth of at most ``LONGEST_UNKNOWN_S``.
    """
    moved_s = tick_s * np.maximum(activity, REST_EXPOSURE)
    known = np.flatnonzero(label != UNSCORED)
    counts = Counts(*(np.zeros(shape) for shape in (len(STATES), len(STATES), (len(STATES), len(STATES)))))
    longest = LONGEST_UNKNOWN_S / tick_s  # number of ticks
    if len(known) and known[0] <= longest:
        counts.begins[label[known[0]]] = 1.0
    for first, last in pairwise(known.tolist()):
        if last - first - 1 <= longest:
            before, after = int(label[first]), int(label[last])
            shared_s = 0.5 * float(moved_s[first + 1 : last + 1].sum())
            counts.moving_s[before] += shared_s
            counts.moving_s[after] += shared_s if before == after or last - first > 1 else 0.0
            counts.changes[before, after] += before != after
    return counts
