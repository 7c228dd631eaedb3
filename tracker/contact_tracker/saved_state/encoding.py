"""Encoding of values of known classes as JSON and arrays, and decoding. No other class is built, no code run.

Shared objects stay shared, as some are compared by identity.
"""

import enum
import hashlib
import json
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Final, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.errors import StateError
from contact_tracker.hypotheses.bank import Bank, Onsets, layout
from contact_tracker.motion.default_poses import DefaultPoseFilter
from contact_tracker.motion.excursions import ExcursionFilter
from contact_tracker.motion.pose_steps import Step
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.stamp_order import Ordered, Periods, StampOrder
from contact_tracker.tracker import Tracker

KINDS: Final = "biuf"
"""Allowed kinds of arrays: flags and numbers."""
DEEPEST: Final = 60
_LAYOUTS: Final = {
    f"{table.__name__} {model.contact.value}": layout(table, model)
    for table in (Bank, Onsets)
    for model in CONTACT_MODELS
}
_EMPTY: Final[Mapping[str, Callable[[], Any]]] = {
    "PoseGate": PoseGate,
    "StampOrder": lambda: StampOrder(Counter()),
    "Periods": Periods,
    "DefaultPoseFilter": lambda: DefaultPoseFilter(Counter()),
    "ExcursionFilter": lambda: ExcursionFilter(Counter()),
}
"""Functions that make empty mutable objects, whose fields are then restored."""


def _classes_in(*roots: type) -> dict[str, type]:
    """The classes of this package in the fields of the given ones, and in theirs, by name."""
    found, waiting = dict[str, type](), list[Any](roots)
    while waiting:
        one = waiting.pop()
        waiting += get_args(one)
        if isinstance(one, type) and one.__module__.startswith("contact_tracker."):
            if found.setdefault(one.__name__, one) is not one:
                raise TypeError(f"two classes of a state are called {one.__name__}")
            waiting += (hint for hint in get_type_hints(one).values() if hint not in found.values())
    return found


_CLASSES: Final[Mapping[str, type]] = _classes_in(
    Tracker, Ordered, Step, *(type(empty()) for empty in _EMPTY.values())
)


def field_names(one: type) -> tuple[str, ...]:
    """Field names of a value in the order of its constructor, of another object in the order of
    assignment."""
    if one.__name__ in _EMPTY:
        return tuple(vars(_EMPTY[one.__name__]()))
    if is_dataclass(one):
        return tuple(field.name for field in fields(one))
    return tuple(getattr(one, "_fields", ()))


def schema() -> dict[str, list[str]]:
    """The field names of all classes and tables, which identify the version of a state."""
    classes = {name: list(field_names(one)) for name, one in sorted(_CLASSES.items())}
    return classes | {name: list(one.names) for name, one in _LAYOUTS.items()}


def is_same(one: Any, other: Any) -> bool:
    """Whether two values are bit-identical."""
    encoders = Encoder(), Encoder()
    trees = [encoder.encode(value) for encoder, value in zip(encoders, (one, other), strict=True)]
    if json.dumps(trees[0]) != json.dumps(trees[1]):
        return False
    pairs = zip(*(encoder.arrays for encoder in encoders), strict=True)
    return all(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in pairs)


