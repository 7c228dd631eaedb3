"""How far an object moves from tick to tick, and how far it might if nothing touched it."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.motion.lifted_pose import R, T

Array = NDArray[np.float64]

_POSE: Final = slice(T[-1] + 1)
"""Where zeta has the rotation, and then the position."""
_PER_AXIS: Final = np.zeros((T[-1] + 1, 2))
_PER_AXIS[T, 0], _PER_AXIS[R, 1] = 1.0 / 3.0, 1.0 / 6.0


def travel_of(zeta: Array, index: NDArray[np.int64], before: Array | None) -> Array:
    """Variances (W, 2) per axis, of position (m^2) and rotation (rad^2), of the ways to ticks of ``zeta``
    (W, 25) from those that came right before by ``index`` (W,).

    Zero where that is not known: it is ``before`` (25,) of the first.
    """
    pose = zeta[:, _POSE]
    apart = np.empty_like(pose)
    np.subtract(pose[1:], pose[:-1], out=apart[1:])
    apart[:1] = 0.0 if before is None else pose[:1] - before[_POSE]
    apart[1:][index[1:] - index[:-1] != 1] = 0.0
    return _per_axis(apart)


def travel_to(zeta: Array, before: Array | None) -> Array:
    """That (2,) of the way to one tick of ``zeta`` (25,), zero without any ``before``."""
    return np.zeros(2) if before is None else _per_axis(zeta[_POSE] - before[_POSE])


def _per_axis(apart: Array) -> Array:
    return np.asarray((apart * apart) @ _PER_AXIS)
