"""The number of directions in which an object moves: the rank of its twists (docs/theory.md, T24)."""

from typing import Final

import numpy as np

from contact_tracker.geometry import linalg
from contact_tracker.geometry.vectors import EYE
from contact_tracker.motion.lifted_pose import T
from contact_tracker.motion.window import Window

DIRECTIONS: Final = 6
"""Degrees of freedom of a rigid object."""
STRIDE_TICKS: Final = 5
"""Steps in ticks between which twists are taken, long enough for slow motion to exceed the noise."""
USED: Final = 10.0
"""A direction is used if its mean squared motion is this many times the variance of the noise."""
LEVER_M: Final = 0.1
ONE_AXIS: Final = 0.14
"""Motion has one degree of freedom if its second largest component is below this share of the largest (turns
scaled by the lever above): hinges, sliders and screws with their errors."""
TINY: Final = 1e-9
_AXIS: Final = np.array([np.cross(b, a) for a in EYE for b in EYE]).T
"""(3, 9): maps a row-major matrix to its antisymmetric part as a vector: of a rotation twice the sine of its
angle times its axis; of ``a b^T`` it is ``b x a``."""
_TRACE: Final = EYE.ravel()
_LEVER: Final = np.array([1.0, 1.0, 1.0, LEVER_M, LEVER_M, LEVER_M])


def used_directions(window: Window) -> int:
    """Number of directions in which the object moves beyond the noise: the rank of its twists (T24).

    Each step of ``STRIDE_TICKS`` has a twist in the world's frame. Rotation about one axis has a constant
    twist, so it is one direction, however far it goes; translation in a plane is two. Motion that is nearly
    all in one direction has one degree of freedom, whatever the noise (``ONE_AXIS``).
    """
    if len(window) <= STRIDE_TICKS:
        return 0
    pose = window.zeta[:, : T[-1] + 1].T.copy()  # R comes before T; numbers of all ticks side by side
    rotation, place = pose[: T[0]].reshape(3, 3, -1), pose[T[0] :]
    place -= place.sum(axis=1, keepdims=True) / len(window)
    before, after = place[:, :-STRIDE_TICKS], place[:, STRIDE_TICKS:]
    step = (rotation[:, None, :, STRIDE_TICKS:] * rotation[:, :, :-STRIDE_TICKS]).sum(axis=2).reshape(9, -1)
    # tan of half the angle along the axis, twice: exact about an axis
    turned = _AXIS @ step / np.maximum(0.5 + 0.5 * (_TRACE @ step), TINY)
    middle = 0.5 * (before + after)
    shifted = after - before - _AXIS @ (middle[:, None] * turned).reshape(9, -1)
    twist = np.concatenate([shifted, turned])
    weight = window.motion_ratio[STRIDE_TICKS:] + TINY
    power = (twist * weight) @ twist.T / weight.sum()
    position, rotational = 2.0 * window.usual_variance
    lever_sq = np.vdot(middle, middle) / len(weight) * 2.0 / 3.0
    sigma = np.sqrt([position + rotational * lever_sq] * 3 + [rotational] * 3)
    used = int(np.count_nonzero(linalg.eigenvalues(power / (sigma[:, None] * sigma)) > USED))
    if used < 2:
        return used
    rising = linalg.eigenvalues(power * (_LEVER[:, None] * _LEVER))
    return 1 if rising[-2] < ONE_AXIS**2 * rising[-1] else used
