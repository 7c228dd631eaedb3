"""Damping of Gauss-Newton steps (Levenberg-Marquardt): less after a step that lowers the cost, else more."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

DAMPING_DECREASE: Final = 0.2
DAMPING_INCREASE: Final = 8.0
LEAST_DAMPING: Final = 1e-12
MOST_DAMPING: Final = 1e12
"""Usual values: in fits of hypotheses half and double of both factors change one label in 32 s of motion."""


def adapted(damping: NDArray[np.float64], better: ArrayLike) -> NDArray[np.float64]:
    """The damping (...) of the next step, by whether this one was ``better`` (...) than none."""
    factor = np.where(better, DAMPING_DECREASE, DAMPING_INCREASE)
    return np.clip(damping * factor, LEAST_DAMPING, MOST_DAMPING)
