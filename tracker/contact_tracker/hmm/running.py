"""The forward pass while ticks come in: the weights of what is alive, and where each may have come from.

What began at one boundary in one state is one *beginning*, whichever hypotheses assume it: they share their
past. What comes later cannot change the probability of the past of a given beginning, and only chooses among
those that are alive: that is what makes it possible to conclude before the end.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hmm.sums import Array, Index, log_sum_exp

NEGLIGIBLE: Final = 1e-14
"""Probability below which a way into the past is left out, whatever comes later."""


class Living(NamedTuple):
    """Beginnings (C,) that are alive at a boundary, in order of onset: ``onset`` and ``state`` of each, the
    ``log_weight`` of all paths that end there and the log weight ``best`` of the best one with the state
    ``origin`` that it came from, -1 at the start."""

    onset: Index
    state: Index
    log_weight: Array
    best: Array
    origin: Index

    @property
    def probability(self) -> Array:
        """(C,) of each, from the data so far."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return np.asarray(weight / weight.sum())


class Step(NamedTuple):
    """What one tick adds, N states: where paths that pass its boundaries come from.

    ``source`` (N, N): probability that what begins with the tick in state j was state i before; zero before
    the first. Of what is left in ``state`` (E,) at the tick's end, ``probability`` (E,) that it began at
    ``onset`` (E,), which are in order. ``best`` (2, N): on the best path to each state, when that began and
    the state before it; -1 where there is none.
    """

    source: Array
    onset: NDArray[np.int32]
    state: NDArray[np.int8]
    probability: Array
    best: NDArray[np.int32]


class Forward:
    """The forward pass over N states; grows with what is alive, not with what has been."""

    def __init__(self, log_initial: Array) -> None:
        self.ticks = 0
        self.living: Living
        """After the last tick."""
        self._initial = log_initial
        self._left = np.zeros((2, len(log_initial)))  # sum and maximum over the paths to each state
        self._onset = np.zeros(0, np.int64)  # of all that is alive, each once, in order
        self._entry = np.zeros((0, 3, len(log_initial)))  # at each: sum, maximum, and where that comes from

    def advance(self, state: Index, onset: Index, log_likelihood: Array, log_transition: Array) -> Step:
        """Take in a tick: state, onset and log-likelihood (A,) of the hypotheses alive at its end, and the
        log chances (N, N) of change at its beginning.

        Raises
        ------
        ValueError : no path leads to any of them.
        """
        source = self._begin(log_transition)
        states, onsets = len(self._initial), len(self._onset)
        row = np.searchsorted(self._onset, onset)
        group = row * states + state
        score = self._entry[row, :2, state] + log_likelihood[:, None]
        top = np.full((onsets, states, 2), -np.inf)
        np.maximum.at(top.reshape(-1, 2), group, score)
        top_sum, top_best = top.max(axis=0).T
        norm = top_sum.max()  # weights matter up to a factor; without it they would outgrow their digits
        if not np.isfinite(norm):
            raise ValueError("no path covers all ticks")
        safe = np.where(np.isfinite(top_sum), top_sum, 0.0)
        weight = np.exp(score[:, 0] - safe[state])
        grouped = np.bincount(group, weight, onsets * states)
        of_state = grouped.reshape(onsets, states).sum(axis=0)
        alive = grouped.nonzero()[0]
        since, column = np.divmod(alive, states)
        beginning, origin = self._onset[since], self._entry[since, 2, column]
        self.living = Living(
            beginning,
            column,
            np.log(grouped[alive]) + safe[column] - norm,
            top[since, column, 1] - norm,
            origin.astype(np.int64),
        )
        probability = grouped[alive] / of_state[column]
        kept = probability > NEGLIGIBLE
        winner, every = top[:, :, 1].argmax(axis=0), np.arange(states)
        best = np.where(np.isfinite(top_best), [self._onset[winner], self._entry[winner, 2, every]], -1)
        with np.errstate(divide="ignore"):
            self._left = np.stack([safe + np.log(of_state), top_best]) - norm
        self._forget(np.bincount(row, minlength=onsets) > 0, norm)
        return Step(
            source,
            beginning[kept].astype(np.int32),
            column[kept].astype(np.int8),
            probability[kept],
            best.astype(np.int32),
        )

    def _begin(self, log_transition: Array) -> Array:
        """What begins now, and from where (N, N)."""
        states = len(self._initial)
        if not self.ticks:
            source, entry = np.zeros((states, states)), np.tile(self._initial, (3, 1))
            entry[2] = -1.0
        else:
            into = self._left[:, :, None] + log_transition
            total = log_sum_exp(into[0], axis=0)
            entry = np.stack([total, into[1].max(axis=0), into[1].argmax(axis=0)])
            source = np.exp(into[0] - np.where(np.isfinite(total), total, 0.0))
        self._onset = np.append(self._onset, self.ticks)
        self._entry = np.concatenate([self._entry, entry[None]])
        self.ticks += 1
        return source

    def _forget(self, alive: NDArray[np.bool_], norm: float) -> None:
        """Keep what is ``alive``, its weights over that of ``norm``."""
        self._onset, self._entry = self._onset[alive], self._entry[alive]
        self._entry[:, :2] -= norm
