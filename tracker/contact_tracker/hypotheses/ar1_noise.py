"""Estimate the variance and the tick-to-tick correlation of a segment's errors from its residuals
(docs/theory.md, T26).
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEARNING_STEPS: Final = 15
"""Iterations of expectation-maximisation."""
PRIOR_TICKS: Final = 1.0
"""Weight of the prior noise variance, as a number of ticks."""
MOST_CORRELATION: Final = 0.95
LEAST_SCALE: Final = 1e-6
LEAST_SHARE: Final = 1e-12


class Ar1Noise(NamedTuple):
    """Errors of the K residuals: an autoregressive process of order one from tick to tick."""

    weight: Array
    """(K,) estimated precision over the assumed precision."""
    correlation: Array
    """(K,) correlation between neighbouring ticks."""


def estimate_ar1(
    errors: Ar1Noise, whitened: Array, jacobian: Array, prior_information: Array, index: Index
) -> Ar1Noise:
    """Estimate the errors from the whitened residuals (K, W) of a fit, by expectation-maximisation.

    Residuals are smaller than errors, because the fit absorbs what looks like geometry. How much it absorbs
    follows from the ``jacobian`` (K, W, P) and the ``prior_information`` (P, P). With too few ticks the
    estimate stays near ``errors``.
    """
    (weight, correlation), count = errors, whitened.shape[1]
    sums = _Sums.of(np.concatenate([jacobian, whitened[..., None]], axis=2), index)
    new = sums.new(correlation)
    for _ in range(LEARNING_STEPS):
        eigenvalues, eigenvectors = np.linalg.eigh(
            np.einsum("k,kpq->pq", weight, new[:, :-1, :-1]) + prior_information
        )
        determined = eigenvalues > LEAST_SHARE * eigenvalues[-1]
        # expected products of errors: those of the residuals plus those of what the fit may have absorbed
        taken = np.eye(len(eigenvalues) + 1)
        taken[:-1, :-1] = (eigenvectors[:, determined] / eigenvalues[determined]) @ eigenvectors[
            :, determined
        ].T
        product, square = np.einsum("ikpq,pq->ik", sums.pairs, taken)
        correlation = np.minimum(np.maximum(product / np.maximum(square, LEAST_SCALE), 0.0), MOST_CORRELATION)
        new = sums.new(correlation)
        variance = np.maximum(np.einsum("kpq,pq->k", new, taken) / count, LEAST_SCALE)
        weight = variance ** (-count / (count + PRIOR_TICKS))
    return Ar1Noise(weight, correlation)


def whiten_ar1(rows: Array, correlation: Array, index: Index) -> Array:
    """Innovations of rows (K, W, ...): what the tick before does not predict, scaled to the same variance."""
    left = correlation[:, None] ** np.diff(index)
    left = left.reshape(*left.shape, *(1,) * (rows.ndim - 2))
    later = (rows[:, 1:] - left * rows[:, :-1]) / np.sqrt(1.0 - left**2)
    return np.concatenate([rows[:, :1], later], axis=1)


class _Sums(NamedTuple):
    """Sufficient statistics of rows (K, W, Z) for any correlation: sums of their products over ticks."""

    gaps: Array
    """(G,) distances in ticks that occur between neighbours."""
    first: Array
    """(K, Z, Z) products of the first tick."""
    later: Array
    """(G, K, Z, Z) products of the later one of two neighbours with itself, per gap."""
    earlier: Array
    """(G, K, Z, Z) the same of the earlier one."""
    both: Array
    """(G, K, Z, Z) products of the two with each other, in either order."""
    pairs: Array
    """(2, K, Z, Z) mean product of adjacent ticks, and mean square of the same ticks. Ticks without an
    adjacent one would only add scatter."""

    @classmethod
    def of(cls, rows: Array, index: Index) -> "_Sums":
        gap = np.diff(index)
        gaps, shape = np.unique(gap), (-1, len(rows), rows.shape[2], rows.shape[2])
        pairs = [(rows[:, 1:][:, gap == one], rows[:, :-1][:, gap == one]) for one in gaps]
        later = np.array([_products(after, after) for after, _ in pairs]).reshape(shape)
        earlier = np.array([_products(before, before) for _, before in pairs]).reshape(shape)
        across = np.array([_products(after, before) for after, before in pairs]).reshape(shape)
        both, follows = across + across.swapaxes(2, 3), gap == 1
        paired = np.append(follows, False) | np.append(False, follows)
        product = 0.5 * both[gaps == 1].sum(axis=0) / max(int(np.count_nonzero(follows)), 1)
        square = _products(rows[:, paired], rows[:, paired]) / max(int(np.count_nonzero(paired)), 1)
        first = _products(rows[:, :1], rows[:, :1])
        return cls(gaps.astype(float), first, later, earlier, both, np.array([product, square]))

    def new(self, correlation: Array) -> Array:
        """Sums (K, Z, Z) of products of the innovations (``whiten_ar1``)."""
        left = (correlation ** self.gaps[:, None])[:, :, None, None]
        later = (self.later - left * self.both + left**2 * self.earlier) / (1.0 - left**2)
        return np.asarray(self.first + later.sum(axis=0))


def _products(a: Array, b: Array) -> Array:
    return a.swapaxes(1, 2) @ b
