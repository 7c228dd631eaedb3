"""Decoding of messages to poses as published, by the library of each encoding; and where poses are in them.

Where they are is a path of fields, of known types and as users name it (``--field``): names with dots
between, ``detections.results[0]``; all elements of a list are meant where none is. It leads to a position and
rotation, or to what holds these in a field ``pose`` or ``transform``. The stamp, frame and name of the
body are those of the message or the part of it next to the pose that has one. Where there are several without
a name, their number is the child frame: ``0`` is the first pose of a PoseArray. The stamp of a type without
one is zero, like an unset stamp.

Poses in CDR are read at fixed offsets, several times faster than by field: with constant frame names, the
messages of a channel differ only in stamps and seven numbers per pose, at offsets that follow from the known
definition of the type. If a file defines the type differently, its messages are left to the library.
"""

import json
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr, suppress
from io import StringIO
from itertools import islice
from operator import attrgetter
from types import MappingProxyType, SimpleNamespace
from typing import Any, Final, NamedTuple

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from contact_tracker.errors import MissingExtra, module_of_extra
from contact_tracker.motion.poses import Pose
from contact_tracker.recording.bytestream import BYTES_PER_RECORD, ZSTD_MAGIC, TooMuchWork, WorkBudget
from contact_tracker.recording.definitions import (
    DecodingWork,
    Definition,
    canonical,
    known_definition,
    parse_definition,
    ros1_decoder,
    work_of,
)
from contact_tracker.recording.items import ROWS, Channel, Item, PoseSource, RawMessage, Rows
from contact_tracker.recording.mcap_file import PARSE_ERRORS, inflate_zstd

SECOND_NS: Final = 1_000_000_000
_MOST_NS: Final = 2**63 - 1
"""Stands for later stamps; the pose gate rejects it."""
_SECONDS: Final = ("sec", "seconds", "secs")
_FRACTIONS: Final = ("nanosec", "nsec", "nanos", "nsecs")
_ADDED: Final = 0
"""The action of a marker that is shown; the others delete it."""
_STAMPS: Final = ("header.stamp", "timestamp", "stamp")
_FRAMES: Final = ("header.frame_id", "frame_id", "parent_frame_id")
_NAMES: Final = ("child_frame_id", "rigid_body_name", "name")
_NAMES_IN_LISTS: Final = (*_NAMES, "hypothesis.class_id", "id")
_PARTS: Final = {"position": "orientation", "translation": "rotation"}
_HOLDERS: Final = ("pose", "transform")
_DEEPEST: Final = 3
"""Most such fields in each other."""
_FOXGLOVE: Final = {
    "PoseInFrame": "",
    "PosesInFrame": "poses",
    "FrameTransform": "",
    "FrameTransforms": "transforms",
}
POSE_TYPES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": "",
        "geometry_msgs/msg/PoseWithCovarianceStamped": "",
        "geometry_msgs/msg/TransformStamped": "",
        "nav_msgs/msg/Odometry": "",
        "tf2_msgs/msg/TFMessage": "transforms",
        "tf/msg/tfMessage": "transforms",
        "geometry_msgs/msg/Pose": "",
        "geometry_msgs/msg/PoseArray": "poses",
        "visualization_msgs/msg/Marker": "",
        "visualization_msgs/msg/MarkerArray": "markers",
        "vision_msgs/msg/Detection3DArray": "detections.results[0]",
        "gazebo_msgs/msg/ModelStates": "pose",
        "motion_capture_tracking_interfaces/msg/NamedPoseArray": "poses",
        "mocap4r2_msgs/msg/RigidBodies": "rigidbodies",
        **{f"foxglove.{name}": path for name, path in _FOXGLOVE.items()},
        **{f"foxglove_msgs/msg/{name}": path for name, path in _FOXGLOVE.items()},
    }
)
"""The path to the poses in each known type."""
_MOST_FIELDS: Final = 500
"""Fields of a definition that are looked at for poses."""


def pose_field(channel: Channel, field: str | None = None) -> str | None:
    """The path to the poses in a channel's messages, None if these have none; ``field`` is that of the user,
    whose names are looked up in the text of the definition."""
    if field is None:
        return POSE_TYPES.get(canonical(channel.type))
    names = [*re.findall(r"[A-Za-z_]\w*", field), "(position|translation)"]
    has_names = all(re.search(rf"\b{name}\b".encode(), channel.schema) for name in names)
    return field if has_names or channel.encoding == "json" else None


