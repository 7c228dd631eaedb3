"""The living hypotheses of one contact as a table: what is known of each."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Entry = TypeVar("Entry", np.int64, np.float64, np.bool_)


class Field(NamedTuple):
    """Where in a row a column is: in words ``first`` to ``end``, with entries of a ``shape``.

    Of symmetric matrices (``side``, ``side``) the upper triangle is kept, row after row.
    """

    first: int
    end: int
    shape: tuple[int, ...]
    whole: bool
    side: int = 0

    def kept(self, column: NDArray[Any] | float) -> NDArray[Any] | float:
        """What is kept of a column."""
        if not self.side or not isinstance(column, np.ndarray):
            return column
        rows, columns = _upper(self.side)
        kept: NDArray[Any] = column[..., rows, columns]
        return kept

    def column(self, kept: NDArray[Any]) -> NDArray[Any]:
        """The column of which that is kept."""
        return kept[..., entries(self.side)] if self.side else kept


@cache
def _upper(side: int) -> tuple[Index, Index]:
    """Rows and columns of an upper triangle."""
    rows, columns = np.triu_indices(side)
    return rows, columns


@cache
def entries(side: int) -> Index:
    """Where in what is kept of a symmetric matrix its entries (side, side) are."""
    where, kept = np.zeros((side, side), np.int64), _upper(side)
    where[kept] = np.arange(len(kept[0]))
    return np.maximum(where, where.T)


@dataclass(frozen=True, eq=False)
class Layout:
    """What is where in a row: ``fields`` by the columns' names, so many ``words`` in all."""

    fields: dict[str, Field]
    words: int


class _Column(Generic[Entry]):
    """A column of the table, by the name it has in ``Bank``, and the shape of its entries."""

    def __init__(self, kind: type[Entry], *shape: str | int) -> None:
        self._is_flag, self._whole, self._shape = kind is np.bool_, kind is not np.float64, shape

    def field(self, first: int, sizes: Mapping[str, int]) -> Field:
        """With the ``sizes`` of C, S and K."""
        shape = tuple(size if isinstance(size, int) else sizes[size] for size in self._shape)
        return Field(first, first + math.prod(shape), shape, self._whole)

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, bank: "Bank", owner: type) -> NDArray[Entry]:
        cells = bank.layout.fields[self._name].column(bank.cells(self._name))
        column: NDArray[Entry] = cells != 0 if self._is_flag else cells
        column.flags.writeable = False
        vars(bank)[self._name] = column  # which is found first from now on
        return column


class _Symmetric(_Column[np.float64]):
    """A column of symmetric matrices."""

    def __init__(self, size: str) -> None:
        super().__init__(np.float64)
        self._size = size

    def field(self, first: int, sizes: Mapping[str, int]) -> Field:
        side = sizes[self._size]
        kept = side * (side + 1) // 2
        return Field(first, first + kept, (kept,), False, side)


