"""Operations on arrays of vectors (..., 3); on a small matrix by direct calls of LAPACK, as wrappers take
several times longer; medians; the damping of Gauss-Newton steps; and rotations.

Rotations are unit quaternions ``xyzw`` (..., 4), in few array operations, for the few poses of a tick, for
which SciPy spends most of the time on checks. The table of Hamilton's products yields the product, the matrix
of a rotation, and the rotation nearest to a matrix. ``q`` and ``-q`` are the same rotation.
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]

EYE: Final = np.eye(3)
ONE: Final = np.eye(1)
PARALLEL: Final = 1e-6
"""Sine of the angle below which two directions are parallel, and their common normal is not defined."""
LEAST_SHARE: Final = 1e-12
"""Curvature, or information, below this share of the largest is rounding errors."""
STEP: Final = 1e-6
"""Step of finite differences, in radians and metres."""


def dot(a: Array, b: Array) -> Array:
    """Inner products over the last axis."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def unit(v: Array) -> Array:
    """v scaled to length one along the last axis; zero stays zero."""
    return np.asarray(v / (np.sqrt(dot(v, v)) + TINY)[..., None])


def cross(a: Array, b: Array) -> Array:
    """Vector products (..., 3); ``np.cross`` takes several times as long for few vectors."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    out[..., 0] = ay * bz - az * by
    out[..., 1] = az * bx - ax * bz
    out[..., 2] = ax * by - ay * bx
    return out


def cross_matrix(v: Array) -> Array:
    """Matrices (..., 3, 3) with ``cross_matrix(v) @ w == cross(v, w)``."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out


def angle_of_lines(first: Array, second: Array) -> float:
    """Angle (rad, 0 to pi/2) between two unit vectors (3,) without regard to their senses."""
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), abs(first @ second)))


def sphere_tangent(n: Array) -> Array:
    """Two orthonormal directions (..., 3, 2) normal to unit vectors n (..., 3).

    Duff et al., Building an Orthonormal Basis, Revisited, JCGT 2017.
    """
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    out = np.empty((*n.shape, 2))
    out[..., 0, 0] = 1.0 + sign * x * x * a
    out[..., 1, 0] = sign * b
    out[..., 2, 0] = -sign * x
    out[..., 0, 1] = b
    out[..., 1, 1] = sign + y * y * a
    out[..., 2, 1] = -y
    return out


def solve(matrix: Array, right: Array) -> Array:
    """Solution (N, M) of a matrix (N, N) and right sides (N, M), as ``np.linalg.solve``."""
    *_, solution, info = lapack.dgesv(matrix, right)
    if info:
        raise _failed(info)
    return np.asarray(solution)


def eigenvalues(symmetric: Array) -> Array:
    """Eigenvalues (N,) of a symmetric matrix (N, N), as ``np.linalg.eigvalsh``."""
    values, _, info = lapack.dsyev(symmetric, compute_v=0)
    if info:
        raise _failed(info)
    return np.asarray(values)


def eigenvectors(symmetric: Array, against: Array | None = None) -> tuple[Array, Array]:
    """Rising eigenvalues (N,) and eigenvectors (N, N) of one or two matrices (N, N), as
    ``scipy.linalg.eigh``.
    """
    if against is None:
        values, vectors, info = lapack.dsyevd(symmetric, lower=1)
    else:
        values, vectors, info = lapack.dsygvd(symmetric, against)
    if info:
        raise _failed(info)
    return values, vectors