def fields_with_poses(channel: Channel) -> list[str]:
    """Paths of poses in the messages of a channel of ROS, by their definition."""
    try:
        definition = parse_definition(channel.schema.decode(errors="replace"), channel.type)
    except (ValueError, KeyError):
        return []
    found, waiting = list[str](), [("", definition.type)]
    for path, kind in waiting:  # which grows
        fields = definition.fields.get(kind, ())
        names = {field.name for field in fields}
        if any(names.issuperset(parts) for parts in _PARTS.items()):
            found.append(path or ".")
        elif len(waiting) < _MOST_FIELDS:
            waiting += [(f"{path}.{field.name}".lstrip("."), field.type) for field in fields]
    return found


def poses_at(path: str, message: Any) -> Iterator[tuple[str, str, Pose] | None]:
    """Frame, child frame and pose of each pose at a path in a decoded message, whichever library decoded it;
    None for an element without one. Unexpected attributes and values can raise any error."""
    seen = set[tuple[str, str, int]]()
    for inside, number in _reached((message,), re.findall(r"(\w+)(?:\[(\d+)\])?", path), ""):
        is_deleted = any(hasattr(part, "ns") and getattr(part, "action", _ADDED) != _ADDED for part in inside)
        if not inside or is_deleted:
            yield None
            continue
        for _ in range(_DEEPEST):
            holder = next((name for name in _HOLDERS if hasattr(inside[-1], name)), None)
            inside = inside if holder is None else (*inside, getattr(inside[-1], holder))
        pose = inside[-1]
        place = next((name for name in _PARTS if hasattr(pose, name)), "position")
        px, py, pz = map(float, _xyz(getattr(pose, place)))
        turn = getattr(pose, _PARTS[place])
        x, y, z, w = map(float, (*_xyz(turn), turn.w))
        stamps = (one for one in _nearest(inside, _STAMPS) if not isinstance(one, int | float | str))
        stamp_ns = next(filter(None, map(_stamp_ns, stamps)), 0)
        frame = next(filter(None, _nearest(inside, _FRAMES)), "")
        if not isinstance(frame, str):
            raise TypeError("the name of a frame is no text")
        child = _child(inside, number)
        child = f"{child}#{number}" if (frame, child, stamp_ns) in seen else child  # a second cup
        seen.add((frame, child, stamp_ns))
        yield frame, child, Pose(stamp_ns, (px, py, pz), (x, y, z, w))


def _reached(
    inside: tuple[Any, ...], steps: list[tuple[str, str]], number: str
) -> Iterator[tuple[tuple[Any, ...], str]]:
    """What is at the end of a path, after all that it is part of; and its name or number, if there are
    several. Nothing if a list has no such element."""
    if not steps:
        yield inside, number
        return
    (name, index), *rest = steps
    value = getattr(inside[-1], name)
    if not hasattr(value, "__len__"):
        yield from _reached((*inside, value), rest, number)
    elif not index:
        names: Any = getattr(inside[-1], "name", None)
        has_names = hasattr(names, "__len__") and not isinstance(names, str) and len(names) == len(value)
        for i, one in enumerate(value):
            yield from _reached((*inside, one), rest, str(names[i] if has_names else i))
    elif int(index) < len(value):
        yield from _reached((*inside, value[int(index)]), rest, number)
    else:
        yield (), ""


def _nearest(inside: tuple[Any, ...], names: tuple[str, ...]) -> Iterator[Any]:
    """The fields of any of these names, that of the innermost part first."""
    for part in reversed(inside):
        for name in names:
            with suppress(AttributeError):
                yield attrgetter(name)(part)


def _child(inside: tuple[Any, ...], number: str) -> str:
    """The name of the body, of a marker ``ns/id``; its number where it has no name."""
    found = list[str]()
    for part in reversed(inside):
        if hasattr(part, "ns") and hasattr(part, "id"):
            found.append(f"{part.ns}/{part.id}")
            continue
        names = _NAMES_IN_LISTS if number and part is not inside[0] else _NAMES
        texts = (one for one in _nearest((part,), names) if isinstance(one, str | int) and one != "")
        found += [str(one) for one in islice(texts, 1)]
    return "/".join(found) or number


def _xyz(vector: Any) -> tuple[Any, Any, Any]:
    return vector.x, vector.y, vector.z


def _stamp_ns(stamp: Any) -> int:
    """Nanoseconds of a time of ROS, protobuf or JSON."""
    seconds, fraction = (
        [getattr(stamp, name) for name in names if hasattr(stamp, name)] for names in (_SECONDS, _FRACTIONS)
    )
    return max(min(int(seconds[0]) * SECOND_NS + int(fraction[0]), _MOST_NS), -_MOST_NS)


