"""Files of the state of a stream, to resume it after a restart, and of other values in the same format.

A value of registered classes becomes a tree of JSON that refers to arrays by number. Loading makes objects of
no other class and runs no code. Shared objects stay shared, as the trackers compare by identity.
"""

import enum
import hashlib
import json
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.errors import ContactTrackerError, StateError
from contact_tracker.files import read_regular, whole_file
from contact_tracker.hypotheses.bank import Bank, Onsets, layout
from contact_tracker.motion.excursions import JumpFilter
from contact_tracker.motion.pose_validation import Ordered, PoseGate, StampOrder
from contact_tracker.motion.poses import Step
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.segmentation import BELIEF
from contact_tracker.version import __version__

FORMAT: Final = 3
"""Version of the format of files."""
LARGEST_BYTES: Final = 512 * 2**20
"""Largest size of a file that is read."""
DEEPEST: Final = 60
"""Largest depth of a tree."""
_ARRAYS: Final = "biuf"
"""Kinds of NumPy's dtypes that arrays may have: flags and numbers."""
_LAYOUTS: Final = {
    f"{table.__name__} {model.contact.value}": layout(table, model)
    for table in (Bank, Onsets)
    for model in CONTACT_MODELS
}
_GATES: Final = (PoseGate, StampOrder, JumpFilter)
"""Mutable classes: an empty object is made, then its fields are restored."""


def classes_in(*roots: type) -> dict[str, type]:
    """``roots`` and all classes of this package in the types of their fields, recursively, by name."""
    classes, waiting = dict[str, type](), list[Any](roots)
    while waiting:
        hint = waiting.pop()
        waiting += get_args(hint)
        if isinstance(hint, type) and hint.__module__.startswith("contact_tracker."):
            if classes.setdefault(hint.__name__, hint) is not hint:
                raise TypeError(f"two classes of a state are called {hint.__name__}")
            waiting += (part for part in get_type_hints(hint).values() if part not in classes.values())
    return classes


class Kind(NamedTuple):
    """A kind of file: its name (in the first line), the classes of its values, and whether another version of
    the package with the same classes may load it."""

    name: str
    classes: Mapping[str, type[Any]]
    outlives_version: bool = False

    @property
    def schema(self) -> dict[str, list[str]]:
        """The field names of all classes and tables by name; they identify the version of a file."""
        classes = {name: list(_field_names(kind)) for name, kind in sorted(self.classes.items())}
        layouts = {} if self.outlives_version else _LAYOUTS
        tables = layouts | {"rows of beliefs": BELIEF}
        return classes | {name: list(dtype.names or ()) for name, dtype in tables.items()}


STREAM: Final = Kind("contact-tracker state", classes_in(Tracker, Ordered, Step, *_GATES))


def save(path: Path, value: Any, kind: Kind = STREAM) -> None:
    """Write a value to a file of a kind, atomically.

    Raises
    ------
    TypeError
        A part of the value is not of the kind's classes.
    OSError
        The file cannot be written.
    """
    content = content_of(value, kind)
    with whole_file(path) as temporary:
        temporary.write_bytes(content)


def content_of(value: Any, kind: Kind = STREAM) -> bytes:
    """The bytes that ``save`` writes for a value; raises TypeError as ``save`` does."""
    return packed(*_encoded(value, kind), kind)


def load(path: Path, kind: Kind = STREAM) -> Any:
    """The value saved in a file; no code in the file is run.

    Raises
    ------
    StateError
        The file is not of this kind, is damaged, or was saved by another version.
    OSError
        The file cannot be read.
    """
    try:
        tree, arrays = unpacked(read_regular(path, LARGEST_BYTES), kind)
        return _decoded(tree, arrays, kind)
    except StateError as error:
        raise StateError(f"{path}: {error}") from error
    except FileNotFoundError:
        raise
    except OSError as error:
        raise StateError(f"{path}: {error.strerror or error}") from error
    except Exception as error:  # the file may have any content
        raise StateError(f"{path}: it is no saved {kind.name.split()[-1]}: name another file") from error


@contextmanager
def continued(path: Path | None) -> Iterator[None]:
    """A context that makes any unexpected error a StateError while a stream goes on from the state in
    ``path``; errors pass unchanged without a ``path``.

    A state has hundreds of arrays and numbers that depend on each other. The checksum of a file detects
    damage, but not values that somebody has written on purpose.
    """
    try:
        yield
    except (ContactTrackerError, OSError):
        raise
    except Exception as error:
        if path is None:
            raise
        reason = f"it cannot be continued ({type(error).__name__})"
        raise StateError(f"{path}: {reason}: name another file") from error


def fingerprint(value: Any) -> str:
    """A hash (BLAKE2b, 32 hexadecimal digits), equal only for bit-identical values."""
    return hashlib.blake2b(_body(*_encoded(value)), digest_size=16).hexdigest()


def packed(tree: Any, arrays: Sequence[NDArray[Any]], kind: Kind = STREAM) -> bytes:
    """The bytes of a file: a line with version and checksum, a line with the tree, and the arrays."""
    body = _body(tree, arrays)
    return json.dumps(_head(body, kind)).encode() + b"\n" + body


