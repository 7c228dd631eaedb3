"""e-f: an edge (d, q) of frame 1 stays on a face (n, h) of frame 2. f-e is its mirror.

x = [d, q, n, h] with d . q = 0 (q is the foot of the line), residuals ``n . R d`` and ``n . (R q + t) - h``
(docs/theory.md, T4). They vanish together with the paper's eq. (10), which weights the angle (T9).
"""

from typing import Final

import numpy as np

from contact_tracker.contacts import face_face, vertex_face
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
)
from contact_tracker.geometry import lifted_pose
from contact_tracker.geometry.elements import Element, Line, Plane
from contact_tracker.geometry.linalg import EYE, dot
from contact_tracker.states import Contact

D: Final = slice(0, 3)
Q: Final = slice(3, 6)
N: Final = slice(6, 9)
H: Final = slice(9, 10)
ROWS: Final = Contact.EF.codimension
COLUMNS: Final = np.concatenate([lifted_pose.R, lifted_pose.T, lifted_pose.ONE])
FORM: Final = Form(d1=0, q1=3, d2=6, h=9)
SIZE, PARAMETERS, SPREAD = FORM.size, FORM.parameters, FORM.spread
place, normalise, tangent = FORM.place, FORM.normalise, FORM.tangent
scale_sq, log_scale_sq_derivative = constant_scale_sq, constant_log_scale_sq_derivative
RANDOM_STARTS: Final = vertex_face.RANDOM_STARTS


def rows(x: Array) -> Array:
    d, q, n, h = x[..., D], x[..., Q], x[..., N], x[..., H]
    angle = np.concatenate([outer(n, d), np.zeros((*x.shape[:-1], 4))], axis=-1)
    distance = np.concatenate([outer(n, q), n, -h], axis=-1)
    return np.stack([angle, distance], axis=-2)


def rows_derivative(x: Array) -> Array:
    d, q, n = x[..., D], x[..., Q], x[..., N]
    out = np.zeros((*x.shape[:-1], ROWS, SIZE, len(COLUMNS)))
    by_second = outer_derivative_second(n)
    out[..., 0, D, :9] = by_second
    out[..., 0, N, :9] = outer_derivative_first(d)
    out[..., 1, Q, :9] = by_second
    out[..., 1, N, :9] = outer_derivative_first(q)
    out[..., 1, N, 9:12] = EYE
    out[..., 1, 9, 12] = -1.0
    return out


def starts(moments: Array) -> Array:
    """Faces of the relaxed v-f problem and of the mean rotation, each with the edge nearest to it."""
    n = np.concatenate(
        [vertex_face.starts(moments)[..., vertex_face.N], face_face.starts(moments)[..., face_face.N]],
        axis=-2,
    )
    leading = moments.shape[:-2]
    # sum over i, k of n_i n_k M_ijkl: square by which each direction of frame 1 leaves the face
    by_pair = moments[..., :9, :9].reshape(*leading, 3, 3, 3, 3).swapaxes(-3, -2).reshape(*leading, 9, 9)
    spread = (outer(n, n) @ by_pair).reshape(*n.shape, 3)
    d = np.linalg.eigh(spread)[1][..., 0]
    return np.concatenate([d, np.zeros_like(d), n, np.zeros_like(n[..., :1])], axis=-1)


def measure(x: Array, frames: Frames) -> Measurement:
    d, q, n, h = x[..., D], x[..., Q], x[..., N], x[..., H]
    n_r_d = outer(n, d) @ frames.rotation.T
    n_r_q = outer(n, q) @ frames.rotation.T
    n_t = n @ frames.t.T
    o = frames.body_origin
    # s: where on the line the body's origin is nearest; there angle and distance have independent noise
    s = d @ o.T - dot(d, q)[:, None]
    reach_sq = dot(q, q)[:, None] - 2.0 * q @ o.T + dot(o, o) - s**2
    height = n_r_q + s * n_r_d + (0.0 if frames.body_in_1 else n_t)
    residual = np.stack([n_r_d, n_r_q + s * n_r_d + n_t - h], axis=1)
    return Measurement(residual, np.maximum(reach_sq - height**2, 0.0), reach_sq, frames.in_world(n))


def elements(x: Array, covariance: Array, reach_m: float) -> tuple[Element, Element]:
    line = Line(x[D], x[Q], covariance[:6, :6])
    return line, Plane(x[N], float(x[9]), covariance[6:, 6:])
