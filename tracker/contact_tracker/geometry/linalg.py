"""Linear algebra of one small matrix by direct calls of LAPACK, whose wrappers take several times longer, and
the damping of Gauss-Newton steps."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]


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
    return np.asarray(0.5 * (rising[(count - 1) // 2] + rising[count // 2]))


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
