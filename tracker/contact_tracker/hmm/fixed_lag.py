"""Fixed-lag smoothing: the posterior of the state L ticks ago, given all data until now.

Each hypothesis carries its *past*: the probabilities of the states at the last L ticks, given that it holds.
A new one inherits the mixture of the pasts of its possible predecessors (docs/theory.md). Only arrays here.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def inherited(past: Array, log_left: Array, log_transition: Array) -> Array:
    """Past (N, L, N) of births in each state, from the pasts ``past`` (N, L, N) of the states that are
    left."""
    if not past.shape[1]:
        return past
    log_weight = log_left[:, None] + log_transition
    weight = np.exp(log_weight - log_weight.max(axis=0))
    return np.asarray(np.einsum("ij,ils->jls", weight / weight.sum(axis=0), past))


def grown(past: Array, state: int) -> Array:
    """Pasts (..., L, N) extended by a tick in ``state``."""
    if not past.shape[-2]:
        return past
    now = np.zeros((*past.shape[:-2], 1, past.shape[-1]))
    now[..., state] = 1.0
    return np.concatenate([past[..., 1:, :], now], axis=-2)


def mixed(past: Array, log_weight: Array) -> Array:
    """Mean past (L, N) of hypotheses' pasts (H, L, N), weighted by log weights (H,); zero without any."""
    if not past.size:
        return np.zeros(past.shape[1:])
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(np.einsum("h,hls->ls", weight / weight.sum(), past))