@dataclass(frozen=True, eq=False)
class Bank:
    """H hypotheses of one contact, in order of onset; C, S, K as in ``contacts.base``.

    Parameters
    ----------
    words : (H, words) what is known of each, a row each, in words of eight bytes: one copy moves it all, and
        kernels see it as numbers. ``layout`` tells what is where; flags are whole numbers there.
    past : (H, L, 7) states at the last L ticks (see ``fixed_lag``); L is 0 without lag.

    Columns
    -------
    onset, onset_ns : (H,) first tick, and when it began.
    number : (H,) tells hypotheses apart over the whole recording.
    entry : (H,) log weight with which it began.
    source, known_mean, known : (H,), (H, S), (H, S, S) which elements it assumes to be known (0: none), and
        the prior on x that they are.
    pivot : (H, 6) where lines are anchored that go through a known point; NaN where the body is.
    pair, certain, searched, met : (H,) which of the pairs of elements that the user knows it assumes, whether
        both are given by that, whether directions are left that have to be searched for, and whether it
        assumes elements that were met before.
    first : (H, C) lifted first tick over its noise: what was given at the onset.
    moments, place_sum, weight : (H, C, C), (H, 3), (H,) weighted sums over the window.
    told : (H,) how many ticks with motion it has seen.
    x : (H, S) geometry that fits the window best.
    row_weight : (H, K) precision of the residuals relative to that of the position.
    lasted : (H,) log prior probability of what it assumes and of having lasted so long.
    settled, earned : (H,) of the log-likelihood ratio and of its gain, those of the ticks that have left the
        window.
    log_likelihood : (H,) of all data since the onset, against free motion.
    rms : (H,) whitened root mean square residual.
    """

    words: Array
    layout: Layout
    past: Array

    onset = _Column(np.int64)
    onset_ns = _Column(np.int64)
    number = _Column(np.int64)
    source = _Column(np.int64)
    pair = _Column(np.int64)
    certain = _Column(np.bool_)
    searched = _Column(np.bool_)
    met = _Column(np.bool_)
    entry = _Column(np.float64)
    known_mean = _Column(np.float64, "S")
    known = _Symmetric("S")
    pivot = _Column(np.float64, 6)
    first = _Column(np.float64, "C")
    moments = _Symmetric("C")
    place_sum = _Column(np.float64, 3)
    weight = _Column(np.float64)
    told = _Column(np.float64)
    x = _Column(np.float64, "S")
    row_weight = _Column(np.float64, "K")
    lasted = _Column(np.float64)
    settled = _Column(np.float64)
    earned = _Column(np.float64)
    log_likelihood = _Column(np.float64)
    rms = _Column(np.float64)

    def __len__(self) -> int:
        return len(self.words)

    def __reduce__(self) -> tuple[Any, ...]:
        return Bank, (self.words, self.layout, self.past)

    def cells(self, name: str) -> NDArray[Any]:
        """What is kept of a column (H, ...), in the memory of the rows; flags as whole numbers."""
        first, end, shape, whole, _ = self.layout.fields[name]
        words: NDArray[Any] = self.words.view(np.int64) if whole else self.words
        return words[:, first:end].reshape(len(words), *shape) if shape else words[:, first]

    @staticmethod
    def of_all(banks: "Sequence[Bank]", name: str) -> NDArray[Any]:
        """A column of single numbers of all banks, one after the other."""
        fields = [bank.layout.fields[name] for bank in banks]
        words = [bank.words[:, field.first] for bank, field in zip(banks, fields, strict=True)]
        column: NDArray[Any] = np.concatenate(words)
        return column.view(np.int64) if fields[0].whole else column

    @property
    def joint(self) -> Array:
        """Log weight (H,) of a hypothesis with all that led to it."""
        return self.entry + self.log_likelihood

    @property
    def log_weight(self) -> float:
        """Log of the sum of all weights; -inf without any hypothesis."""
        joint, top = self.joint, self.best
        return top + float(np.log(np.exp(joint - top).sum())) if len(self) else -np.inf

    @property
    def leader(self) -> int:
        """The row of the best hypothesis; -1 without any."""
        return int(self.joint.argmax()) if len(self) else -1

    @property
    def best(self) -> float:
        """Log weight of the best hypothesis; -inf without any."""
        return float(self.joint.max()) if len(self) else -np.inf

    def pick(self, rows: Index) -> "Bank":
        """The hypotheses in ``rows``."""
        return Bank(self.words.take(rows, axis=0), self.layout, self.past.take(rows, axis=0))

    def having(self, **columns: NDArray[Any] | float) -> "Bank":
        """The same with other columns."""
        other = self.copy()
        for name, column in columns.items():
            other.cells(name)[...] = self.layout.fields[name].kept(column)
        return other

    def copy(self) -> "Bank":
        """The same with rows of its own, which may be written to as long as no column has been read."""
        return Bank(self.words.copy(), self.layout, self.past)

    def putting(self, rows: Index, found: "Bank", which: Index) -> "Bank":
        """The same with the geometry and evidence of ``found``'s hypotheses ``which`` in ``rows``."""
        other = self.copy()
        for name in FOUND:
            other.cells(name)[rows] = found.cells(name)[which]
        return other


FOUND: Final = ("x", "row_weight", "log_likelihood", "rms")
"""Columns that change when a hypothesis learns."""


@cache
def layout(model: ContactModel) -> Layout:
    """Of the rows of the contact's ``Bank``."""
    family, fields, end = model.family, dict[str, Field](), 0
    sizes = {"C": len(family.COLUMNS), "S": family.SIZE, "K": family.ROWS}
    for name, column in vars(Bank).items():
        if isinstance(column, _Column):
            fields[name] = column.field(end, sizes)
            end = fields[name].end
    return Layout(fields, end)
