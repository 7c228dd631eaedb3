"""Message definitions in ros2msg and of ROS 1 as the fields of types, and the decoding of ROS 1 by them.

The text of a definition in a file is not trusted: it is parsed line by line in linear time, only the fields
of the message and of the types in it are used, and libraries get definitions that are written anew from these
fields. Definitions in IDL are not read. Messages of ROS 1 are little-endian,
without padding (http://wiki.ros.org/msg); sizes are checked before memory is allocated.
"""

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from graphlib import TopologicalSorter
from itertools import chain
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

from contact_tracker.recording.bytestream import BYTES_PER_RECORD

LONGEST_DEFINITION: Final = 2**17
"""Longest definition that is used (characters)."""
_DEEPEST: Final = 50
"""Most nested levels of types."""
_MOST_FIELDS: Final = 1000
"""Most fields of a message and of all types in it: libraries compare the names of fields with each other."""
_ELEMENTS_PER_RECORD: Final = 16
_RULE: Final = re.compile(r"=+\s*")
_NAME: Final = re.compile(r"\s*MSG:\s*([A-Za-z][\w/]*)\s*", re.ASCII)
_FIELD: Final = re.compile(
    r"\s*([A-Za-z][\w/]*)(?:<=\d+)?(\[(?:<=)?(\d{0,12})\])?\s+([A-Za-z]\w*)\s*(=)?", re.ASCII
)
_NUMBERS: Final = {
    kind: struct.Struct(f"<{letter}")
    for kind, letter in {
        **{"bool": "?", "int8": "b", "uint8": "B", "byte": "b", "char": "B"},
        **{"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q"},
        **{"float32": "f", "float64": "d"},
    }.items()
}
PRIMITIVES: Final[Mapping[str, int]] = {
    **{kind: number.size for kind, number in _NUMBERS.items()},
    **dict.fromkeys(("string", "wstring"), 4),
    **dict.fromkeys(("time", "duration"), 8),
}
"""Types without fields, and the least sizes of their values (bytes)."""
_LENGTH: Final = struct.Struct("<I")
_HEADER: Final = "std_msgs/Header header\n"
_KNOWN: Final = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": f"{_HEADER}string child_frame_id\ngeometry_msgs/Transform transform\n",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    "motion_capture_tracking_interfaces/NamedPose": "string name\ngeometry_msgs/Pose pose\n",
    "std_msgs/String": "string data\n",
    "geometry_msgs/PoseStamped": f"{_HEADER}geometry_msgs/Pose pose\n",
    "geometry_msgs/PoseWithCovarianceStamped": f"{_HEADER}geometry_msgs/PoseWithCovariance pose\n",
    "geometry_msgs/WrenchStamped": f"{_HEADER}geometry_msgs/Wrench wrench\n",
    "geometry_msgs/PoseArray": f"{_HEADER}geometry_msgs/Pose[] poses\n",
    "nav_msgs/Odometry": f"{_HEADER}string child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    "geometry_msgs/TwistWithCovariance twist\n",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "motion_capture_tracking_interfaces/NamedPoseArray": f"{_HEADER}"
    "motion_capture_tracking_interfaces/NamedPose[] poses\n",
}
"""Definitions of known types, as in ROS 2."""


def canonical(type_name: str) -> str:
    """The name of a ROS type with ``/msg/``, which ROS 1 and some writers omit."""
    package, slash, name = type_name.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else type_name


class Field(NamedTuple):
    """A field: its type and name, and its number of elements: None for a scalar, 0 for a sequence."""

    type: str
    name: str
    length: int | None


class Definition(NamedTuple):
    """The fields of a message and of the types in it.

    Parameters
    ----------
    type : type of the message, as ``package/Name``.
    fields : fields of each type, the message itself first.
    is_complete : whether the file defines all of these types; the known definition of others is used.
    bytes_per_record : bytes of a message that count as the work of one record: 16 elements of an array, if
        these are no numbers or texts.
    """

    type: str
    fields: Mapping[str, Sequence[Field]]
    is_complete: bool
    bytes_per_record: int

    @property
    def ros2msg(self) -> str:
        """The definition in ros2msg."""
        parts = list[str]()
        for name, fields in self.fields.items():
            sizes = ("" if length is None else f"[{length or ''}]" for _, _, length in fields)
            pairs = zip(fields, sizes, strict=True)
            lines = "".join(f"{field.type}{size} {field.name}\n" for field, size in pairs)
            parts.append(f"{'=' * 80}\nMSG: {name}\n{lines}" if parts else lines)
        return "".join(parts)


