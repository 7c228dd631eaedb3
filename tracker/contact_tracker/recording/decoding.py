"""Decoding of messages to observed poses, by the library of each channel's encoding."""

import json
import struct
from collections.abc import Callable, Iterable, Sequence
from contextlib import redirect_stderr
from io import StringIO
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

import numpy as np
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from contact_tracker.errors import MissingExtra
from contact_tracker.extras import module_of_extra
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording.bytestream import ZSTD_MAGIC
from contact_tracker.recording.definitions import (
    DecodingWork,
    Definition,
    known_definition,
    parse_definition,
    work_of,
)
from contact_tracker.recording.items import PARSE_ERRORS, POSE_ROW, Channel, RawMessage, inflate_zstd
from contact_tracker.recording.layouts import Layouts, Observation, ObservedColumns
from contact_tracker.recording.limits import BYTES_PER_RECORD, TooMuchWork, WorkBudget
from contact_tracker.recording.message_types import (
    canonical,
    is_pose_type,
    number_of_poses,
    observations,
    typed,
)
from contact_tracker.recording.ros1 import ros1_decoder

MESSAGE_LIMIT: Final = 2**22
_ROW: Final = struct.Struct("<q7d")
_ROW_COLUMNS: Final = np.dtype([("stamp_ns", "<i8"), ("numbers", "<f8", (7,))])
POSES_PER_RECORD: Final = 4
"""Number of poses of a known layout that count as the work of one record."""
_INFLATED_PER_RECORD: Final = 2**17
"""Decompressed bytes of a message that count as the work of one record, whether it is decoded or not."""
READ: Final = "ROS 2 (cdr), ROS 1 (ros1), protobuf and json"


class Undecodable(Exception):
    """A message does not match its schema."""


class _Decoder(NamedTuple):
    """A library's decoder, the work of its messages, and whether its definition is the known one of CDR."""

    decode: Callable[[bytes], Any]
    work: DecodingWork = DecodingWork()
    is_known: bool = False


_Definition = tuple[str, str, str, bytes]
"""Encoding, type, encoding of the schema, and schema."""


class _Defined(NamedTuple):
    """What follows from a definition, which many channels can have in common.

    Parameters
    ----------
    decoder : that of the library, and its work; None where the definition in the file cannot be used.
    assumption : why the known definition of the type is used, in words; None where it is not.
    """

    decoder: _Decoder | None
    assumption: str | None


class _Reading(NamedTuple):
    """How the messages of a channel are read."""

    defined: _Defined
    layouts: Layouts


