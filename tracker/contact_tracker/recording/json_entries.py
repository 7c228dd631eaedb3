"""JSON in tables: the entries of a document, and the values of an entry by their paths."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import IO, Any, Final

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.table_bodies import OF_BODY
from contact_tracker.recording.table_layouts import DIGITS_OF_STAMP, UNNAMED, are_numbers
from contact_tracker.recording.table_times import stamp_of_date

LEAST_OF_POSE: Final = 6
"""Number of values of the smallest pose: a position and three angles."""
_DOCUMENT: Final = 2**26
"""Longest JSON document (characters), as it is in memory as a whole."""
_BEGIN_DOCUMENT: Final = re.compile(r"\s*(?:\{|\[\s*(?:$|[\[{]))")
_loads: Final = partial(json.loads, parse_float=str, parse_int=str, parse_constant=str)


def loads(text: str) -> Any:
    """The content of JSON, or of a dictionary as Python prints it; numbers and NaN are text."""
    try:
        return _loads(text)
    except ValueError:
        if '"' in text:
            raise
        return _loads(re.sub("None|True|False", "null", text.replace("'", '"')))


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


MOST_SHARED: Final = 100_000
"""Largest number of values that the objects of an entry share with it: each has a copy."""


def rows_of(entry: Any) -> list[dict[str, str]]:
    """The values of an entry by their paths, or of each object with a name in its only list, as the places of
    objects may change."""
    entry = _named(entry)
    keys = [key for key, value in entry.items() if _has_objects(value)]
    parts = [_named(part) for key in keys[:1] for part in entry[key]]
    if len(keys) == 1 and all(any(map(OF_BODY.fullmatch, part)) for part in parts):
        shared = flattened({key: value for key, value in entry.items() if key != keys[0]})
        own = [flattened({keys[0]: part}) for part in parts]
        is_bounded = len(own) * len(shared) <= MOST_SHARED
        if is_bounded and not _may_be_pose(shared) and all(map(_may_be_pose, own)):
            return [{**shared, **part} for part in own]
    return [flattened(entry)]


def is_document(lines: Sequence[str]) -> bool:
    """Whether the text is one JSON document, not one object per line."""
    first, second = ([line for line in lines if line.strip()] + ["", ""])[:2]
    if not second or not first.lstrip().startswith("{"):
        return _BEGIN_DOCUMENT.match(first) is not None
    try:
        loads(first)
    except (ValueError, RecursionError):
        return True
    return False


def entries_in(file: IO[str]) -> list[Any]:
    """The entries of a JSON document: the elements of its list, or of its object; raises
    UnreadableRecording."""
    text = file.read(_DOCUMENT + 1)
    if len(text) > _DOCUMENT:
        raise UnreadableRecording(
            "it is JSON of more than 64 MB: write one object a line, as jq -c '.[]' does"
        )
    try:
        content = loads(text)
    except (ValueError, RecursionError) as error:
        raise UnreadableRecording(f"it begins like JSON, but is none: {error}") from error
    if isinstance(content, dict):
        content = _entries_of(content)
    if content == []:
        raise UnreadableRecording(
            "it is JSON without entries in a list, or lists of one length by name: write these alone, as by "
            "jq .data"
        )
    return content if isinstance(content, list) else [content]


_Document = Mapping[str, Any]
_DIGITS: Final = re.compile(r"\d+")


def _by_time(document: _Document) -> list[Any]:
    """The entry, or the objects, of each time, number of a frame, or file with such a number."""
    names = [*document]
    if not all(are_numbers([name]) or stamp_of_date(name) for name in names):
        names = [digits for name in names for digits in _DIGITS.findall(name)]
        forms = {_DIGITS.sub("", name) for name in document}
        if len(forms) > 1 or not 1 < len(document) == len(names) == len({*names}):
            return []
    key = "frame" if all(n.isdigit() and len(n) < DIGITS_OF_STAMP for n in names) else "time"
    values = zip(names, document.values(), strict=True)
    return [
        {key: name, **_named(entry)}
        for name, value in values
        for entry in (value if _has_objects(value) else [value])
    ]


def _by_column_and_row(document: _Document) -> list[Any]:
    """The rows of columns with their values by number, as pandas writes them."""
    columns = [*document.values()]
    if not columns or not all(isinstance(c, dict) and c and all(map(str.isdigit, c)) for c in columns):
        return []
    if any(column.keys() != columns[0].keys() for column in columns):
        return []
    return [{"index": row, **{name: document[name][row] for name in document}} for row in columns[0]]


def _under_names(document: _Document) -> list[Any]:
    """The rows in a list, below the names of their columns in another, and beside the index of pandas."""
    lists = _lists(document)
    names = next((value for value in lists.values() if all(map(_is_name, value))), [])
    tables = [v for v in lists.values() if v and isinstance(v[0], list) and len(v[0]) == len(names)]
    if len(tables) != 1 or not names:
        return []
    rows = [dict(zip(names, row, strict=False)) if isinstance(row, list) else {} for row in tables[0]]
    index = lists.get("index", [])
    if len(index) != len(rows):
        return rows
    return [{"index": i, **row} for i, row in zip(index, rows, strict=True)]


def _in_a_list(document: _Document) -> list[Any]:
    """The objects in the only list of objects, if no other list is longer."""
    lists = _lists(document).values()
    objects = [value for value in lists if _has_objects(value)]
    return objects[0] if len(objects) == 1 and len(objects[0]) == max(map(len, lists)) else []


def _by_name(document: _Document) -> list[Any]:
    """The rows of equally long lists by name, some of which may be in lists, as that of x, y and z."""
    lists = _lists(document)
    longest = max(map(len, lists.values()), default=0)
    for name, value in [*lists.items()]:
        inner = value if len(value) < longest else []
        lists |= {f"{name}[{i}]": v for i, v in enumerate(inner) if isinstance(v, list) and len(v) == longest}
    columns = {name: value for name, value in lists.items() if len(value) == longest}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


_FORMS: Final[Sequence[Callable[[_Document], list[Any]]]] = (
    _by_time,
    _by_column_and_row,
    _under_names,
    _in_a_list,
    _by_name,
)
"""Forms of documents that are an object; each function returns the entries, none of another form."""


def _entries_of(document: _Document) -> list[Any]:
    """The entries of an object, or of the first part whose entries may be poses."""
    if found := next(filter(None, (entries(document) for entries in _FORMS)), []):
        return found
    inside = map(_entries_of, (part for part in document.values() if isinstance(part, dict)))
    return next((part for part in inside if part and _may_be_pose(rows_of(part[0])[0])), [])


def _lists(document: _Document) -> dict[str, list[Any]]:
    return {name: value for name, value in document.items() if isinstance(value, list)}


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and not are_numbers([value])


def _has_objects(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)


def _may_be_pose(row: Mapping[str, str]) -> bool:
    of_pose = islice((value for value in row.values() if are_numbers([value])), LEAST_OF_POSE)
    return len([*of_pose]) == LEAST_OF_POSE


def _named(entry: Any) -> dict[str, Any]:
    return entry if isinstance(entry, dict) else {UNNAMED: entry}