USUAL: Final = (
    "PoseStamped, PoseWithCovarianceStamped, TransformStamped, Odometry, TFMessage, PoseArray, "
    "foxglove.PoseInFrame and foxglove.FrameTransform"
)
MESSAGE_LIMIT: Final = 2**22
POSES_PER_RECORD: Final = 4
"""Number of poses of a known layout that count as the work of one record."""
_RECORDS_PER_DEFINITION: Final = 64
"""Records whose work a definition takes, whatever its length."""
_DEFINITION_BYTES_PER_RECORD: Final = 8
"""Bytes of a definition that count as the work of one record more."""
_INFLATED_PER_RECORD: Final = 2**17
"""Decompressed bytes of a message that count as the work of one record, whether it is decoded or not."""
READ: Final = "ROS 2 (cdr), ROS 1 (ros1), protobuf and json"
_ENCAPSULATION: Final = 4
_PLAIN: Final = (b"\0\0", b"\0\1")
"""How messages of the first version of CDR begin, in big and little endian."""
_STAMP: Final = 8
_NUMBERS: Final = 56
_COVARIANCE: Final = 288
_TWIST: Final = 48 + _COVARIANCE
_PER_SIZE: Final = 8
_MOST: Final = 64
"""Most layouts of one size, and in all: some channels have endlessly many frame names."""

_Definition = tuple[str, str, str, bytes]
"""Encoding, type, encoding of the schema, and schema."""
Observation = tuple[PoseSource, Pose]
"""One pose as published, before validation; the child frame is empty where the type has none."""
LoggedPose = tuple[PoseSource, Pose, int]
"""The same with its log time in nanoseconds."""


class _Type(NamedTuple):
    """Layout of a message type: ``stamp_at``, offset of the first stamp; number of names after it; bytes
    after the numbers; whether there may be several such blocks after their count."""

    stamp_at: int
    names: int
    tail: int
    repeats: bool = False


_TYPES: Final[Mapping[str, _Type]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": _Type(4, 1, 0),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _Type(4, 1, _COVARIANCE),
        "geometry_msgs/msg/TransformStamped": _Type(4, 2, 0),
        "nav_msgs/msg/Odometry": _Type(4, 2, _COVARIANCE + _TWIST),
        "tf2_msgs/msg/TFMessage": _Type(8, 2, 0, repeats=True),
    }
)


class _Layout(NamedTuple):
    """``fixed`` are the constant bytes around stamps and numbers, with their offsets."""

    fixed: tuple[tuple[int, int, bytes], ...]
    values: struct.Struct
    sources: tuple[PoseSource, ...]

    def read(self, data: bytes) -> list[Observation] | None:
        """The poses if the constant bytes match, else None; ``data`` has the size of the layout."""
        for start, end, expected in self.fixed:
            if data[start:end] != expected:
                return None
        values = self.values.unpack(data)
        found = list[Observation]()
        for i, source in enumerate(self.sources):
            sec, nanosec, px, py, pz, x, y, z, w = values[9 * i : 9 * i + 9]
            found.append((source, Pose(sec * SECOND_NS + nanosec, (px, py, pz), (x, y, z, w))))
        return found


class _Layouts:
    """The known layouts of one channel, by message size."""

    def __init__(self, message_type: str) -> None:
        self._type = _TYPES.get(message_type)
        self._by_size: dict[int, list[_Layout]] = {}
        self._left = _MOST

    def read(self, data: bytes) -> list[Observation] | None:
        """The poses in a message; None if no layout fits."""
        found = (layout.read(data) for layout in self._by_size.get(len(data), ()))
        return next((one for one in found if one is not None), None)

    def learn(self, data: bytes, found: Sequence[Observation]) -> None:
        """Add the layout of a message, in which the library has ``found`` these poses."""
        if self._type is None or not self._left or len(self._by_size.get(len(data), ())) >= _PER_SIZE:
            return
        blocks, order = _blocks(data, self._type), _order(data)
        if not blocks or len(blocks) != len(found):
            return
        bodies = {(one.frame_id, one.child_frame_id.partition("#")[0]) for one, _ in found}
        if len(bodies) < len(found):  # their names depend on whether their stamps are equal
            return
        fields, fixed, at = [order], list[tuple[int, int, bytes]](), 0
        for stamp_at, numbers_at in blocks:
            names_at = stamp_at + _STAMP
            fixed += [(at, stamp_at, data[at:stamp_at]), (names_at, numbers_at, data[names_at:numbers_at])]
            fields.append(f"{stamp_at - at}xiI{numbers_at - names_at}x7d")
            at = numbers_at + _NUMBERS + self._type.tail
        values = struct.Struct("".join([*fields, f"{self._type.tail}x"]))
        layout = _Layout(tuple(fixed), values, tuple(source for source, _ in found))
        self._by_size.setdefault(len(data), []).append(layout)
        self._left -= 1


