"""The forward pass while ticks come in: the weights of what is alive, and where each may have come from.

What began at one boundary in one state is one *beginning*, whichever hypotheses assume it: they share their
past. What comes later cannot change the probability of the past of a given beginning, and only chooses among
those that are alive: that is what makes it possible to conclude before the end.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hmm.log_space import Array, Index, log_sum_exp

NEGLIGIBLE: Final = 1e-14
"""Probability below which a way into the past is left out, whatever comes later."""
LOWEST: Final = np.finfo(float).min
"""What is subtracted in place of -inf, where nothing is possible."""


class FilterFrontier(NamedTuple):
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


class ForwardMessage(NamedTuple):
    """What one tick adds, N states: where paths that pass its boundaries come from."""

    origin_probability: Array
    """(N, N) that what begins with the tick in state j was state i before; zero before the first tick."""
    onset: NDArray[np.int32]
    """(E,) onsets, in order, of what is left at the end of the tick."""
    state: NDArray[np.int8]
    """(E,) and its states."""
    probability: Array
    """(E,) that what is left in the state began at the onset."""
    best: NDArray[np.int32]
    """(2, N) of the best path to each state, when that began and the state before it; -1 without any."""


class _Ended(NamedTuple):
    """The end of a tick: of each ``onset`` (O,) and state the state before it, the ``weight`` against that of
    the state's best, and the log weight of the ``best`` path, (O, N)."""

    onset: Index
    origin: Array
    weight: Array
    best: Array


class ForwardFilter:
    """The forward pass over N states; grows with what is alive, not with what has been."""

    def __init__(self, log_initial: Array) -> None:
        self.ticks = 0
        states = len(log_initial)
        self._initial, self._every = log_initial, np.arange(states)
        self._left: Array  # sum and maximum over the paths to each state
        self._onset = np.zeros(0, np.int64)  # of all that is alive, each once, in order
        self._entry = np.zeros((3, 0, states))  # at each: sum, maximum, and where that comes from
        self._ended: _Ended

    @property
    def living(self) -> FilterFrontier:
        """After the last tick."""
        onset, origin, weight, best = self._ended
        since, state = weight.nonzero()
        log_share = np.log(weight[since, state]) - np.log(weight.sum(axis=0)[state])
        return FilterFrontier(
            onset[since],
            state,
            log_share + self._left[0, state],
            best[since, state],
            origin[since, state].astype(np.int64),
        )

    def advance(
        self, state: Index, onset: Index, log_likelihood: Array, log_transition: Array
    ) -> ForwardMessage:
        """Take in a tick: state, onset and log-likelihood (A,), which is finite, of the hypotheses alive at
        its end, and the log chances (N, N) of change at its beginning.

        Raises
        ------
        ValueError : no path leads to any of them, or nothing was alive at an onset.
        """
        source = self._begin(log_transition)
        top, many = self._gathered(state, onset, log_likelihood)
        score = self._entry[:2] + top
        norm = score[0].max()  # weights matter up to a factor; without it they would outgrow their digits
        if not np.isfinite(norm):
            raise ValueError("no path covers all ticks")
        score -= norm
        safe = np.maximum(score[0].max(axis=0), LOWEST)
        weight = np.exp(score[0] - safe) * many
        of_state = weight.sum(axis=0)
        winner = score[1].argmax(axis=0)
        best = score[1, winner, self._every]
        before = np.where(np.isfinite(best), [self._onset[winner], self._entry[2, winner, self._every]], -1)
        with np.errstate(divide="ignore"):
            self._left = np.array([safe + np.log(of_state), best])
        since, column = (weight > NEGLIGIBLE * of_state).nonzero()
        step = ForwardMessage(
            source,
            self._onset[since].astype(np.int32),
            column.astype(np.int8),
            weight[since, column] / of_state[column],
            before.astype(np.int32),
        )
        self._ended = _Ended(self._onset, self._entry[2], weight, score[1])
        alive = many.any(axis=1)
        self._onset, self._entry = self._onset[alive], self._entry[:, alive]
        self._entry[:2] -= norm
        return step

    def _begin(self, log_transition: Array) -> Array:
        """What begins now, and from where (N, N)."""
        states = len(self._initial)
        if not self.ticks:
            source = np.zeros((states, states))
            entry = np.array([self._initial, self._initial, np.full(states, -1.0)])
        else:
            into, best = self._left[:, :, None] + log_transition
            total, origin = log_sum_exp(into, axis=0), best.argmax(axis=0)
            entry = np.array([total, best[origin, self._every], origin])
            source = np.exp(into - np.maximum(total, LOWEST))
        self._onset = np.append(self._onset, self.ticks)
        self._entry = np.concatenate([self._entry, entry[:, None]], axis=1)
        self.ticks += 1
        return source

    def _gathered(self, state: Index, onset: Index, log_likelihood: Array) -> tuple[Array, Array]:
        """Of the hypotheses of each onset and state the best log-likelihood (O, N), -inf without any, and as
        how many of that they all count (O, N)."""
        shape = len(self._onset), len(self._initial)
        row = self._onset.searchsorted(onset)
        if (self._onset.take(row, mode="clip") != onset).any():
            raise ValueError("a hypothesis of which nothing has begun")
        if not np.isfinite(log_likelihood).all():
            raise ValueError("no path covers all ticks")
        cell = row * shape[1] + state
        top = np.full(shape[0] * shape[1], -np.inf)
        np.maximum.at(top, cell, log_likelihood)
        many = np.bincount(cell, np.exp(log_likelihood - top[cell]), len(top))
        return top.reshape(shape), np.asarray(many, float).reshape(shape)
