"""Wrenches on the object, from the messages of one topic (geometry_msgs/msg/WrenchStamped)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from contact_tracker.errors import InputError, UsageError
from contact_tracker.motion.poses import Poses
from contact_tracker.recording.decoding import MessageDecoder, Undecodable, is_readable
from contact_tracker.recording.items import Channel, RawMessage
from contact_tracker.recording.message_types import canonical
from contact_tracker.recording.reading import Reading
from contact_tracker.recording.sources import PoseSource
from contact_tracker.wrenches.wrenches import Wrenches, about_body

WRENCH_TYPE: Final = "geometry_msgs/msg/WrenchStamped"
_MOST: Final = 20_000_000
"""Rows of 56 bytes that are kept; what comes later is left out and counted."""


@dataclass(frozen=True, eq=False)
class WrenchLog:
    """What one topic holds.

    Parameters
    ----------
    wrenches : finite ones, in order of time, about the body's origin and in its axes.
    dropped : messages that cannot be decoded, without a stamp, not finite, or of a stamp that is repeated.
    frame_id : of the messages.
    damage : one line if the recording is truncated or damaged.
    """

    wrenches: Wrenches
    dropped: int
    frame_id: str
    damage: str | None


def read_wrenches(
    path: str, topic: str, source: PoseSource, poses: Poses, by_log_time: bool = False
) -> WrenchLog:
    """The wrenches on ``topic`` of the object whose ``poses`` come from ``source``.

    Messages are about the origin and in the axes of their ``header.frame_id``. That is the body's frame,
    or the frame in which its poses are. A pose without a child frame does not name the body's: any other
    frame is taken for it.

    Parameters
    ----------
    by_log_time : whether poses have their log times as stamps, since their headers have none.

    Raises
    ------
    UsageError
        There is no such topic, it is of another type, or its frame is neither.
    InputError
        Nothing on it can be read.
    """
    channels: dict[str, Channel] = {}

    def wanted(channel: Channel) -> bool:
        channels[channel.topic] = channel
        return channel.topic == topic and canonical(channel.type) == WRENCH_TYPE and is_readable(channel)

    reading = Reading(path, wanted)
    rows, frames, dropped = list[tuple[float, ...]](), dict[str, int](), 0
    stamps = list[int]()
    for message, row in _decoded(reading):
        if row is None or len(stamps) == _MOST:
            dropped += 1
            continue
        frame_id, stamp_ns, numbers = row
        stamp_ns = message.log_time_ns if by_log_time else stamp_ns
        if not stamp_ns:
            dropped += 1
            continue
        frames[frame_id] = frames.get(frame_id, 0) + 1
        stamps.append(stamp_ns)
        rows.append(numbers)
    if not stamps:
        raise _nothing(path, topic, channels)
    if len(frames) > 1:
        raise UsageError(f"{path}: {topic} changes its frame: {', '.join(sorted(frames)[:4])}")
    (frame_id,) = frames
    columns = np.array(rows, float)
    found = Wrenches(np.array(stamps, np.int64), columns[:, :3], columns[:, 3:]).valid
    dropped += len(stamps) - len(found)
    if not len(found):
        raise InputError(f"{path}: no wrench on {topic} is finite")
    if _is_in_world(path, topic, frame_id, source):
        found = about_body(found, poses)
    return WrenchLog(found, dropped, frame_id, reading.damage)


def _decoded(reading: Reading) -> Iterator[tuple[RawMessage, tuple[str, int, tuple[float, ...]] | None]]:
    """Each message with its frame, stamp and numbers; None if it is not what its schema promises."""
    decoder = MessageDecoder(reading.budget)
    for item in reading:
        if not isinstance(item, RawMessage):
            continue
        try:
            decoded = decoder.decode(item)
            header, force, moment = decoded.header, decoded.wrench.force, decoded.wrench.torque
            stamp_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
            numbers = (force.x, force.y, force.z, moment.x, moment.y, moment.z)
            yield item, (str(header.frame_id), int(stamp_ns), tuple(map(float, numbers)))
        except (Undecodable, AttributeError, TypeError, ValueError):
            yield item, None


def _is_in_world(path: str, topic: str, frame_id: str, source: PoseSource) -> bool:
    """Whether wrenches are in the frame of the poses; raises UsageError where that is not known."""
    if frame_id == source.frame_id and frame_id and frame_id != source.child_frame_id:
        return True
    if source.child_frame_id and frame_id not in ("", source.child_frame_id):
        raise UsageError(
            f"{path}: {topic} is in the frame {frame_id}; wrenches must be in the frame of the object "
            f"({source.child_frame_id}) or of its poses ({source.frame_id})"
        )
    return False


def _nothing(path: str, topic: str, channels: dict[str, Channel]) -> UsageError | InputError:
    there = channels.get(topic)
    if there is None:
        names = [name for name, channel in sorted(channels.items()) if canonical(channel.type) == WRENCH_TYPE]
        return UsageError(
            f"{path}: no topic {topic}; of {WRENCH_TYPE} there is {', '.join(names[:8]) or 'none'}"
        )
    if canonical(there.type) != WRENCH_TYPE or not is_readable(there):
        return UsageError(f"{path}: {topic} is {there.type or 'of no type'}; only {WRENCH_TYPE} is read")
    return InputError(f"{path}: no message on {topic} can be used")
