"""From where one looks: upright on the surroundings, at the object, near enough for it and what it touches.

The eye of the layout never moves. What moves is the frame that it is in: the object stays about its origin,
its z axis points away from the plane that is touched, and its unit is as long as the object is large.
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
"""Of the layout, in the frame that moves."""
TARGET: Final = (0.0, 0.0, -0.2)
SLACK: Final = 0.5
"""How far the object moves, by its radius, before the frame follows."""
_EVERY_NS: Final = 50_000_000
_ALIKE: Final = np.cos(np.radians(10.0))
_MOST_PLACES: Final = 4000
_FARTHEST: Final = 10.0
"""What seems to touch farther from the object, by its radius, is not waited for."""


class Touched(NamedTuple):
    """A normal (3,) of touched planes, for how long they were, and for how long with the object above."""

    normal: Array
    touched_ns: int
    above_ns: int


class Camera:
    """Follows the object pose by pose, and learns contact by contact what is below it.

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
        """Where the frame is from now on, as far as it moves: stamps (K,) and origins (K, 3) in the world."""
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

    def see(self, geometry: ContactGeometry, drawing: Drawing, poses: Poses, lasted_ns: int) -> bool:
        """Take note of a contact that held for ``lasted_ns``; whether the frame has changed by that."""
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
        """(3,) away from the plane that was touched longest; z where none was.

        Faces that touch do not say on which side of each other they are: then it is the side of z.
        """
        if not self._touched:
            return UP
        longest = max(self._touched, key=lambda touched: touched.touched_ns)
        above = longest.above_ns or longest.normal @ UP
        return longest.normal if above >= 0 else -longest.normal

    def frame(self) -> Array:
        """The axes of the frame in the world, its columns (3, 3), as long as its unit (m).

        It looks along the direction in which the object moves least: one sees the motion from the side.
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
    """Rows that are so far apart as the frame is moved, from ``next_ns`` on."""
    row = int(np.searchsorted(stamp_ns, next_ns))
    while row < len(stamp_ns):
        yield row
        row = max(row + 1, int(np.searchsorted(stamp_ns, int(stamp_ns[row]) + _EVERY_NS)))


def _with(touched: list[Touched], normal: Array, lasted_ns: int, way: float) -> list[Touched]:
    """``touched`` and a plane that was, which may have been before."""
    for number, one in enumerate(touched):
        alike = float(one.normal @ normal)
        if abs(alike) > _ALIKE:
            above_ns = one.above_ns + round(np.sign(alike) * way * lasted_ns)
            longer = Touched(one.normal, one.touched_ns + lasted_ns, above_ns)
            return [*touched[:number], longer, *touched[number + 1 :]]
    return [*touched, Touched(normal, lasted_ns, round(way * lasted_ns))]
