"""The alignment of two sequences as a hidden Markov model of pairs (Durbin et al. 1998, chapter 4).

A hidden sequence of steps generates both: a step with contact c is in both sequences (match), only in the
first (missing) or only in the second (new). In each it may be cut into several segments. Likelihoods are
computed for the cells (i, j) after i segments of the first and j of the second sequence, along diagonals.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints

MATCH, FIRST_GOES_ON, SECOND_GOES_ON, MISSING, NEW = range(5)
"""Moves; they add a segment of each sequence, a further segment of the first or of the second to a step, or a
segment of the first or the second alone."""
_MOVES: Final = np.array([(1, 1), (1, 0), (0, 1), (1, 0), (0, 1)])
RATE: Final = 0.2
"""Probability of a step being missing (or new), cut in two, and open in one sequence only. Of rates from 0.02
to 0.4, also different ones, 0.2 and 0.3 find the most differences of takes and the fewest false ones
(tests/benchmarks/takes.py)."""
_SAMPLES: Final = 1000
"""Alignments that are sampled for probabilities with errors of 0.01: with half or twice as many, one of 57
verdicts changes (tests/benchmarks/takes.py)."""


class Alignment(NamedTuple):
    """The most probable steps, and how probable they are.

    Parameters
    ----------
    steps : for each step the numbers of its segments in the first and in the second sequence; one list is
        empty if the step is missing or new.
    together : (n, m) probability that two segments belong to the same step.
    missing, new : (n,) and (m,) probability that the other sequence does not have a segment's step.
    """

    steps: list[tuple[list[int], list[int]]]
    together: Array
    missing: Array
    new: Array


def align(
    first: Array, second: Array, pairs: Array, are_alike: Bools, alone: tuple[Array, Array]
) -> Alignment:
    """Align two sequences.

    Parameters
    ----------
    first, second : (n, C) and (m, C) log likelihoods of the contacts of each segment, relative to their mean
        over all contacts.
    pairs : (n, m, C) further log likelihood ratios of two segments that begin the same step.
    are_alike : (n, m) whether two segments are both open, or both not.
    alone : (n,) and (m,) log probability that a segment is a step at all, if the other sequence lacks it.
    """
    agreement = np.log(2.0 * np.where(are_alike, 1.0 - RATE, RATE))[..., None]
    model = _Model.of(first, second, pairs + agreement, alone)
    (move,) = model.trace(model.forward(np.max))
    samples = model.trace(model.forward(np.logaddexp.reduce), np.random.default_rng(0))
    shape = len(first), len(second)
    together, alone = np.zeros(shape), (np.zeros(shape[0]), np.zeros(shape[1]))
    for sample in samples:
        for rows, columns in _steps(sample):
            together[np.ix_(rows, columns)] += 1.0 / len(samples)
            if not (rows and columns):
                alone[0][rows] += 1.0 / len(samples)
                alone[1][columns] += 1.0 / len(samples)
    return Alignment(_steps(move), together, *alone)


def _steps(moves: Ints) -> list[tuple[list[int], list[int]]]:
    """The segments of each step, from the moves (L,), of which negative ones are padding."""
    steps, at = list[tuple[list[int], list[int]]](), [0, 0]
    for move in moves[moves >= 0]:
        if move not in (FIRST_GOES_ON, SECOND_GOES_ON):
            steps.append(([], []))
        for side in (0, 1):
            if _MOVES[move, side]:
                steps[-1][side].append(at[side])
                at[side] += 1
    return steps


class _Model(NamedTuple):
    """The K hidden states: those of the moves within a match, for each contact, then missing and new.

    ``move`` (K,) leads to each state. ``emission`` (K, n + 1, m + 1) are log likelihoods by cell,
    ``transition`` (K, K) log probabilities from each state to each, ``start`` and ``end`` (K,) log
    probabilities of the first and after the last state.
    """

    move: Ints
    emission: Array
    transition: Array
    start: Array
    end: Array

    @classmethod
    def of(cls, first: Array, second: Array, pairs: Array, alone: tuple[Array, Array]) -> "_Model":
        (n, contacts), m = first.shape, len(second)
        move = np.append(np.repeat([MATCH, FIRST_GOES_ON, SECOND_GOES_ON], contacts), [MISSING, NEW])
        match, on, over = (slice(k * contacts, (k + 1) * contacts) for k in range(3))
        emission = np.full((len(move), n + 1, m + 1), -np.inf)
        emission[on, 1:], emission[over, :, 1:] = first.T[:, :, None], second.T[:, None, :]
        emission[match, 1:, 1:] = emission[on, 1:, 1:] + emission[over, 1:, 1:] + pairs.transpose(2, 0, 1)
        emission[match] -= np.log(contacts)
        emission[-2, 1:], emission[-1, :, 1:] = alone[0][:, None], alone[1]  # any contact
        with np.errstate(divide="ignore"):
            begin = np.log([1.0 - 2.0 * RATE, 0.0, 0.0, RATE, RATE])[move]
        ends, goes_on = np.log1p(-RATE), np.log(RATE)
        end = ends * np.array([2.0, 2.0, 1.0, 0.0, 0.0])[move]  # the first ends before the second goes on
        transition = end[:, None] + begin
        repeat = np.where(np.eye(contacts, dtype=bool), goes_on, -np.inf)
        transition[match, on] = transition[on, on] = transition[over, over] = repeat
        transition[match, over] = transition[on, over] = repeat + ends
        transition[-1, -2] = -np.inf  # missing steps come before new ones
        return cls(move, emission, transition, begin, end)

    def forward(self, combined: Callable[..., Array]) -> Array:
        """Log weights (K, n + 1, m + 1) of all paths to a state in a cell, ``combined`` along an axis."""
        _, rows, columns = self.emission.shape
        ways = np.full(self.emission.shape, -np.inf)
        for diagonal in range(1, rows + columns - 1):
            i = np.arange(max(0, diagonal - columns + 1), min(rows, diagonal + 1))
            for move, (down, right) in enumerate(_MOVES):
                states = np.flatnonzero(self.move == move)[:, None]
                to_i = i[(i >= down) & (diagonal - i >= right)]
                to_j = diagonal - to_i
                paths = ways[:, None, to_i - down, to_j - right] + self.transition[:, states.ravel(), None]
                reached = combined(paths, axis=0)
                is_first = (to_i == down) & (to_j == right)
                reached[:, is_first] = self.start[states]
                ways[states, to_i, to_j] = reached + self.emission[states, to_i, to_j]
        return ways

    def trace(self, ways: Array, rng: np.random.Generator | None = None) -> Ints:
        """Moves (N, L) from the first to the last cell, padded with -1 at the start, of the most probable
        path or of samples by ``rng`` (Gumbel's maximum)."""
        _, rows, columns = self.emission.shape
        count = 1 if rng is None else _SAMPLES
        i, j = np.full(count, rows - 1), np.full(count, columns - 1)
        log_weight, moves = ways[:, i, j] + self.end[:, None], list[Ints]()
        while (is_on := (i > 0) | (j > 0)).any():
            noise = 0.0 if rng is None else rng.gumbel(size=log_weight.shape)
            state = (log_weight + noise).argmax(axis=0)
            move = self.move[state]
            moves.append(np.where(is_on, move, -1))
            i, j = i - np.where(is_on, _MOVES[move, 0], 0), j - np.where(is_on, _MOVES[move, 1], 0)
            log_weight = ways[:, i, j] + self.transition[:, state]
        return np.stack(moves[::-1], axis=1)
