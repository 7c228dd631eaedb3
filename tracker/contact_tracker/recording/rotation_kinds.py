"""Kinds of rotations in the columns of a table, and their quaternions."""

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.config.table_reading import ANGLES, MATRIX, QUATERNION
from contact_tracker.geometry.rotation import from_rotation_vectors

Array = NDArray[np.float64]
_PLAUSIBLE: Final = 0.1
"""Largest deviation of a determinant from 1; other matrices are no rotations."""


class RotationKind(NamedTuple):
    """Roles of the columns of a rotation; the function from their values (N, k), and text on how they are
    meant, to quaternions ``xyzw``."""

    roles: tuple[str, ...]
    quaternions: Callable[[Array, str], Array]


def _from_euler(angles: Array, how: str) -> Array:
    order, _, unit = how.partition(":")
    if len(set(order)) == 3:  # by axis, else by place
        angles = angles[:, ["xyz".index(letter) for letter in order.lower()]]
    return np.asarray(Rotation.from_euler(order, angles, degrees=unit == "deg").as_quat())


def _from_vectors(vectors: Array, unit: str) -> Array:
    return from_rotation_vectors(np.radians(vectors) if unit == "deg" else vectors)


def _from_matrices(rows: Array, _: str) -> Array:
    """Quaternions of the rotations nearest to matrices; zero for what is none, which the pose gate counts."""
    matrices = rows.reshape(-1, 3, 3)
    found = np.zeros((len(rows), 4))
    is_rotation = np.abs(np.linalg.det(matrices) - 1.0) < _PLAUSIBLE
    if is_rotation.any():
        found[is_rotation] = Rotation.from_matrix(matrices[is_rotation]).as_quat()
    return found


ROTATIONS: Final[Mapping[str, RotationKind]] = {
    "quaternion": RotationKind(QUATERNION, lambda values, _: values),
    "euler": RotationKind(ANGLES, _from_euler),
    "rotation_vector": RotationKind(ANGLES, _from_vectors),
    "matrix": RotationKind(MATRIX, _from_matrices),
}


def quaternions(kind: str, values: Array, how: str) -> Array:
    """Quaternions (N, 4) ``xyzw`` of rotations of a kind; NaN where a value is not finite."""
    known = np.isfinite(values).all(axis=1)
    found = np.full((len(values), 4), np.nan)
    if known.any():
        found[known] = ROTATIONS[kind].quaternions(values[known], how)
    return found
