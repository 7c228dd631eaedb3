"""v-f: a vertex q of frame 1 stays on a face (n, h) of frame 2. f-v is its mirror.

x = [q, n, h], residual ``n . (R q + t) - h`` (docs/theory.md, T3; the paper's eq. (15), its sign corrected).
"""

from typing import Final

import numpy as np

from contact_tracker.contacts.family import (
    Array,
    Form,
    Frames,
    Measurement,
    constant_log_scale_sq_derivative,
    constant_scale_sq,
    outer,
    outer_derivative_first,
    outer_derivative_second,
    smallest_directions,
)
from contact_tracker.geometry import lifted_pose
from contact_tracker.geometry.elements import Element, Plane, Point
from contact_tracker.geometry.linalg import EYE, dot, unit
from contact_tracker.states import Contact

Q: Final = slice(0, 3)
N: Final = slice(3, 6)
H: Final = slice(6, 7)
ROWS: Final = Contact.VF.codimension
COLUMNS: Final = np.concatenate([lifted_pose.R, lifted_pose.T, lifted_pose.ONE])
FORM: Final = Form(q1=0, d2=3, h=6)
SIZE, PARAMETERS, SPREAD = FORM.size, FORM.parameters, FORM.spread
place, normalise, tangent = FORM.place, FORM.normalise, FORM.tangent
scale_sq, log_scale_sq_derivative = constant_scale_sq, constant_log_scale_sq_derivative
RANDOM_STARTS: Final = 24


def rows(x: Array) -> Array:
    q, n, h = x[..., Q], x[..., N], x[..., H]
    return np.concatenate([outer(n, q), n, -h], axis=-1)[..., None, :]


def rows_derivative(x: Array) -> Array:
    q, n = x[..., Q], x[..., N]
    out = np.zeros((*x.shape[:-1], ROWS, SIZE, len(COLUMNS)))
    out[..., 0, Q, :9] = outer_derivative_second(n)
    out[..., 0, N, :9] = outer_derivative_first(q)
    out[..., 0, N, 9:12] = EYE
    out[..., 0, 6, 12] = -1.0
    return out


def starts(moments: Array) -> Array:
    c = np.swapaxes(smallest_directions(moments, slice(9, 12)), -1, -2)
    n = unit(c)
    return np.concatenate([np.zeros_like(n), n, np.zeros_like(n[..., :1])], axis=-1)


def measure(x: Array, frames: Frames) -> Measurement:
    q, n, h = x[..., Q], x[..., N], x[..., H]
    n_r_q = outer(n, q) @ frames.rotation.T
    n_t = n @ frames.t.T
    residual = n_r_q + n_t - h
    o = frames.body_origin
    reach_sq = dot(q, q)[:, None] - 2.0 * q @ o.T + dot(o, o)
    # n . R (q - o), where -R o is 0 or t
    height = n_r_q if frames.body_in_1 else n_r_q + n_t
    lever_sq = np.maximum(reach_sq - height**2, 0.0)
    return Measurement(residual[:, None, :], lever_sq, reach_sq, frames.in_world(n))


def elements(x: Array, covariance: Array, reach_m: float) -> tuple[Element, Element]:
    plane = Plane(x[N], float(x[6]), covariance[3:, 3:])
    return Point(x[Q], covariance[Q, Q]), plane
