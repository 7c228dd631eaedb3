"""Decoding of messages to poses as published, by the library of each encoding, and the paths of poses in
messages.

A path, of a known type or stated by the user (``--field``), is names of fields with dots between,
as in ``detections.results[0]``; a list without an index stands for all its elements. It leads to a position
and a rotation, to a part with these in a field ``pose`` or ``transform``, or, if the user states it, to an
array of numbers. Stamp, frame and name of the body are those of the innermost part of the message that has
one. If several bodies have no name, their number is the child frame: ``0`` is the first pose of a PoseArray.
The stamp of a type without one is zero, like an unset stamp.

Poses of the usual types in CDR are read at their offsets, which follow from the known definition of the type
and the lengths of the names, several times faster than by field. If a file defines a type differently, the
library decodes its messages.
"""

import json
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr, suppress
from functools import lru_cache, partial
from io import StringIO
from itertools import chain, islice
from operator import attrgetter
from types import MappingProxyType, SimpleNamespace
from typing import Any, Final, NamedTuple

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from contact_tracker.config.table_reading import AS_NAMED, NO_TABLE, TableReading
from contact_tracker.errors import ChoiceError, MissingExtra, module_of_extra
from contact_tracker.motion.poses import AS_GIVEN, Pose
from contact_tracker.recording.array_poses import ArrayPoses
from contact_tracker.recording.bytestream import (
    BYTES_PER_RECORD,
    FROM_ARRAYS,
    SHARE_OF_RECORD,
    ZSTD_MAGIC,
    TooMuchWork,
    WorkBudget,
)
from contact_tracker.recording.definitions import (
    Definition,
    canonical,
    known_definition,
    parse_definition,
    ros1_decoder,
)
from contact_tracker.recording.items import ROWS, Channel, Item, PoseSource, RawMessage, Rows
from contact_tracker.recording.mcap_file import PARSE_ERRORS, inflate_zstd
from contact_tracker.recording.table_times import ns_of_date, stamp_of_date

SECOND_NS: Final = 1_000_000_000
_MOST_NS: Final = 2**63 - 1
"""Largest stamp (ns), which stands for later ones; the pose gate rejects it."""
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
_XYZ: Final[Callable[[Any], Iterable[Any]]] = attrgetter("x", "y", "z")
_XYZW: Final[Callable[[Any], Iterable[Any]]] = attrgetter("x", "y", "z", "w")
_DEEPEST: Final = 3
"""Most fields of these names within each other."""
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
_REALS: Final = ("float64", "float32")
_LENGTHS: Final = (16, 12, 7, 0, 6)
"""Numbers of elements of arrays that may be poses: matrices, positions with quaternions, of any number, and
positions with angles."""
_ARRAY: Final = rf"(?:{'|'.join(_REALS)})\[[^\]]*\]\s+"
_LONGEST_ARRAY: Final = 200
"""Most numbers of an array that may be a pose."""
_MOST_FIELDS: Final = 500
"""Largest number of fields of a definition that are searched for poses."""


def pose_field(channel: Channel, field: str | None = None) -> str | None:
    """The path to the poses in a channel's messages, None if they have none; the names in the user's path
    ``field`` are looked up in the text of the definition."""
    if field is None:
        return POSE_TYPES.get(canonical(channel.type))
    names = re.findall(r"[A-Za-z_]\w*", field)
    names.append(f"(position|translation{''.join(f'|{_ARRAY}{name}' for name in names[-1:])})")
    has_names = all(re.search(rf"\b{name}\b".encode(), channel.schema) for name in names)
    return field if has_names or channel.encoding == "json" else None


def fields_with_poses(channel: Channel) -> tuple[list[str], list[str]]:
    """Paths of poses, and of arrays of numbers that may be poses, in the messages of a channel of ROS, by
    their definition; matrices first."""
    try:
        definition = parse_definition(channel.schema.decode(errors="replace"), channel.type)
    except (ValueError, KeyError):
        return [], []
    paths, arrays, waiting = list[str](), list[tuple[int, str]](), [("", definition.type)]
    for path, kind in waiting:  # which grows
        fields = definition.fields.get(kind, ())
        names = {field.name for field in fields}
        if any(names.issuperset(parts) for parts in _PARTS.items()):
            paths.append(path or ".")
        elif len(waiting) < _MOST_FIELDS:
            inner = [(f"{path}.{field.name}".lstrip("."), field) for field in fields]
            waiting += [(place, field.type) for place, field in inner]
            arrays += [
                (_LENGTHS.index(field.length), place)
                for place, field in inner
                if field.type in _REALS and field.length in _LENGTHS
            ]
    return paths, [place for _, place in sorted(arrays, key=lambda array: array[0])]


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
        px, py, pz = map(float, _XYZ(getattr(pose, place)))
        x, y, z, w = map(float, _XYZW(getattr(pose, _PARTS[place])))
        stamp_ns, frame = _stamp(inside), _frame(inside)
        child = _child(inside, number)
        child = f"{child}#{number}" if (frame, child, stamp_ns) in seen else child  # a second cup
        seen.add((frame, child, stamp_ns))
        yield frame, child, Pose(stamp_ns, (px, py, pz), (x, y, z, w))


