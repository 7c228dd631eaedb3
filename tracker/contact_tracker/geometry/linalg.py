"""Linear algebra of one small matrix, by LAPACK itself: what wraps it elsewhere costs several times more."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]


def solve(matrix: Array, right: Array) -> Array:
    """As ``np.linalg.solve`` of a matrix (N, N) and right sides (N, M)."""
    *_, solution, failed = lapack.dgesv(matrix, right)
    return np.asarray(_unless(failed, solution))


def eigenvalues(symmetric: Array) -> Array:
    """As ``np.linalg.eigvalsh`` of a matrix (N, N)."""
    values, _, failed = lapack.dsyev(symmetric, compute_v=0)
    return np.asarray(_unless(failed, values))


def eigenvectors(symmetric: Array, against: Array | None = None) -> tuple[Array, Array]:
    """As ``scipy.linalg.eigh`` of one or two matrices (N, N): values (N,) in rising order, vectors (N, N)."""
    if against is None:
        values, vectors, failed = lapack.dsyevd(symmetric, lower=1)
    else:
        values, vectors, failed = lapack.dsygvd(symmetric, against)
    return _unless(failed, values), vectors


def _unless(failed: int, found: Array) -> Array:
    if failed:
        raise np.linalg.LinAlgError(f"LAPACK's info is {failed}")
    return found
