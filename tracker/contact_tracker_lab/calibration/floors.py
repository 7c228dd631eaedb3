"""Floors of the noise: deviations of real contacts from ideal ones, from residuals beyond the sensor's
noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2

from contact_tracker.config.parameters import Model
from contact_tracker.states import CONTACTS
from contact_tracker_lab.calibration.learned import value_of, with_value
from contact_tracker_lab.calibration.segment_residuals import CLIP, ContactSegment, Residuals, refined

Array = NDArray[np.float64]

FEWEST: Final = 100
"""Least number of residuals; with fewer a floor stays as it was."""
LEAST: Final = 1e-6
"""Floors (m, rad) below this count as zero."""
MOST: Final = 0.1
ROUNDS: Final = 8
FIRST_STEPS: Final = 6
CONVERGED: Final = 1e-3
_MEAN: Final = float(chi2.cdf(CLIP**2, 3) + CLIP**2 * chi2.sf(CLIP**2, 1))
"""Mean square of a standard normal variable clipped at ``CLIP``."""
POSITION: Final = "noise.floor_position_m"
ROTATION: Final = "noise.floor_rotation_rad"


@dataclass(frozen=True)
class Floor:
    """A floor (m or rad; None from too few residuals), the number of ``residuals``, and their
    ``contacts``."""

    key: str
    contacts: str
    value: float | None
    residuals: int


def learn_floors(
    model: Model, segments: Sequence[ContactSegment], keys: Sequence[str]
) -> tuple[Model, tuple[Floor, ...]]:
    """The floors ``keys`` at which clipped whitened squares have their expected mean.

    Fit and floors are refined in turns, so that the result does not depend on the floors of ``model``.

    Returns
    -------
    The model, and each floor overall and by contact.
    """
    segments, all_residuals = list(segments), []
    for turn in range(ROUNDS):
        before = model
        both = [refined(s, model, FIRST_STEPS if turn == 0 else 2) for s in segments]
        segments, all_residuals = [s for s, _ in both], [r for _, r in both]
        model = _solved(model, all_residuals, keys)
        if _moved(before, model) < CONVERGED:
            break
    floors = [Floor(key, "all", _of(model, all_residuals, key), _size(all_residuals, key)) for key in keys]
    for column, contact in enumerate(CONTACTS):
        mine = [r for s, r in zip(segments, all_residuals, strict=True) if s.column == column]
        floors += [
            Floor(key, contact.value, _of(model, mine, key), _size(mine, key))
            for key in keys
            if _size(mine, key)
        ]
    return model, tuple(floors)


def _solved(model: Model, all_residuals: Sequence[Residuals], keys: Sequence[str]) -> Model:
    for key in (ROTATION, POSITION):  # the floor of rotation enters distances
        value = _of(model, all_residuals, key) if key in keys else None
        if value is not None:
            model = with_value(model, key, value)
    return model


def _of(model: Model, all_residuals: Sequence[Residuals], key: str) -> float | None:
    """One floor, given the other."""
    if _size(all_residuals, key) < FEWEST:
        return None
    whitened_sq = _whitened_sq(model, all_residuals, key)
    return _root(lambda floor: float(np.mean(whitened_sq(floor))) - _MEAN)


def _whitened_sq(model: Model, all_residuals: Sequence[Residuals], key: str) -> Callable[[float], Array]:
    """Clipped whitened squares of all residuals that a floor applies to, as a function of it."""
    rows = [
        _angles(r) if key == ROTATION else _distances(r, model.noise.floor_rotation_rad)
        for r in all_residuals
    ]
    square, variance, free = (np.concatenate(column) for column in zip(*rows, strict=True))
    return lambda floor: np.minimum(square / (free * (variance + floor**2)), CLIP**2)


def excess_significance(model: Model, segments: Sequence[ContactSegment], key: str) -> float:
    """Standard errors by which residuals exceed the floors of ``model``; 0 with too few."""
    all_residuals = [refined(s, model, FIRST_STEPS)[1] for s in segments]
    if _size(all_residuals, key) < FEWEST:
        return 0.0
    found = _whitened_sq(model, all_residuals, key)(float(value_of(model, key)))
    return float((found.mean() - _MEAN) / (found.std() / np.sqrt(len(found)) + LEAST))


def _root(excess: Callable[[float], float]) -> float:
    if excess(LEAST) <= 0.0:
        return LEAST
    if excess(MOST) >= 0.0:
        return MOST
    return float(
        np.exp(brentq(lambda log: excess(float(np.exp(log))), np.log(LEAST), np.log(MOST), xtol=1e-4))
    )


def _angles(r: Residuals) -> tuple[Array, Array, Array]:
    """Squares, variances without the floor, and residual shares (1 - leverage) of all angles of a segment."""
    variance = np.broadcast_to(r.variance[:, 1], r.residual[:-1].shape)
    return r.residual[:-1].ravel() ** 2, variance.ravel(), r.free[:-1].ravel()


def _distances(r: Residuals, floor_rotation: float) -> tuple[Array, Array, Array]:
    """The same for all distances."""
    variance = r.variance[:, 0] + (r.variance[:, 1] + floor_rotation**2) * r.lever_sq
    return r.residual[-1] ** 2, variance, r.free[-1]


def _size(all_residuals: Sequence[Residuals], key: str) -> int:
    return sum(r.residual[:-1].size if key == ROTATION else r.residual[-1].size for r in all_residuals)


def _moved(before: Model, after: Model) -> float:
    pairs = (
        (before.noise.floor_position_m, after.noise.floor_position_m),
        (before.noise.floor_rotation_rad, after.noise.floor_rotation_rad),
    )
    return max(abs(a - b) / b for a, b in pairs)
