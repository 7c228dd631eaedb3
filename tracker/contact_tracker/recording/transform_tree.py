"""The tree of frames: chains of transforms between frames, and which of them move."""

from collections import deque
from collections.abc import Iterable
from typing import Final, NamedTuple

from contact_tracker.recording.message_types import canonical
from contact_tracker.recording.sources import PoseSource

TRANSFORM_TYPES: Final = frozenset(
    {
        "tf2_msgs/msg/TFMessage",
        "tf/msg/tfMessage",
        "geometry_msgs/msg/TransformStamped",
        "foxglove.FrameTransform",
        "foxglove.FrameTransforms",
        "foxglove_msgs/msg/FrameTransform",
        "foxglove_msgs/msg/FrameTransforms",
    }
)


class Step(NamedTuple):
    """One transform of a chain; ``inverted`` if it is published in the opposite direction."""

    source: PoseSource
    inverted: bool


def frame_name(name: str) -> str:
    """A frame name without the leading slash of ROS 1."""
    return name.lstrip("/")


def is_transform(source: PoseSource) -> bool:
    """Whether a source is a transform between frames instead of a measured pose."""
    return canonical(source.type) in TRANSFORM_TYPES and bool(source.child_frame_id)


def is_static(source: PoseSource) -> bool:
    """Whether a source is published as static."""
    return source.topic.endswith("tf_static")


class TransformTree:
    """The frames and the transforms between them, of each pair the first."""

    def __init__(self, sources: Iterable[PoseSource]) -> None:
        self._steps: dict[str, dict[str, Step]] = {}
        for source in sorted(sources):
            if source.child_frame_id:
                parent, child = frame_name(source.frame_id), frame_name(source.child_frame_id)
                self._steps.setdefault(parent, {}).setdefault(child, Step(source, False))
                self._steps.setdefault(child, {}).setdefault(parent, Step(source, True))

    def __contains__(self, frame: str) -> bool:
        return frame_name(frame) in self._steps

    def chain(self, start: str, end: str) -> list[Step] | None:
        """The shortest chain of transforms from one frame to another; None if there is none."""
        start, end = frame_name(start), frame_name(end)
        reached: dict[str, tuple[str, Step] | None] = {start: None}
        waiting = deque([start])
        while waiting:
            frame = waiting.popleft()
            for other, step in self._steps.get(frame, {}).items():
                if other not in reached:
                    reached[other] = frame, step
                    waiting.append(other)
        if end not in reached:
            return None
        steps, at = list[Step](), reached[end]
        while at is not None:
            before, step = at
            steps.append(step)
            at = reached[before]
        return steps[::-1]

    def moving_root(self, frame: str) -> str | None:
        """The root of the tree, if a transform from there to ``frame`` may move; else None."""
        at, moves, seen = frame_name(frame), False, set[str]()
        while at not in seen:
            seen.add(at)
            above = next((name for name, step in self._steps.get(at, {}).items() if step.inverted), None)
            if above is None:
                break
            moves = moves or not is_static(self._steps[at][above].source)
            at = above
        return at if moves else None