def _blocks(data: bytes, kind: _Type) -> list[tuple[int, int]]:
    """Offsets of the stamp and of the numbers of each pose; none unless the message has the size of its type
    and names."""
    if len(data) < max(kind.stamp_at, _ENCAPSULATION + 4) or data[:2] not in _PLAIN:
        return []
    order = _order(data)
    count = struct.unpack_from(f"{order}I", data, _ENCAPSULATION)[0] if kind.repeats else 1
    stamp_at, blocks = kind.stamp_at, list[tuple[int, int]]()
    while len(blocks) < count and stamp_at + _STAMP <= len(data):
        end = stamp_at + _STAMP
        for _ in range(kind.names):
            end += (_ENCAPSULATION - end) % 4
            if end + 4 > len(data):
                return []
            end += 4 + struct.unpack_from(f"{order}I", data, end)[0]
        start = end + (_ENCAPSULATION - end) % 8
        blocks.append((stamp_at, start))
        stamp_at = start + _NUMBERS + kind.tail
    return blocks if len(blocks) == count and stamp_at == len(data) else []


def _order(data: bytes) -> str:
    return "<" if data[1] & 1 else ">"


class Undecodable(Exception):
    """A message does not match its schema."""


class _Decoder(NamedTuple):
    """A library's decoder, the work of its messages, and whether its definition is the known one of CDR."""

    decode: Callable[[bytes], Any]
    work: DecodingWork = DecodingWork()
    is_known: bool = False


_Reading = tuple[_Decoder | None, _Layouts]
"""How the messages of a channel are read; the decoder is None where its definition cannot be used."""


