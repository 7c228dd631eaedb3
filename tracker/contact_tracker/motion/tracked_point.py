"""The point of the body that is tracked: that whose position noise is independent of the orientation noise.

The filters assume independent noise of both, as of a marker cluster about its centroid. An origin elsewhere
moves with each error of the orientation, so that results would depend on its place, which is arbitrary: for a
mug, an origin 0.3 m away changed half of the labels.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import binom

from contact_tracker.geometry.rotation import between, rotation_vectors
from contact_tracker.geometry.vectors import cross_matrix
from contact_tracker.motion.poses import Poses

Array = NDArray[np.float64]

ORDER: Final = 5
"""Order of the differences between poses, in which motion of 2 Hz at 30 poses a second nearly vanishes."""
KEPT: Final = 0.9
"""Share of the differences that are used; of impacts they are larger."""
MOST_POSES: Final = 20_000


def independent_point(poses: Poses) -> Array:
    """The point (3,), in the body frame, whose position noise is independent of the orientation noise.

    If the orientation has the noise ``e`` (a rotation vector in the body frame) and the point ``c`` the noise
    ``n``, the origin has ``n + c x e``: ``c`` follows by linear regression from differences of the poses of
    an order so high that hardly any motion is left. It is zero, the origin itself, unless the Bayesian
    information criterion prefers another point (T47).

    Parameters
    ----------
    poses : consecutive ones, of which the first ``MOST_POSES`` are used.
    """
    poses = poses[:MOST_POSES].fresh
    count = len(poses) - ORDER
    if count < 2:
        return np.zeros(3)
    middle = np.arange(count) + ORDER // 2
    to_body = poses[middle].rotation.swapaxes(1, 2)
    shift, turn = np.zeros((count, 3)), np.zeros((count, 3))
    for row in range(ORDER + 1):
        weight, rows = (-1.0) ** row * binom(ORDER, row), np.arange(count) + row
        off_m = poses.position_m[rows] - poses.position_m[middle]
        shift += weight * (to_body @ off_m[..., None])[..., 0]
        turn += weight * rotation_vectors(between(poses.quat_xyzw[middle], poses.quat_xyzw[rows]))
    sizes = (np.linalg.norm(some, axis=1) for some in (shift, turn))
    usual = np.all([size <= np.quantile(size, KEPT) for size in sizes], axis=0)
    shift, by_point = shift[usual], -cross_matrix(turn[usual])
    information = np.einsum("nij,nik->jk", by_point, by_point)
    point_m = np.linalg.pinv(information, hermitian=True) @ np.einsum("nij,ni->j", by_point, shift)
    before, after = float((shift**2).sum()), float(((shift - by_point @ point_m) ** 2).sum())
    gain = shift.size * np.log(before / after) if after > 0.0 else 0.0
    return point_m if gain > len(point_m) * np.log(shift.size) else np.zeros(3)
