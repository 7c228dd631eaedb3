"""TOML files, and validated access to the keys of their tables; unknown keys are rejected."""

import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.errors import KeyFault, KnowledgeError
from contact_tracker.files import parse_toml, read_regular
from contact_tracker.suggestions import closest, near_file, suggestion

FARTHEST_M: Final = 1e6
SIZES_M: Final = (1e-4, 1e3)
"""Range of a body's size along an edge (m)."""
LARGEST: Final = 1e18
"""Largest entry of a matrix."""
LONGEST_TEXT: Final = 200
UNIT_TOLERANCE: Final = 0.01
"""Largest deviation of a direction's length from 1."""

MOST_BYTES: Final = 1_000_000
"""Largest TOML file (bytes)."""
_NUMBER: Final = int | float | np.integer | np.floating


def read_toml(
    path: Path, fault: type[KeyFault], name: str, unreadable: str, near: str | None = None
) -> dict[str, Any]:
    """The keys of a TOML file, not validated.

    Parameters
    ----------
    fault : exception that is raised if the file cannot be read or parsed.
    name : the file's name as the user wrote it.
    unreadable, near : begin and end of the message if the file cannot be read; ``near`` is a name that the
        user may have meant, by default that of a similar file.
    """
    try:
        content = read_regular(path, MOST_BYTES)
    except (OSError, ValueError) as error:  # names with a zero byte
        reason = getattr(error, "strerror", None) or error
        raise fault("", f"{unreadable}: {reason}{near or near_file(name)}") from error
    try:
        return parse_toml(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # of endless numbers and nesting in tomllib
        raise fault("", f"{name} is not TOML: {error}") from error


class Keys:
    """The keys of one table; ``name``: the table's name in errors, which are of the kind ``fault``."""

    def __init__(self, table: Any, name: str = "", fault: type[KeyFault] = KnowledgeError) -> None:
        if not isinstance(table, dict):
            raise fault(name, "must be a table")
        if not all(isinstance(key, str) for key in table):
            raise fault(name, "the names of its keys must be text")
        self._table: dict[str, Any] = table
        self._name, self._fault = name, fault
        self._asked: list[str] = []

    def __contains__(self, key: str) -> bool:
        self._asked.append(key)
        return key in self._table

    def called(self, key: str) -> str:
        """The full name of a key."""
        return f"{self._name}.{key}" if self._name else key

    def wrong(self, key: str, reason: str) -> KeyFault:
        """The error of a key; for a missing key it names an unknown one that may be meant."""
        unknown = [] if key in self._table else [name for name in self._table if name not in self._asked]
        near = closest(key, unknown)
        return self._fault(self.called(key), f"{reason}; is {near} meant for it?" if near else reason)

    def finish(self) -> None:
        """Reject keys that were not read."""
        for key in self._table:
            if key not in self._asked:
                hint = suggestion(key, self._asked) or f"; known are {', '.join(dict.fromkeys(self._asked))}"
                raise self.wrong(key, f"unknown{hint}")

    def real(self, key: str, default: float | None = None) -> float:
        """Any number, infinite if beyond the range of floats; required if ``default`` is None."""
        value = self._take(key, default)
        if isinstance(value, bool) or not isinstance(value, _NUMBER):
            raise self.wrong(key, f"must be a number, not {type(value).__name__}")
        try:
            return float(value)
        except OverflowError:
            return math.inf if value > 0 else -math.inf

    def number(self, key: str, default: float | None, low: float, high: float) -> float:
        """A number from ``low`` to ``high``; required if ``default`` is None."""
        value = self.real(key, default)
        if not low <= value <= high:
            raise self.wrong(key, f"must lie between {low:g} and {high:g}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        value = self._take(key, default)
        if not isinstance(value, bool):
            raise self.wrong(key, f"must be true or false, not {type(value).__name__}")
        return value

    def text(self, key: str, default: str | None) -> str:
        value = self._take(key, default)
        if not isinstance(value, str) or not value.isprintable() or len(value) > LONGEST_TEXT:
            raise self.wrong(key, f"must be a printable string of {LONGEST_TEXT} characters at most")
        return value

    def vector(self, key: str, size: int = 3, default: list[float] | None = None) -> Array:
        """``size`` finite numbers, from Python also as a tuple or an array."""
        value = self._take(key, default)
        is_list = isinstance(value, list | tuple | np.ndarray) and len(value) == size
        if not is_list or not all(_is_number(number, FARTHEST_M) for number in value):
            raise self.wrong(key, f"must be a list of {size} numbers, none beyond {FARTHEST_M:g}")
        return np.array(value, float)

    def matrix(self, key: str, columns: int, rows: range, largest: float = LARGEST) -> Array:
        """Rows of ``columns`` finite numbers, as many as are in ``rows``."""
        value, lists = self._take(key, None), list | tuple | np.ndarray
        count = f"{rows[0]}" if len(rows) == 1 else f"{rows[0]} to {rows[-1]}"
        must_be = f"must be {count} rows of {columns} numbers"
        if not isinstance(value, lists) or len(value) not in rows:
            raise self.wrong(key, must_be)
        if not all(isinstance(row, lists) and len(row) == columns for row in value):
            raise self.wrong(key, must_be)
        if not all(_is_number(number, largest) for row in value for number in row):
            raise self.wrong(key, f"{must_be}, all finite")
        return np.array(value, float)

    def lengths(self, key: str) -> Array:
        """Three lengths (m) of a body."""
        value, (low, high) = self.vector(key), SIZES_M
        if not ((value >= low) & (value <= high)).all():
            raise self.wrong(key, f"must lie between {low:g} and {high:g}")
        return value

    def direction(self, key: str, size: int = 3, default: list[float] | None = None) -> Array:
        """A vector of length 1 within a hundredth, normalised."""
        value = self.vector(key, size, default)
        length = math.hypot(*value)
        if abs(length - 1.0) > UNIT_TOLERANCE:
            unit = f": write {(value / length).round(4).tolist()}" if length > 0.0 else ""
            raise self.wrong(key, f"must have length 1, not {length:.4g}{unit}")
        return value / length

    def table(self, key: str, is_required: bool = False) -> "Keys":
        """The table ``key``, empty if absent."""
        return Keys(self._take(key, None if is_required else {}), self.called(key), self._fault)

    def tables(self, key: str) -> "list[Keys]":
        """The tables of an array, or one single table."""
        value = self._take(key, [])
        if isinstance(value, dict):
            return [Keys(value, self.called(key), self._fault)]
        if not isinstance(value, list):
            raise self.wrong(key, "must be a table, or an array of tables")
        return [Keys(row, f"{self.called(key)}[{i}]", self._fault) for i, row in enumerate(value, start=1)]

    def _take(self, key: str, default: Any) -> Any:
        self._asked.append(key)
        value = self._table.get(key, default)
        if value is None:
            raise self.wrong(key, "missing")
        return value


def _is_number(value: Any, largest: float) -> bool:
    return isinstance(value, _NUMBER) and not isinstance(value, bool) and bool(abs(value) <= largest)
