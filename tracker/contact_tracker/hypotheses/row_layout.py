"""Tables of rows of 8-byte words: selecting rows is one copy, and the kernels use the same memory."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Generic, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Entry = TypeVar("Entry", np.int64, np.float64, np.bool_)


class Field(NamedTuple):
    """Place of a column in a row: words ``first`` to ``end``, with entries of a ``shape``.

    Symmetric matrices (``side``, ``side``) are stored as their upper triangle, row by row.
    """

    first: int
    end: int
    shape: tuple[int, ...]
    whole: bool
    side: int = 0

    def kept(self, column: NDArray[Any] | float) -> NDArray[Any] | float:
        """The stored form of a column."""
        if not self.side or not isinstance(column, np.ndarray):
            return column
        rows, columns = _upper(self.side)
        kept: NDArray[Any] = column[..., rows, columns]
        return kept


@cache
def _upper(side: int) -> tuple[Index, Index]:
    """Rows and columns of an upper triangle."""
    rows, columns = np.triu_indices(side)
    return rows, columns


@cache
def entries(side: int) -> Index:
    """Index (side, side) of each entry of a symmetric matrix in its stored form."""
    where, kept = np.zeros((side, side), np.int64), _upper(side)
    where[kept] = np.arange(len(kept[0]))
    return np.maximum(where, where.T)


@dataclass(frozen=True, eq=False)
class Layout:
    """Layout of a row: ``fields`` by column name, and the number of ``words``."""

    fields: dict[str, Field]
    words: int

    @property
    def first(self) -> dict[str, int]:
        """The word at which each column begins."""
        return {name: field.first for name, field in self.fields.items()}


class Column(Generic[Entry]):
    """A column of a table: a descriptor with the type and shape of its entries."""

    def __init__(self, kind: type[Entry], *shape: str | int) -> None:
        self._is_flag, self._whole, self._shape = kind is np.bool_, kind is not np.float64, shape

    @property
    def is_single(self) -> bool:
        """Whether its entries are single numbers."""
        return not self._shape

    @property
    def is_number(self) -> bool:
        """Whether its entries are floating-point numbers."""
        return not self._whole

    def field(self, first: int, sizes: Mapping[str, int]) -> Field:
        """The field of this column, given the ``sizes`` of C, S and K."""
        shape = tuple(size if isinstance(size, int) else sizes[size] for size in self._shape)
        return Field(first, first + math.prod(shape), shape, self._whole)

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, table: "Table", owner: type) -> NDArray[Entry]:
        first, end, shape, whole, side = table.layout.fields[self._name]
        words: NDArray[Any] = table.words.view(np.int64) if whole else table.words
        cells = words[:, first:end].reshape(len(words), *shape) if shape else words[:, first]
        cells = cells[..., entries(side)] if side else cells
        column: NDArray[Entry] = cells != 0 if self._is_flag else cells
        column.flags.writeable = False
        vars(table)[self._name] = column  # cached: found before this descriptor from now on
        return column


class Symmetric(Column[np.float64]):
    """A column of symmetric matrices."""

    def __init__(self, size: str) -> None:
        super().__init__(np.float64, size, size)
        self._size = size

    def field(self, first: int, sizes: Mapping[str, int]) -> Field:
        side = sizes[self._size]
        kept = side * (side + 1) // 2
        return Field(first, first + kept, (kept,), False, side)


@dataclass(frozen=True, eq=False)
class Table:
    """N rows as ``words`` (N, words) with their ``layout``; flags are stored as integers."""

    words: Array
    layout: Layout

    def __len__(self) -> int:
        return len(self.words)

    def raw_column(self, name: str) -> NDArray[Any]:
        """A view (N, ...) of a column in its stored form; flags are integers."""
        first, end, shape, whole, _ = self.layout.fields[name]
        words: NDArray[Any] = self.words.view(np.int64) if whole else self.words
        return words[:, first:end].reshape(len(words), *shape) if shape else words[:, first]

    @staticmethod
    def of_all(tables: "Sequence[Table]", name: str) -> NDArray[Any]:
        """A column of single numbers of all tables, one after the other."""
        fields = [table.layout.fields[name] for table in tables]
        words = [table.words[:, field.first] for table, field in zip(tables, fields, strict=True)]
        column: NDArray[Any] = np.concatenate(words)
        return column.view(np.int64) if fields[0].whole else column

    def replace_columns(self, **columns: NDArray[Any] | float) -> Self:
        """A copy with some columns replaced."""
        other = self.copy()
        for name, column in columns.items():
            other.raw_column(name)[...] = self.layout.fields[name].kept(column)
        return other

    def copy(self) -> Self:
        """A copy with its own memory. It may be written to as long as no column has been read."""
        return replace(self, words=self.words.copy())


@cache
def layout(table: type[Table], model: ContactModel) -> Layout:
    """Layout of the rows of a table of this contact."""
    family, fields, end = model.family, dict[str, Field](), 0
    sizes = {"C": len(family.COLUMNS), "S": family.SIZE, "K": family.ROWS}
    for name, column in vars(table).items():
        if isinstance(column, Column):
            fields[name] = column.field(end, sizes)
            end = fields[name].end
    return Layout(fields, end)