def arrays_at(path: str, message: Any) -> Iterator[tuple[tuple[Any, ...], str, Sequence[float]]]:
    """The arrays of numbers at a path in a decoded message, with the parts around each, and its name or
    number if there are several."""
    *steps, (name, index) = re.findall(r"(\w+)(?:\[(\d+)\])?", path) or [("", "")]
    for inside, number in _reached((message,), steps, ""):
        values: Any = getattr(inside[-1], name, None) if inside and not index else None
        if isinstance(values, list) and values and isinstance(values[0], list):  # rows of a matrix
            values = [*chain.from_iterable(values)]
        is_list = hasattr(values, "__len__") and not isinstance(values, str | bytes)
        if is_list and 0 < len(values) <= _LONGEST_ARRAY and isinstance(values[0], int | float):
            yield inside, number, values


def _reached(
    inside: tuple[Any, ...], steps: list[tuple[str, str]], number: str
) -> Iterator[tuple[tuple[Any, ...], str]]:
    """The parts of a message along a path, the outermost first, and the name or number of the last if there
    are several; no parts if a list has no such element."""
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
        for i, element in enumerate(value):
            yield from _reached((*inside, element), rest, str(names[i] if has_names else i))
    elif int(index) < len(value):
        yield from _reached((*inside, value[int(index)]), rest, number)
    else:
        yield (), ""


def _stamp(inside: tuple[Any, ...]) -> int:
    """The stamp (ns) of the innermost part that has one; zero without."""
    return next(filter(None, map(_stamp_ns, _nearest(inside, _STAMPS))), 0)


def _frame(inside: tuple[Any, ...]) -> str:
    frame = next(filter(None, _nearest(inside, _FRAMES)), "")
    if not isinstance(frame, str):
        raise TypeError("the name of a frame is no text")
    return frame


def _nearest(inside: tuple[Any, ...], names: tuple[str, ...]) -> Iterator[Any]:
    """The values of fields with these names, from the innermost part outwards."""
    for part in reversed(inside):
        for name in names:
            with suppress(AttributeError):
                yield attrgetter(name)(part)


def _child(inside: tuple[Any, ...], number: str) -> str:
    """The name of the body, or ``ns/id`` of a marker; its number if it has no name."""
    words = list[str]()
    for part in reversed(inside):
        if hasattr(part, "ns") and hasattr(part, "id"):
            words.append(f"{part.ns}/{part.id}")
            continue
        names = _NAMES_IN_LISTS if number and part is not inside[0] else _NAMES
        texts = (text for text in _nearest((part,), names) if isinstance(text, str | int) and text != "")
        words += [str(text) for text in islice(texts, 1)]
    return "/".join(words) or number


def _stamp_ns(stamp: Any) -> int:
    """Nanoseconds of a time of ROS, protobuf or JSON; zero for text and numbers that are no dates."""
    if isinstance(stamp, str):
        return stamp_of_date(stamp) or 0
    if isinstance(stamp, int | float):
        return ns_of_date(stamp)
    seconds, fraction = (
        [getattr(stamp, name) for name in names if hasattr(stamp, name)] for names in (_SECONDS, _FRACTIONS)
    )
    return max(min(int(seconds[0]) * SECOND_NS + int(fraction[0]), _MOST_NS), -_MOST_NS)


