"""Direct search of the log-loss for parameters without a closed form, one by one, on a logarithmic scale."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar

from contact_tracker.config.loading import limits
from contact_tracker.config.parameters import Model
from contact_tracker_lab.calibration.learned import rounded, value_of, with_value

EVALUATIONS: Final = 7
"""Evaluations of the loss per parameter; each is a pass over all recordings."""
FACTOR: Final = 5.0
"""A value is searched within this factor of where it was."""
WORTH: Final = 1e-3
"""A parameter is changed only if the loss falls by more than this share."""


@dataclass(frozen=True)
class Searched:
    """A parameter's loss (nats) before and after, and all (value, loss) that were tried."""

    key: str
    before: float
    after: float
    tried: tuple[tuple[float, float], ...]


def coordinate_search(
    model: Model, keys: Sequence[str], loss: Callable[[Model], float]
) -> tuple[Model, tuple[Searched, ...]]:
    """Lower ``loss`` along each of ``keys`` in turn; a parameter stays if the gain is too small."""
    searched = []
    best = loss(model) if keys else 0.0
    for key in keys:
        start = float(value_of(model, key))
        low, high = limits(key)
        bounds = (np.log(max(start / FACTOR, low * 1.01)), np.log(min(start * FACTOR, high * 0.99)))
        tried = _tried(model, key, loss, bounds)
        value, least = min(tried, key=lambda pair: pair[1])
        before = best
        if least < best * (1.0 - WORTH):
            model, best = with_value(model, key, value), least
        searched.append(Searched(key, before, best, ((start, before), *tried)))
    return model, tuple(searched)


def _tried(
    model: Model, key: str, loss: Callable[[Model], float], bounds: tuple[float, float]
) -> list[tuple[float, float]]:
    tried: list[tuple[float, float]] = []

    def at(log_value: float) -> float:
        value = rounded(float(np.exp(log_value)))
        tried.append((value, loss(with_value(model, key, value))))
        return tried[-1][1]

    options = {"maxiter": EVALUATIONS, "xatol": 0.05}
    minimize_scalar(at, bounds=bounds, method="bounded", options=options)
    return tried