def fingerprint(value: Any) -> str:
    """A hash (BLAKE2b, 32 hexadecimal digits) that is equal only for bit-identical values."""
    encoder = Encoder()
    found = hashlib.blake2b(json.dumps(encoder.encode(value)).encode(), digest_size=16)
    for array in encoder.arrays:
        found.update(f"{array.dtype.str} {array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()


class Encoder:
    """Encodes values as a tree for JSON, with references by number to ``arrays``."""

    def __init__(self) -> None:
        self.arrays: list[NDArray[Any]] = []
        self._known: dict[int, int] = {}
        self._kept: list[Any] = []

    def encode(self, value: Any) -> Any:
        """The tree of a value; raises TypeError for an unknown class."""
        if value is None or type(value) in (bool, int, float, str):
            return value
        if isinstance(value, np.generic):
            return ["scalar", self._add(np.asarray(value))]
        if isinstance(value, enum.Enum):
            return ["member", type(value).__name__, value.name]
        if type(value) is tuple:
            return ["tuple", *map(self.encode, value)]
        if type(value) is list:
            return ["list", *map(self.encode, value)]
        if id(value) in self._known:
            return ["same", self._known[id(value)]]
        tree = self._encode_object(value)
        self._known[id(value)] = len(self._known)
        self._kept.append(value)  # keeps its id unique
        return tree

    def _encode_object(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return ["array", self._add(value)]
        if isinstance(value, np.dtype):
            return ["layout", next(name for name, one in _LAYOUTS.items() if one == value)]
        if isinstance(value, deque):
            return ["deque", value.maxlen, *map(self.encode, value)]
        if type(value) in (dict, Counter):
            pairs = ([self.encode(key), self.encode(item)] for key, item in value.items())
            return [type(value).__name__, *pairs]
        name = type(value).__name__
        if _CLASSES.get(name) is not type(value):
            raise TypeError(f"{name} is no part of a state")
        return ["object", name, *(self.encode(getattr(value, field)) for field in field_names(type(value)))]

    def _add(self, array: NDArray[Any]) -> int:
        if array.dtype.kind not in KINDS:
            raise TypeError(f"arrays of {array.dtype} are no part of a state")
        self.arrays.append(array)
        return len(self.arrays) - 1


class Decoder:
    """Decodes a tree to its value.

    Raises
    ------
    StateError
        The tree is not one that ``Encoder`` writes.
    """

    def __init__(self, arrays: Sequence[NDArray[Any]]) -> None:
        self._arrays = arrays
        self._known: list[Any] = []

    def decode(self, tree: Any, depth: int = 0) -> Any:
        """The value of a tree."""
        if tree is None or isinstance(tree, bool | int | float | str):
            return tree
        if not isinstance(tree, list) or not tree or depth > DEEPEST:
            raise _not_ours()
        kind, *rest = tree
        match kind, rest:
            case "scalar", [int() as number]:
                array = self._array(number)
                if array.ndim:
                    raise _not_ours()
                return array[()]
            case "member", [str() as name, str() as member]:
                return _member(name, member)
            case "tuple", _:
                return tuple(self.decode(one, depth + 1) for one in rest)
            case "list", _:
                return [self.decode(one, depth + 1) for one in rest]
            case "same", [int() as number] if 0 <= number < len(self._known):
                return self._known[number]
        value = self._decode_object(kind, rest, depth)
        self._known.append(value)
        return value

    def _decode_object(self, kind: Any, rest: list[Any], depth: int) -> Any:
        match kind, rest:
            case "array", [int() as number]:
                return self._array(number)
            case "layout", [str() as name] if name in _LAYOUTS:
                return _LAYOUTS[name]
            case "deque", [int() | None as most, *items]:
                return deque((self.decode(one, depth + 1) for one in items), most)
            case "dict" | "Counter", _:
                pairs = [self._pair(pair, depth) for pair in rest]
                return Counter(dict(pairs)) if kind == "Counter" else dict(pairs)
            case "object", [str() as name, *items] if name in _CLASSES:
                return self._object(_CLASSES[name], [self.decode(one, depth + 1) for one in items])
        raise _not_ours()

    def _pair(self, pair: Any, depth: int) -> tuple[Any, Any]:
        if not isinstance(pair, list) or len(pair) != 2:
            raise _not_ours()
        key, value = (self.decode(one, depth + 1) for one in pair)
        return key, value

    def _object(self, one: type, items: list[Any]) -> Any:
        names = field_names(one)
        if len(items) != len(names):
            raise _not_ours()
        if one.__name__ not in _EMPTY:
            return one(**dict(zip(names, items, strict=True)))
        value = _EMPTY[one.__name__]()
        vars(value).update(zip(names, items, strict=True))
        return value

    def _array(self, number: int) -> NDArray[Any]:
        if not 0 <= number < len(self._arrays):
            raise _not_ours()
        return self._arrays[number]


def _not_ours() -> StateError:
    return StateError("it is no saved state")


def _member(name: str, member: str) -> Any:
    one = _CLASSES.get(name)
    if one is None or not issubclass(one, enum.Enum) or member not in one.__members__:
        raise _not_ours()
    return one[member]
