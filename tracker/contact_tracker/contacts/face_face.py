"""f-f: a face with normal m in frame 1 stays in a face (n, h) of frame 2.

x = [m, n, h], residuals ``n . R b1``, ``n . R b2`` (b1, b2 span the face) and ``n . t - h`` (docs/theory.md,
T5). They vanish together with the paper's eq. (5). The offsets of the two faces are not observable, only
their difference: h is the height of the body's origin over the world's.
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
)
from contact_tracker.geometry import lifted_pose
from contact_tracker.geometry.elements import Element, Plane
from contact_tracker.geometry.linalg import EYE, sphere_tangent
from contact_tracker.states import Contact

M: Final = slice(0, 3)
N: Final = slice(3, 6)
H: Final = slice(6, 7)
ROWS: Final = Contact.FF.codimension
COLUMNS: Final = np.concatenate([lifted_pose.R, lifted_pose.T, lifted_pose.ONE])
FORM: Final = Form(d1=0, d2=3, h=6)
SIZE, PARAMETERS, SPREAD = FORM.size, FORM.parameters, FORM.spread
place, normalise, tangent = FORM.place, FORM.normalise, FORM.tangent
scale_sq, log_scale_sq_derivative = constant_scale_sq, constant_log_scale_sq_derivative
RANDOM_STARTS: Final = 4


def rows(x: Array) -> Array:
    m, n, h = x[..., M], x[..., N], x[..., H]
    b = sphere_tangent(m)
    out = np.zeros((*x.shape[:-1], ROWS, len(COLUMNS)))
    out[..., 0, :9] = outer(n, b[..., 0])
    out[..., 1, :9] = outer(n, b[..., 1])
    out[..., 2, 9:12] = n
    out[..., 2, 12] = -h[..., 0]
    return out


def rows_derivative(x: Array) -> Array:
    m, n = x[..., M], x[..., N]
    b = np.swapaxes(sphere_tangent(m), -1, -2)
    out = np.zeros((*x.shape[:-1], ROWS, SIZE, len(COLUMNS)))
    # turning m by delta turns b_k by -(delta . b_k) m; the rest of the turn stays in the face
    out[..., :2, M, :9] = -b[..., None] * outer(n, m)[..., None, None, :]
    out[..., :2, N, :9] = outer_derivative_first(b)
    out[..., 2, N, 9:12] = EYE
    out[..., 2, 6, 12] = -1.0
    return out


def starts(moments: Array) -> Array:
    """Singular pairs of the mean rotation: the normals of a lasting f-f contact have R m = n at all times."""
    mean = moments[..., :9, 12].reshape(*moments.shape[:-2], 3, 3)
    left, _, right = np.linalg.svd(mean)
    n = np.swapaxes(left, -1, -2)
    return np.concatenate([right, n, np.zeros_like(n[..., :1])], axis=-1)


def measure(x: Array, frames: Frames) -> Measurement:
    m, n, h = x[..., M], x[..., N], x[..., H]
    b = sphere_tangent(m)
    angles = [outer(n, b[..., k]) @ frames.rotation.T for k in range(2)]
    residual = np.stack([*angles, n @ frames.t.T - h], axis=1)
    zero = np.zeros((len(x), len(frames.t)))
    return Measurement(residual, zero, zero, frames.in_world(n))


def elements(x: Array, covariance: Array, reach_m: float) -> tuple[Element, Element]:
    """The faces through the body's origin, with the variance ``reach_m`` squared of their unknown offsets."""
    unknown = np.zeros((4, 4))
    unknown[3, 3] = reach_m**2
    of_m = np.zeros((4, 4))
    of_m[:3, :3] = covariance[M, M]
    return Plane(x[M], 0.0, of_m + unknown), Plane(x[N], float(x[6]), covariance[3:, 3:] + unknown)
