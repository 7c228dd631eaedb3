"""A bounded buffer of the poses that a segmentation reads, for drawing them beside its segments."""

from collections.abc import Callable, Iterable, Iterator
from typing import Final

from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.tracking.segmentation import Segmentation

Pieces = Callable[[Iterable[Pose]], Iterable[Segmentation]]
"""Reads all poses and yields segmentations piece by piece, as ``offline_smoother.pieces`` does."""

BLOCK: Final = 1000
LIMIT: Final = 200_000


def with_pose_callback(
    poses: Iterable[Pose], pieces: Pieces, on_poses: Callable[[Poses], None]
) -> Iterator[Segmentation]:
    """Yield the ``pieces`` of ``poses``; before each, call ``on_poses`` with the poses read for it, block by
    block."""
    rows: list[Pose] = []

    def flush() -> None:
        if rows:
            on_poses(Poses.collect(rows))
            rows.clear()

    def recorded() -> Iterator[Pose]:
        for pose in poses:
            rows.append(pose)
            if len(rows) == BLOCK:
                flush()
            yield pose

    for piece in pieces(recorded()):
        flush()
        yield piece


class PoseBuffer:
    """Buffered poses since the oldest that is still needed; thinned evenly if there are more than
    ``limit``."""

    def __init__(self, limit: int = LIMIT) -> None:
        self._limit = limit
        self._blocks: list[Poses] = []
        self._size = 0
        self._every = 1
        self._next = 0  # number of poses to skip before the next one is kept

    def extend(self, poses: Poses) -> None:
        """Append later poses."""
        kept = Poses.join([poses[self._next :: self._every]])  # a copy, so that the others are freed
        self._next = (self._next - len(poses)) % self._every
        self._blocks.append(kept)
        self._size += len(kept)
        while self._size > self._limit:
            self._thin()

    @property
    def poses(self) -> Poses:
        """The buffered poses."""
        if len(self._blocks) != 1:
            self._blocks = [Poses.join(self._blocks)]
        return self._blocks[0]

    def drop(self, count: int) -> None:
        """Drop the oldest; if few are left, thinning ends for the next ones."""
        self._blocks = [Poses.join([self.poses[count:]])]
        self._size = len(self._blocks[0])
        if self._size <= self._limit // 16:
            self._every, self._next = 1, 0

    def _thin(self) -> None:
        """Keep every other pose, the oldest included."""
        if self._size % 2:  # the newest is kept, so one more is skipped
            self._next += self._every
        self._every *= 2
        self._blocks = [Poses.join([self.poses[::2]])]
        self._size = len(self._blocks[0])
