"""The point about which an object rotates: near the body's origin, or for inverse poses near the world's.

An object rotates about a point near it (where it touches, or the hand). Inverse poses, of the world in the
body, are rigid motion as well, with the roles of object and surroundings exchanged: their point of rotation
is near the world's origin, and as far from the body's as the object was from the world's.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.motion.poses import NO_POSES, Poses

Array = NDArray[np.float64]

STEP_NS: Final = 100_000_000
SPAN: Final = 30
"""Time between poses, and number of poses per span."""
EXPLAINED: Final = 0.8
"""Least share of the origin's motion in a span that is rotation about a point."""
ENOUGH: Final = 3
"""Number of such spans that are needed."""
FAR_M: Final = 0.6
TIMES_FARTHER: Final = 2.0
"""Poses are inverse if the point is farther than this from the body's origin, and this many times farther
than from the world's."""
KEPT: Final = 200


class TurningPoints(NamedTuple):
    """``sparse`` poses of the current span, and ``distances`` (n, 2) of the spans before: of the point of
    rotation from the origins of the body and of the world (m)."""

    sparse: Poses
    distances: Array

    @property
    def median_m(self) -> tuple[float, float]:
        """Median of both distances."""
        from_body_m, from_world_m = np.median(self.distances, axis=0).tolist()
        return from_body_m, from_world_m

    @property
    def are_inverse(self) -> bool:
        """Whether the poses look like those of the world in the body."""
        if len(self.distances) < ENOUGH:
            return False
        from_body_m, from_world_m = self.median_m
        return from_body_m > max(FAR_M, TIMES_FARTHER * from_world_m)


NO_TURNING_POINTS: Final = TurningPoints(NO_POSES, np.zeros((0, 2)))


def advance(points: TurningPoints, poses: Poses) -> TurningPoints:
    """Advance by poses of the stream, in order."""
    sparse = points.sparse
    next_ns = int(sparse.stamp_ns[-1]) + STEP_NS if len(sparse) else int(poses.stamp_ns[0])
    while (row := int(np.searchsorted(poses.stamp_ns, next_ns))) < len(poses):
        sparse = Poses.join([sparse, poses[row : row + 1]])
        next_ns = int(poses.stamp_ns[row]) + STEP_NS
        if len(sparse) == SPAN:
            distances = np.concatenate([points.distances, turning_point(sparse)])[-KEPT:]
            points, sparse = points._replace(distances=distances), sparse[-1:]
    return points._replace(sparse=sparse)


def turning_point(span: Poses) -> Array:
    """Its ``distances`` (1, 2); (0, 2) if the motion is no rotation about a point."""
    turn, position = span.rotation, span.position_m
    about = (turn - turn.mean(axis=0)).reshape(-1, 3)
    moved = (position - position.mean(axis=0)).ravel()
    in_body, *_ = np.linalg.lstsq(-about, moved, rcond=1e-3)
    left = moved + about @ in_body
    if left @ left > (1.0 - EXPLAINED) * (moved @ moved):
        return np.zeros((0, 2))
    in_world = position.mean(axis=0) + turn.mean(axis=0) @ in_body
    return np.array([[np.linalg.norm(in_body), np.linalg.norm(in_world)]])
