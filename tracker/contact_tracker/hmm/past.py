"""Smoothing of what is past as soon as the future cannot change it any more."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hmm.running import Living, Step
from contact_tracker.hmm.sums import Array, Index

_STEP_BYTES: Final = 1300
_WAY_BYTES: Final = 13


class Past:
    """The ticks whose posterior is still open, from tick ``first`` on.

    Whatever comes later, the posterior of a past tick will be a mixture of what it is given each beginning
    that is alive now. So the spread between these bounds by how much the future can still change it.
    """

    def __init__(self) -> None:
        self.first = 0
        self.size = 0
        """Bytes that are held, about."""
        self._steps: list[Step] = []

    def __len__(self) -> int:
        return len(self._steps)

    def append(self, step: Step) -> None:
        self._steps.append(step)
        self.size += _size(step)

    def drop(self, count: int) -> None:
        """Forget the oldest ``count`` ticks."""
        self.size -= sum(map(_size, self._steps[:count]))
        del self._steps[:count]
        self.first += count

    def look_back(self, living: Living, tolerance: float) -> tuple[Array, int]:
        """Posterior (n, N) of the open ticks given the data so far; and how many of them, the oldest ones, no
        future can change by more than ``tolerance``."""
        today = living.probability[:, None]
        futures = np.eye(len(today))
        posterior, spread = self.follow(living, np.hstack([today, futures[:, _outermost(living)]]))
        if spread[0] <= tolerance:  # then it is worth while to look at all of them
            _, spread = self.follow(living, futures)
        return posterior, int(np.argmax(np.append(spread, np.inf) > tolerance))

    def follow(self, living: Living, futures: Array) -> tuple[Array, Array]:
        """Follow what is alive back through the open ticks, for C ``futures`` at once: given each, the
        probability (L, C) of what is alive now.

        Returns
        -------
        posterior (n, N) in the first of these futures; spread (n,) between all of them.
        """
        states, columns = len(self._steps[0].source), futures.shape[1]
        held = _Held(states, columns, self.first, self.first + len(self))
        held.add(living.onset, living.state, futures)
        cover = np.zeros((states, columns))  # probability of each state in the tick at hand
        np.add.at(cover, living.state, futures)
        left = np.zeros((states, columns))  # that it is left at the tick's end
        posterior, spread = np.zeros((len(self), states)), np.zeros(len(self))
        for row in range(len(self) - 1, -1, -1):
            step = self._steps[row]
            if left.any():
                cover += left
                held.add(step.onset, step.state, step.probability[:, None] * left[step.state])
            posterior[row] = cover[:, 0]
            spread[row] = np.ptp(cover, axis=1).max()
            begun = held.take(self.first + row)
            cover = np.maximum(cover - begun, 0.0)
            left = step.source @ begun
        return posterior / posterior.sum(axis=1, keepdims=True), spread


def _outermost(living: Living) -> Index:
    """The oldest and the youngest of each state: futures that are likely to differ the most."""
    order = np.lexsort((living.onset, living.state))
    ends = np.flatnonzero(np.diff(living.state[order]))
    return np.concatenate([order[[0, -1]], order[ends], order[ends + 1]])


def _size(step: Step) -> int:
    return _STEP_BYTES + _WAY_BYTES * len(step.onset)


class _Held:
    """Probability of the beginnings that last through the tick at hand, (N, C) by onset.

    Those before ``first`` or after ``end`` are not asked for.
    """

    def __init__(self, states: int, columns: int, first: int, end: int) -> None:
        self._first = first
        self._table = np.zeros((16, states, columns))
        self._row = np.full(end - first, -1)
        self._free = list(range(16))

    def add(self, onset: NDArray[Any], state: NDArray[Any], probability: Array) -> None:
        """Each beginning at most once."""
        known = onset >= self._first
        since = onset[known] - self._first
        new = np.unique(since[self._row[since] < 0])
        if len(new):
            self._make_room(len(new))
            self._row[new] = [self._free.pop() for _ in new]
        self._table[self._row[since], state[known]] += probability[known]

    def take(self, onset: int) -> Array:
        """What began then, and is not held before."""
        row = int(self._row[onset - self._first])
        if row < 0:
            return np.zeros(self._table.shape[1:])
        begun: Array = self._table[row].copy()
        self._table[row] = 0.0
        self._free.append(row)
        return begun

    def _make_room(self, count: int) -> None:
        while len(self._free) < count:
            self._free += range(len(self._table), 2 * len(self._table))
            self._table = np.concatenate([self._table, np.zeros_like(self._table)])
