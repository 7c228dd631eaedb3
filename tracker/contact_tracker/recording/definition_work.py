"""How much work messages take by their definition, before any is decoded.

Decoding takes a step for each field and each nested message. A definition in a file can have a thousand
nested levels or elements of one byte, so that a small message takes as long as thousands of poses.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

LONGEST_DEFINITION: Final = 2**17
"""Longest definition that is used (bytes)."""
_DEEPEST: Final = 50
"""Most nested levels that are used."""
_STEPS_PER_RECORD: Final = 48
"""Steps that count as the work of one record; a pose takes 13, a transform 23."""
_RULE: Final = re.compile(r"^=+$", re.MULTILINE)
_NAME: Final = re.compile(r"\s*MSG:\s*(\S+)")
_FIELD: Final = re.compile(r"([\w/]+)(?:<=\d+)?(\[[^\]]*\])?\s+\w+\s*(=)?")
_LONGEST_NUMBER: Final = 12
"""Digits of a number of elements that are read."""
_SIZE_OF_LENGTH: Final = 4
_STEPS: Final = 2
"""Of a message without its fields."""
_SIZES: Final[Mapping[str, int]] = {
    **dict.fromkeys(("bool", "byte", "char", "octet", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32", "string", "wstring"), 4),
    **dict.fromkeys(("int64", "uint64", "float64", "time", "duration"), 8),
}
"""Least sizes of values (bytes)."""


@dataclass(frozen=True)
class DecodingWork:
    """Most steps that messages of a definition take: ``steps``, and ``steps_per_byte`` of their sequences."""

    steps: int = 0
    steps_per_byte: float = 0.0

    def records(self, size: int) -> int:
        """Number of records whose work that of a message of ``size`` bytes is at most, beyond the first."""
        return int((self.steps + self.steps_per_byte * size) / _STEPS_PER_RECORD)


class _Field(NamedTuple):
    """A field: its type as written, and its number of elements; None for a sequence."""

    type: str
    many: int | None


class _Least(NamedTuple):
    """Of a message: steps, least size (bytes), and levels below."""

    steps: int
    size: int
    depth: int


def work_of(text: str) -> DecodingWork:
    """The work by a definition in ros2msg or of ROS 1.

    Raises
    ------
    ValueError
        It is too long or too deep, or a type contains itself.
    """
    if len(text) > LONGEST_DEFINITION:
        raise ValueError("the definition is too long")
    types = _Types(text)
    dense = [one.steps / max(one.size, 1) for one in types.elements()]
    return DecodingWork(types.least("").steps, max(dense, default=0.0))


class _Types:
    """The types of a definition by package and name; the message itself has the empty name."""

    def __init__(self, text: str) -> None:
        self._fields = dict[str, list[_Field]]()
        self._named = dict[str, list[str]]()
        self._known = dict[str, _Least | None]()
        for number, part in enumerate(_RULE.split(text)):
            found = _NAME.match(part) if number else None
            name = found[1].replace("/msg/", "/") if found else ""
            self._fields.setdefault(name, []).extend(_fields(part[found.end() :] if found else part))
            self._named.setdefault(name.rpartition("/")[2], []).append(name)

    def elements(self) -> Iterator[_Least]:
        """Each type of which there are sequences."""
        for name, fields in self._fields.items():
            for field in fields:
                if field.many is None:
                    yield from (self.least(one) for one in self._meant(name, field.type))

    def least(self, name: str, depth: int = 0) -> _Least:
        """Of the type of this name; raises ValueError."""
        if name not in self._known:
            if depth > _DEEPEST:
                raise ValueError("the definition is too deep")
            self._known[name] = None
            self._known[name] = self._sum(name, depth)
        found = self._known[name]
        if found is None:
            raise ValueError(f"the type {name} is part of itself")
        if depth + found.depth > _DEEPEST:
            raise ValueError("the definition is too deep")
        return found

    def _sum(self, name: str, depth: int) -> _Least:
        steps, size, below = _STEPS, 0, 0
        for field in self._fields[name]:
            parts = [self.least(one, depth + 1) for one in self._meant(name, field.type)]
            below = max([below, *(part.depth + 1 for part in parts)])
            if field.many is None:
                steps, size = steps + 1, size + _SIZE_OF_LENGTH
            elif parts:
                steps += field.many * max(part.steps for part in parts)
                size += field.many * min(part.size for part in parts)
            else:
                steps, size = steps + 1, size + field.many * _SIZES.get(field.type, 1)
        return _Least(steps, max(size, 1), below)

    def _meant(self, inside: str, written: str) -> list[str]:
        """The types that a field of the type ``inside`` can mean; none for a type without fields."""
        if "/" in written:
            full = written.replace("/msg/", "/")
            return [full] if full in self._fields else []
        beside = f"{inside.rpartition('/')[0]}/{written}"
        return [beside] if beside in self._fields else self._named.get(written, [])


def _fields(part: str) -> Iterator[_Field]:
    for line in part.splitlines():
        found = _FIELD.match(line.strip())
        if found is not None and not found[3]:  # no constant
            count = found[2].strip("[]") if found[2] else "1"
            yield _Field(found[1], int(count[:_LONGEST_NUMBER]) if count.isdecimal() else None)