USUAL: Final = (
    "PoseStamped, PoseWithCovarianceStamped, TransformStamped, Odometry, TFMessage, PoseArray, "
    "foxglove.PoseInFrame and foxglove.FrameTransform; --field NAME reads the pose in a field of other "
    f"messages, and {FROM_ARRAYS}"
)
READ: Final = "ROS 2 (cdr), ROS 1 (ros1), protobuf and json"
_READABLE: Final = (("cdr", "ros2msg"), ("cdr", ""), ("ros1", "ros1msg"), ("protobuf", "protobuf"))
"""Encodings of messages and of their schemas."""
_MESSAGE_LIMIT: Final = 2**22
_RECORDS_PER_DEFINITION: Final = 64
"""Work of a definition of any length, in records."""
_DEFINITION_BYTES_PER_RECORD: Final = 8
"""Bytes of a definition that count as the work of one further record."""
_INFLATED_PER_RECORD: Final = 2**17
"""Decompressed bytes of a message that count as the work of one record, whether it is decoded or not."""
_ENCAPSULATION: Final = 4
_ORDERS: Final = {b"\0\0": ">", b"\0\1": "<"}
"""First bytes of messages in the first version of CDR, and their byte order."""
_COVARIANCE: Final = 288
_TWIST: Final = 48 + _COVARIANCE
_MOST_SOURCES: Final = 64
"""Most sources per channel that are kept; some channels have ever new frame names."""

LoggedPose = tuple[PoseSource, Pose, int]
"""One pose as published, before validation, with its log time (ns); the child frame of its source is empty
where the type has none."""


_LAYOUTS: Final[Mapping[str, tuple[int, int, int, bool]]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": (4, 1, 0, False),
        "geometry_msgs/msg/PoseWithCovarianceStamped": (4, 1, _COVARIANCE, False),
        "geometry_msgs/msg/TransformStamped": (4, 2, 0, False),
        "nav_msgs/msg/Odometry": (4, 2, _COVARIANCE + _TWIST, False),
        "tf2_msgs/msg/TFMessage": (8, 2, 0, True),
    }
)
"""Layouts of types in CDR: offset of the first stamp (bytes); number of names after it; bytes after the
numbers of the pose; whether a count precedes several of these blocks."""
_HEAD, _SIZE, _POSE = ({o: struct.Struct(o + kinds) for o in "<>"} for kinds in ("iII", "I", "7d"))
"""By byte order: stamp and size of a name, a size, and the numbers of a pose."""


class _KnownLayout:
    """Reads the poses of one channel at their offsets in the layout of its type."""

    def __init__(self, channel: Channel, source: Callable[[str, str], PoseSource]) -> None:
        self._named_source, self._layout = source, _LAYOUTS[canonical(channel.type)]
        self._source = lru_cache(_MOST_SOURCES)(self._source_of)

    def read(self, data: bytes, log_time_ns: int) -> list[LoggedPose] | None:
        """The poses in a message; None, so that the library decodes it, if its size does not fit its type and
        names, or if one of several bodies has no name or occurs twice."""
        at, names, tail, repeats = self._layout
        poses = list[LoggedPose]()
        try:
            order = _ORDERS[data[:2]]
            read_head, read_size, read_pose = _HEAD[order].unpack_from, _SIZE[order].unpack_from, _POSE[order]
            count = read_size(data, _ENCAPSULATION)[0] if repeats else 1
            while len(poses) < count:
                sec, nanosec, size = read_head(data, at)
                end = at + 12 + size
                for _ in range(names - 1):
                    end += -end % 4
                    end += 4 + read_size(data, end)[0]
                start = end + (_ENCAPSULATION - end) % 8
                x, y, z, qx, qy, qz, qw = read_pose.unpack_from(data, start)
                source = self._source(data[at + 8 : end], order)
                pose = Pose(sec * SECOND_NS + nanosec, (x, y, z), (qx, qy, qz, qw))
                poses.append((source, pose, log_time_ns))
                at = start + read_pose.size + tail
        except (struct.error, KeyError, UnicodeDecodeError):
            return None
        is_whole = at == len(data) and (count == 1 or len({source for source, _, _ in poses}) == count)
        return poses if is_whole else None

    def _source_of(self, key: bytes, order: str) -> PoseSource:
        """The source with the names in ``key``, each after its size and ended by a zero byte."""
        names, at = list[str](), 0
        while at < len(key):
            at += -at % 4
            end = at + 4 + _SIZE[order].unpack_from(key, at)[0]
            names.append(key[at + 4 : max(end - 1, at + 4)].decode())
            at = end
        frame, child = (*names, "")[:2]
        if self._layout[3] and not child:
            raise KeyError("a body among others that has no name gets a number")
        return self._named_source(frame, child)


class Undecodable(Exception):
    """A message does not match its schema."""


class _Decoder(NamedTuple):
    """The decoder of messages, None if their definition cannot be used; whether the definition equals the
    known one of CDR; why the known one replaces that of the file; bytes that count as the work of a
    record."""

    decode: Callable[[bytes], Any] | None
    is_known: bool = False
    why: str = ""
    bytes_per_record: int = BYTES_PER_RECORD


