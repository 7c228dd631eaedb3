"""Message definitions in IDL and of ROS 1 as plain data, by the parsers of rosbags.

Definitions come from the file and must not become code: only the parsers of rosbags are used, not its
registered types, for which it generates code. The parsers' results are validated here.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from contact_tracker.recording.definition_work import LONGEST_DEFINITION
from contact_tracker.recording.extras import need
from contact_tracker.recording.message_types import canonical

_RULE: Final = re.compile(r"^={80}\n", re.MULTILINE)
_NAME: Final = re.compile(r"[A-Za-z]\w*", re.ASCII)
_TYPE: Final = re.compile(r"[A-Za-z]\w*(?:/[A-Za-z]\w*)*", re.ASCII)
_OTHERWISE: Final = {"octet": "byte"}
"""Names of types that differ between IDL and ros2msg."""
_BASE, _NAMED, _ARRAY, _SEQUENCE = 1, 2, 3, 4
"""Kinds of type descriptions in rosbags."""


class Field(NamedTuple):
    """A field: name, type and length ``many``: None for a scalar, 0 for a sequence of any length, negative
    for one of at most ``-many``."""

    name: str
    type: str
    many: int | None


Fields = Mapping[str, Sequence[Field]]
"""The fields of each type in a definition, by type name with ``/msg/``."""


def fields_of_idl(text: str) -> Fields:
    """The types of a definition in IDL; an invalid text can raise any error of the parser."""
    typesys = need("rosbags.typesys", "ros2idl")
    types: dict[str, Any] = {}
    for part in _RULE.split(_checked(text)):
        if part.strip():
            types |= typesys.get_types_from_idl(part.partition("\n")[2] if part.startswith("IDL: ") else part)
    return _fields(types)


def fields_of_ros1(text: str, type_name: str) -> Fields:
    """The types of a definition of ROS 1, in which a header has a sequence number; raises as above."""
    types = need("rosbags.typesys", "ROS 1").get_types_from_msg(_checked(text), canonical(type_name))
    return _fields(types)


def ros2msg_of(fields: Fields, type_name: str) -> str:
    """A definition in ros2msg."""
    own, parts = canonical(type_name), list[str]()
    for name in (own, *(other for other in fields if other != own)):
        lines = "".join(f"{_written(field)} {field.name}\n" for field in fields[name])
        parts.append(lines if name == own else f"{'=' * 80}\nMSG: {_short(name)}\n{lines}")
    return "".join(parts)


def _checked(text: str) -> str:
    if len(text) > LONGEST_DEFINITION:
        raise ValueError("the definition is too long")
    return text


def _fields(types: Mapping[str, Any]) -> Fields:
    return {
        _matched(_TYPE, name): [_field(*field) for field in fields] for name, (_, fields) in types.items()
    }


def _field(name: str, description: Any) -> Field:
    kind, about = description
    many: int | None = None
    if kind in (_ARRAY, _SEQUENCE):
        (inner, inner_about), size = about
        kind, about, many = inner, inner_about, int(size) if kind == _ARRAY else -int(size)
    return Field(_matched(_NAME, name), _matched(_TYPE, about[0] if kind == _BASE else about), many)


def _matched(pattern: re.Pattern[str], name: Any) -> str:
    if not (isinstance(name, str) and pattern.fullmatch(name)):
        raise ValueError(f"{name!r} is no name")
    return name


def _written(field: Field) -> str:
    if field.many is None:
        return _short(field.type)
    size = str(field.many) if field.many > 0 else f"<={-field.many}" if field.many else ""
    return f"{_short(field.type)}[{size}]"


def _short(name: str) -> str:
    return _OTHERWISE.get(name, name.replace("/msg/", "/"))
