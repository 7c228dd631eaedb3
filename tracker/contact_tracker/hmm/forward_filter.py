"""The forward pass, tick by tick: weights of the active beginnings and of their predecessors.

A *beginning* is an onset in a state. All hypotheses with the same beginning share their past. Later data
cannot change the posterior of the past given a beginning; they only choose among the beginnings that are
still active. So past ticks can be decided before the end of the stream (``smoother``, ``viterbi_survivors``).

For the posterior of the state L ticks ago each hypothesis carries its *past*: the probabilities of the states
at the last L ticks, given the hypothesis. A new hypothesis inherits the mixture of the pasts of its possible
predecessors (docs/theory.md).
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def log_sum_exp(values: Array, axis: int = -1) -> Array:
    """Logarithm of the sum of exponentials along ``axis``; -inf where all values are -inf."""
    return np.asarray(np.logaddexp.reduce(values, axis=axis))


def birth_log_weights(log_ended: Array, log_transition: Array) -> Array:
    """Log weights (N,) of births in each state, from those of the states before, ``log_ended`` (N,)."""
    return np.asarray(np.logaddexp.reduce(log_ended[:, None] + log_transition, axis=0))


def inherited_past(past: Array, log_ended: Array, log_transition: Array) -> Array:
    """Pasts (N, L, N) of births in each state, from the pasts ``past`` (N, L, N) and log weights
    ``log_ended`` (N,) of the states before."""
    log_weight = log_ended[:, None] + log_transition
    weight = np.exp(log_weight - log_weight.max(axis=0))
    return np.asarray(np.einsum("ij,ils->jls", weight / weight.sum(axis=0), past))


def grown_past(past: Array, state: int) -> Array:
    """Pasts (..., L, N) extended by a tick in ``state``."""
    if not past.shape[-2]:
        return past
    present = np.zeros((*past.shape[:-2], 1, past.shape[-1]))
    present[..., state] = 1.0
    return np.concatenate([past[..., 1:, :], present], axis=-2)


def mixed_past(past: Array, log_weight: Array) -> Array:
    """Mean (L, N) of the pasts (H, L, N) of hypotheses with log weights (H,); zero without hypotheses."""
    if not past.size:
        return np.zeros(past.shape[1:])
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(np.einsum("h,hls->ls", weight / weight.sum(), past))


NEGLIGIBLE: Final = 1e-14
"""Least probability of a predecessor; less probable ones are dropped."""
LOWEST: Final = np.finfo(float).min
"""Log weight that replaces -inf in subtractions where all weights are zero."""


class FilterFrontier(NamedTuple):
    """The C active beginnings at a boundary, in order of onset."""

    onset: Index
    """(C,) numbers of their first ticks."""
    state: Index
    """(C,) their states."""
    log_weight: Array
    """(C,) log of the summed weights of all paths that end in the beginning."""
    best: Array
    """(C,) log weight of the best path."""
    origin: Index
    """(C,) state before the onset on that path; -1 at the start."""

    @property
    def probability(self) -> Array:
        """Probability (C,) of each beginning, given the data so far."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return np.asarray(weight / weight.sum())


class ForwardMessage(NamedTuple):
    """Backward probabilities at one tick, for N states."""

    tick: int
    """Number of the tick."""
    origin_probability: Array
    """(N, N) probability of state i before the tick, given a beginning in state j; zero at the first tick."""
    onset: NDArray[np.int32]
    """(E,) onsets of the beginnings at the end of the tick, in order."""
    state: NDArray[np.int8]
    """(E,) their states."""
    probability: Array
    """(E,) probability of the onset, given that its state ends with the tick."""
    best: NDArray[np.int32]
    """(2, N) best path to each state: its onset and the state before it; -1 without a path."""


class _Ended(NamedTuple):
    """Weights at the end of a tick by onset (O) and state (N)."""

    onset: Index
    """(O,) numbers of first ticks."""
    origin: Array
    """(O, N) state before the onset on the best path."""
    log_weight: Array
    """(O, N) log of the summed weights of all paths."""
    best: Array
    """(O, N) log weight of the best path."""