def parse_definition(text: str, type_name: str) -> Definition:
    """The definition of a type by a text in ros2msg or of ROS 1; raises ValueError if it is invalid, too long
    or too deep, has too many fields, or a type contains itself."""
    if len(text) > LONGEST_DEFINITION:
        raise ValueError("the definition is too long")
    message = _short(canonical(type_name))
    bodies = _bodies(text, message)
    last_names = {name.rpartition("/")[2]: name for name in bodies}

    def resolved(written: str, package: str) -> str:
        """The full name of a field's type; a name without package is of the same package, or of the only type
        with it."""
        if written in PRIMITIVES:
            return written
        name = _short(written)
        names = [name] if "/" in name else [f"{package}/{name}", last_names.get(name, ""), f"std_msgs/{name}"]
        full_name = next((name for name in names if name in bodies or name in _KNOWN), None)
        if full_name is None:
            raise ValueError(f"the type {written} is not defined")
        return full_name

    fields, is_complete, waiting = dict[str, list[Field]](), True, [message]
    for name in waiting:  # which grows
        if name in fields:
            continue
        is_complete &= name in bodies or name.startswith("builtin_interfaces/")  # which ROS 2 leaves out
        body = bodies[name] if name in bodies else _KNOWN[name].splitlines()
        package = name.rpartition("/")[0]
        written = filter(None, map(_field, body))
        fields[name] = [field._replace(type=resolved(field.type, package)) for field in written]
        waiting += [field.type for field in fields[name] if field.type not in PRIMITIVES]
        if sum(map(len, fields.values())) > _MOST_FIELDS:
            raise ValueError("the definition has too many fields")
    parts = {name: {field.type for field in fields[name]} - PRIMITIVES.keys() for name in fields}
    levels, sizes = dict[str, int](), dict[str, int](PRIMITIVES)
    for name in TopologicalSorter(parts).static_order():  # raises ValueError if a type is part of itself
        levels[name] = 1 + max((levels[part] for part in parts[name]), default=0)
        least = (_LENGTH.size if n == 0 else (n or 1) * sizes[kind] for kind, _, n in fields[name])
        sizes[name] = max(sum(least), 1)
    if levels[message] > _DEEPEST:
        raise ValueError("the definition is too deep")
    arrays = {kind for kind, _, length in chain(*fields.values()) if length is not None}
    element_bytes = min((sizes[kind] for kind in arrays - PRIMITIVES.keys()), default=sizes[message])
    bytes_per_record = min(BYTES_PER_RECORD, _ELEMENTS_PER_RECORD * element_bytes)
    return Definition(message, fields, is_complete, bytes_per_record)


@cache
def known_definition(type_name: str) -> Definition | None:
    """The known definition of a type of ROS 2; None for other types."""
    body = _KNOWN.get(_short(canonical(type_name)))
    return None if body is None else parse_definition(body, type_name)


def _bodies(text: str, name: str) -> dict[str, list[str]]:
    """The lines of each type, by its first definition."""
    body, after_rule = list[str](), False
    bodies = {name: body}
    for line in text.splitlines():
        if _RULE.fullmatch(line):
            after_rule = True
        elif after_rule and line.strip():
            match = _NAME.fullmatch(line)
            if match is None:
                raise ValueError("a definition of a type without its name")
            body, after_rule = [], False
            bodies.setdefault(_short(match[1]), body)
        else:
            body.append(line)
    return bodies


def _field(line: str) -> Field | None:
    """The field that a line defines; None for a constant, a comment, or nothing; raises ValueError."""
    match = _FIELD.match(line)
    if match is None and line.strip() and not line.lstrip().startswith("#"):
        raise ValueError("a line that defines no field")
    if match is None or match[5]:
        return None
    kind, brackets, length, name, _ = match.groups()
    return Field(kind, name, None if brackets is None else 0 if "<" in brackets else int(length or 0))


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


_TIMES: Final = {
    "time": [Field("uint32", "sec", None), Field("uint32", "nanosec", None)],
    "duration": [Field("int32", "sec", None), Field("int32", "nanosec", None)],
}


def ros1_decoder(definition: Definition) -> Callable[[bytes], Any]:
    """The decoder of messages of ROS 1; raises ValueError for an invalid definition."""
    if not definition.is_complete:
        raise ValueError("the definition lacks parts, which differ between ROS 1 and ROS 2")
    if not all(definition.fields.values()):
        raise ValueError("a type has no fields")
    fields_of = {**definition.fields, **_TIMES}

    def message(name: str, data: bytes, at: int) -> tuple[Any, int]:
        values = dict[str, Any]()
        for field in fields_of[name]:
            if field.length is None and field.type in _NUMBERS:
                (values[field.name],) = _NUMBERS[field.type].unpack_from(data, at)
                at += _NUMBERS[field.type].size
            else:
                values[field.name], at = value(field, data, at)
        return SimpleNamespace(**values), at

    def value(field: Field, data: bytes, at: int) -> tuple[Any, int]:
        count = field.length
        if not count and (count == 0 or field.type == "string"):
            (count,) = _LENGTH.unpack_from(data, at)
            at += _LENGTH.size
        if count is None:
            return message(field.type, data, at)
        if count > len(data) - at:
            raise ValueError("an array or a text is longer than its message")
        if field.type == "string" and field.length is None:
            return data[at : at + count].decode(errors="replace"), at + count
        if field.type in _NUMBERS:
            numbers = struct.Struct(f"<{count}{_NUMBERS[field.type].format[1:]}")
            return numbers.unpack_from(data, at), at + numbers.size
        values, element = list[Any](), field._replace(length=None)
        for _ in range(count):
            element_value, at = value(element, data, at)
            values.append(element_value)
        return values, at

    def decode(data: bytes) -> Any:
        decoded, end = message(definition.type, data, 0)
        if end != len(data):
            raise ValueError(f"{len(data) - end} bytes more than its definition has")
        return decoded

    return decode
