"""Writing of labelled recordings (profile ros2, CDR, indexed zstd chunks), and of copies with results."""

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from heapq import merge
from pathlib import Path
from typing import Final

import numpy as np
from mcap.records import Attachment, Metadata
from mcap.writer import Writer

from contact_tracker.files import accept_any, whole_file
from contact_tracker.ground_truth import UNSCORED, Truth
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording.annotations import TRUTH_ATTACHMENT, TRUTH_TOPIC, TRUTH_TYPE
from contact_tracker.recording.definitions import known_definition
from contact_tracker.recording.items import RESULT_TOPICS, Channel, Item, RawMessage, Rows
from contact_tracker.recording.reading import Reading
from contact_tracker.recording.wrenches import WRENCH_TYPE
from contact_tracker.wrenches.wrenches import Wrenches

POSE_TOPIC: Final = "/object/pose"
POSE_TYPE: Final = "geometry_msgs/msg/PoseStamped"
WRENCH_TOPIC: Final = "/object/wrench"
METADATA_NAME: Final = "recording"
WORLD_FRAME: Final = "world"
_CHUNK_SIZE: Final = 128 * 1024
_LIBRARY: Final = "contact-tracker"

_CDR_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"
# CDR aligns to the size of each value, counted from after the 4-byte header: 18 bytes, then 6 of padding.
_POSE_CDR: Final = struct.Struct("<4siII6s6x7d")
_FRAME: Final = WORLD_FRAME.encode() + b"\0"
# An empty frame_id is the object's; 13 bytes, then 3 of padding.
_WRENCH_CDR: Final = struct.Struct("<4siIIs3x6d")


def write_recording(
    path: str,
    poses: Poses,
    truth: Truth | None,
    metadata: Mapping[str, str],
    check: Callable[[], None] = accept_any,
    wrenches: Wrenches | None = None,
) -> None:
    """Write a recording, whole or not at all; the same input gives the same bytes.

    Parameters
    ----------
    path : an existing file is replaced.
    poses : to ``/object/pose``, log time = header stamp; stamps from 0 to 2^31 s.
    truth : to ``/contact/truth`` at each change of contact, and as the attachment ``truth.json``.
    metadata : the metadata record ``recording``.
    check : check of the file that is replaced, as for ``whole_file``.
    wrenches : wrenches of the hand on the object, to ``/object/wrench``; stamps as for ``poses``.

    Raises
    ------
    OSError
        If the file cannot be written.
    ValueError
        If a stamp cannot be represented.
    """
    for stamp_ns in (poses.stamp_ns, wrenches.stamp_ns if wrenches is not None else poses.stamp_ns):
        if len(stamp_ns) and not 0 <= int(stamp_ns.min()) <= int(stamp_ns.max()) < 2**31 * 10**9:
            raise ValueError("stamps of a recording lie between 0 and 2^31 s")
    with whole_file(Path(path), check) as temporary, temporary.open("wb") as file:
        writer = Writer(file, chunk_size=_CHUNK_SIZE)
        writer.start(profile="ros2", library=_LIBRARY)
        writer.add_metadata(METADATA_NAME, dict(metadata))
        pose_channel = _channel(writer, POSE_TOPIC, POSE_TYPE)
        messages = list[tuple[int, int, bytes]]()
        if truth is not None:
            # Before the messages, so that a truncated or piped recording still has its truth.
            writer.add_attachment(0, 0, TRUTH_ATTACHMENT, "application/json", truth.to_json().encode())
            truth_channel, before = _channel(writer, TRUTH_TOPIC, TRUTH_TYPE), ""
            for interval in truth.intervals:
                label = interval.contact.value if interval.contact else UNSCORED
                if label != before:
                    data = label.encode() + b"\0"
                    cdr = _CDR_LITTLE_ENDIAN + struct.pack("<I", len(data)) + data
                    messages.append((interval.start_ns, truth_channel, cdr))
                before = label
        messages += ((pose.stamp_ns, pose_channel, _pose_cdr(pose)) for pose in poses)
        if wrenches is not None:
            wrench_channel = _channel(writer, WRENCH_TOPIC, WRENCH_TYPE)
            numbers = np.concatenate([wrenches.force_n, wrenches.moment_nm], axis=1).tolist()
            for ns, row in zip(wrenches.stamp_ns.tolist(), numbers, strict=True):
                cdr = _WRENCH_CDR.pack(_CDR_LITTLE_ENDIAN, *divmod(ns, 10**9), 1, b"\0", *row)
                messages.append((ns, wrench_channel, cdr))
        for log_time_ns, channel, cdr in sorted(messages, key=lambda message: message[0]):
            writer.add_message(channel, log_time_ns, cdr, log_time_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def _channel(writer: Writer, topic: str, kind: str) -> int:
    return writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", _schema(kind)))


@cache
def _schema(kind: str) -> bytes:
    definition = known_definition(kind)
    assert definition is not None
    return definition.ros2msg.encode()


def _pose_cdr(pose: Pose) -> bytes:
    time, numbers = divmod(pose.stamp_ns, 10**9), (*pose.position_m, *pose.quat_xyzw)
    return _POSE_CDR.pack(_CDR_LITTLE_ENDIAN, *time, len(_FRAME), _FRAME, *numbers)


_COPY_CHUNK_SIZE: Final = 1024 * 1024


def write_beside(path: Path, log: str | None, added: Iterable[RawMessage]) -> None:
    """Write a recording and result messages, merged by log time.

    Parameters
    ----------
    log : the recording, which is read again; None to write the result alone. Damaged parts are left out.
    added : messages on ``RESULT_TOPICS`` by log time, which replace the recording's messages on these topics.

    Raises
    ------
    UnreadableRecording
        The recording can no longer be read.
    OSError
        The file cannot be written.
    """
    with path.open("wb") as file:
        items = () if log is None else Reading(log, lambda channel: channel.topic not in RESULT_TOPICS)
        writer = Writer(file, chunk_size=_COPY_CHUNK_SIZE)
        writer.start(profile="", library=_LIBRARY)  # profile ros2 requires CDR
        numbers: dict[Channel, int] = {}
        for message in merge(_messages(items, writer), added, key=lambda message: message.log_time_ns):
            channel, schema = message.channel, 0
            if channel not in numbers:
                if channel.type or channel.schema_encoding:
                    kind = channel.type, channel.schema_encoding, channel.schema
                    schema = writer.register_schema(*kind)
                numbers[channel] = writer.register_channel(channel.topic, channel.encoding, schema)
            writer.add_message(numbers[channel], message.log_time_ns, message.data, message.log_time_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def _messages(items: Iterable[Item], writer: Writer) -> Iterator[RawMessage]:
    """The messages; other items are written at once."""
    for item in items:
        match item:
            case RawMessage():
                yield item
            case Rows(sources, poses):
                for source, pose in zip(sources, poses, strict=True):
                    name = f"{source.topic}/{source.child_frame_id}".rstrip("/")
                    channel = Channel(name, "cdr", POSE_TYPE, "ros2msg", _schema(POSE_TYPE))
                    yield RawMessage(channel, pose.stamp_ns, _pose_cdr(pose))
            case Attachment():
                times = item.create_time, item.log_time
                writer.add_attachment(*times, item.name, item.media_type, item.data)
            case Metadata():
                writer.add_metadata(item.name, item.metadata)
