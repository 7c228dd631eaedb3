"""Two bodies in one stream, by poses that go back and forth, or positions that lie on two smooth paths.

A pose *returns* if it is far from the last one and close to another of the few before it. An outlier makes
one pose return, a swapped marker one a burst; bodies that take turns make every pose return, those that come
in random order every second one.

Close bodies: in short pieces a path is a cubic of time. Poses of two bodies follow one such path, some of
them with an offset that is the same for all; which body a pose belongs to follows from its position. Noise is
unimodal (split in the middle, its halves are 3 residual deviations apart, those of a vibration up to 8.5),
and motion alternates less often. Outliers are fewer.
"""

from math import log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.motion.excursions import ARM_M, FAR_M_PER_S2
from contact_tracker.motion.poses import Poses

Array = NDArray[np.float64]

PIECE: Final = 10
POWERS: Final = 4
"""Powers of time in the cubic."""
ROUNDS: Final = 4
APART_M: Final = (0.002, 0.03)
"""Range of offsets. Well calibrated cameras agree better than the first; ``returned`` finds more than the
second."""
APART_SIGMAS: Final = 9.0
CHANGES: Final = 0.35
"""Least share of the poses that follow one of the other body; in random order it is one half."""
LEAST_SHARE: Final = 0.25
"""Least share of the poses of the rarer body."""
BACK: Final = 8
"""How many poses back a return is looked for."""
FAR_M: Final = 0.01
FAR_STEPS: Final = 8.0
RETURNED_SHARE: Final = 0.25
"""Largest distance from the pose returned to, as a share of the step."""
# Page's test: with returns in 13 % of the poses the sum drifts down, with 40 % it rises; the chance of a
# false alarm is about exp(-ALARM) a pose.
RETURN: Final = log(0.40 / 0.13)
NO_RETURN: Final = log(0.60 / 0.87)
ALARM: Final = 25.0


def returned(poses: Poses, interval_s: float) -> NDArray[np.bool_]:
    """(n,) which poses from the BACKth on are far from the last one and close to another of the last few."""
    position, quat = poses.position_m, poses.quat_xyzw
    step = _distance(position[BACK:], quat[BACK:], position[BACK - 1 : -1], quat[BACK - 1 : -1])
    far = step > max(FAR_M, FAR_M_PER_S2 * interval_s**2)  # slower alternation is motion
    if not far.any():
        return far
    rows = np.arange(len(poses) - BACK)[:, None] + np.arange(BACK)
    distance = _distance(position[BACK:, None], quat[BACK:, None], position[rows], quat[rows])
    nearest = distance.min(axis=1)
    far &= step > FAR_STEPS * np.median(nearest)
    return np.asarray(far & (nearest < RETURNED_SHARE * step) & (nearest > 0.0))


def page_sum(page: float, returns: NDArray[np.bool_]) -> tuple[float, bool]:
    """Page's cumulative sum (never below zero) after these poses, and whether it reached the alarm."""
    if not page and not returns.any():
        return 0.0, False
    path = np.append(page, np.where(returns, RETURN, NO_RETURN)).cumsum()
    above = path - np.minimum(np.minimum.accumulate(path), 0.0)
    return float(above[-1]), bool(above.max() > ALARM)


def _distance(position: Array, quat: Array, other_position: Array, other_quat: Array) -> Array:
    """Distances in metres, rotations by their path on the lever arm."""
    path, cosine = other_position - position, (other_quat * quat).sum(axis=-1)
    turn_sq = 8.0 * np.maximum(1.0 - np.abs(cosine), 0.0)
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", path, path) + ARM_M**2 * turn_sq))


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
