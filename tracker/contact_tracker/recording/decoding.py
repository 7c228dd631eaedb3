"""From messages to observed poses: each channel by the library of its encoding."""

import struct
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np

from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording.bytestream import ZSTD_MAGIC
from contact_tracker.recording.extras import MissingExtra
from contact_tracker.recording.foxglove import decode_json, protobuf_reading
from contact_tracker.recording.items import PARSE_ERRORS, POSE_ROW, Channel, RawMessage, inflate_zstd
from contact_tracker.recording.layouts import Layouts, Observation, ObservedColumns
from contact_tracker.recording.limits import TooMuchWork, WorkBudget
from contact_tracker.recording.message_types import canonical, is_pose_type, observations, typed
from contact_tracker.recording.ros import cdr_reading, ros1_decoding

MESSAGE_LIMIT: Final = 2**22
BYTES_PER_RECORD: Final = 128
"""So many bytes of a message are as much work as a record."""
_ROW: Final = struct.Struct("<q7d")
_ROW_COLUMNS: Final = np.dtype([("stamp_ns", "<i8"), ("numbers", "<f8", (7,))])
POSES_PER_RECORD: Final = 4
"""So many poses of a known layout are as much work as a record."""
READ: Final = "ROS 2 (cdr), ROS 1 (ros1), protobuf and json"


class Undecodable(Exception):
    """A message that is not what its schema promises."""


class MessageDecoder:
    """Decodes messages by the schema of their channel; keeps one decoder per channel.

    Parameters
    ----------
    budget : of the recording; messages that are larger than it explains are not decoded.
    """

    def __init__(self, budget: WorkBudget | None = None) -> None:
        self._budget = budget
        self._decoders: dict[Channel, Callable[[bytes], Any] | None] = {}
        self._layouts: dict[Channel, Layouts] = {}
        self._current: Channel | None = None
        self._known = Layouts("")

    def decode(self, message: RawMessage) -> Any:
        """The message as an object with attributes; raises Undecodable, or MissingExtra where no library is
        installed for it."""
        channel, _, data = message
        try:
            try:
                decoder = self._decoders[channel]
            except KeyError:
                decoder = self._decoders[channel] = _decoder_of(channel)
            if decoder is None:
                raise Undecodable(f"{channel.topic}: the schema of {channel.type} cannot be used")
            if data.startswith(ZSTD_MAGIC):
                data = inflate_zstd(data, MESSAGE_LIMIT)
            self._count_work(message, len(data) // BYTES_PER_RECORD)
            return decoder(data)
        except (Undecodable, MissingExtra):
            raise
        except (*PARSE_ERRORS, TypeError, AttributeError, AssertionError) as error:
            raise Undecodable(f"{channel.topic}: {error}") from error
        except Exception as error:
            if channel.encoding == "cdr":
                raise
            raise Undecodable(f"{channel.topic}: {error}") from error  # errors of optional libraries

    def _count_work(self, message: RawMessage, records: int) -> None:
        """Count the work beyond that of one record; raises Undecodable where the file does not explain it."""
        if records and self._budget is not None:
            try:
                self._budget.count_records(records)
            except TooMuchWork as error:
                raise Undecodable(f"{message.channel.topic}: {error}") from error

    def observe(self, message: RawMessage) -> list[Observation]:
        """The poses in a message of a pose type; raises Undecodable."""
        channel = message.channel
        if channel.encoding == POSE_ROW:
            return _row(message)
        if channel is not self._current:  # hashing one takes longer than reading a pose
            self._current, self._known = (
                channel,
                self._layouts.setdefault(channel, Layouts(_laid_out(channel))),
            )
        found = self._known.read(message.data)
        if found is not None:
            self._count_work(message, (len(found) - 1) // POSES_PER_RECORD)
            return found
        found = self._observe(message)
        with suppress(Undecodable):
            self._known.learn(message.data, lambda data: self._observe(message._replace(data=data)))
        return found

    def observe_all(self, messages: Sequence[RawMessage]) -> ObservedColumns | None:
        """The poses in messages of one channel, if they are of one source and of a layout that is known."""
        channel = messages[0].channel
        if channel.encoding == POSE_ROW:
            return _rows(messages)
        known = self._layouts.get(channel)
        return None if known is None else known.read_all([message.data for message in messages])

    def _observe(self, message: RawMessage) -> list[Observation]:
        """The same by the library's decoder."""
        decoded = self.decode(message)
        try:
            found = observations(message.channel.type, decoded)
            return typed(found) if message.channel.encoding == "json" else found
        except (AttributeError, TypeError, ValueError, OverflowError, StopIteration) as error:
            raise Undecodable(f"{message.channel.topic}: {error}") from error


def may_have_poses(channel: Channel) -> bool:
    """Whether its messages are poses, and can be decoded."""
    return (is_pose_type(channel.type) and is_readable(channel)) or channel.encoding == POSE_ROW


def is_readable(channel: Channel) -> bool:
    """Whether it says what is in its messages, and there is a library for that."""
    if not channel.type:
        return False
    match channel.encoding, channel.schema_encoding:
        case ("cdr", "ros2msg" | "ros2idl" | "") | ("ros1", "ros1msg") | ("protobuf", "protobuf"):
            return True
        case "json", _:
            return True
    return False


def row_channel(topic: str, type_name: str, frame_id: str, child_frame_id: str) -> Channel:
    """A channel of poses that other modules have put into rows: of a table, or composed of transforms."""
    return Channel(topic, POSE_ROW, type_name, "", f"{frame_id}\0{child_frame_id}".encode())


def pose_row(stamp_ns: int, numbers: Iterable[float]) -> bytes:
    """A message of such a channel: position and quaternion ``xyzw``."""
    return _ROW.pack(stamp_ns, *numbers)


def _row_frames(channel: Channel) -> tuple[str, str]:
    frame_id, _, child_frame_id = channel.schema.decode(errors="replace").partition("\0")
    return frame_id, child_frame_id


def _row(message: RawMessage) -> list[Observation]:
    try:
        stamp_ns, px, py, pz, x, y, z, w = _ROW.unpack(message.data)
    except struct.error as error:
        raise Undecodable(f"{message.channel.topic}: {error}") from error
    return [Observation(*_row_frames(message.channel), Pose(stamp_ns, (px, py, pz), (x, y, z, w)))]


def _rows(messages: Sequence[RawMessage]) -> ObservedColumns | None:
    if any(len(message.data) != _ROW.size for message in messages):
        return None
    rows = np.frombuffer(b"".join(message.data for message in messages), _ROW_COLUMNS)
    poses = Poses(rows["stamp_ns"].astype(np.int64), rows["numbers"][:, :3], rows["numbers"][:, 3:])
    return ObservedColumns(*_row_frames(messages[0].channel), poses)


def _laid_out(channel: Channel) -> str:
    """The type, if its messages may have a known layout."""
    return canonical(channel.type) if channel.encoding == "cdr" else ""


def _decoder_of(channel: Channel) -> Callable[[bytes], Any] | None:
    """The decoder for a channel; None if its schema is unusable."""
    match channel.encoding:
        case "cdr":
            return cdr_reading(channel)
        case "ros1":
            return ros1_decoding(channel)
        case "protobuf":
            return protobuf_reading(channel)
        case "json":
            return decode_json
    return None