class MessageDecoder:
    """Decodes messages by the schema of their channel.

    Parameters
    ----------
    budget : budget of the recording; messages that exceed it are not decoded.
    reading : path to the poses, in messages that have these fields, and the meaning of the numbers there.
    path : of the recording, for commands in messages.

    Attributes
    ----------
    counts : number of messages of pose types that could not be decoded, as ``undecodable``.
    """

    def __init__(self, budget: WorkBudget, reading: TableReading = AS_NAMED, path: str = "") -> None:
        self.counts = Counter[str]()
        self._budget, self._reading, self._field, self._path = budget, reading, reading.field, path
        self._arrays = dict[Channel, ArrayPoses]()
        self._decoders: dict[tuple[str, str, str, bytes], _Decoder] = {}

    def decode(self, message: RawMessage) -> Any:
        """The message as an object with attributes; raises Undecodable, or MissingExtra without its
        library."""
        channel, _, data = message
        decode, _, _, bytes_per_record = self._decoder(channel)
        if decode is None:
            raise Undecodable(f"{channel.topic}: the schema of {channel.type} cannot be used")
        try:
            if data.startswith(ZSTD_MAGIC):
                self._spend(message, 1)  # before and after, as its size is not known
                data = inflate_zstd(data, _MESSAGE_LIMIT)
                self._spend(message, len(data) // _INFLATED_PER_RECORD)
            self._spend(message, len(data) // bytes_per_record)
            return decode(data)
        except (Undecodable, MissingExtra):
            raise
        except Exception as error:  # optional libraries can raise anything
            expected = (*PARSE_ERRORS, TypeError, AttributeError, AssertionError)
            if channel.encoding == "cdr" and not isinstance(error, expected):
                raise
            raise Undecodable(f"{channel.topic}: {error}") from error

    def poses(self, items: Iterable[Item]) -> Iterator[LoggedPose]:
        """The poses in messages of pose types, and in rows; messages that cannot be decoded are counted."""
        return chain.from_iterable(self.groups(items))

    def groups(self, items: Iterable[Item]) -> Iterator[Sequence[LoggedPose]]:
        """The same poses, grouped by message."""
        ways = dict[Channel, tuple[str | None, _KnownLayout | None]]()
        channel: Channel | None = None
        for item in items:
            if isinstance(item, Rows):
                for source, pose in zip(item.sources, item.poses, strict=True):
                    yield ((source, pose, pose.stamp_ns),)
            elif isinstance(item, RawMessage):
                if item.channel is not channel:  # hashing takes longer than reading a pose
                    channel = item.channel
                    if channel not in ways:
                        ways[channel] = self._way(channel)
                    path, layout = ways[channel]
                if path is None:
                    continue
                try:
                    poses = None if layout is None else layout.read(item.data, item.log_time_ns)
                    poses = self._observe(item, path) if poses is None else poses
                    self._spend(item, SHARE_OF_RECORD * (len(poses) - 1))
                    yield poses
                except Undecodable:
                    self.counts["undecodable"] += 1
                    yield ()

    def _observe(self, message: RawMessage, path: str) -> list[LoggedPose]:
        """The poses at a path in a message, by the library's decoder."""
        decoded, (channel, log_time_ns, _) = self.decode(message), message
        try:
            is_stated = path == self._field
            arrays = list(arrays_at(path, decoded)) if is_stated else []
            observed = [self._array_pose(channel, *array) for array in arrays]
            if not arrays:
                observed = list(filter(None, poses_at(path, decoded)))
                if observed and is_stated and self._reading.is_of_table:
                    raise ChoiceError(f"{self._path}: {NO_TABLE}")
        except (AttributeError, IndexError, TypeError, ValueError, OverflowError, RuntimeError) as error:
            raise Undecodable(f"{channel.topic}: {error}") from error
        return [(self._source(channel, frame, child), pose, log_time_ns) for frame, child, pose in observed]

    def _array_pose(
        self, channel: Channel, inside: tuple[Any, ...], number: str, values: Sequence[float]
    ) -> tuple[str, str, Pose]:
        if channel not in self._arrays:
            self._arrays[channel] = ArrayPoses(self._reading, self._path)
        return _frame(inside), _child(inside, number), self._arrays[channel].read(_stamp(inside), values)

    def _source(self, channel: Channel, frame: str, child: str) -> PoseSource:
        read_as = self._arrays[channel].read_as if channel in self._arrays else AS_GIVEN
        why = self._decoder(channel).why
        return PoseSource(channel.topic, channel.type, frame, child, read_as=read_as, assumed=why)

    def _way(self, channel: Channel) -> tuple[str | None, _KnownLayout | None]:
        """The path to the poses in a channel's messages, if they have any; their layout, if it is known."""
        has_field = may_have_poses(channel, self._field)
        if not has_field and not may_have_poses(channel):
            return None, None
        has_layout = self._decoder(channel).is_known and canonical(channel.type) in _LAYOUTS
        has_layout &= not (has_field and self._reading.is_of_table)  # which is refused
        path = pose_field(channel, self._field if has_field else None)
        return path, _KnownLayout(channel, partial(self._source, channel)) if has_layout else None

    def _decoder(self, channel: Channel) -> _Decoder:
        key = channel.encoding, channel.type, channel.schema_encoding, channel.schema
        if key not in self._decoders:
            decoder = _Decoder(None, why="its definition in the file is too long, or one of too many")
            work = _RECORDS_PER_DEFINITION + len(channel.schema) // _DEFINITION_BYTES_PER_RECORD
            with suppress(TooMuchWork):
                self._budget.spend(work)
                decoder = _decoder_of(channel)
            definition = known_definition(channel.type) if channel.encoding == "cdr" else None
            if decoder.decode is None:
                decoder = _Decoder(None) if definition is None else _cdr(definition)._replace(why=decoder.why)
            self._decoders[key] = decoder
        return self._decoders[key]

    def _spend(self, message: RawMessage, records: float) -> None:
        """Count the work beyond one record; raises Undecodable if it exceeds the budget."""
        if records > 0:
            try:
                self._budget.spend(records)
            except TooMuchWork as error:
                self._budget.is_message_left_out = True
                raise Undecodable(f"{message.channel.topic}: {error}") from error


def assumption_text(count: int, source: PoseSource) -> str:
    """One line on the definition that was assumed for ``count`` poses."""
    return f"{count} poses are read by the known definition of {source.type}: {source.assumed}"


def may_have_poses(channel: Channel, field: str | None = None) -> bool:
    """Whether a channel's messages have poses, in ``field`` if given, and can be decoded."""
    return (pose_field(channel, field) is not None and is_readable(channel)) or channel.encoding == ROWS


def is_readable(channel: Channel) -> bool:
    """Whether a channel has a schema that a library can decode."""
    encodings = channel.encoding, channel.schema_encoding
    if encodings == ("cdr", "ros2idl"):
        return bool(channel.type) and known_definition(channel.type) is not None
    return bool(channel.type) and (channel.encoding == "json" or encodings in _READABLE)


def _decoder_of(channel: Channel) -> _Decoder:
    """The decoder of a channel by its schema; if that is unusable, none, with the reason."""
    if channel.schema_encoding == "ros2idl":
        return _Decoder(None, why="definitions in IDL are not read")
    if channel.encoding == "cdr" and not channel.schema.strip():
        return _Decoder(None, why="the file does not define it")
    if channel.encoding == "protobuf":
        factory = module_of_extra("mcap_protobuf.decoder", "foxglove", "protobuf").DecoderFactory()
    with suppress(Exception):  # an invalid schema can raise anything
        match channel.encoding:
            case "cdr":
                definition = parse_definition(channel.schema.decode(errors="replace"), channel.type)
                lacks = "" if definition.is_complete else "its definition in the file lacks parts"
                return _cdr(definition)._replace(why=lacks)
            case "ros1":
                definition = parse_definition(channel.schema.decode(), channel.type)
                return _Decoder(ros1_decoder(definition), bytes_per_record=definition.bytes_per_record)
            case "json":
                return _Decoder(partial(json.loads, object_hook=lambda values: SimpleNamespace(**values)))
            case "protobuf":
                schema = Schema(id=1, name=channel.type, encoding="protobuf", data=channel.schema)
                return _Decoder(factory.decoder_for(channel.encoding, schema))
    return _Decoder(None, why="its definition in the file cannot be used")


def _cdr(definition: Definition) -> _Decoder:
    """The decoder of messages; an invalid definition can raise any error of the library."""
    schema = Schema(id=1, name=definition.type, encoding="ros2msg", data=definition.ros2msg.encode())
    with redirect_stderr(StringIO()):  # the parser also prints its errors
        decode = DecoderFactory().decoder_for("cdr", schema)
    reference = known_definition(definition.type)
    is_known = reference is not None and reference.fields == definition.fields
    return _Decoder(decode, is_known, bytes_per_record=definition.bytes_per_record)
