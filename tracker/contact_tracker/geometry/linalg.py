"""Operations on arrays of vectors (..., 3); on a small matrix by direct calls of LAPACK, as wrappers take
several times longer; medians; and the damping of Gauss-Newton steps."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from contact_tracker.arrays import Array

EYE: Final = np.eye(3)
ONE: Final = np.eye(1)


def dot(a: Array, b: Array) -> Array:
    """Inner products over the last axis."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def unit(v: Array) -> Array:
    """v scaled to length one along the last axis."""
    return np.asarray(v / np.sqrt(dot(v, v))[..., None])


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
MOST_DAMPING: Final = 1e12
"""Factors and bounds of the damping (usual values): half and double of both factors in fits of hypotheses
change one label in 32 s of motion."""


def adapted(damping: NDArray[np.float64], is_better: ArrayLike) -> NDArray[np.float64]:
    """The damping (...) of the next step, by whether this step was an improvement (...)."""
    factor = np.where(is_better, DAMPING_DECREASE, DAMPING_INCREASE)
    return np.asarray(np.minimum(np.maximum(damping * factor, LEAST_DAMPING), MOST_DAMPING))
