"""Vectors of three numbers, many at once; one small matrix by direct calls of LAPACK, whose wrappers take
several times longer; medians; and the damping of Gauss-Newton steps."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]

EYE: Final = np.eye(3)
ONE: Final = np.eye(1)


def dot(a: Array, b: Array) -> Array:
    """Inner products over the last axis."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def unit(v: Array) -> Array:
    """v scaled to length one along the last axis."""
    return np.asarray(v / np.sqrt(dot(v, v))[..., None])


def cross(a: Array, b: Array) -> Array:
    """Vector products (..., 3); ``np.cross`` takes several times as long for few of them."""
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
    """Angle (rad) of two unit vectors (3,) without regard to their senses, 0 to pi/2."""
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
    """As ``np.linalg.solve`` of a matrix (N, N) and right sides (N, M)."""
    *_, solution, info = lapack.dgesv(matrix, right)
    if info:
        raise _failed(info)
    return np.asarray(solution)


def eigenvalues(symmetric: Array) -> Array:
    """As ``np.linalg.eigvalsh`` of a matrix (N, N)."""
    values, _, info = lapack.dsyev(symmetric, compute_v=0)
    if info:
        raise _failed(info)
    return np.asarray(values)


def eigenvectors(symmetric: Array, against: Array | None = None) -> tuple[Array, Array]:
    """As ``scipy.linalg.eigh`` of one or two matrices (N, N): values (N,) in rising order, vectors (N, N)."""
    if against is None:
        values, vectors, info = lapack.dsyevd(symmetric, lower=1)
    else:
        values, vectors, info = lapack.dsygvd(symmetric, against)
    if info:
        raise _failed(info)
    return values, vectors


def median(values: NDArray[np.generic]) -> NDArray[np.float64]:
    """As ``np.median`` along the first axis, of few values several times faster."""
    rising, count = np.sort(values, axis=0), len(values)
    return np.asarray(0.5 * rising[(count - 1) // 2] + 0.5 * rising[count // 2])


def _failed(info: int) -> np.linalg.LinAlgError:
    return np.linalg.LinAlgError(f"LAPACK's info is {info}")


DAMPING_DECREASE: Final = 0.2
DAMPING_INCREASE: Final = 8.0
LEAST_DAMPING: Final = 1e-12
MOST_DAMPING: Final = 1e12
"""Usual values: in fits of hypotheses half and double of both factors change one label in 32 s of motion."""


def adapted(damping: NDArray[np.float64], better: ArrayLike) -> NDArray[np.float64]:
    """The damping (...) of the next step, by whether this one was ``better`` (...) than none."""
    factor = np.where(better, DAMPING_DECREASE, DAMPING_INCREASE)
    return np.asarray(np.minimum(np.maximum(damping * factor, LEAST_DAMPING), MOST_DAMPING))
