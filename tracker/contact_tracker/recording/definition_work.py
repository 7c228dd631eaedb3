"""How much work messages take by their definition, before any is decoded.

Decoding takes a step for each field and each nested message. A definition in a file can have a thousand
nested levels or elements of one byte, so that a small message takes as long as thousands of poses.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
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
        """The work of decoding a message of ``size`` bytes, as a number of usual records beyond the first."""
        return int((self.steps + self.steps_per_byte * size) / _STEPS_PER_RECORD)


class _Field(NamedTuple):
    """A field: its type as written, and its number of elements; None for a sequence."""

    type: str
    element_count: int | None


class _Extent(NamedTuple):
    """Of the messages of a type without what is in sequences: most steps, least size (bytes), and the number
    of nested levels."""

    steps: int
    size: int
    levels: int


def work_of(text: str) -> DecodingWork:
    """The work by a definition in ros2msg or of ROS 1.

    Raises
    ------
    ValueError
        It is too long or too deep, or a type contains itself.
    """
    if len(text) > LONGEST_DEFINITION:
        raise ValueError("the definition is too long")
    types = _Types("\n".join(text.splitlines()))  # as parsers do, with all that ends a line
    dense = [one.steps / max(one.size, 1) for one in types.of_sequences()]
    return DecodingWork(types.extent("").steps, max(dense, default=0.0))


class _Types:
    """The types of a definition by package and name; the message itself has the empty name.

    A type without package can be that of its own package, or else any of this name.
    """

    def __init__(self, text: str) -> None:
        self._fields = dict[str, list[_Field]]()
        self._known = dict[str, _Extent | None]()
        self._any = dict[str, _Extent | None]()
        for number, part in enumerate(_RULE.split(text)):
            found = _NAME.match(part) if number else None
            name = found[1].replace("/msg/", "/") if found else ""
            self._fields.setdefault(name, []).extend(_fields(part[found.end() :] if found else part))
        self._named = dict[str, list[str]]()
        for name in self._fields:
            self._named.setdefault(name.rpartition("/")[2], []).append(name)

    def of_sequences(self) -> Iterator[_Extent]:
        """The elements of all sequences."""
        written = {
            (name.rpartition("/")[0], field.type)
            for name, fields in self._fields.items()
            for field in fields
            if field.element_count is None
        }
        for package, type_name in written:
            if (element := self._of_field(package, type_name, 0)) is not None:
                yield element

    def extent(self, name: str, depth: int = 0) -> _Extent:
        """Of the type of this name at ``depth`` levels; raises ValueError."""
        if name not in self._known:
            if depth > _DEEPEST:
                raise ValueError("the definition is too deep")
            self._known[name] = None
            self._known[name] = self._sum(name, depth)
        found = self._known[name]
        if found is None:
            raise ValueError(f"the type {name} is part of itself")
        if depth + found.levels > _DEEPEST:
            raise ValueError("the definition is too deep")
        return found

    def _sum(self, name: str, depth: int) -> _Extent:
        steps, size, levels, package = _STEPS, 0, 0, name.rpartition("/")[0]
        for field in self._fields[name]:
            nested = self._of_field(package, field.type, depth + 1)
            levels = max(levels, 0 if nested is None else nested.levels + 1)
            if field.element_count is None:
                steps, size = steps + 1, size + _SIZE_OF_LENGTH
            elif nested is not None:
                steps += field.element_count * nested.steps
                size += field.element_count * nested.size
            else:
                steps, size = steps + 1, size + field.element_count * _SIZES.get(field.type, 1)
        return _Extent(steps, max(size, 1), levels)

    def _of_field(self, package: str, written: str, depth: int) -> _Extent | None:
        """Of a field of this type; None for one without fields."""
        name = written.replace("/msg/", "/") if "/" in written else f"{package}/{written}"
        if name in self._fields:
            return self.extent(name, depth)
        if "/" in written:
            return None
        if written not in self._any:
            all_of_name = [self.extent(one, depth) for one in self._named.get(written, ())]
            self._any[written] = _most(all_of_name) if all_of_name else None
        return self._any[written]


def _most(extents: Sequence[_Extent]) -> _Extent:
    return _Extent(
        max(one.steps for one in extents),
        min(one.size for one in extents),
        max(one.levels for one in extents),
    )


def _fields(part: str) -> Iterator[_Field]:
    for line in part.splitlines():
        found = _FIELD.match(line.strip())
        if found is not None and not found[3]:  # no constant
            yield _Field(found[1], _element_count(found[2]))


def _element_count(brackets: str | None) -> int | None:
    """Number of elements by what follows the type; None for a sequence."""
    if brackets is None:
        return 1
    digits = brackets[1:-1].strip().lstrip("+")[:_LONGEST_NUMBER]
    return int(digits) if digits.isdecimal() else None
