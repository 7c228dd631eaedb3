"""JSON in tables: documents, whose entries are lines, and the values of an entry by their paths."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import IO, Any, Final

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.table_layouts import OF_BODY, UNNAMED, are_numbers
from contact_tracker.recording.table_times import stamp_of_date

LEAST_OF_POSE: Final = 6
"""Number of values of the smallest pose: a position and three angles."""
_DIGITS_OF_STAMP: Final = 10
"""Least number of digits of a time since 1970."""
_DOCUMENT: Final = 2**26
"""Longest JSON document (characters), as it is in memory as a whole."""
OF_OBJECTS: Final = re.compile(r"\s*\{[^\[]*\[\s*\{")
"""Begins a JSON object whose first list has objects."""
_BEGIN_DOCUMENT: Final = re.compile(r"\s*(?:\{|\[\s*(?:$|[\[{]))")
loads: Final = partial(json.loads, parse_float=str, parse_int=str, parse_constant=str)
"""JSON, with numbers and NaN as text."""


def flattened(entry: Mapping[str, Any]) -> dict[str, str]:
    """The numbers and texts in an object and its parts, by their paths."""
    fields, waiting = dict[str, str](), list(entry.items())[::-1]
    while waiting:
        name, value = waiting.pop()
        if isinstance(value, dict):
            waiting += [(f"{name}.{key}", part) for key, part in value.items()][::-1]
        elif isinstance(value, list):
            waiting += [(f"{name}[{i}]", part) for i, part in enumerate(value)][::-1]
        elif isinstance(value, str) or value is None:
            fields[name] = value or ""
    return fields


def is_document(lines: Sequence[str]) -> bool:
    """Whether the text is one JSON document, not one object per line."""
    first, second = ([line for line in lines if line.strip()] + ["", ""])[:2]
    if not second or not first.lstrip().startswith("{"):
        return _BEGIN_DOCUMENT.match(first) is not None
    try:
        json.loads(first)
    except (ValueError, RecursionError):
        return True
    return False


def entries_in(file: IO[str]) -> Iterator[str]:
    """The entries of a JSON document, one per line: the elements of its list, of the only list of objects in
    it, or of equally long lists by name; raises UnreadableRecording."""
    text = file.read(_DOCUMENT + 1)
    if len(text) > _DOCUMENT:
        raise UnreadableRecording(
            "it is JSON of more than 64 MB: write one object a line, as jq -c '.[]' does"
        )
    try:
        content = loads(text)
    except (ValueError, RecursionError) as error:
        raise UnreadableRecording(f"it begins like JSON, but is none: {error}") from error
    if isinstance(content, dict) and content and all(are_numbers([n]) or stamp_of_date(n) for n in content):
        parts = ((name, value if _has_objects(value) else [value]) for name, value in content.items())
        key = "frame" if all(name.isdigit() and len(name) < _DIGITS_OF_STAMP for name in content) else "time"
        content = [{key: name, **named(entry)} for name, value in parts for entry in value]
    elif isinstance(content, dict):
        lists = {name: value for name, value in content.items() if isinstance(value, list)}
        if not lists and content and all(map(_has_rows, content.values())):  # as pandas writes columns
            index = list(next(iter(content.values())))
            if all(value.keys() == {*index} for value in content.values()):
                columns = {name: [value[row] for row in index] for name, value in content.items()}
                lists = {"index": index} | columns
        names = next((value for value in lists.values() if all(isinstance(name, str) for name in value)), [])
        rows_of = [v for v in lists.values() if v and isinstance(v[0], list) and len(v[0]) == len(names)]
        if len(rows_of) == 1 and names:  # names of the columns, and rows
            cells = [row if isinstance(row, list) else [] for row in rows_of[0]]
            index = lists.get("index", [])  # of a DataFrame
            names, index = (["index", *names], index) if len(index) == len(cells) else (names, [])
            cells = [[i, *row] for i, row in zip(index, cells, strict=True)] if index else cells
            lists = {"data": [dict(zip(names, row, strict=False)) for row in cells]}
        objects = [value for value in lists.values() if _has_objects(value)]
        longest = max(map(len, lists.values()), default=0)
        for name in [name for name, value in lists.items() if 0 < len(value) < longest]:  # row by row
            for i, part in enumerate(lists[name]):
                lists |= {f"{name}[{i}]": part} if isinstance(part, list) and len(part) == longest else {}
        rows = {name: value for name, value in lists.items() if len(value) == longest}
        by_row = [dict(zip(rows, row, strict=True)) for row in zip(*rows.values(), strict=True)]
        content = objects[0] if len(objects) == 1 and len(objects[0]) == longest else by_row
    if content == []:
        raise UnreadableRecording(
            "it is JSON without entries in a list, or lists of one length by name: write these alone, as by "
            "jq .data"
        )
    for entry in content if isinstance(content, list) else [content]:
        yield json.dumps(named(entry)) + "\n"


def _has_objects(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)


def by_object(line: str) -> list[str]:
    """The line of JSON, or one for each object with a name in its only list, as their places may change."""
    with suppress(ValueError, RecursionError):
        entry = loads(line) if OF_OBJECTS.match(line) else {}
        lists = [key for key, value in entry.items() if _has_objects(value)]
        parts = [named(part) for key in lists[:1] for part in entry[key]]
        is_inside = all(map(_may_be_pose, parts)) and not _may_be_pose({**entry, **dict.fromkeys(lists)})
        if len(lists) == 1 and is_inside and all(any(map(OF_BODY.fullmatch, part)) for part in parts):
            return [json.dumps({**entry, lists[0]: part}) + "\n" for part in parts]
    return [line]


def _may_be_pose(entry: Mapping[str, Any]) -> bool:
    return sum(are_numbers([value]) for value in flattened(entry).values()) >= LEAST_OF_POSE


def _has_rows(value: Any) -> bool:
    return isinstance(value, dict) and bool(value) and all(map(str.isdigit, value))


def named(entry: Any) -> dict[str, Any]:
    return entry if isinstance(entry, dict) else {UNNAMED: entry}
