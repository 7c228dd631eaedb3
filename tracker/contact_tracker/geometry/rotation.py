"""Unit quaternions ``xyzw`` (..., 4) in few array operations, for the few poses of a tick, for which SciPy
spends most of the time on checks.

The table of Hamilton's products yields the product, the matrix of a rotation, and the rotation nearest to a
matrix. ``q`` and ``-q`` are the same rotation.
"""

from typing import Final

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.geometry import linalg

_CONJUGATE: Final = np.array([-1.0, -1.0, -1.0, 1.0])
TINY: Final = 1e-300
"""Number added to a divisor that may be zero, together with the dividend."""


def _hamilton() -> Array:
    """Table (4, 4, 4): element [i, j, k] is the coefficient of unit k in the product of the units i and j."""
    table = np.zeros((4, 4, 4))
    for i in range(3):
        table[i, 3, i] = table[3, i, i] = 1.0
        table[i, i, 3] = -1.0
        table[i, (i + 1) % 3, (i + 2) % 3], table[(i + 1) % 3, i, (i + 2) % 3] = 1.0, -1.0
    table[3, 3, 3] = 1.0
    return table


_PRODUCT: Final = _hamilton()
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
    return linalg.eigenvectors((_QUADRATIC @ matrix.ravel()).reshape(4, 4))[1][:, 3]
