"""Residuals of one contact fitted to a segment of ticks."""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hypotheses.evidence import residual_noise
from contact_tracker.hypotheses.window_fit import fit_window
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS
from contact_tracker.tracking.state import scales_of
from contact_tracker_lab.calibration.tick_stream import MOVING, Observed, runs

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SHORTEST_TICKS: Final = 15
"""Least number of ticks with motion; fewer carry too little information beside the fitted geometry."""
MARGIN_TICKS: Final = 1
"""Ticks left out at either end, which may hold frames of both sides of a change."""
CLIP: Final = 3.0
"""Standard deviations beyond which the weight of a residual falls, since a bounce is no contact."""
STEP: Final = 1e-6
"""Step of finite differences, in rad and m."""


@dataclass(frozen=True, eq=False)
class ContactSegment:
    """A contact (``column``) with geometry ``x`` (S,) on the moving ticks of ``window``.

    The variances of the window are the sensor's alone.
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


def fit_contact_segments(observed: Observed, label: Ints, model: Model) -> list[ContactSegment]:
    """Fit each run of one contact in ``label`` (T,) that is long enough."""
    segments = []
    for column, first, end in runs(label):
        first, end = first + MARGIN_TICKS, end - MARGIN_TICKS
        moving = first + np.flatnonzero(observed.activity[first:end] >= MOVING)
        if column < len(CONTACTS) and len(moving) >= SHORTEST_TICKS:
            window = replace(observed.window.pick(moving), index=np.arange(len(moving)))
            contact, scales = CONTACT_MODELS[column], scales_of(model)
            noisy = window.with_error(_floors_sq(model)).with_error(
                model.noise.extra_contact_variance[column]
            )
            fitted = fit_window(contact, noisy, scales)
            segments.append(ContactSegment(column, window, fitted.x[0]))
    return segments


def refined(segment: ContactSegment, model: Model, steps: int) -> tuple[ContactSegment, Residuals]:
    """The segment with its geometry at the least (robust) whitened squares under the floors of ``model``."""
    contact = CONTACT_MODELS[segment.column]
    anchors = contact.anchors(segment.window.zeta[:, 9:12].mean(axis=0))
    pull = contact.family.SPREAD / model.geometry.reach_m**2
    place = contact.family.place(anchors)
    x = segment.x
    own = segment.window.with_error(model.noise.extra_contact_variance[segment.column])
    noisy = own.with_error(_floors_sq(model))

    def measured(many: Array) -> tuple[Array, Array, Array]:
        measurement = contact.measure(many, segment.window.zeta)
        return measurement.residual, residual_noise(measurement, noisy), measurement.lever_sq

    def cost(x: Array) -> float:
        residual, noise, _ = measured(x[None])
        beyond = np.maximum(residual**2 / noise / CLIP**2, 1.0)
        square = np.where(beyond > 1.0, CLIP**2 * (1.0 + np.log(beyond)), residual**2 / noise)
        return float(square.sum() + pull @ (x - place) ** 2)

    for _ in range(steps + 1):
        tangent = contact.family.tangent(x, anchors)
        residual, noise, lever_sq = (values[0] for values in measured(x[None]))
        noise = noise * np.maximum(residual**2 / noise / CLIP**2, 1.0)
        shifts = STEP * np.concatenate([tangent, -tangent], axis=1).T
        ahead, behind = np.split(measured(contact.family.normalise(x + shifts, anchors))[0], 2)
        slope = (ahead - behind) / (2.0 * STEP)  # (P, K, T)
        information = np.einsum("pkt,qkt,kt->pq", slope, slope, 1.0 / noise)
        covariance = np.linalg.inv(information + tangent.T @ (pull[:, None] * tangent))
        free = 1.0 - np.einsum("pkt,pq,qkt->kt", slope, covariance, slope) / noise
        found = Residuals(residual, own.variance, lever_sq, np.clip(free, 0.05, 1.0))
        gradient = np.einsum("pkt,kt->p", slope, residual / noise) + tangent.T @ (pull * (x - place))
        ahead_x = contact.family.normalise(x - tangent @ (covariance @ gradient), anchors)
        if not cost(ahead_x) < cost(x):
            break
        x = ahead_x
    return replace(segment, x=x), found


def _floors_sq(model: Model) -> tuple[float, float]:
    return model.noise.floor_position_m**2, model.noise.floor_rotation_rad**2
