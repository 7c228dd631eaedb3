"""Poses that are looked at while they pass: beside their segmentation, and in bounded memory."""

from collections.abc import Callable, Iterable, Iterator
from typing import Final

from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.tracking.segmentation import Segmentation

Pieces = Callable[[Iterable[Pose]], Iterable[Segmentation]]
"""Reads all poses and gives what was found piece by piece, as ``offline_smoother.pieces`` does."""

BLOCK: Final = 1000
LIMIT: Final = 200_000


def watched(poses: Iterable[Pose], pieces: Pieces, note: Callable[[Poses], None]) -> Iterator[Segmentation]:
    """The ``pieces`` of ``poses``; all that were read for one are noted before it, block by block."""
    rows: list[Pose] = []

    def flush() -> None:
        if rows:
            note(Poses.collect(rows))
            rows.clear()

    def passing() -> Iterator[Pose]:
        for pose in poses:
            rows.append(pose)
            if len(rows) == BLOCK:
                flush()
            yield pose

    for piece in pieces(passing()):
        flush()
        yield piece


class Waiting:
    """Poses from the oldest that is still needed on; where more than ``limit`` wait, evenly thinned."""

    def __init__(self, limit: int = LIMIT) -> None:
        self._limit = limit
        self._blocks: list[Poses] = []
        self._size = 0
        self._every = 1
        self._next = 0  # so many poses are passed over before the next is kept

    def extend(self, poses: Poses) -> None:
        """Later poses."""
        kept = Poses.join([poses[self._next :: self._every]])  # a copy: the others are let go
        self._next = (self._next - len(poses)) % self._every
        self._blocks.append(kept)
        self._size += len(kept)
        while self._size > self._limit:
            self._thin()

    @property
    def poses(self) -> Poses:
        """All that wait."""
        if len(self._blocks) != 1:
            self._blocks = [Poses.join(self._blocks)]
        return self._blocks[0]

    def drop(self, count: int) -> None:
        """Forget the oldest; where few are left, the next are kept one and all."""
        self._blocks = [Poses.join([self.poses[count:]])]
        self._size = len(self._blocks[0])
        if self._size <= self._limit // 16:
            self._every, self._next = 1, 0

    def _thin(self) -> None:
        """Keep every other one, the oldest first."""
        if self._size % 2:  # the newest is kept, so that one more is passed over
            self._next += self._every
        self._every *= 2
        self._blocks = [Poses.join([self.poses[::2]])]
        self._size = len(self._blocks[0])
