"""e-e: an edge (d1, q1) of frame 1 crosses an edge (d2, q2) of frame 2.

x = [d1, q1, d2, q2] with d . q = 0, residual ``d2 . R m1 + m2 . R d1 + d2 . [t]x R d1`` with m = q x d: the
paper's volume (18). ``rows`` are the coefficients of the volume. ``measure`` divides it by the sine of the
crossing angle at each pose: the distance of the two lines in metres, which is not small merely because lines
are nearly parallel (docs/theory.md, T6).
"""

from typing import Final

import numpy as np

from contact_tracker.contacts.family import (
    Array,
    Form,
    Frames,
    Measurement,
    outer,
    outer_derivative_first,
    outer_derivative_second,
    smallest_directions,
)
from contact_tracker.geometry import lifted_pose
from contact_tracker.geometry.elements import Element, Line
from contact_tracker.geometry.linalg import PARALLEL, TINY, cross, dot
from contact_tracker.states import Contact

D1: Final = slice(0, 3)
Q1: Final = slice(3, 6)
D2: Final = slice(6, 9)
Q2: Final = slice(9, 12)
LINE1: Final = slice(0, 6)
LINE2: Final = slice(6, 12)
ROWS: Final = Contact.EE.codimension
COLUMNS: Final = np.concatenate([lifted_pose.R, lifted_pose.TXR, lifted_pose.ONE])
FORM: Final = Form(d1=0, q1=3, d2=6, q2=9)
SIZE, PARAMETERS, SPREAD = FORM.size, FORM.parameters, FORM.spread
place, normalise, tangent = FORM.place, FORM.normalise, FORM.tangent
RANDOM_STARTS: Final = 75
SINE_SQ_FLOOR: Final = PARALLEL**2
"""Against division by zero only. With a larger floor the distance of edges that are nearly parallel shrinks:
two along a straight slide would then explain it best."""
STARTS: Final = 6


def rows(x: Array) -> Array:
    d1, q1, d2, q2 = x[..., D1], x[..., Q1], x[..., D2], x[..., Q2]
    on_r = outer(d2, cross(q1, d1)) + outer(cross(q2, d2), d1)
    return np.concatenate([on_r, outer(d2, d1), np.zeros_like(x[..., :1])], axis=-1)[..., None, :]


def rows_derivative(x: Array) -> Array:
    lines = _lines(x)
    by_line = (lines @ _MOMENT).reshape(*lines.shape, 3)
    d = lines[..., None, :3]
    m = d @ by_line[..., :3, :]
    d1, d2, m1, m2 = d[..., 0, :, :], d[..., 1, :, :], m[..., 0, :, :], m[..., 1, :, :]
    out = np.zeros((*x.shape[:-1], ROWS, SIZE, len(COLUMNS)))
    out[..., 0, LINE1, :9] = outer(d2, by_line[..., 0, :, :]) + outer(m2, _DIRECTION)
    out[..., 0, LINE1, 9:18] = outer(d2, _DIRECTION)
    out[..., 0, LINE2, :9] = outer(by_line[..., 1, :, :], d1) + outer(_DIRECTION, m1)
    out[..., 0, LINE2, 9:18] = outer(_DIRECTION, d1)
    return out


def scale_sq(x: Array, moments: Array) -> Array:
    """Squared sine of the mean crossing angle: the volume is the distance times the sine."""
    return np.asarray(np.maximum(1.0 - _cosine(x, moments) ** 2, SINE_SQ_FLOOR))


def log_scale_sq_derivative(x: Array, moments: Array) -> Array:
    d1, d2 = x[..., D1], x[..., D2]
    by_r = -2.0 * _cosine(x, moments)[..., None] * _mean_rotation(moments)
    scale = scale_sq(x, moments)[..., None]
    by_r = np.where(scale > SINE_SQ_FLOOR, by_r / scale, 0.0)
    out = np.zeros_like(x)
    out[..., D1] = np.einsum("...sc,...c->...s", outer_derivative_second(d2), by_r)
    out[..., D2] = np.einsum("...sc,...c->...s", outer_derivative_first(d1), by_r)
    return out


def starts(moments: Array) -> Array:
    """The pairs of lines nearest to the smallest directions of the relaxed problem."""
    relaxed = smallest_directions(moments[..., :18, :18], slice(9, 18))
    c = np.swapaxes(relaxed, -1, -2)[..., :STARTS, :]
    left, _, right = np.linalg.svd(c.reshape(*c.shape[:-1], 3, 3))
    zero = np.zeros((*c.shape[:-1], 3))
    return np.concatenate([right[..., 0, :], zero, left[..., 0], zero], axis=-1)


def measure(x: Array, frames: Frames) -> Measurement:
    d1, q1, d2, q2 = x[..., D1], x[..., Q1], x[..., D2], x[..., Q2]
    rotation, t, u = frames.rotation.T, frames.t.T, frames.u.T
    m1 = cross(q1, d1)
    d2_r_m1 = outer(d2, m1) @ rotation
    volume = d2_r_m1 + outer(cross(q2, d2), d1) @ rotation + outer(d2, d1) @ frames.t_cross_r.T
    cosine = outer(d2, d1) @ rotation
    sine_sq = np.maximum(1.0 - cosine**2, SINE_SQ_FLOOR)
    # gap w = R q1 + t - q2 along both directions, then the touching point q1 + s d1
    w_d1 = dot(q1, d1)[:, None] + d1 @ u - outer(q2, d1) @ rotation
    w_d2 = outer(d2, q1) @ rotation + d2 @ t - dot(d2, q2)[:, None]
    s = (cosine * w_d2 - w_d1) / sine_sq
    reach_sq = dot(q1, q1)[:, None] + 2.0 * s * dot(q1, d1)[:, None] + s**2
    height_sq = d2_r_m1**2 / sine_sq
    sine = np.sqrt(sine_sq)
    residual = (volume / sine)[:, None, :]
    d1_in_2 = (frames.rotation.reshape(-1, 3, 3) @ d1.T).transpose(2, 0, 1)
    along = cross(d1_in_2, d2[:, None, :]) / sine[..., None]
    return Measurement(residual, np.maximum(reach_sq - height_sq, 0.0), reach_sq, along)


def elements(x: Array, covariance: Array, reach_m: float) -> tuple[Element, Element]:
    line1, line2 = Line(x[D1], x[Q1], covariance[:6, :6]), Line(x[D2], x[Q2], covariance[6:, 6:])
    return line1, line2


def _cosine(x: Array, moments: Array) -> Array:
    """Mean cosine (...) of the crossing angle."""
    return dot(outer(x[..., D2], x[..., D1]), _mean_rotation(moments))


def _mean_rotation(moments: Array) -> Array:
    """Mean of vec R (..., 9), from the last row of moments (..., C, C)."""
    return np.asarray(moments[..., 18, :9] / np.maximum(moments[..., 18, 18, None], TINY))


def _lines(x: Array) -> Array:
    """Both lines (d, q), (..., 2, 6)."""
    return x.reshape(*x.shape[:-1], 2, 6)


def _by_line() -> Array:
    """Second derivative (6, 18) of m = q x d by a line (d, q): by one entry, of the derivative (6, 3)."""
    out, eye = np.zeros((6, 6, 3)), np.eye(3)
    out[3:, :3] = np.cross(eye[:, None], eye)
    out[:3, 3:] = np.cross(eye, eye[:, None])
    return out.reshape(6, 18)


_MOMENT: Final = _by_line()
_DIRECTION: Final = np.eye(6, 3)
"""The derivative of d by the line."""