class MessageDecoder:
    """Decodes messages by the schema of their channel, with one decoder per channel.

    Parameters
    ----------
    budget : of the recording; messages that exceed it are not decoded. None for messages that are made here.
    """

    def __init__(self, budget: WorkBudget | None) -> None:
        self._budget = budget
        self._readings: dict[Channel, _Reading] = {}
        self._defined: dict[_Definition, _Defined] = {}
        self._current: tuple[Channel, _Reading] | None = None

    def decode(self, message: RawMessage) -> Any:
        """The message as an object with attributes; raises Undecodable, or MissingExtra without its
        library."""
        return self._decoded(message)[0]

    def _decoded(self, message: RawMessage) -> tuple[Any, int]:
        """As ``decode``, with the work that was counted (records)."""
        channel, _, data = message
        try:
            decoder = self._reading(channel).defined.decoder
            if decoder is None:
                raise Undecodable(f"{channel.topic}: the schema of {channel.type} cannot be used")
            decode, work, _ = decoder
            if data.startswith(ZSTD_MAGIC):
                self._count_work(message, 1)  # before and after: its size is not known
                data = inflate_zstd(data, MESSAGE_LIMIT)
                self._count_work(message, len(data) // _INFLATED_PER_RECORD)
            records = max(len(data) // BYTES_PER_RECORD, work.records(len(data)))
            self._count_work(message, records)
            return decode(data), records
        except (Undecodable, MissingExtra):
            raise
        except (*PARSE_ERRORS, TypeError, AttributeError, AssertionError) as error:
            raise Undecodable(f"{channel.topic}: {error}") from error
        except Exception as error:
            if channel.encoding == "cdr":
                raise
            raise Undecodable(f"{channel.topic}: {error}") from error  # errors of optional libraries

    def assumption(self, channel: Channel) -> str | None:
        """Why a channel is read by the known definition of its type; None if it is not."""
        return self._reading(channel).defined.assumption if channel.encoding == "cdr" else None

    def layouts(self, channel: Channel) -> Layouts:
        """The known byte layouts of a channel's messages."""
        return self._reading(channel).layouts

    def observe(self, message: RawMessage) -> list[Observation]:
        """The poses in a message of a pose type; raises Undecodable."""
        channel = message.channel
        if is_row(channel):
            return _row(message)
        layouts = self.layouts(channel)
        found = layouts.read(message.data)
        if found is not None:
            self._count_work(message, (len(found) - 1) // POSES_PER_RECORD)
            return found
        found = self._observe(message)
        layouts.learn(message.data, found)
        return found

    def observe_all(self, messages: Sequence[RawMessage]) -> ObservedColumns | None:
        """The poses in messages of one channel; None unless they are of one source and a known layout."""
        channel = messages[0].channel
        if is_row(channel):
            return _rows(messages)
        known = self._readings.get(channel)
        return None if known is None else known.layouts.read_all([message.data for message in messages])

    def _observe(self, message: RawMessage) -> list[Observation]:
        """The poses in a message, by the library's decoder."""
        decoded, records = self._decoded(message)
        self._count_work(message, max(number_of_poses(decoded) // POSES_PER_RECORD - records, 0))
        try:
            found = observations(message.channel.type, decoded)
            return typed(found) if message.channel.encoding == "json" else found
        except (AttributeError, TypeError, ValueError, OverflowError, StopIteration) as error:
            raise Undecodable(f"{message.channel.topic}: {error}") from error

    def _reading(self, channel: Channel) -> _Reading:
        if (
            self._current is not None and self._current[0] is channel
        ):  # hashing takes longer than reading a pose
            return self._current[1]
        reading = self._readings.get(channel)
        if reading is None:
            reading = self._readings[channel] = self._new_reading(channel)
        self._current = channel, reading
        return reading

    def _new_reading(self, channel: Channel) -> _Reading:
        key = channel.encoding, channel.type, channel.schema_encoding, channel.schema
        defined = self._defined.get(key)
        if defined is None:
            defined = self._defined[key] = self._new_definition(channel)
        has_layouts = defined.decoder is not None and defined.decoder.is_known
        return _Reading(defined, Layouts(canonical(channel.type) if has_layouts else ""))

    def _new_definition(self, channel: Channel) -> _Defined:
        decoder: _Decoder | None = None
        why: str | None = "its definition in the file is too long, or one of too many"
        if self._is_explained(channel.schema):
            decoder, why = _decoder_of(channel)
        if decoder is None and channel.encoding == "cdr":
            known = known_definition(channel.type)
            decoder = None if known is None else _cdr(known)
        return _Defined(decoder, why if decoder is not None and channel.encoding == "cdr" else None)

    def _is_explained(self, schema: bytes) -> bool:
        """Whether the bytes of the file explain the work of reading a definition, which is counted then."""
        try:
            if self._budget is not None:
                self._budget.count_definition(len(schema))
        except TooMuchWork:
            return False
        return True

    def _count_work(self, message: RawMessage, records: int) -> None:
        """Count the work beyond that of one record; raises Undecodable where it exceeds the budget."""
        if records and self._budget is not None:
            try:
                self._budget.count_records(records)
            except TooMuchWork as error:
                self._budget.leave_out_message()
                raise Undecodable(f"{message.channel.topic}: {error}") from error


def assumption_text(count: int, type_name: str, why: str) -> str:
    """One line that says that a definition was assumed for ``count`` poses."""
    return f"{count} poses are read by the known definition of {type_name}: {why}"


def may_have_poses(channel: Channel) -> bool:
    """Whether a channel's messages are poses and can be decoded."""
    return (is_pose_type(channel.type) and is_readable(channel)) or is_row(channel)


def is_readable(channel: Channel) -> bool:
    """Whether a channel has a schema that a library can decode."""
    if not channel.type:
        return False
    match channel.encoding, channel.schema_encoding:
        case ("cdr", "ros2msg" | "") | ("ros1", "ros1msg") | ("protobuf", "protobuf") | ("json", _):
            return True
        case "cdr", "ros2idl":
            return known_definition(channel.type) is not None
    return False


def row_channel(topic: str, type_name: str, frame_id: str, child_frame_id: str) -> Channel:
    """A channel of poses in rows, from a table or composed of transforms."""
    return Channel(topic, POSE_ROW, type_name, "", f"{frame_id}\0{child_frame_id}".encode())


def is_row(channel: Channel) -> bool:
    """Whether its messages are such rows. These have a stamp in any case, also where it is zero."""
    return channel.encoding == POSE_ROW


def pose_row(stamp_ns: int, numbers: Iterable[float]) -> bytes:
    """A message of a row channel; ``numbers`` are position (m) and quaternion ``xyzw``."""
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


def _decoder_of(channel: Channel) -> tuple[_Decoder | None, str | None]:
    """The decoder of a channel by its schema, None if that is unusable; and why the known definition of its
    type is used, if it is."""
    if channel.schema_encoding == "ros2idl":
        return None, "definitions in IDL are not read"
    if channel.encoding == "cdr" and not channel.schema.strip():
        return None, "the file does not define it"
    try:
        match channel.encoding:
            case "cdr":
                definition = parse_definition(channel.schema.decode(errors="replace"), channel.type)
                lacks = None if definition.is_complete else "its definition in the file lacks parts"
                if (decoder := _cdr(definition)) is not None:
                    return decoder, lacks
            case "ros1":
                definition = parse_definition(channel.schema.decode(), channel.type)
                return _Decoder(ros1_decoder(definition), work_of(definition)), None
            case "protobuf":
                decode = protobuf_reading(channel)
                return None if decode is None else _Decoder(decode), None
            case "json":
                return _Decoder(decode_json), None
    except MissingExtra:
        raise
    except Exception:  # an invalid schema can raise anything
        return None, "its definition in the file cannot be used"
    return None, "its definition in the file cannot be used"


def _cdr(definition: Definition) -> _Decoder | None:
    decode = cdr_decoder(definition)
    known = known_definition(definition.type)
    is_known = known is not None and known.fields == definition.fields
    return None if decode is None else _Decoder(decode, work_of(definition), is_known)


Decoder = Callable[[bytes], Any]


def cdr_decoder(definition: Definition) -> Decoder | None:
    """The decoder of messages; an invalid definition can raise any error of the library."""
    text = definition.ros2msg.encode()
    schema = Schema(id=1, name=definition.type, encoding="ros2msg", data=text)
    with redirect_stderr(StringIO()):  # the parser also prints its errors
        decoder: Decoder | None = DecoderFactory().decoder_for("cdr", schema)
    return decoder


def protobuf_reading(channel: Channel) -> Callable[[bytes], Any] | None:
    """The decoder of a protobuf channel; an invalid schema can raise any error of the library."""
    factory = module_of_extra("mcap_protobuf.decoder", "foxglove", "protobuf").DecoderFactory()
    decoder: Callable[[bytes], Any] | None = factory.decoder_for(
        channel.encoding, Schema(id=1, name=channel.type, encoding="protobuf", data=channel.schema)
    )
    return decoder


def decode_json(data: bytes) -> Any:
    """A JSON object; raises ValueError."""
    return json.loads(data, object_hook=lambda values: SimpleNamespace(**values))
