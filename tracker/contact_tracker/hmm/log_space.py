"""Sums and maxima of log weights."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def log_sum_exp(values: Array, axis: int = -1) -> Array:
    """log of the sum of exponentials; -inf where all are -inf."""
    return np.asarray(np.logaddexp.reduce(values, axis=axis))


def by_state(values: Array, state: Index, states: int, best: bool = False) -> Array:
    """Log-sum (or maximum) of ``values`` (H,) over the hypotheses of each state, (states,)."""
    table = np.full((states, len(values)), -np.inf)
    table[state, np.arange(len(values))] = values
    return np.asarray(table.max(axis=1, initial=-np.inf)) if best else log_sum_exp(table)


def birth_log_weights(log_left: Array, log_transition: Array) -> Array:
    """Log birth weight (states,) of each state, from the log weights with which states are left."""
    return log_sum_exp(log_left[:, None] + log_transition, axis=0)