class MessageDecoder:
    """Decodes messages by the schema of their channel, with one decoder per channel.

    Parameters
    ----------
    budget : of the recording; messages that exceed it are not decoded.
    field : path to the poses in messages that have it.

    Attributes
    ----------
    assumed : why a type on a topic is read by its known definition, in words, where it is.
    """

    def __init__(self, budget: WorkBudget, field: str | None = None) -> None:
        self.assumed: dict[tuple[str, str], str] = {}
        self._field = field
        self._budget = budget
        self._readings: dict[Channel, _Reading] = {}
        self._decoders: dict[_Definition, tuple[_Decoder | None, str | None]] = {}
        self._current: tuple[Channel, _Reading] | None = None

    def decode(self, message: RawMessage) -> Any:
        """The message as an object with attributes; raises Undecodable, or MissingExtra without its
        library."""
        return self._decoded(message)[0]

    def _decoded(self, message: RawMessage) -> tuple[Any, int]:
        """As ``decode``, with the work that was counted (records)."""
        channel, _, data = message
        try:
            decoder, _ = self._reading(channel)
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

    def poses(self, items: Iterable[Item]) -> Iterator[LoggedPose | None]:
        """The poses in messages of pose types, and in rows; None for each message that cannot be decoded."""
        current: Channel | None = None
        path: str | None = None
        for item in items:
            if isinstance(item, Rows):
                columns = zip(*item.poses, strict=True)
                yield from (
                    (source, pose, pose.stamp_ns)
                    for row in columns
                    for source, pose in zip(item.sources, row, strict=True)
                )
            elif isinstance(item, RawMessage):
                if item.channel is not current:
                    current = item.channel
                    has_field = may_have_poses(current, self._field)
                    path = pose_field(current, self._field if has_field else None)
                    path = path if has_field or may_have_poses(current) else None
                if path is None:
                    continue
                try:
                    _, layouts = self._reading(item.channel)
                    found = layouts.read(item.data)
                    if found is None:
                        found = self._observe(item, path)
                        layouts.learn(item.data, found)
                    else:
                        self._count_work(item, (len(found) - 1) // POSES_PER_RECORD)
                except Undecodable:
                    yield None
                else:
                    for source, pose in found:
                        yield source, pose, item.log_time_ns

    def _observe(self, message: RawMessage, path: str) -> list[Observation]:
        """The poses at a path in a message, by the library's decoder; more of them than the records that
        decoding took are counted as work."""
        decoded, records = self._decoded(message)
        topic, name, found = message.channel.topic, message.channel.type, list[Observation]()
        try:
            for number, one in enumerate(poses_at(path, decoded), 1):
                is_more = number % POSES_PER_RECORD == 0 and number // POSES_PER_RECORD > records
                self._count_work(message, int(is_more))
                if one is not None:
                    frame, child, pose = one
                    found.append((PoseSource(topic, name, frame, child), pose))
        except (AttributeError, IndexError, TypeError, ValueError, OverflowError, RuntimeError) as error:
            raise Undecodable(f"{topic}: {error}") from error
        return found

    def _reading(self, channel: Channel) -> _Reading:
        if self._current is not None and self._current[0] is channel:
            return self._current[1]  # hashing takes longer than reading a pose
        reading = self._readings.get(channel)
        if reading is None:
            reading = self._readings[channel] = self._new_reading(channel)
        self._current = channel, reading
        return reading

    def _new_reading(self, channel: Channel) -> _Reading:
        key = channel.encoding, channel.type, channel.schema_encoding, channel.schema
        if key not in self._decoders:
            self._decoders[key] = self._new_decoder(channel)
        decoder, why = self._decoders[key]
        if why is not None:
            self.assumed[channel.topic, channel.type] = why
        has_layouts = decoder is not None and decoder.is_known
        return decoder, _Layouts(canonical(channel.type) if has_layouts else "")

    def _new_decoder(self, channel: Channel) -> tuple[_Decoder | None, str | None]:
        """The decoder by a definition, and why the known one of the type is used, if it is."""
        decoder: _Decoder | None = None
        why: str | None = "its definition in the file is too long, or one of too many"
        with suppress(TooMuchWork):
            work = _RECORDS_PER_DEFINITION + len(channel.schema) // _DEFINITION_BYTES_PER_RECORD
            self._budget.spend("definitions", work)
            decoder, why = _decoder_of(channel)
        if decoder is None and channel.encoding == "cdr":
            known = known_definition(channel.type)
            decoder = None if known is None else _cdr(known)
        return decoder, why if decoder is not None and channel.encoding == "cdr" else None

    def _count_work(self, message: RawMessage, records: int) -> None:
        """Count the work beyond that of one record; raises Undecodable where it exceeds the budget."""
        if records:
            try:
                self._budget.spend("records", records)
            except TooMuchWork as error:
                self._budget.is_message_left_out = True
                raise Undecodable(f"{message.channel.topic}: {error}") from error


def assumption_text(count: int, type_name: str, why: str) -> str:
    """One line that says that a definition was assumed for ``count`` poses."""
    return f"{count} poses are read by the known definition of {type_name}: {why}"


def may_have_poses(channel: Channel, field: str | None = None) -> bool:
    """Whether a channel's messages have poses, in ``field`` if given, and can be decoded."""
    return (pose_field(channel, field) is not None and is_readable(channel)) or channel.encoding == ROWS


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
                return _protobuf(channel), None
            case "json":
                return _Decoder(_decode_json), None
    except MissingExtra:
        raise
    except Exception:  # an invalid schema can raise anything
        return None, "its definition in the file cannot be used"
    return None, "its definition in the file cannot be used"


def _cdr(definition: Definition) -> _Decoder | None:
    """The decoder of messages; an invalid definition can raise any error of the library."""
    schema = Schema(id=1, name=definition.type, encoding="ros2msg", data=definition.ros2msg.encode())
    with redirect_stderr(StringIO()):  # the parser also prints its errors
        decode = DecoderFactory().decoder_for("cdr", schema)
    known = known_definition(definition.type)
    is_known = known is not None and known.fields == definition.fields
    return None if decode is None else _Decoder(decode, work_of(definition), is_known)


def _protobuf(channel: Channel) -> _Decoder | None:
    """The decoder of messages; an invalid schema can raise any error of the library."""
    factory = module_of_extra("mcap_protobuf.decoder", "foxglove", "protobuf").DecoderFactory()
    schema = Schema(id=1, name=channel.type, encoding="protobuf", data=channel.schema)
    decode = factory.decoder_for(channel.encoding, schema)
    return None if decode is None else _Decoder(decode)


def _decode_json(data: bytes) -> Any:
    """A JSON object; raises ValueError."""
    return json.loads(data, object_hook=lambda values: SimpleNamespace(**values))
