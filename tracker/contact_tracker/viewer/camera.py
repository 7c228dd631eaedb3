"""Camera of the 3D view: upright with respect to the surroundings, following the object.

The eye of the layout is fixed in a frame that moves: its origin stays near the object, its z axis points away
from the touched plane, and its unit is the size of the object.
"""

from typing import Final

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
_FARTHEST: Final = 10.0
"""Contacts farther from the object, in object radii, do not enlarge the view."""


class Camera:
    """Follows the poses of the object and estimates the upward direction from its contacts.

    ``extent`` is that of the object.
    """

    def __init__(self, extent: Extent) -> None:
        self._extent = extent
        self._radius_m = extent.radius_m
        self._touched = np.zeros((3, 3))  # sum of n n^T over normals n of touched planes, by time (s)
        self._above = np.zeros(3)  # sum of the normals on whose side the object is
        self._first: Array | None = None
        self._places, self._sum, self._squares = (
            0,
            np.zeros(3),
            np.zeros((3, 3)),
        )  # of the way since the first
        self._centre: Array | None = None
        self._next_ns = -(2**62)

    def follow(self, poses: Poses) -> tuple[Stamps, Array]:
        """Move the frame with poses: stamps (K,) and origins (K, 3) in the world where it moves."""
        stamps, origins, slack_m = list[int](), list[Array](), SLACK * self._radius_m
        while (row := int(np.searchsorted(poses.stamp_ns, self._next_ns))) < len(poses):
            stamp_ns, pose = int(poses.stamp_ns[row]), poses[row : row + 1]
            self._next_ns = stamp_ns + _EVERY_NS
            place = pose.rotation[0] @ self._extent.centre_m + pose.position_m[0]
            if self._first is None:
                self._first = place
            way = place - self._first
            self._places += 1
            self._sum += way
            self._squares += np.outer(way, way)
            far_m = np.inf if self._centre is None else float(np.linalg.norm(place - self._centre))
            if far_m > slack_m:
                self._centre = (
                    place if self._centre is None else place + slack_m / far_m * (self._centre - place)
                )
                stamps.append(stamp_ns)
                origins.append(self._centre)
        return np.array(stamps, np.int64), np.reshape(origins, (-1, 3))

    def add_contact(self, geometry: ContactGeometry, drawing: Drawing, poses: Poses, lasted_ns: int) -> bool:
        """Add a contact of duration ``lasted_ns``; returns whether the frame has changed."""
        up, radius_m = self.up, self._radius_m
        if drawing.reach_m < _FARTHEST * self._extent.radius_m:
            self._radius_m = max(self._radius_m, drawing.reach_m)
        if isinstance(geometry.environment, Plane):
            centres = poses.rotation @ self._extent.centre_m + poses.position_m
            normal, lasted_s = geometry.environment.normal, 1e-9 * lasted_ns
            self._touched = self._touched + lasted_s * np.outer(normal, normal)
            self._above = self._above + lasted_s * side(geometry.environment, centres, radius_m) * normal
        return not up @ self.up > _ALIKE or self._radius_m > 1.1 * radius_m

    @property
    def up(self) -> Array:
        """(3,) upward: away from the planes that were touched longest; z without any.

        Touching faces do not determine the side; then it is that of z.
        """
        if not self._touched.any():
            return UP
        normal: Array = np.linalg.eigh(self._touched)[1][:, 2]
        height = self._above @ normal
        return normal if (height if abs(height) > 1e-12 else normal @ UP) >= 0.0 else -normal

    def frame(self) -> Array:
        """The axes of the frame in the world, columns (3, 3) of the length of its unit (m).

        The view is along the direction of least motion, so that the motion is visible from the side.
        """
        up = self.up
        level = np.eye(3) - np.outer(up, up)
        count = max(self._places, 1)
        spread = self._squares / count - np.outer(self._sum, self._sum) / count**2
        forward = np.linalg.eigh(level @ spread @ level + (1e-3 * self._radius_m) ** 2 * level)[1][:, 1]
        forward = forward if forward @ np.array([0.2, 1.0, 0.1]) >= 0.0 else -forward
        return self._radius_m * np.column_stack([np.cross(forward, up), forward, up])