class ForwardFilter:
    """The forward pass over N states. Its size grows with the number of active hypotheses, not with time."""

    def __init__(self, log_initial: Array) -> None:
        self.ticks = 0
        states = len(log_initial)
        self._initial, self._every = log_initial, np.arange(states)
        self._state_weight: Array  # (2, N) log of the sum and of the maximum over the paths to each state
        self._onset = np.zeros(0, np.int64)  # distinct onsets of the active hypotheses, in order
        self._entry = np.zeros((3, 0, states))  # per onset: sum, maximum, and state before on the best path
        self._ended: _Ended

    @property
    def frontier(self) -> FilterFrontier:
        """The active beginnings after the last tick, however small their weights: without noise, later data
        can make up for thousands of log units."""
        onset, origin, log_weight, best = self._ended
        since, state = np.isfinite(best).nonzero()
        return FilterFrontier(
            onset[since],
            state,
            log_weight[since, state],
            best[since, state],
            origin[since, state].astype(np.int64),
        )

    def skip(self) -> None:
        """Skip a tick in which no state can change and no likelihood changes: all weights stay the same.

        Free motion begins anew at each tick, so its onset stays the last tick that was not skipped.
        """
        assert self.ticks, "the first tick has the initial distribution"
        self.ticks += 1

    def advance(
        self, state: Index, onset: Index, log_likelihood: Array, log_transition: Array
    ) -> ForwardMessage:
        """Advance by a tick; returns its message for the backward pass.

        Parameters
        ----------
        state, onset, log_likelihood : (A,) of the hypotheses that are active at the end of the tick;
            log-likelihoods are finite.
        log_transition : (N, N) log probabilities of change at the beginning of the tick.

        Raises
        ------
        ValueError : no path leads to any hypothesis, or an onset is unknown.
        """
        tick, source = self.ticks, self._begin(log_transition)
        top, multiplicity = self._gathered(state, onset, log_likelihood)
        score = self._entry[:2] + top
        norm = score[0].max()  # only ratios of weights matter; unnormalised logs would lose digits
        if not np.isfinite(norm):
            raise ValueError("no path covers all ticks")
        score -= norm
        safe = np.maximum(score[0].max(axis=0), LOWEST)
        weight = np.exp(score[0] - safe) * multiplicity
        of_state = weight.sum(axis=0)
        winner = score[1].argmax(axis=0)
        best = score[1, winner, self._every]
        path = np.where(np.isfinite(best), [self._onset[winner], self._entry[2, winner, self._every]], -1)
        with np.errstate(divide="ignore"):
            self._state_weight = np.array([safe + np.log(of_state), best])
            log_weight = score[0] + np.log(multiplicity)
        since, column = (weight > NEGLIGIBLE * of_state).nonzero()
        step = ForwardMessage(
            tick,
            source,
            self._onset[since].astype(np.int32),
            column.astype(np.int8),
            weight[since, column] / of_state[column],
            path.astype(np.int32),
        )
        self._ended = _Ended(self._onset, self._entry[2], log_weight, score[1])
        alive = multiplicity.any(axis=1)
        self._onset, self._entry = self._onset[alive], self._entry[:, alive]
        self._entry[:2] -= norm
        return step

    def _begin(self, log_transition: Array) -> Array:
        """Add the beginnings of a new tick; returns the probabilities (N, N) of the states before it."""
        states = len(self._initial)
        if not self.ticks:
            source = np.zeros((states, states))
            entry = np.array([self._initial, self._initial, np.full(states, -1.0)])
        else:
            into, best = self._state_weight[:, :, None] + log_transition
            total, origin = log_sum_exp(into, axis=0), best.argmax(axis=0)
            entry = np.array([total, best[origin, self._every], origin])
            source = np.exp(into - np.maximum(total, LOWEST))
        self._onset = np.append(self._onset, self.ticks)
        self._entry = np.concatenate([self._entry, entry[:, None]], axis=1)
        self.ticks += 1
        return source

    def _gathered(self, state: Index, onset: Index, log_likelihood: Array) -> tuple[Array, Array]:
        """The best log-likelihood by onset and state (O, N), -inf without a hypothesis, and the sum of the
        likelihoods relative to the best (O, N)."""
        shape = len(self._onset), len(self._initial)
        row = self._onset.searchsorted(onset)
        if (self._onset.take(row, mode="clip") != onset).any():
            raise ValueError("a hypothesis has an unknown onset")
        if not np.isfinite(log_likelihood).all():
            raise ValueError("no path covers all ticks")
        cell = row * shape[1] + state
        top = np.full(shape[0] * shape[1], -np.inf)
        np.maximum.at(top, cell, log_likelihood)
        multiplicity = np.bincount(cell, np.exp(log_likelihood - top[cell]), len(top))
        return top.reshape(shape), np.asarray(multiplicity, float).reshape(shape)