def unpacked(content: bytes, kind: Kind = STREAM) -> tuple[Any, list[NDArray[Any]]]:
    """Tree and arrays of the bytes of a file; raises StateError, or any error for another kind of file."""
    line, _, body = content.partition(b"\n")
    head, expected = json.loads(line), _head(body, kind)
    if head["kind"] != kind.name:
        raise ValueError("it is of another kind")
    compared = ("schema", "format") if kind.outlives_version else ("schema", "format", "version")
    if any(head[key] != expected[key] for key in compared):
        versions = f"({head['version']}, this is {__version__})"
        if head["version"] == __version__:
            versions = f"of {__version__}, whose states have other parts"
        raise StateError(f"it was saved by another version {versions}")
    if head["sha256"] != expected["sha256"]:
        raise StateError("it is damaged: its checksum is wrong")
    tree, _, data = body.partition(b"\n")
    arrays, stream = list[NDArray[Any]](), BytesIO(data)
    while stream.tell() < len(data):
        arrays.append(np.lib.format.read_array(stream, allow_pickle=False))
        _require_numbers(arrays[-1])
    return json.loads(tree), arrays


def _head(body: bytes, kind: Kind) -> dict[str, Any]:
    schema = hashlib.sha256(json.dumps(kind.schema).encode()).hexdigest()
    head = {"kind": kind.name, "format": FORMAT, "version": __version__, "schema": schema}
    return head | {"sha256": hashlib.sha256(body).hexdigest()}


def _body(tree: Any, arrays: Sequence[NDArray[Any]]) -> bytes:
    stream = BytesIO()
    stream.write(json.dumps(tree).encode() + b"\n")
    for array in arrays:
        np.lib.format.write_array(stream, array, allow_pickle=False)
    return stream.getvalue()


def _require_numbers(array: NDArray[Any]) -> None:
    if array.dtype.kind not in _ARRAYS and array.dtype != BELIEF:
        raise TypeError(f"arrays of {array.dtype} are no part of a state")


def _field_names(kind: type) -> tuple[str, ...]:
    """Field names of a class in the order of its constructor (in ``_GATES``: of assignment)."""
    if kind in _GATES:
        return tuple(vars(kind(Counter())))
    if issubclass(kind, enum.Enum):
        return ("value",)
    if is_dataclass(kind):
        return tuple(field.name for field in fields(kind) if field.init)
    return tuple(getattr(kind, "_fields", ()))


def _encoded(value: Any, kind: Kind = STREAM) -> tuple[Any, list[NDArray[Any]]]:
    """The tree of a value and the arrays that it refers to by number; raises TypeError for other classes."""
    arrays = list[NDArray[Any]]()
    seen = dict[int, tuple[int, Any]]()  # number and object by id; the reference keeps the id unique

    def encode(value: Any) -> Any:
        cls = type(value)
        name = cls.__name__
        if value is None or cls in (bool, int, float, str):
            return value
        if cls in (tuple, list):
            return [name, *map(encode, value)]
        if isinstance(value, np.generic):
            return ["scalar", add(np.asarray(value))]
        if id(value) in seen:
            return ["same", seen[id(value)][0]]
        if isinstance(value, np.ndarray):
            tree = ["array", add(value)]
        elif cls is deque:
            tree = [name, value.maxlen, *map(encode, value)]
        elif cls in (dict, Counter):
            tree = [name, *map(encode, value.items())]
        elif kind.classes.get(name) is cls:
            tree = ["object", name, *(encode(getattr(value, field)) for field in _field_names(cls))]
        elif layouts := [key for key, layout in _LAYOUTS.items() if layout is value]:
            tree = ["layout", *layouts]
        else:
            raise TypeError(f"{name} is no part of a state")
        seen[id(value)] = len(seen), value
        return tree

    def add(array: NDArray[Any]) -> int:
        _require_numbers(array)
        arrays.append(array)
        return len(arrays) - 1

    return encode(value), arrays


def _decoded(tree: Any, arrays: Sequence[NDArray[Any]], kind: Kind) -> Any:
    """The value of a tree; raises any error for a tree that ``_encoded`` does not return."""
    numbered, objects = dict(enumerate(arrays)), dict[int, Any]()

    def decode(tree: Any, depth: int) -> Any:
        if tree is None or isinstance(tree, bool | int | float | str):
            return tree
        if not isinstance(tree, list) or depth > DEEPEST:
            raise ValueError("it is no tree, or too deep")
        parts = [decode(part, depth + 1) for part in tree[1:]]
        value: Any
        match tree[0], parts:
            case "tuple", _:
                return tuple(parts)
            case "list", _:
                return parts
            case "scalar", [number] if numbered[number].ndim == 0:
                return numbered[number][()]
            case "same", [number]:
                return objects[number]
            case "array", [number]:
                value = numbered[number]
            case "layout", [name]:
                value = _LAYOUTS[name]
            case "deque", [length, *items]:
                value = deque(items, length)
            case "dict", _:
                value = dict(parts)
            case "Counter", _:
                value = Counter(dict(parts))
            case "object", [name, *items]:
                value = _restored(kind.classes[name], items)
            case _:
                raise ValueError("it is no value of a state")
        objects[len(objects)] = value
        return value

    return decode(tree, 0)


def _restored(kind: type, items: Sequence[Any]) -> Any:
    """An object of the class ``kind`` whose fields have the values ``items``."""
    values = dict(zip(_field_names(kind), items, strict=True))
    if kind not in _GATES:
        return kind(**values)
    value = kind(Counter())
    vars(value).update(values)
    return value
