"""Camera of the 3D view: upright with respect to the surroundings, following the object.

The eye of the layout is fixed in a frame that moves: its origin stays near the object, its z axis points away
from the touched plane, and its unit is the size of the object.
"""

from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Array, ContactGeometry, Plane
from contact_tracker.motion.poses import Poses
from contact_tracker.viewer.scene import UP, Drawing, Extent, side

Stamps = NDArray[np.int64]

EYE: Final = (0.0, -3.4, 1.9)
"""Position of the layout's eye in the moving frame."""
TARGET: Final = (0.0, 0.0, -0.2)
SLACK: Final = 0.5
"""Distance in object radii by which the object moves before the frame follows."""
_EVERY_NS: Final = 50_000_000
_ALIKE: Final = np.cos(np.radians(10.0))
_MOST_PLACES: Final = 4000
_FARTHEST: Final = 10.0
"""Contacts farther from the object, in object radii, do not enlarge the view."""


class Touched(NamedTuple):
    """A normal (3,) of touched planes, the time of contact, and the time with the object above."""

    normal: Array
    touched_ns: int
    above_ns: int


class Camera:
    """Follows the poses of the object and estimates the upward direction from its contacts.

    ``extent`` is that of the object.
    """

    def __init__(self, extent: Extent) -> None:
        self._extent = extent
        self._radius_m = extent.radius_m
        self._touched: list[Touched] = []
        self._way: list[Array] = []
        self._centre: Array | None = None
        self._next_ns = -(2**62)

    def follow(self, poses: Poses) -> tuple[Stamps, Array]:
        """Move the frame with poses: stamps (K,) and origins (K, 3) in the world where it moves."""
        stamps, origins = [], []
        for row in _spaced(poses.stamp_ns, self._next_ns):
            pose = poses[row : row + 1]
            self._next_ns = int(pose.stamp_ns[0]) + _EVERY_NS
            place = pose.rotation[0] @ self._extent.centre_m + pose.position_m[0]
            if len(self._way) == _MOST_PLACES:
                self._way = self._way[::2]
            self._way.append(place)
            before = self._centre
            ahead = np.zeros(3) if before is None else place - before
            far = float(np.linalg.norm(ahead))
            slack = SLACK * self._radius_m
            if before is None:
                self._centre = place
            elif far > slack:
                self._centre = before + (1.0 - slack / far) * ahead
            if self._centre is not before:
                assert self._centre is not None
                stamps.append(int(pose.stamp_ns[0]))
                origins.append(self._centre)
        return np.array(stamps, np.int64), np.reshape(origins, (-1, 3))

    def add_contact(self, geometry: ContactGeometry, drawing: Drawing, poses: Poses, lasted_ns: int) -> bool:
        """Add a contact of duration ``lasted_ns``; returns whether the frame has changed."""
        before = self.up, self._radius_m
        if drawing.reach_m < _FARTHEST * self._extent.radius_m:
            self._radius_m = max(self._radius_m, drawing.reach_m)
        if isinstance(geometry.environment, Plane):
            centres = poses.rotation @ self._extent.centre_m + poses.position_m
            way = side(geometry.environment, centres, self._extent.radius_m)
            self._touched = _with(self._touched, geometry.environment.normal, lasted_ns, way)
        is_upright = bool(before[0] @ self.up > _ALIKE)
        return not is_upright or self._radius_m > 1.1 * before[1]

    @property
    def up(self) -> Array:
        """(3,) upward: away from the plane that was touched longest; z without any.

        Touching faces do not determine the side; then it is that of z.
        """
        if not self._touched:
            return UP
        longest = max(self._touched, key=lambda touched: touched.touched_ns)
        above = longest.above_ns or longest.normal @ UP
        return longest.normal if above >= 0 else -longest.normal

    def frame(self) -> Array:
        """The axes of the frame in the world, columns (3, 3) of the length of its unit (m).

        The view is along the direction of least motion, so that the motion is visible from the side.
        """
        up = self.up
        level = np.eye(3) - np.outer(up, up)
        way = np.reshape(self._way, (-1, 3))
        spread = (way - np.median(way, axis=0)) @ level if len(way) else way
        spread = np.vstack([spread, 1e-3 * self._radius_m * level])
        forward = np.linalg.svd(spread, full_matrices=False)[2][1]
        forward = forward if forward @ np.array([0.2, 1.0, 0.1]) >= 0.0 else -forward
        return self._radius_m * np.column_stack([np.cross(forward, up), forward, up])


def _spaced(stamp_ns: Stamps, next_ns: int) -> Iterable[int]:
    """Rows from ``next_ns`` on at the interval at which the frame is moved."""
    row = int(np.searchsorted(stamp_ns, next_ns))
    while row < len(stamp_ns):
        yield row
        row = max(row + 1, int(np.searchsorted(stamp_ns, int(stamp_ns[row]) + _EVERY_NS)))


def _with(touched: list[Touched], normal: Array, lasted_ns: int, way: float) -> list[Touched]:
    """``touched`` with a further contact, merged with an earlier plane of the same normal."""
    for number, one in enumerate(touched):
        alike = float(one.normal @ normal)
        if abs(alike) > _ALIKE:
            above_ns = one.above_ns + round(np.sign(alike) * way * lasted_ns)
            longer = Touched(one.normal, one.touched_ns + lasted_ns, above_ns)
            return [*touched[:number], longer, *touched[number + 1 :]]
    return [*touched, Touched(normal, lasted_ns, round(way * lasted_ns))]
