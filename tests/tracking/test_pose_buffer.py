"""The buffer of poses that a segmentation reads."""

from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.tracking.pose_buffer import BLOCK, PoseBuffer, with_pose_callback
from contact_tracker.tracking.segmentation import Segmentation


def numbered(first: int, count: int) -> Poses:
    stamp_ns = np.arange(first, first + count, dtype=np.int64)
    return Poses(stamp_ns, np.zeros((count, 3)), np.zeros((count, 4)))


def test_a_piece_comes_after_the_poses_that_were_read_for_it() -> None:
    counts, noted, passed = (1, BLOCK, 2 * BLOCK + 7, 0, 5), list[int](), list[int]()

    def pieces(poses: Iterable[Pose]) -> Iterator[Segmentation]:
        stream = iter(poses)
        for count in counts:
            passed.extend(pose.stamp_ns for pose in islice(stream, count))
            yield Segmentation(outliers=count)

    def note(poses: Poses) -> None:
        assert 0 < len(poses) <= BLOCK
        noted.extend(poses.stamp_ns.tolist())

    found = []
    for piece in with_pose_callback(numbered(0, 10_000), pieces, note):
        found.append(piece.outliers)
        assert noted == passed == list(range(sum(found)))
    assert found == list(counts)


@settings(deadline=None)
@given(st.lists(st.integers(0, 40), max_size=30), st.integers(2, 30))
def test_pending_poses_are_evenly_thinned_to_the_limit(blocks: list[int], limit: int) -> None:
    buffer, count = PoseBuffer(limit), 0
    for size in blocks:
        buffer.extend(numbered(count, size))
        count += size
        kept = buffer.poses.stamp_ns
        assert len(kept) <= limit
        every = 1
        while -(-count // every) > limit:
            every *= 2
        assert kept.tolist() == list(range(0, count, every))


def test_the_oldest_poses_are_dropped_and_then_all_are_kept() -> None:
    buffer = PoseBuffer(limit=100)
    buffer.extend(numbered(0, 400))
    buffer.drop(99)
    assert buffer.poses.stamp_ns.tolist() == [396]
    buffer.extend(numbered(400, 3))
    assert buffer.poses.stamp_ns.tolist() == [396, 400, 401, 402]
    buffer.drop(1)
    assert buffer.poses.stamp_ns.tolist() == [400, 401, 402]
