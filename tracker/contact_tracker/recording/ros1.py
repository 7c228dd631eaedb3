"""Decoding of ROS 1 messages by the fields of their definition: little-endian, without padding.

See http://wiki.ros.org/msg. Sizes are checked against the rest of the message before memory is allocated.
"""

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Final

from contact_tracker.recording.definitions import Definition, Field

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

_Step = Callable[[bytes, int], tuple[Any, int]]
"""Takes a message and an offset; returns the value there and the offset after it."""


def ros1_decoder(definition: Definition) -> Callable[[bytes], Any]:
    """The decoder of messages of ROS 1; raises ValueError for an invalid definition."""
    if not definition.is_complete:
        raise ValueError("the definition lacks parts, which differ between ROS 1 and ROS 2")
    step = _Types({**definition.fields, **_TIMES}).message(definition.type)

    def decode(data: bytes) -> Any:
        message, end = step(data, 0)
        if end != len(data):
            raise ValueError(f"{len(data) - end} bytes more than its definition has")
        return message

    return decode


class _Types:
    """Readers of the types of a definition, each made once."""

    def __init__(self, fields: Mapping[str, Sequence[Field]]) -> None:
        self._fields = fields
        self._made: dict[str, _Step] = {}

    def message(self, name: str) -> _Step:
        if name not in self._made:
            self._made[name] = self._message(name)
        return self._made[name]

    def _message(self, name: str) -> _Step:
        steps = list(self._steps(self._fields[name]))
        if not steps:
            raise ValueError(f"{name} has no fields")

        def step(data: bytes, at: int) -> tuple[Any, int]:
            values = dict[str, Any]()
            for names, read in steps:
                found, at = read(data, at)
                values.update(zip(names, found, strict=True))
            return SimpleNamespace(**values), at

        return step

    def _steps(self, fields: Sequence[Field]) -> Iterator[tuple[list[str], _Step]]:
        """Consecutive fields with their reader; those of fixed size are read together."""
        names, formats = list[str](), "<"
        for field in fields:
            if field.length is None and field.type in _FORMATS:
                names.append(field.name)
                formats += _FORMATS[field.type]
                continue
            if names:
                yield names, _numbers(struct.Struct(formats))
                names, formats = [], "<"
            yield [field.name], _single(self._value(field))
        if names:
            yield names, _numbers(struct.Struct(formats))

    def _value(self, field: Field) -> _Step:
        if field.length is not None and field.type in _FORMATS:
            return _array_of_numbers(_FORMATS[field.type], field.length)
        one = _text if field.type == "string" else self.message(field.type)
        return one if field.length is None else _array(one, field.length)


def _single(read: _Step) -> _Step:
    def step(data: bytes, at: int) -> tuple[Any, int]:
        value, at = read(data, at)
        return (value,), at

    return step


def _numbers(numbers: struct.Struct) -> _Step:
    return lambda data, at: (numbers.unpack_from(data, at), at + numbers.size)


def _text(data: bytes, at: int) -> tuple[str, int]:
    size, at = _count(data, at, 0)
    return data[at : at + size].decode(errors="replace"), at + size


def _array(one: _Step, many: int) -> _Step:
    def step(data: bytes, at: int) -> tuple[Any, int]:
        count, at = _count(data, at, many)
        values = list[Any]()
        for _ in range(count):
            value, at = one(data, at)
            values.append(value)
        return values, at

    return step


def _array_of_numbers(letter: str, many: int) -> _Step:
    def step(data: bytes, at: int) -> tuple[Any, int]:
        count, at = _count(data, at, many)
        size = count * struct.calcsize(f"<{letter}")
        if size > len(data) - at:
            raise ValueError("an array is longer than its message")
        return struct.unpack_from(f"<{count}{letter}", data, at), at + size

    return step


def _count(data: bytes, at: int, many: int) -> tuple[int, int]:
    """The number of elements (at least one byte each), fixed or as written, and their offset."""
    if many <= 0:
        (many,) = _LENGTH.unpack_from(data, at)
        at += _LENGTH.size
    if many > len(data) - at:
        raise ValueError("an array is longer than its message")
    return many, at
