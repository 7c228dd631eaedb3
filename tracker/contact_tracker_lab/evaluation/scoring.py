"""The scored frames of a recording: their weights, true states, and the true changes.

They are independent of beliefs. The weight of a frame is the time until the next one, at most 0.1 s, so that
neither irregular rates nor dropouts distort a figure. Frames without truth (``?``) are not scored.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.ground_truth import CoarseLabel, Truth
from contact_tracker.states import STATES

Columns = NDArray[np.int8]

LONGEST_FRAME_NS: Final = 100_000_000
NEAR_CHANGE_NS: Final = 250_000_000
SHORTEST_PHASE_NS: Final = 300_000_000
UNSCORED: Final = -1


class Subset(IntEnum):
    """Subsets of the scored frames; the value is the row in ``Scoring.subsets``. If it is not known how the
    object moved, all frames count as identifiable."""

    ALL = 0
    """every scored frame"""
    CLEAR = 1
    """those more than 0.25 s from a true change"""
    IDENTIFIABLE = 2
    """those whose motion determines the contact: neither singular nor at rest before the first motion"""
    AMBIGUOUS = 3
    """the others: singular, or at rest before the first motion"""
    MOVED = 4
    """those after the first motion: the rest at the start left out"""


@dataclass(frozen=True)
class Change:
    """A true change between two phases that each last 0.3 s or more; all but ``into`` are frame indices.

    The change is in one of the frames ``earliest`` to ``onset``, which differ if there are unscored frames
    between the phases. The old phase begins at ``begin``; the new one is ``onset`` to ``end`` (excluded), in
    the state or coarse label with the column ``into``.
    """

    begin: int
    earliest: int
    onset: int
    end: int
    into: int


@dataclass(frozen=True, eq=False)
class Scoring:
    """Scored frames among N, in 14 bytes for each.

    Parameters
    ----------
    edges_ns : (N + 1,) their stamps, strictly increasing, and the end of the last, as long as the one before.
    truth : (N,) column of the true state, or, from 7 on, index of a coarse label; ``UNSCORED`` where there is
        neither.
    subsets : (5, N) membership of the frames in each ``Subset``.
    changes : the true changes in order.
    coarse : the coarse labels of the truth.
    """

    edges_ns: Ints
    truth: Columns
    subsets: Bools
    changes: tuple[Change, ...]
    coarse: tuple[CoarseLabel, ...] = ()

    @property
    def stamp_ns(self) -> Ints:
        """Stamps (N,) of the frames."""
        return self.edges_ns[:-1]

    @property
    def end_ns(self) -> Ints:
        """Ends (N,) of the frames, each the stamp of the next one."""
        return self.edges_ns[1:]

    @property
    def seconds(self) -> Array:
        """Weight (N,) of each frame."""
        return np.asarray(np.minimum(self.end_ns - self.stamp_ns, LONGEST_FRAME_NS) * 1e-9)

    def part(self, frames: slice) -> "Scoring":
        """Only consecutive ``frames``, without changes."""
        edges_ns = self.edges_ns[frames.start : frames.stop + 1]
        return Scoring(edges_ns, self.truth[frames], self.subsets[:, frames], (), self.coarse)

    def within(self, subset: Subset) -> "Scoring":
        """Only the frames of ``subset``, and the changes whose onset is among them."""
        members = self.subsets[subset]
        changes = tuple(change for change in self.changes if members[change.onset])
        return replace(self, subsets=self.subsets & members, changes=changes)


def scoring(stamp_ns: Ints, truth: Truth) -> Scoring:
    """Assign ``truth`` to the frames at ``stamp_ns`` (N,); frames outside all intervals are not scored."""
    column = np.full(len(stamp_ns), UNSCORED, np.int8)
    subsets = np.zeros((len(Subset), len(stamp_ns)), bool)
    moved = False
    first = np.searchsorted(stamp_ns, [interval.start_ns for interval in truth.intervals])
    end = np.searchsorted(stamp_ns, [interval.end_ns for interval in truth.intervals], side="right")
    later = np.append(first[1:], len(stamp_ns))  # frames in two intervals belong to the later
    for interval, *ends in zip(truth.intervals, first, np.minimum(end, later), strict=True):
        frames = slice(*ends)
        moved |= interval.motion != "rest"
        if interval.contact is not None or interval.coarse is not None:
            state, coarse = interval.contact, interval.coarse
            column[frames] = len(STATES) + truth.coarse.index(coarse) if state is None else state.column
            if interval.motion is not None:
                subsets[Subset.MOVED, frames] = moved
                subsets[Subset.AMBIGUOUS, frames] = interval.singular or not moved
    subsets[Subset.ALL] = column != UNSCORED
    subsets[Subset.IDENTIFIABLE] = subsets[Subset.ALL] & ~subsets[Subset.AMBIGUOUS]
    subsets[Subset.CLEAR] = subsets[Subset.ALL]
    runs = _runs(stamp_ns, column)
    for (_, last), (onset, _) in pairwise(runs):
        if column[last] != column[onset]:
            begin = np.searchsorted(stamp_ns, stamp_ns[last + 1] - NEAR_CHANGE_NS)
            end = np.searchsorted(stamp_ns, stamp_ns[onset] + NEAR_CHANGE_NS, side="right")
            subsets[Subset.CLEAR, begin:end] = False
    end_ns = 2 * stamp_ns[-1:] - stamp_ns[-2:-1] if len(stamp_ns) > 1 else stamp_ns
    edges_ns = np.append(stamp_ns, end_ns)
    return Scoring(edges_ns, column, subsets, _changes(edges_ns, column, runs), truth.coarse)


def tick_containing(frame_ns: Ints, tick_ns: Ints) -> Ints:
    """Offline: index of the first tick that ends at or after each frame; -1 after the last tick."""
    tick = np.searchsorted(tick_ns, frame_ns, side="left")
    tick[tick == len(tick_ns)] = -1
    return tick


def tick_in_force(frame_ns: Ints, tick_ns: Ints) -> Ints:
    """Online: index of the latest tick reported at each frame; -1 before the first."""
    return np.searchsorted(tick_ns, frame_ns, side="right") - 1


def _runs(stamp_ns: Ints, column: Columns) -> list[tuple[int, int]]:
    """First and last frame of each phase: one state, its scored frames never more than 0.3 s apart."""
    if len(stamp_ns) == 0:
        return []
    split = np.flatnonzero((np.diff(column) != 0) | (np.diff(stamp_ns) > SHORTEST_PHASE_NS))
    runs: list[tuple[int, int]] = []
    for first, last in zip([0, *(split + 1).tolist()], [*split.tolist(), len(stamp_ns) - 1], strict=True):
        if column[first] == UNSCORED:
            continue
        begin, previous = runs[-1] if runs else (first, None)
        is_same = previous is not None and column[previous] == column[first]
        if is_same and stamp_ns[first] - stamp_ns[previous] <= SHORTEST_PHASE_NS:
            runs[-1] = begin, last
        else:
            runs.append((first, last))
    return runs


def _changes(edges_ns: Ints, column: Columns, runs: list[tuple[int, int]]) -> tuple[Change, ...]:
    """The changes at known times: both phases are long enough, with at most 0.3 s between them."""
    stamp_ns, end_ns = edges_ns[:-1], edges_ns[1:]
    return tuple(
        Change(begin, last + 1, onset, final + 1, int(column[onset]))
        for (begin, last), (onset, final) in pairwise(runs)
        if column[last] != column[onset]
        and end_ns[last] - stamp_ns[begin] >= SHORTEST_PHASE_NS
        and end_ns[final] - stamp_ns[onset] >= SHORTEST_PHASE_NS
        and stamp_ns[onset] - stamp_ns[last] <= SHORTEST_PHASE_NS
    )
