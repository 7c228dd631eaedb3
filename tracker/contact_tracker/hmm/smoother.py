"""Smoothing of past ticks as soon as later data can no longer change their posterior."""

from bisect import bisect_right
from collections.abc import Iterator
from operator import attrgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hmm.forward_filter import Array, FilterFrontier, ForwardMessage

_STEP_BYTES: Final = 1300
"""Size in bytes of a step without beginnings."""
_BEGINNING_BYTES: Final = 13
"""Size in bytes of a beginning in a step."""
_SKIPPED_BYTES: Final = 300
"""Size in bytes of a skipped tick: of its pose, which other modules store until the tick is decided."""
_CHECK_INTERVAL: Final = 16
"""Number of steps between checks of the backward pass whether the futures still differ."""


class OpenTicks:
    """The ticks whose posterior later data can still change, from tick ``first`` on.

    With any later data, the posterior of a past tick is a mixture of its posteriors given each active
    beginning. So the spread of these bounds the change.
    """

    def __init__(self) -> None:
        self.first = 0
        self.size = 0
        """Approximate size in bytes."""
        self._end = 0
        self._steps: list[ForwardMessage] = []

    def __len__(self) -> int:
        return self._end - self.first

    def append(self, step: ForwardMessage) -> None:
        self._steps.append(step)
        self._end = step.tick + 1
        self.size += _size(step)

    def skip(self) -> None:
        """Append a tick that the filter has skipped; its posterior equals that of the previous tick."""
        self._end += 1
        self.size += _SKIPPED_BYTES

    def drop(self, count: int) -> None:
        """Drop the oldest ``count`` ticks, but not the step that covers the next tick."""
        start, self.first = self.first, self.first + count
        covering = max(bisect_right(self._steps, self.first, key=attrgetter("tick")) - 1, 0)
        stepped = sum(start <= step.tick < self.first for step in self._steps[: covering + 1])
        self.size -= sum(map(_size, self._steps[:covering])) + _SKIPPED_BYTES * (count - stepped)
        del self._steps[:covering]

    def look_back(self, frontier: FilterFrontier, tolerance: float) -> tuple[Array, int]:
        """Posterior (n, N) of the open ticks given the data so far, and the number of those now decided."""
        return self.posterior(frontier), self.count_decided(frontier, tolerance)

    def posterior(self, frontier: FilterFrontier) -> Array:
        """Posterior (n, N) of the open ticks, given the data so far."""
        posterior = self._state_probabilities(frontier)
        posterior /= posterior.sum(axis=1, keepdims=True)
        begins = np.array([*(step.tick for step in self._steps), self._end])
        return posterior.repeat(np.diff(np.maximum(begins, self.first)), axis=0)

    def _state_probabilities(self, frontier: FilterFrontier) -> Array:
        """Weights of the states at each open step, given the active beginnings."""
        posterior = np.zeros((len(self._steps), len(self._steps[0].origin_probability)))
        for row, probability, _ in self._backward_pass(frontier, frontier.probability[:, None]):
            posterior[row] = probability[:, 0]
        return posterior

    def count_decided(self, frontier: FilterFrontier, tolerance: float) -> int:
        """Number of the oldest open ticks that later data cannot change by more than ``tolerance``."""
        futures = np.eye(len(frontier.onset))
        if not self._count_common(frontier, futures[:, [0, -1]], tolerance):
            return 0  # the usual case at rest, where a comparison of all beginnings takes long
        return self._count_common(frontier, futures, tolerance)

    def _count_common(self, frontier: FilterFrontier, futures: Array, tolerance: float) -> int:
        """Number of the oldest ticks with the same posterior in all ``futures``, up to ``tolerance``."""
        common = len(self._steps)
        for row, probability, open_beginnings in self._backward_pass(frontier, futures):
            spread = np.max(probability.max(axis=1) - probability.min(axis=1))
            if spread > tolerance:
                common = row
            elif row % _CHECK_INTERVAL == 0 and spread + 2.0 * open_beginnings.spread <= tolerance:
                break  # older ticks differ by no more than this
        end = self._steps[common].tick if common < len(self._steps) else self._end
        return max(end - self.first, 0)

    def _backward_pass(
        self, frontier: FilterFrontier, futures: Array
    ) -> Iterator[tuple[int, Array, "_OpenBeginnings"]]:
        """Backward pass through the open ticks for C futures at once; ``futures`` (L, C) are distributions
        over the active beginnings.

        Yields, from the newest step to the oldest: its row, the probabilities (N, C) of the states, and the
        beginnings that last through the step.
        """
        states, columns = len(self._steps[0].origin_probability), futures.shape[1]
        open_beginnings = _OpenBeginnings(states, columns, self._steps[0].tick, self._end)
        open_beginnings.add(frontier.onset, frontier.state, futures)
        probability = np.zeros((states, columns))
        np.add.at(probability, frontier.state, futures)
        ended = np.zeros((states, columns))  # probability that a state ends with the tick
        for row in range(len(self._steps) - 1, -1, -1):
            step = self._steps[row]
            if ended.any():
                probability += ended
                open_beginnings.add(step.onset, step.state, step.probability[:, None] * ended[step.state])
            yield row, probability, open_beginnings
            beginning = open_beginnings.pop(step.tick)
            probability = np.maximum(probability - beginning, 0.0)
            ended = step.origin_probability @ beginning


def _size(step: ForwardMessage) -> int:
    """Approximate size of a step in bytes."""
    return _STEP_BYTES + _BEGINNING_BYTES * len(step.onset)


class _OpenBeginnings:
    """Probabilities (N, C), by onset, of the beginnings that last through the current tick of the backward
    pass; onsets are from ``first`` to before ``end``, earlier ones are ignored."""

    def __init__(self, states: int, columns: int, first: int, end: int) -> None:
        self._first = first
        self._table = np.zeros((16, states, columns))
        self._row = np.full(end - first, -1)
        self._free = list(range(16))

    def add(self, onset: NDArray[Any], state: NDArray[Any], probability: Array) -> None:
        """Add probabilities of beginnings, each at most once, in order of onset."""
        old = int(onset.searchsorted(self._first))
        since = onset[old:] - self._first
        rows = self._row[since]
        if rows.min(initial=0) < 0:
            new = np.unique(since[rows < 0])
            self._make_room(len(new))
            self._row[new] = [self._free.pop() for _ in new]
            rows = self._row[since]
        self._table[rows, state[old:]] += probability[old:]

    def pop(self, onset: int) -> Array:
        """Remove and return the probabilities (N, C) of the beginnings at ``onset``."""
        row = int(self._row[onset - self._first])
        if row < 0:
            return np.zeros(self._table.shape[1:])
        beginning: Array = self._table[row].copy()
        self._table[row] = 0.0
        self._free.append(row)
        return beginning

    @property
    def spread(self) -> float:
        """Sum over all beginnings of the spread of their probabilities between the futures."""
        return float((self._table.max(axis=2) - self._table.min(axis=2)).sum())

    def _make_room(self, count: int) -> None:
        while len(self._free) < count:
            self._free += range(len(self._table), 2 * len(self._table))
            self._table = np.concatenate([self._table, np.zeros_like(self._table)])
