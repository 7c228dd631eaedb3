"""How large the errors of a stretch are, and how much of each is left in the next tick, told by its residuals
(docs/theory.md, T26).
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEARNING_STEPS: Final = 15
"""Of expectation-maximisation."""
PRIOR_TICKS: Final = 1.0
"""Weight of the noise as it was believed against that of the residuals."""
MOST_CORRELATION: Final = 0.95
LEAST_SCALE: Final = 1e-6
LEAST_SHARE: Final = 1e-12


class Ar1Noise(NamedTuple):
    """Errors of the K residuals: an autoregressive process of order one from tick to tick."""

    weight: Array
    """(K,) how much smaller their variances are than believed, as a factor of precision."""
    correlation: Array
    """(K,) from one tick to the next."""


def estimate_ar1(
    errors: Ar1Noise, whitened: Array, jacobian: Array, prior_information: Array, index: Index
) -> Ar1Noise:
    """What whitened residuals (K, W) at a minimum say of their errors, by expectation-maximisation.

    Errors are not residuals: the fit has taken from them what looks like geometry. How much follows from the
    ``jacobian`` (K, W, P) and the ``prior_information`` (P, P). With too few ticks the estimate stays as it
    was.
    """
    (weight, echo), count = errors, whitened.shape[1]
    sums = _Sums.of(np.concatenate([jacobian, whitened[..., None]], axis=2), index)
    new = sums.new(echo)
    for _ in range(LEARNING_STEPS):
        eigenvalues, eigenvectors = np.linalg.eigh(
            np.einsum("k,kpq->pq", weight, new[:, :-1, :-1]) + prior_information
        )
        determined = eigenvalues > LEAST_SHARE * eigenvalues[-1]
        # of products of errors are expected those of the residuals, and of what the fit may have taken
        taken = np.eye(len(eigenvalues) + 1)
        taken[:-1, :-1] = (eigenvectors[:, determined] / eigenvalues[determined]) @ eigenvectors[
            :, determined
        ].T
        product, square = np.einsum("ikpq,pq->ik", sums.pairs, taken)
        echo = np.minimum(np.maximum(product / np.maximum(square, LEAST_SCALE), 0.0), MOST_CORRELATION)
        new = sums.new(echo)
        variance = np.maximum(np.einsum("kpq,pq->k", new, taken) / count, LEAST_SCALE)
        weight = variance ** (-count / (count + PRIOR_TICKS))
    return Ar1Noise(weight, echo)


def whiten_ar1(rows: Array, echo: Array, index: Index) -> Array:
    """What is new in each tick of rows (K, W, ...), in units of what that usually is."""
    left = echo[:, None] ** np.diff(index)
    left = left.reshape(*left.shape, *(1,) * (rows.ndim - 2))
    later = (rows[:, 1:] - left * rows[:, :-1]) / np.sqrt(1.0 - left**2)
    return np.concatenate([rows[:, :1], later], axis=1)


class _Sums(NamedTuple):
    """Sums (K, Z, Z) over ticks of products of rows (K, W, Z): all that is asked of them, however many.

    Of the ``first`` tick; of neighbours that are each of G ``gaps`` apart, of the ``later`` and the
    ``earlier`` ones, and of ``both`` in either order (G, K, Z, Z). Of ``pairs`` right after each other the
    mean (2, K, Z, Z) product and, of the same ticks, square: other ticks only add their own scatter.
    """

    gaps: Array
    first: Array
    later: Array
    earlier: Array
    both: Array
    pairs: Array

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

    def new(self, echo: Array) -> Array:
        """Sums (K, Z, Z) of products of what is ``whiten_ar1`` the rows."""
        left = (echo ** self.gaps[:, None])[:, :, None, None]
        later = (self.later - left * self.both + left**2 * self.earlier) / (1.0 - left**2)
        return np.asarray(self.first + later.sum(axis=0))


def _products(a: Array, b: Array) -> Array:
    return a.swapaxes(1, 2) @ b
