"""Where the 3D view looks from: from the side, upright with respect to what was touched."""

from typing import Final, NamedTuple

import numpy as np

from contact_tracker.geometry.elements import Array, ContactGeometry, Plane
from contact_tracker.motion.poses import Poses
from contact_tracker.viewer.scene import UP, Extent, side

_BACK: Final = 3.9
_ABOVE: Final = 2.2
"""Place of the eye relative to the object, by its radius."""
_AHEAD: Final = np.array([0.2, 1.0, 0.1])
"""The view is along the level direction nearest to this one."""
_ALIKE: Final = np.cos(np.radians(10.0))


class Eye(NamedTuple):
    """``position_m`` (3,) relative to the object, which is in the middle of the view; ``up`` (3,)."""

    position_m: Array
    up: Array


class Upward:
    """Estimates upward as away from the planes that were touched longest; without any it is z.

    ``extent`` is that of the object. A plane on whose side the object is not known counts towards z.
    """

    def __init__(self, extent: Extent) -> None:
        self._extent = extent
        self._sum = np.zeros(3)  # of the normals on the object's side, by time (s)

    def add(self, geometry: ContactGeometry, poses: Poses, lasted_ns: int) -> bool:
        """Add a contact of duration ``lasted_ns``; returns whether the direction has changed."""
        if not isinstance(geometry.environment, Plane):
            return False
        before, normal = self.direction, geometry.environment.normal
        centres = poses.rotation @ self._extent.centre_m + poses.position_m
        known = side(geometry.environment, centres, self._extent.radius_m)
        sign = known or (1.0 if normal @ before >= 0.0 else -1.0)
        self._sum = self._sum + 1e-9 * lasted_ns * sign * normal
        return not before @ self.direction > _ALIKE

    @property
    def direction(self) -> Array:
        """(3,) upward in the world."""
        length = float(np.linalg.norm(self._sum))
        return self._sum / length if length > 0.0 else UP

    def eye(self, radius_m: float) -> Eye:
        """The eye for an object of this size."""
        up = self.direction
        ahead = _AHEAD - (_AHEAD @ up) * up
        return Eye(radius_m * (_ABOVE * up - _BACK * ahead / np.linalg.norm(ahead)), up)
