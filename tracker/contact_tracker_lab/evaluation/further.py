"""Scores of further contacts: the reported set of contacts against the true one."""

from collections.abc import Iterator
from dataclasses import astuple, dataclass
from itertools import pairwise, permutations
from operator import add
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.ground_truth import Truth
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.segmentation import Beliefs
from contact_tracker_lab.evaluation.scoring import Scoring, Subset

Ints = NDArray[np.int64]

NONE: Final = -1
"""Index of no tick, or of no label."""
Kinds = tuple[tuple[Contact, ...], ...]
"""For each further contact its kind, and those that the motion does not distinguish from it."""


@dataclass(frozen=True)
class FurtherScore:
    """Of one recording or (``a + b``) of several, in scored seconds.

    Parameters
    ----------
    several_s : several contacts hold.
    right_s : of these, with exactly the true kinds reported.
    open_s : of these, with the true kind of a further contact only reported as inseparable from it.
    alone_s : one contact holds, or none.
    false_s : of these, with a further contact reported.
    """

    several_s: float = 0.0
    right_s: float = 0.0
    open_s: float = 0.0
    alone_s: float = 0.0
    false_s: float = 0.0

    def __add__(self, other: "FurtherScore") -> "FurtherScore":
        return FurtherScore(*map(add, astuple(self), astuple(other)))

    @property
    def right(self) -> float:
        """Share of the time with several contacts in which exactly these are reported; nan without."""
        return self.right_s / self.several_s if self.several_s else float("nan")

    @property
    def open(self) -> float:
        """Share of that time in which a true kind is only reported as inseparable."""
        return self.open_s / self.several_s if self.several_s else float("nan")

    @property
    def false(self) -> float:
        """Share of the time without a further contact in which one is reported; nan without."""
        return self.false_s / self.alone_s if self.alone_s else float("nan")


def score_further(scored: Scoring, truth: Truth, tick: Ints, beliefs: Beliefs) -> FurtherScore:
    """Compare the further contacts of T ``beliefs`` with the truth.

    Parameters
    ----------
    scored, truth : of N frames.
    tick : (N,) index of the belief that holds at each frame, -1 where there is none.
    """
    kinds = [tuple((one.contact, *one.inseparable) for one in further) for further in beliefs.formations]
    found = np.append(beliefs.rows["further"], NONE)[tick]
    labelled = np.append(beliefs.rows["contact"], NONE)[tick]
    total = FurtherScore()
    for true, frames in _true_sets(scored, truth):
        cells = np.stack([found[frames], labelled[frames]], axis=1)
        for (number, column), seconds in _summed(cells, scored.seconds[frames]):
            first = () if column == NONE else (STATES[column],)
            total += _score(true, first, () if number == NONE else kinds[number], seconds)
    return total


class _TrueSet(NamedTuple):
    """The true contacts: the first and the further ones."""

    first: Contact
    further: tuple[Contact, ...]


def _true_sets(scored: Scoring, truth: Truth) -> Iterator[tuple[_TrueSet, Ints]]:
    """The true sets of contacts, each with the indices of its scored frames."""
    stamp_ns = scored.stamp_ns
    bounds = np.searchsorted(truth.at(stamp_ns), np.arange(len(truth.intervals) + 1))
    for interval, (begin, end) in zip(truth.intervals, pairwise(bounds.tolist()), strict=True):
        frames = begin + np.flatnonzero(scored.subsets[Subset.ALL, begin:end])
        if interval.contact is None or not len(frames):
            continue
        at = stamp_ns[frames]
        holds = np.array([(one.start_ns <= at) & (at <= one.end_ns) for one in interval.further], bool)
        holds = holds.reshape(len(interval.further), len(frames)).T
        for present in np.unique(holds, axis=0):
            contacts = (
                one.contact for one, is_there in zip(interval.further, present, strict=True) if is_there
            )
            yield _TrueSet(interval.contact, tuple(contacts)), frames[(holds == present).all(axis=1)]


def _summed(cells: Ints, seconds: NDArray[np.float64]) -> Iterator[tuple[tuple[int, int], float]]:
    """Distinct rows of (N, 2), each with the sum of its seconds."""
    rows, number = np.unique(cells, axis=0, return_inverse=True)
    sums = np.bincount(number.ravel(), seconds, len(rows))
    yield from zip(map(tuple, rows.tolist()), sums.tolist(), strict=True)


def _score(true: _TrueSet, label: tuple[Contact, ...], further: Kinds, seconds: float) -> FurtherScore:
    """Score of frames with one reported set of contacts; ``label`` is empty where there is no belief."""
    if not true.further:
        return FurtherScore(alone_s=seconds, false_s=seconds if further else 0.0)
    contacts, first = (true.first, *true.further), tuple((one,) for one in label)
    score = FurtherScore(several_s=seconds)
    if _matches(contacts, (*first, *((one[0],) for one in further))):
        return score + FurtherScore(right_s=seconds)
    return score + FurtherScore(open_s=seconds if _matches(contacts, (*first, *further)) else 0.0)


def _matches(true: tuple[Contact, ...], found: Kinds) -> bool:
    """Whether true and found contacts can be assigned to each other one to one."""
    return len(true) == len(found) and any(
        all(one in kinds for one, kinds in zip(order, found, strict=True)) for order in permutations(true)
    )
