"""Message definitions in ros2msg and of ROS 1 as the fields of types, and the decoding of ROS 1 by them.

A definition in a file can be anything. It is read line by line here, in time that grows with its length, and
only the fields of the message itself and of the types in it are kept. Libraries are given definitions that
are written anew from these fields. Definitions in IDL are not read. Messages of ROS 1 are little-endian,
without padding (http://wiki.ros.org/msg); sizes are checked before memory is allocated.
"""

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import groupby
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

LONGEST_DEFINITION: Final = 2**17
"""Longest definition that is used (bytes)."""
_DEEPEST: Final = 50
"""Most nested levels that are used."""
_MOST_FIELDS: Final = 1000
"""Most fields of a message and of all types in it: libraries compare the names of fields with each other."""
_RULE: Final = re.compile(r"=+\s*")
_NAME: Final = re.compile(r"\s*MSG:\s*([A-Za-z][\w/]*)\s*", re.ASCII)
_FIELD: Final = re.compile(
    r"\s*([A-Za-z][\w/]*)(?:<=\d+)?(\[(?:<=)?(\d{0,12})\])?\s+([A-Za-z]\w*)\s*(=)?", re.ASCII
)
PRIMITIVES: Final[Mapping[str, int]] = {
    **dict.fromkeys(("bool", "byte", "char", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32", "string", "wstring"), 4),
    **dict.fromkeys(("int64", "uint64", "float64", "time", "duration"), 8),
}
"""Types without fields, and least sizes of their values (bytes)."""

_HEADER: Final = "std_msgs/Header header\n"
_PARTS: Final = {
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
}
"""Definitions of known types, as in ROS 2, that are parts of others."""
_MESSAGES: Final = {
    **_PARTS,
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
"""The same of all known types."""


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
    type : of the message, as ``package/Name``.
    fields : of each type, the message itself first.
    is_complete : whether the file defines all of these types; the known definition of others is used.
    """

    type: str
    fields: Mapping[str, Sequence[Field]]
    is_complete: bool

    @property
    def ros2msg(self) -> str:
        """The definition in ros2msg."""
        parts = list[str]()
        for name, fields in self.fields.items():
            lines = "".join(f"{field.type}{_brackets(field.length)} {field.name}\n" for field in fields)
            parts.append(f"{'=' * 80}\nMSG: {name}\n{lines}" if parts else lines)
        return "".join(parts)


def parse_definition(text: str, type_name: str) -> Definition:
    """The definition of a type by a text in ros2msg or of ROS 1.

    Raises
    ------
    ValueError
        It is invalid, too long or too deep, has too many fields, or a type contains itself.
    """
    if len(text) > LONGEST_DEFINITION:
        raise ValueError("the definition is too long")
    name = _short(canonical(type_name))
    types = _Types(_bodies(text, name))
    types.add(name)
    return Definition(name, types.added, types.is_complete)


@cache
def known_definition(type_name: str) -> Definition | None:
    """The known definition of a type of ROS 2; None for other types."""
    body = _MESSAGES.get(_short(canonical(type_name)))
    return None if body is None else parse_definition(body, type_name)


class _Types:
    """The types of a message, each added with the types of its fields."""

    def __init__(self, bodies: Mapping[str, Sequence[str]]) -> None:
        self._bodies = bodies
        self._named = {name.rpartition("/")[2]: name for name in bodies}
        self._levels = dict[str, int | None]()
        self.added = dict[str, list[Field]]()
        self.is_complete = True

    def add(self, name: str, depth: int = 0) -> int:
        """Add a type at ``depth`` levels; returns the number of levels in it, and raises ValueError."""
        if name not in self._levels:
            if depth > _DEEPEST:
                raise ValueError("the definition is too deep")
            self._levels[name] = None
            fields = self.added[name] = self._fields_of(name)
            if sum(map(len, self.added.values())) > _MOST_FIELDS:
                raise ValueError("the definition has too many fields")
            parts = (field.type for field in fields if field.type not in PRIMITIVES)
            self._levels[name] = 1 + max((self.add(part, depth + 1) for part in parts), default=0)
        levels = self._levels[name]
        if levels is None:
            raise ValueError(f"the type {name} is part of itself")
        if levels > _DEEPEST:
            raise ValueError("the definition is too deep")
        return levels

    def _fields_of(self, name: str) -> list[Field]:
        body = self._bodies.get(name)
        if body is None:
            self.is_complete &= name.startswith("builtin_interfaces/")  # which ROS 2 leaves out
            body = _PARTS[name].splitlines()
        package = name.rpartition("/")[0]
        fields = filter(None, map(_field, body))
        return [field._replace(type=self._resolved(field.type, package)) for field in fields]

    def _resolved(self, written: str, package: str) -> str:
        """The name of a field's type: without package it is that of the same package, or the only one."""
        if written in PRIMITIVES:
            return written
        name = _short(written)
        inside = f"{package}/{name}"
        names = [name] if "/" in name else [inside, self._named.get(name, ""), f"std_msgs/{name}"]
        found = next((one for one in names if one in self._bodies or one in _PARTS), None)
        if found is None:
            raise ValueError(f"the type {written} is not defined")
        return found


def _bodies(text: str, name: str) -> dict[str, list[str]]:
    """The lines of each type, by its first definition."""
    body, bodies, after_rule = list[str](), dict[str, list[str]](), False
    bodies[name] = body
    for line in text.splitlines():
        if _RULE.fullmatch(line):
            after_rule = True
        elif after_rule and line.strip():
            found = _NAME.fullmatch(line)
            if found is None:
                raise ValueError("a definition of a type without its name")
            body, after_rule = [], False
            bodies.setdefault(_short(found[1]), body)
        else:
            body.append(line)
    return bodies


def _field(line: str) -> Field | None:
    """The field that a line defines; None for a constant, a comment, or nothing; raises ValueError."""
    found = _FIELD.match(line)
    if found is None:
        if line.strip() and not line.lstrip().startswith("#"):
            raise ValueError("a line that defines no field")
        return None
    kind, brackets, length, name, is_constant = found.groups()
    if is_constant:
        return None
    has_bound = brackets is not None and "<" in brackets
    return Field(kind, name, None if brackets is None else 0 if has_bound else int(length or 0))


def _brackets(length: int | None) -> str:
    return "" if length is None else f"[{length or ''}]"


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


_STEPS_PER_RECORD: Final = 48
"""Steps that count as the work of one record; a pose takes 13, a transform 23."""
_SIZE_OF_LENGTH: Final = 4
_STEPS: Final = 2
"""Steps of a message without its fields."""


class DecodingWork(NamedTuple):
    """Most steps that messages of a definition take: ``steps``, and ``steps_per_byte`` of their sequences."""

    steps: int = 0
    steps_per_byte: float = 0.0

    def records(self, size: int) -> int:
        """The work of decoding a message of ``size`` bytes, as a number of usual records beyond the first."""
        return int((self.steps + self.steps_per_byte * size) / _STEPS_PER_RECORD)


def work_of(definition: Definition) -> DecodingWork:
    """The work of messages by a definition."""

    @cache
    def extent(name: str) -> tuple[int, int]:
        """Most steps and the least size (bytes) of the messages of a type, without what is in sequences."""
        steps, size = _STEPS, 0
        for kind, _, length in definition.fields[name]:
            count = length or 1
            if length == 0 or kind in PRIMITIVES:
                steps, size = steps + 1, size + (count * PRIMITIVES[kind] if length != 0 else _SIZE_OF_LENGTH)
            else:
                inner_steps, inner_size = extent(kind)
                steps, size = steps + count * inner_steps, size + count * inner_size
        return steps, max(size, 1)

    every = (field for fields in definition.fields.values() for field in fields)
    elements = [extent(one.type) for one in every if one.length == 0 and one.type not in PRIMITIVES]
    dense = max((steps / size for steps, size in elements), default=0.0)
    return DecodingWork(extent(definition.type)[0], dense)


_FORMATS: Final = {
    **{"bool": "?", "int8": "b", "uint8": "B", "byte": "b", "char": "B"},
    **{"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q"},
    **{"float32": "f", "float64": "d"},
}
_TIMES: Final = {
    "time": [Field("uint32", "sec", None), Field("uint32", "nanosec", None)],
    "duration": [Field("int32", "sec", None), Field("int32", "nanosec", None)],
}
_LENGTH: Final = struct.Struct("<I")
_Step = tuple[list[str], struct.Struct | Field]
"""Names of consecutive fields with their numbers, or of one other field."""


def ros1_decoder(definition: Definition) -> Callable[[bytes], Any]:
    """The decoder of messages of ROS 1; raises ValueError for an invalid definition."""
    if not definition.is_complete:
        raise ValueError("the definition lacks parts, which differ between ROS 1 and ROS 2")
    plans = {name: _plan(name, fields) for name, fields in {**definition.fields, **_TIMES}.items()}

    def message(name: str, data: bytes, at: int) -> tuple[Any, int]:
        values = dict[str, Any]()
        for names, step in plans[name]:
            if isinstance(step, Field):
                values[names[0]], at = value(step, data, at)
            else:
                values.update(zip(names, step.unpack_from(data, at), strict=True))
                at += step.size
        return SimpleNamespace(**values), at

    def value(field: Field, data: bytes, at: int) -> tuple[Any, int]:
        if field.length is None:
            return one(field.type, data, at)
        count, at = (field.length, at) if field.length else _count(data, at)
        if count > len(data) - at:
            raise ValueError("an array is longer than its message")
        if field.type in _FORMATS:
            numbers = struct.Struct(f"<{count}{_FORMATS[field.type]}")
            return numbers.unpack_from(data, at), at + numbers.size
        values = list[Any]()
        for _ in range(count):
            found, at = one(field.type, data, at)
            values.append(found)
        return values, at

    def one(kind: str, data: bytes, at: int) -> tuple[Any, int]:
        if kind != "string":
            return message(kind, data, at)
        size, at = _count(data, at)
        if size > len(data) - at:
            raise ValueError("a text is longer than its message")
        return data[at : at + size].decode(errors="replace"), at + size

    def decode(data: bytes) -> Any:
        found, end = message(definition.type, data, 0)
        if end != len(data):
            raise ValueError(f"{len(data) - end} bytes more than its definition has")
        return found

    return decode


def _plan(name: str, fields: Sequence[Field]) -> list[_Step]:
    """The steps that read a type: consecutive numbers are read together."""
    steps = list[_Step]()
    for are_numbers, some in groupby(fields, lambda one: one.length is None and one.type in _FORMATS):
        own = list(some)
        if are_numbers:
            formats = "".join(_FORMATS[field.type] for field in own)
            steps.append(([field.name for field in own], struct.Struct(f"<{formats}")))
        else:
            steps += [([field.name], field) for field in own]
    if not steps:
        raise ValueError(f"{name} has no fields")
    return steps


def _count(data: bytes, at: int) -> tuple[int, int]:
    """The number of elements that is written at an offset, and the offset after it."""
    (many,) = _LENGTH.unpack_from(data, at)
    return many, at + _LENGTH.size
