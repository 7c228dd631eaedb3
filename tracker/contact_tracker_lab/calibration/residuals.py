"""Deviations of real contacts from ideal ones, from residuals of contacts fitted to segments of ticks.

Floors of the noise explain the residuals of all contacts beyond the sensor's noise; further errors explain
those of single contacts beyond the floors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2

from contact_tracker.arrays import Array, Ints
from contact_tracker.config.parameters import ZERO, Model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.evidence import residual_noise
from contact_tracker.motion.poses import Poses, batches
from contact_tracker.motion.tick_averaging import tick_variances
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS
from contact_tracker.tracking.contact_filter import ticks_of
from contact_tracker.tracking.state import scales_of
from contact_tracker_lab.calibration.parameters import rounded, value_of, with_value
from contact_tracker_lab.calibration.transitions import runs
from contact_tracker_lab.calibration.trellis import window_of

MOVING: Final = 0.5
"""Least activity of a tick that counts as motion."""
SHORTEST_TICKS: Final = 15
"""Least number of ticks with motion; fewer have too little information beside the fitted geometry."""
MARGIN_TICKS: Final = 1
"""Number of ticks left out at either end, as they may have frames of both sides of a change."""
CLIP: Final = 3.0
"""Standard deviations from which the weight of a residual decreases, since a bounce is no contact."""
_MEAN: Final = float(chi2.cdf(CLIP**2, 3) + CLIP**2 * chi2.sf(CLIP**2, 1))
"""Mean square of a standard normal variable clipped at ``CLIP``."""
FEWEST: Final = 100
"""Least number of residuals; with fewer a floor stays unchanged."""
LEAST: Final = 1e-6
"""Floors (m, rad) below this count as zero."""
MOST: Final = 0.1
ROUNDS: Final = 8
CONVERGED: Final = 1e-3
SHOWN: Final = 5.0
"""Standard errors by which residuals of a contact must exceed the common floor; many, since neighbours are
correlated."""
POSITION: Final = "noise.floor_position_m"
ROTATION: Final = "noise.floor_rotation_rad"
FLOOR_OF: Final = {"noise.contact_position_m": POSITION, "noise.contact_rotation_rad": ROTATION}


@dataclass(frozen=True, eq=False)
class Observed:
    """T ticks of a recording, independent of hypotheses.

    ``middle_ns`` (T,); ``window``: all ticks, with variances of the sensor only, from the noise
    ``sigma_position_m``, ``sigma_rotation_rad`` of the whole stream; ``activity`` (T,) as in the tracker.
    """

    middle_ns: Ints
    window: Window
    activity: Array
    sigma_position_m: float
    sigma_rotation_rad: float


def observe(poses: Poses, model: Model) -> Observed:
    """Average poses (at least one) into ticks as the tracker does."""
    ticks = list(ticks_of(batches(poses), model))
    window, count = window_of(ticks, model), np.array([float(tick.count) for tick in ticks])
    sigma = np.array([ticks[-1].noise.sigma_position_m, ticks[-1].noise.sigma_rotation_rad])
    sensor = sigma**2 / np.maximum(count, 1.0)[:, None]
    as_tracked = [tick_variances(tick.noise, n, model) for tick, n in zip(ticks, count, strict=True)]
    activity = replace(window, variance=np.array(as_tracked)).motion_ratio
    middle = np.array([(tick.start_ns + tick.stamp_ns) // 2 for tick in ticks], np.int64)
    window = replace(window, variance=sensor, position_anisotropy=None)
    return Observed(middle, window, activity, float(sigma[0]), float(sigma[1]))


@dataclass(frozen=True, eq=False)
class ContactSegment:
    """A contact (``column``) with geometry ``x`` (S,) in the moving ticks of ``window``.

    The variances of the window are those of the sensor.
    """

    column: int
    window: Window
    x: Array


class Residuals(NamedTuple):
    """Residuals of one segment: ``residual`` (K, T), angles first and one distance last; the ``variance`` (T,
    2) of sensor and contact without the floor; ``lever_sq`` (T,); ``free`` (K, T), one minus the leverage of
    each.
    """

    residual: Array
    variance: Array
    lever_sq: Array
    free: Array

    def of(self, key: str, model: Model) -> tuple[Array, Array, Array]:
        """Squares, variances without the floor ``key``, and ``free`` of the residuals with this floor: angles
        have that of rotation, distances that of position, and by their lever that of rotation."""
        if key == ROTATION:
            variance = np.tile(self.variance[:, 1], len(self.residual) - 1)
            return self.residual[:-1].ravel() ** 2, variance, self.free[:-1].ravel()
        turned = (self.variance[:, 1] + model.noise.floor_rotation_rad**2) * self.lever_sq
        return self.residual[-1] ** 2, self.variance[:, 0] + turned, self.free[-1]


def fit_contact_segments(observed: Observed, label: Ints, model: Model) -> list[ContactSegment]:
    """Fit each run of one contact in ``label`` (T,) that is long enough."""
    segments = []
    for column, first, end in runs(label):
        first, end = first + MARGIN_TICKS, end - MARGIN_TICKS
        moving = first + np.flatnonzero(observed.activity[first:end] >= MOVING)
        if column < len(CONTACTS) and len(moving) >= SHORTEST_TICKS:
            window = replace(observed.window.pick(moving), index=np.arange(len(moving)))
            noisy = _with_errors(window, column, model)[1]
            x = fit_window(CONTACT_MODELS[column], noisy, scales_of(model)).x[0]
            segments.append(ContactSegment(column, window, x))
    return segments


def _with_errors(window: Window, column: int, model: Model) -> tuple[Window, Window]:
    """The window with the errors of its contact, without and with the floors."""
    noise = model.noise
    bare = window.with_error(noise.extra_contact_variance[column])
    return bare, bare.with_error((noise.floor_position_m**2, noise.floor_rotation_rad**2))


def refined(segment: ContactSegment, model: Model) -> tuple[ContactSegment, Residuals]:
    """The segment with its geometry at the least (robust) whitened squares under the floors of ``model``."""
    contact, family = CONTACT_MODELS[segment.column], CONTACT_MODELS[segment.column].family
    corrected, noisy = _with_errors(segment.window, segment.column, model)
    anchors = contact.anchors(segment.window.zeta[:, 9:12].mean(axis=0))
    pull, place = np.sqrt(family.SPREAD) / model.geometry.reach_m, family.place(anchors)
    tangent = family.tangent(segment.x, anchors)

    def geometry(step: Array) -> Array:
        return family.normalise((segment.x + tangent @ step)[None], anchors)

    def whitened(step: Array) -> Array:
        x = geometry(step)
        measurement = contact.measure(x, segment.window.zeta)
        residual = measurement.residual / np.sqrt(residual_noise(measurement, noisy))
        return np.concatenate([residual.ravel(), pull * (x[0] - place)])

    start = np.zeros(tangent.shape[1])
    fit = least_squares(whitened, start, loss=_clipped, f_scale=CLIP, x_scale="jac", xtol=1e-6)
    x = geometry(fit.x)
    residual, lever_sq = contact.measure(x, segment.window.zeta)[:2]
    leverage = np.einsum("np,pq,nq->n", fit.jac, np.linalg.inv(fit.jac.T @ fit.jac), fit.jac)
    free = np.clip(1.0 - leverage[: residual.size], 0.05, 1.0).reshape(residual[0].shape)
    return replace(segment, x=x[0]), Residuals(residual[0], corrected.variance, lever_sq[0], free)


def _clipped(square: Array) -> Array:
    """The loss of squares over ``CLIP`` squared, logarithmic above 1, with its two derivatives."""
    beyond = np.maximum(square, 1.0)
    second = np.where(square > 1.0, -1.0 / beyond**2, 0.0)
    return np.array([np.minimum(square, 1.0) + np.log(beyond), 1.0 / beyond, second])


class Floor(NamedTuple):
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
    segments, residuals = list(segments), []
    for _ in range(ROUNDS):
        previous = np.array([value_of(model, key) for key in keys])
        fits = [refined(segment, model) for segment in segments]
        segments, residuals = [s for s, _ in fits], [r for _, r in fits]
        for key in sorted(keys, reverse=True):  # the floor of rotation enters distances
            value = _solved(key, "", model, residuals).value
            model = model if value is None else with_value(model, key, value)
        updated = np.array([value_of(model, key) for key in keys])
        if np.all(np.abs(updated - previous) < CONVERGED * previous):
            break
    floors = [_solved(key, "all", model, residuals) for key in keys]
    for column, contact in enumerate(CONTACTS):
        selected = [r for s, r in zip(segments, residuals, strict=True) if s.column == column]
        floors += [_solved(key, contact.value, model, selected) for key in keys if selected]
    return model, tuple(floors)


def _solved(key: str, contacts: str, model: Model, residuals: Sequence[Residuals]) -> Floor:
    """The floor ``key``, given the other floor."""
    squares = _whitened_squares(key, model, residuals)
    size = len(squares(0.0))
    if size < FEWEST:
        return Floor(key, contacts, None, size)

    def excess(log_floor: float) -> float:
        return float(np.mean(squares(float(np.exp(log_floor))))) - _MEAN

    ends = np.log([LEAST, MOST])
    if excess(ends[0]) <= 0.0 or excess(ends[1]) >= 0.0:
        return Floor(key, contacts, LEAST if excess(ends[0]) <= 0.0 else MOST, size)
    return Floor(key, contacts, float(np.exp(brentq(excess, *ends, xtol=1e-4))), size)


def _whitened_squares(key: str, model: Model, residuals: Sequence[Residuals]) -> Callable[[float], Array]:
    """Clipped whitened squares of all residuals with the floor ``key``, as a function of the floor."""
    rows = [(np.empty(0), np.empty(0), np.empty(0)), *(residual.of(key, model) for residual in residuals)]
    square, variance, free = (np.concatenate(column) for column in zip(*rows, strict=True))
    return lambda floor: np.minimum(square / (free * (variance + floor**2)), CLIP**2)


def learn_contact_errors(model: Model, segments: Sequence[ContactSegment], keys: Sequence[str]) -> Model:
    """The errors ``keys`` of each contact: its own floor beyond the common one, in quadrature.

    They are zero for contacts with too few residuals, or whose residuals the common floor explains.
    """
    bare = model
    for key in keys:
        bare = model = with_value(bare, key, ZERO)
    for column in range(len(CONTACTS)) if keys else ():
        selected = [segment for segment in segments if segment.column == column]
        residuals = [refined(segment, bare)[1] for segment in selected]
        fitted, _ = learn_floors(bare, selected, [FLOOR_OF[key] for key in keys])
        for key in keys:
            common = value_of(bare, FLOOR_OF[key])
            beyond = value_of(fitted, FLOOR_OF[key]) ** 2 - common**2
            squares = _whitened_squares(FLOOR_OF[key], bare, residuals)(common)
            if len(squares) >= FEWEST and beyond > 0.0:
                standard_error = squares.std() / sqrt(len(squares)) + LEAST
                if squares.mean() - _MEAN > SHOWN * standard_error:
                    errors = list(value_of(model, key))
                    errors[column] = rounded(sqrt(beyond))
                    model = with_value(model, key, tuple(errors))
    return model
