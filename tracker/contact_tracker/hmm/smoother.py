"""Smoothing of past ticks as soon as later data cannot change their posterior any more."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hmm.forward_filter import FilterFrontier, ForwardMessage
from contact_tracker.hmm.log_space import Array

_STEP_BYTES: Final = 1300
_WAY_BYTES: Final = 13
_CHECKED: Final = 16
"""Interval in ticks at which the backward pass checks whether the futures still differ."""


class OpenTicks:
    """The ticks whose posterior later data can still change, from tick ``first`` on.

    Whatever comes later, the posterior of a past tick will be a mixture of its posteriors given each active
    beginning. So their spread bounds the change.
    """

    def __init__(self) -> None:
        self.first = 0
        self.size = 0
        """Approximate size in bytes."""
        self._steps: list[ForwardMessage] = []

    def __len__(self) -> int:
        return len(self._steps)

    def append(self, step: ForwardMessage) -> None:
        self._steps.append(step)
        self.size += _size(step)

    def drop(self, count: int) -> None:
        """Forget the oldest ``count`` ticks."""
        self.size -= sum(map(_size, self._steps[:count]))
        del self._steps[:count]
        self.first += count

    def look_back(self, living: FilterFrontier, tolerance: float) -> tuple[Array, int]:
        """Posterior (n, N) of the open ticks given the data so far, and how many of the oldest are
        decided."""
        return self.posterior(living), self.count_decided(living, tolerance)

    def posterior(self, living: FilterFrontier) -> Array:
        """Posterior (n, N) of the open ticks, given the data so far."""
        posterior = self._covered(living)
        return np.asarray(posterior / posterior.sum(axis=1, keepdims=True))

    def _covered(self, living: FilterFrontier) -> Array:
        """Weights (n, N) of the states at the open ticks, given the active beginnings."""
        posterior = np.zeros((len(self), len(self._steps[0].origin_probability)))
        for row, cover, _ in self._followed(living, living.probability[:, None]):
            posterior[row] = cover[:, 0]
        return posterior

    def count_decided(self, living: FilterFrontier, tolerance: float) -> int:
        """How many of the oldest open ticks later data cannot change by more than ``tolerance``."""
        futures = np.eye(len(living.onset))
        if not self._common(living, futures[:, [0, -1]], tolerance):
            return 0  # the usual case at rest; comparing all beginnings would take long
        return self._common(living, futures, tolerance)

    def _common(self, living: FilterFrontier, futures: Array, tolerance: float) -> int:
        """How many of the oldest ticks have the same posterior in all ``futures``, up to ``tolerance``."""
        common = len(self)
        for row, cover, open_states in self._followed(living, futures):
            spread = np.max(cover.max(axis=1) - cover.min(axis=1))
            if spread > tolerance:
                common = row
            elif row % _CHECKED == 0 and spread + 2.0 * open_states.apart <= tolerance:
                break  # older ticks differ by no more than this
        return common

    def _followed(self, living: FilterFrontier, futures: Array) -> Iterator[tuple[int, Array, "_Held"]]:
        """Backward pass through the open ticks for C ``futures`` at once, each a distribution (L, C) over the
        active beginnings.

        Yields from the newest tick on: its row, the probabilities (N, C) of the states, and the beginnings
        that last through it.
        """
        states, columns = len(self._steps[0].origin_probability), futures.shape[1]
        open_states = _Held(states, columns, self.first, self.first + len(self))
        open_states.add(living.onset, living.state, futures)
        cover = np.zeros((states, columns))
        np.add.at(cover, living.state, futures)
        left = np.zeros((states, columns))  # probability that a state is left at the tick's end
        for row in range(len(self) - 1, -1, -1):
            step = self._steps[row]
            if left.any():
                cover += left
                open_states.add(step.onset, step.state, step.probability[:, None] * left[step.state])
            yield row, cover, open_states
            beginning = open_states.take(self.first + row)
            cover = np.maximum(cover - beginning, 0.0)
            left = step.origin_probability @ beginning


def _size(step: ForwardMessage) -> int:
    return _STEP_BYTES + _WAY_BYTES * len(step.onset)


class _Held:
    """Probabilities (N, C) by onset of the beginnings that last through the current tick of the backward
    pass.

    Onsets before ``first`` are left out; ``end`` is after all of them.
    """

    def __init__(self, states: int, columns: int, first: int, end: int) -> None:
        self._first = first
        self._table = np.zeros((16, states, columns))
        self._row = np.full(end - first, -1)
        self._free = list(range(16))

    def add(self, onset: NDArray[Any], state: NDArray[Any], probability: Array) -> None:
        """Add probabilities of beginnings, each at most once."""
        old = int(onset.searchsorted(self._first))  # they are in order
        since = onset[old:] - self._first
        rows = self._row[since]
        if rows.min(initial=0) < 0:
            new = np.unique(since[rows < 0])
            self._make_room(len(new))
            self._row[new] = [self._free.pop() for _ in new]
            rows = self._row[since]
        self._table[rows, state[old:]] += probability[old:]

    def take(self, onset: int) -> Array:
        """Remove and return the probabilities (N, C) of the beginnings at ``onset``."""
        row = int(self._row[onset - self._first])
        if row < 0:
            return np.zeros(self._table.shape[1:])
        beginning: Array = self._table[row].copy()
        self._table[row] = 0.0
        self._free.append(row)
        return beginning

    @property
    def apart(self) -> float:
        """Sum over all beginnings of the spread between the futures."""
        return float((self._table.max(axis=2) - self._table.min(axis=2)).sum())

    def _make_room(self, count: int) -> None:
        while len(self._free) < count:
            self._free += range(len(self._table), 2 * len(self._table))
            self._table = np.concatenate([self._table, np.zeros_like(self._table)])
