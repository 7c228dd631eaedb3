"""Test for two close bodies in one stream: positions lie on two smooth paths with a constant offset.

In short pieces a path is a cubic of time. Poses of two bodies follow one such path, some of them with an
offset that is the same for all; which body a pose belongs to follows from its position. Noise is unimodal
(split in the middle, its halves are 3 residual deviations apart, those of a vibration up to 8.5), and motion
alternates less often. Outliers are fewer. Bodies farther apart are found by ``recurrence``.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.motion.poses import Poses

Array = NDArray[np.float64]

PIECE: Final = 10
POWERS: Final = 4
"""Powers of time in the cubic."""
ROUNDS: Final = 4
APART_M: Final = (0.002, 0.03)
"""Range of offsets. Well calibrated cameras agree better than the first; ``recurrence`` finds more than the
second."""
APART_SIGMAS: Final = 9.0
CHANGES: Final = 0.35
"""Least share of the poses that follow one of the other body; in random order it is one half."""
LEAST_SHARE: Final = 0.25
"""Least share of the poses of the rarer body."""


def is_of_two_bodies(poses: Poses) -> bool:
    """Whether these poses (a multiple of PIECE) alternate between two paths."""
    shape = -1, PIECE
    time = (poses.stamp_ns - poses.stamp_ns[0]).reshape(shape).astype(float)
    time = 2.0 * (time - time[:, :1]) / (time[:, -1:] - time[:, :1]) - 1.0
    smooth, _ = np.linalg.qr(time[:, :, None] ** np.arange(POWERS))
    position = (poses.position_m - poses.position_m.mean(axis=0)).reshape(*shape, 3)
    rest = _without(smooth, position)
    aside = np.linalg.svd(rest.reshape(-1, 3), full_matrices=False)[2][0]
    side, step, left = rest @ aside > 0.0, aside, rest
    for _ in range(ROUNDS):
        body = side - 0.5
        own = _without(smooth, body[..., None])[..., 0]
        if not own.any():
            return False
        step = (own[..., None] * rest).sum(axis=(0, 1)) / (own * own).sum()
        left = rest - own[..., None] * step
        side = (left + body[..., None] * step) @ step > 0.0
    apart_m = float(np.linalg.norm(step))
    sigma_m = float(np.sqrt((left * left).mean() * PIECE / (PIECE - POWERS)))
    share, changes = float(side.mean()), float(np.mean(np.diff(side.ravel())))
    are_mixed = min(share, 1.0 - share) > LEAST_SHARE and changes > CHANGES
    return are_mixed and max(APART_M[0], APART_SIGMAS * sigma_m) < apart_m < APART_M[1]


def _without(smooth: Array, values: Array) -> Array:
    """Values (n, PIECE, k) minus their projection on smooth paths in each piece."""
    return np.asarray(values - smooth @ (smooth.transpose(0, 2, 1) @ values))
