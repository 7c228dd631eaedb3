"""What of a recording is scored: the weight of each frame, its truth, and the true changes.

Nothing here knows what was believed. A frame weighs the time until the next one, at most 0.1 s, so that
neither irregular rates nor dropouts distort a figure. Frames without truth (``?``) are not scored.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.truth import Truth

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

LONGEST_FRAME_NS: Final = 100_000_000
NEAR_CHANGE_NS: Final = 250_000_000
SHORTEST_PHASE_NS: Final = 300_000_000
UNSCORED: Final = -1


class Subset(IntEnum):
    """Which frames an accuracy is taken over; the value is the row in ``Scoring.subsets``."""

    ALL = 0
    """every scored frame"""
    CLEAR = 1
    """those more than 0.25 s from a true change"""
    IDENTIFIABLE = 2
    """those whose motion can tell the contact: neither singular nor at rest before the first motion"""
    AMBIGUOUS = 3
    """the others: singular, or at rest before the first motion"""
    MOVED = 4
    """those after the first motion: the rest at the start left out"""


@dataclass(frozen=True)
class Change:
    """A true change between two phases that each last 0.3 s or more; all but ``into`` are frame indices.

    The change happened in one of the frames ``earliest`` to ``onset``: they differ where unscored frames
    lie between the phases. The old phase begins at ``begin``, the new one covers ``onset`` to ``end``
    (excluded) and has the state's column ``into``.
    """

    begin: int
    earliest: int
    onset: int
    end: int
    into: int


@dataclass(frozen=True, eq=False)
class Scoring:
    """What is scored of N frames.

    Parameters
    ----------
    stamp_ns : (N,) strictly increasing.
    end_ns : (N,) when the frame ends: the next frame's stamp; the last one is as long as the one before.
    seconds : (N,) weight.
    truth : (N,) column of the true state, ``UNSCORED`` where there is none.
    subsets : (5, N) which frames each ``Subset`` takes.
    changes : the true changes in order.
    """

    stamp_ns: Ints
    end_ns: Ints
    seconds: Array
    truth: Ints
    subsets: Bools
    changes: tuple[Change, ...]

    def within(self, subset: Subset) -> "Scoring":
        """Only the frames of ``subset``, and the changes after which they come."""
        taken = self.subsets[subset]
        changes = tuple(change for change in self.changes if taken[change.onset])
        return replace(self, subsets=self.subsets & taken, changes=changes)


def scoring(stamp_ns: Ints, truth: Truth) -> Scoring:
    """Lay ``truth`` over the frames at ``stamp_ns`` (N,); frames outside all intervals are not scored."""
    intervals = truth.intervals
    index = truth.at(stamp_ns)
    ends = np.array([i.end_ns for i in intervals], np.int64)
    columns = np.array([UNSCORED if i.contact is None else i.contact.column for i in intervals], np.int64)
    moved = np.logical_or.accumulate(np.array([i.motion != "rest" for i in intervals], bool))
    ambiguous = np.array([i.singular for i in intervals], bool) | ~moved

    inside = index >= 0
    inside[inside] = stamp_ns[inside] <= ends[index[inside]]
    column = np.full(len(stamp_ns), UNSCORED, np.int64)
    column[inside] = columns[index[inside]]
    end_ns = _frame_ends(stamp_ns)
    runs = _runs(stamp_ns, column)

    scored = column != UNSCORED
    subsets = np.zeros((len(Subset), len(stamp_ns)), bool)
    subsets[Subset.ALL] = scored
    subsets[Subset.CLEAR] = scored & ~_near_change(stamp_ns, column, runs)
    subsets[Subset.AMBIGUOUS, inside] = ambiguous[index[inside]]
    subsets[Subset.AMBIGUOUS] &= scored
    subsets[Subset.IDENTIFIABLE] = scored & ~subsets[Subset.AMBIGUOUS]
    subsets[Subset.MOVED, inside] = moved[index[inside]]
    subsets[Subset.MOVED] &= scored
    seconds = np.minimum(end_ns - stamp_ns, LONGEST_FRAME_NS) * 1e-9
    return Scoring(stamp_ns, end_ns, seconds, column, subsets, _changes(stamp_ns, end_ns, column, runs))


def tick_containing(frame_ns: Ints, tick_ns: Ints) -> Ints:
    """Offline: for each frame the tick that contains it, the first not before it; -1 after the last tick."""
    tick = np.searchsorted(tick_ns, frame_ns, side="left")
    return np.where(tick == len(tick_ns), -1, tick)


def tick_in_force(frame_ns: Ints, tick_ns: Ints) -> Ints:
    """Online: for each frame the latest tick reported by then; -1 before the first report."""
    return np.searchsorted(tick_ns, frame_ns, side="right") - 1


def _frame_ends(stamp_ns: Ints) -> Ints:
    if len(stamp_ns) < 2:
        return stamp_ns
    return np.append(stamp_ns[1:], 2 * stamp_ns[-1] - stamp_ns[-2])


def _runs(stamp_ns: Ints, column: Ints) -> list[tuple[int, int]]:
    """First and last frame of each phase: one state, its scored frames never more than 0.3 s apart."""
    scored = np.flatnonzero(column != UNSCORED)
    if len(scored) == 0:
        return []
    differs = np.diff(column[scored]) != 0
    apart = np.diff(stamp_ns[scored]) > SHORTEST_PHASE_NS
    split = np.flatnonzero(differs | apart)
    first, last = scored[np.append(0, split + 1)], scored[np.append(split, -1)]
    return list(zip(first.tolist(), last.tolist(), strict=True))


def _near_change(stamp_ns: Ints, column: Ints, runs: list[tuple[int, int]]) -> Bools:
    near = np.zeros(len(stamp_ns), bool)
    for (_, last), (onset, _) in pairwise(runs):
        if column[last] != column[onset]:
            from_ns, until_ns = stamp_ns[last + 1] - NEAR_CHANGE_NS, stamp_ns[onset] + NEAR_CHANGE_NS
            near[np.searchsorted(stamp_ns, from_ns) : np.searchsorted(stamp_ns, until_ns, side="right")] = (
                True
            )
    return near


def _changes(stamp_ns: Ints, end_ns: Ints, column: Ints, runs: list[tuple[int, int]]) -> tuple[Change, ...]:
    """The changes whose time is known: both phases long enough, not more than 0.3 s between them."""
    return tuple(
        Change(begin, last + 1, onset, final + 1, int(column[onset]))
        for (begin, last), (onset, final) in pairwise(runs)
        if column[last] != column[onset]
        and end_ns[last] - stamp_ns[begin] >= SHORTEST_PHASE_NS
        and end_ns[final] - stamp_ns[onset] >= SHORTEST_PHASE_NS
        and stamp_ns[onset] - stamp_ns[last] <= SHORTEST_PHASE_NS
    )