def median(values: NDArray[np.generic]) -> NDArray[np.float64]:
    """Median along the first axis, as ``np.median``, but several times faster for few values."""
    rising, count = np.sort(values, axis=0), len(values)
    return np.asarray(0.5 * rising[(count - 1) // 2] + 0.5 * rising[count // 2])


def _failed(info: int) -> np.linalg.LinAlgError:
    return np.linalg.LinAlgError(f"LAPACK's info is {info}")


DAMPING_DECREASE: Final = 0.2
DAMPING_INCREASE: Final = 8.0
LEAST_DAMPING: Final = 1e-12
MOST_DAMPING: Final = 1.0 / LEAST_DAMPING
"""Factors and bounds of the damping (usual values): half and double of both factors in fits of hypotheses
change one label in 32 s of motion."""


def adapted(damping: NDArray[np.float64], is_better: ArrayLike) -> NDArray[np.float64]:
    """The damping (...) of the next step, by whether this step was an improvement (...)."""
    factor = np.where(is_better, DAMPING_DECREASE, DAMPING_INCREASE)
    return np.asarray(np.minimum(np.maximum(damping * factor, LEAST_DAMPING), MOST_DAMPING))


_CONJUGATE: Final = np.array([-1.0, -1.0, -1.0, 1.0])
TINY: Final = 1e-300
"""Number added to a divisor that may be zero, together with the dividend."""
_PRODUCT: Final = np.zeros((4, 4, 4))
"""Element [i, j, k] is the coefficient of unit k in Hamilton's product of the units i and j."""
_PRODUCT[:3, :3, :3], _PRODUCT[range(3), range(3), 3] = np.cross(EYE[:, None], EYE), -1.0
_PRODUCT[3] = _PRODUCT[:, 3] = np.eye(4)
# x_world = q x_body q*: element [i, j, a, b] is the coefficient of q_i q_j in the matrix element (a, b).
_MATRIX: Final = np.einsum("ibm,mja,j->ijab", _PRODUCT[:, :3], _PRODUCT[:, :, :3], _CONJUGATE)
_PRODUCT_ROWS: Final = _PRODUCT.reshape(16, 4)
_BETWEEN_ROWS: Final = (_CONJUGATE[:, None, None] * _PRODUCT).reshape(16, 4)
_MATRIX_ROWS: Final = _MATRIX.reshape(16, 9)
_QUADRATIC: Final = (0.5 * (_MATRIX + _MATRIX.swapaxes(0, 1))).reshape(16, 9)


def product(first: Array, second: Array) -> Array:
    """Quaternions (..., 4) of the rotation ``second`` followed by ``first``."""
    pairs = first[..., :, None] * second[..., None, :]
    return np.asarray(pairs.reshape(*pairs.shape[:-2], 16) @ _PRODUCT_ROWS)


def between(first: Array, second: Array) -> Array:
    """Quaternions (..., 4) of the rotation from ``first`` to ``second``, in the axes of ``first``."""
    pairs = first[..., :, None] * second[..., None, :]
    return np.asarray(pairs.reshape(*pairs.shape[:-2], 16) @ _BETWEEN_ROWS)


def matrices(quat: Array) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) of any norm but zero."""
    pairs = (quat[..., :, None] * quat[..., None, :]).reshape(*quat.shape[:-1], 16)
    rows = pairs @ _MATRIX_ROWS / np.einsum("...i,...i", quat, quat)[..., None]
    return np.asarray(rows.reshape(*quat.shape[:-1], 3, 3))


def rotation_vectors(quat: Array) -> Array:
    """Rotation vectors (..., 3), in rad, of at most half a turn."""
    vector, cosine = quat[..., :3], quat[..., 3]
    sine = np.sqrt(np.einsum("...i,...i", vector, vector)) + TINY
    scale = np.copysign(2.0 / sine, cosine) * np.arctan2(sine, np.abs(cosine))
    return np.asarray(vector * scale[..., None])


def from_rotation_vectors(vector: Array) -> Array:
    """Unit quaternions (..., 4) of rotation vectors (..., 3)."""
    half = 0.5 * np.sqrt(np.einsum("...i,...i", vector, vector)) + TINY
    scale = 0.5 * np.sin(half) / half
    return np.concatenate([vector * scale[..., None], np.cos(half)[..., None]], axis=-1)


def nearest(matrix: Array) -> Array:
    """Unit quaternion (4,) of the rotation nearest to any ``matrix`` (3, 3), such as a mean of rotations.

    It maximises the trace of its product with ``matrix``, a quadratic form of the quaternion (Davenport's
    q-method).
    """
    return eigenvectors((_QUADRATIC @ matrix.ravel()).reshape(4, 4))[1][:, 3]
