"""The bank of one contact: its run-length hypotheses, and the sufficient statistics since their onsets.

Rows are words of 8 bytes: selecting rows is one copy, and the kernels use the same memory.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from math import isqrt
from typing import Any, Final, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array, Ints
from contact_tracker.contacts import ContactModel
from contact_tracker.states import STATES

Entry = TypeVar("Entry", np.int64, np.float64, np.bool_)


@cache
def _upper(side: int) -> tuple[Ints, Ints]:
    """Rows and columns of an upper triangle."""
    rows, columns = np.triu_indices(side)
    return rows, columns


@cache
def entries(side: int) -> Ints:
    """Index (side, side) of each entry of a symmetric matrix in its stored form."""
    index, upper = np.zeros((side, side), np.int64), _upper(side)
    index[upper] = np.arange(len(upper[0]))
    return np.maximum(index, index.T)


class Column(Generic[Entry]):
    """A column of a table: a descriptor with the type and shape of its entries. Flags are stored as
    integers."""

    def __init__(self, kind: type[Entry], *shape: str | int) -> None:
        self._kind: type[Any] = kind
        self._shape = shape

    def stored(self, sizes: Mapping[str, int]) -> tuple[type, tuple[int, ...]]:
        """Type and shape of an entry as stored, given the ``sizes`` of C, S and K."""
        shape = tuple(size if isinstance(size, int) else sizes[size] for size in self._shape)
        return np.float64 if self._kind is np.float64 else np.int64, shape

    def kept(self, column: NDArray[Any] | float) -> NDArray[Any] | float:
        """The stored form of a column."""
        return column

    def read(self, kept: NDArray[Any]) -> NDArray[Entry]:
        """A column from its stored form."""
        return kept != 0 if self._kind is np.bool_ else kept

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, table: "Table", owner: type) -> NDArray[Entry]:
        column = self.read(table.rows[self._name])
        column.flags.writeable = False
        vars(table)[self._name] = column  # cached: found before this descriptor from now on
        return column


class Symmetric(Column[np.float64]):
    """A column of symmetric matrices, stored as their upper triangle, row by row."""

    def __init__(self, size: str) -> None:
        super().__init__(np.float64, size, size)

    def stored(self, sizes: Mapping[str, int]) -> tuple[type, tuple[int, ...]]:
        kind, (side, _) = super().stored(sizes)
        return kind, (side * (side + 1) // 2,)

    def kept(self, column: NDArray[Any] | float) -> NDArray[Any] | float:
        return column[..., *_upper(column.shape[-1])] if isinstance(column, np.ndarray) else column

    def read(self, kept: Array) -> Array:
        side = (isqrt(8 * kept.shape[-1] + 1) - 1) // 2
        return np.asarray(kept[..., entries(side)])


@dataclass(frozen=True, eq=False)
class Table:
    """N rows as ``words`` (N, W) of eight bytes, with the ``layout`` of a row."""

    words: Array
    layout: np.dtype[np.void]

    def __len__(self) -> int:
        return len(self.words)

    @cached_property
    def rows(self) -> NDArray[np.void]:
        """The same memory (N,) by the names of the columns, in their stored form."""
        return np.ndarray(len(self.words), self.layout, self.words)  # a view takes several times longer

    @staticmethod
    def of_all(tables: "Sequence[Table]", name: str) -> NDArray[Any]:
        """A column of single numbers of all tables, one after the other."""
        return np.concatenate([table.rows[name] for table in tables])

    def replace_columns(self, **columns: NDArray[Any] | float) -> Self:
        """A copy with some columns replaced."""
        copy = self.copy()
        for name, column in columns.items():
            copy.rows[name] = vars(type(self))[name].kept(column)
        return copy

    def copy(self) -> Self:
        """A copy with its own memory. It may be written to as long as no column has been read."""
        return replace(self, words=self.words.copy())


@cache
def layout(table: type[Table], model: ContactModel) -> np.dtype[np.void]:
    """Layout of the rows of a table of this contact."""
    family = model.family
    sizes = {"C": len(family.COLUMNS), "S": family.SIZE, "K": family.ROWS}
    columns = [(name, column) for name, column in vars(table).items() if isinstance(column, Column)]
    return np.dtype([(name, *column.stored(sizes)) for name, column in columns])


@dataclass(frozen=True, eq=False)
class Onsets(Table):
    """O onsets of one contact in order of time, with the sums over all ticks since each.

    Hypotheses with the same onset share one row. C as in ``contacts.family``.

    Columns
    -------
    onset, onset_ns : (O,) index of the first tick, and its time.
    weight : (O,) sum of the weights of the ticks.
    weighted_position_sum : (O, 3) weighted sum of the body's positions.
    second_moment : (O, C, C) weighted second moment of the lifted poses: the sufficient statistics.
    effective_ticks : (O,) number of ticks with motion.
    onset_row : (O, C) lifted pose of the first tick over its noise.
    """

    onset = Column(np.int64)
    onset_ns = Column(np.int64)
    weight = Column(np.float64)
    effective_ticks = Column(np.float64)
    weighted_position_sum = Column(np.float64, 3)
    onset_row = Column(np.float64, "C")
    second_moment = Symmetric("C")

    def __reduce__(self) -> tuple[Any, ...]:
        return Onsets, (self.words, self.layout)


@dataclass(frozen=True, eq=False)
class Bank(Table):
    """H hypotheses of one contact, in order of onset; C, S, K as in ``contacts.family``.

    Parameters
    ----------
    onsets : the onsets of all hypotheses, possibly more. Their columns (``weight``, ``effective_ticks``,
        ``second_moment``, ...) can be read per hypothesis as well, with shape (H, ...).
    lag_history : (H, L, 7) states at the last L ticks (see ``hmm.forward_filter``); L is 0 without lag.

    Columns
    -------
    onset : (H,) index of the first tick.
    number : (H,) identifies the hypothesis in the whole recording.
    log_birth_weight : (H,) log weight at birth.
    prior_index : (H,) number of the known or learned elements that it assumes; 0: none.
    prior_mean, prior_information : (H, S), (H, S, S) the Gaussian prior on x that follows from them.
    line_anchor : (H, 6) points by which lines through a known point are parametrised; NaN: near the body.
    known_pair_index : (H,) index of the pair of elements of the map that it assumes.
    elements_known : (H,) whether that pair gives both elements completely.
    needs_search : (H,) whether the prior leaves directions open, so that global search is needed.
    x : (H, S) estimated geometry.
    row_weight : (H, K) precision of the residuals relative to that of the position.
    log_prior : (H,) log prior probability of its elements and of its run length.
    llr_before_window, gain_before_window : (H,) log-likelihood ratio and its gain, summed before the window.
    log_likelihood : (H,) of all data since the onset, relative to free motion.
    rms : (H,) whitened root mean square residual.
    """

    onsets: Onsets
    lag_history: Array

    onset = Column(np.int64)
    number = Column(np.int64)
    prior_index = Column(np.int64)
    known_pair_index = Column(np.int64)
    elements_known = Column(np.bool_)
    needs_search = Column(np.bool_)
    log_birth_weight = Column(np.float64)
    log_prior = Column(np.float64)
    llr_before_window = Column(np.float64)
    gain_before_window = Column(np.float64)
    log_likelihood = Column(np.float64)
    rms = Column(np.float64)
    prior_mean = Column(np.float64, "S")
    prior_information = Symmetric("S")
    line_anchor = Column(np.float64, 6)
    x = Column(np.float64, "S")
    row_weight = Column(np.float64, "K")

    def __reduce__(self) -> tuple[Any, ...]:
        return Bank, (self.words, self.layout, self.onsets, self.lag_history)

    @cached_property
    def onset_index(self) -> Ints:
        """Row (H,) of each hypothesis in the table of onsets; raises ValueError if one has none."""
        onsets = self.onsets.onset
        row = onsets.searchsorted(self.onset)
        if not np.array_equal(onsets[row[row < len(onsets)]], self.onset):
            raise ValueError("a hypothesis without its onset")
        return row

    @cached_property
    def weight(self) -> Array:
        return self.onsets.weight[self.onset_index]

    @cached_property
    def effective_ticks(self) -> Array:
        return self.onsets.effective_ticks[self.onset_index]

    @cached_property
    def weighted_position_sum(self) -> Array:
        return self.onsets.weighted_position_sum[self.onset_index]

    @cached_property
    def onset_row(self) -> Array:
        return self.onsets.onset_row[self.onset_index]

    @cached_property
    def second_moment(self) -> Array:
        return self.onsets.second_moment[self.onset_index]

    @property
    def log_weight(self) -> Array:
        """Log weight (H,) of each hypothesis, including the history before its onset."""
        return np.asarray(self.rows["log_birth_weight"] + self.rows["log_likelihood"])

    @property
    def log_total_weight(self) -> float:
        """Log of the sum of all weights; -inf for an empty bank."""
        joint, top = self.log_weight, self.best
        return top + float(np.log(np.exp(joint - top).sum())) if len(self) else -np.inf

    @property
    def best_row(self) -> int:
        """Row of the best hypothesis; -1 for an empty bank."""
        return int(self.log_weight.argmax()) if len(self) else -1

    @property
    def leader(self) -> tuple[int, int, int]:
        """Row, onset tick and onset time (ns) of the best hypothesis; -1 for an empty bank."""
        if (row := self.best_row) < 0:
            return -1, -1, -1
        return row, int(self.onset[row]), int(self.onsets.onset_ns[self.onset_index[row]])

    @property
    def best(self) -> float:
        """Log weight of the best hypothesis; -inf for an empty bank."""
        return float(self.log_weight.max()) if len(self) else -np.inf

    def single(self, row: int) -> "Bank":
        """A copy of one hypothesis with its onset; it keeps no other hypothesis in memory."""
        rows, since = slice(row, row + 1), self.onsets.rows["onset"].searchsorted(self.rows["onset"][row])
        onsets = Onsets(self.onsets.words[since : since + 1].copy(), self.onsets.layout)
        bank = Bank(self.words[rows].copy(), self.layout, onsets, self.lag_history[rows].copy())
        vars(bank)["onset_index"] = _FIRST
        return bank

    def pick(self, rows: Ints) -> "Bank":
        """The hypotheses in ``rows``, which need not be in order."""
        words, past = self.words.take(rows, axis=0), self.lag_history.take(rows, axis=0)
        return Bank(words, self.layout, self.onsets, past)

    def replace_onset_columns(self, **columns: NDArray[Any] | float) -> "Bank":
        """A copy with some columns (O, ...) of the onsets replaced."""
        return replace(self, onsets=self.onsets.replace_columns(**columns))

    def replace_rows(self, rows: Ints, source: "Bank", source_rows: Ints) -> "Bank":
        """A copy whose ``rows`` have the geometry and evidence of the ``source_rows`` of ``source``."""
        copy = self.copy()
        for name in FITTED_COLUMNS:
            copy.rows[name][rows] = source.rows[name][source_rows]
        return copy


_FIRST: Final = np.zeros(1, np.int64)
FITTED_COLUMNS: Final = ("x", "row_weight", "log_likelihood", "rms")
"""Columns that a refit changes."""


@lru_cache(maxsize=256)
def blank(model: ContactModel, count: int, lag: int = 0) -> Bank:
    """``count`` hypotheses without prior or data, with onsets in ticks 0, 1, ..."""
    family, row, of_onset = model.family, layout(Bank, model), layout(Onsets, model)
    onsets = Onsets(np.zeros((count, of_onset.itemsize // 8)), of_onset).replace_columns(
        onset=np.arange(count)
    )
    bank = Bank(np.zeros((count, row.itemsize // 8)), row, onsets, np.zeros((count, lag, len(STATES))))
    # arbitrary directions; points at the body, which starts at the origin
    x = family.normalise((1.0 - family.SPREAD) * (1.0 + np.arange(family.SIZE) % 2), np.zeros(6))
    return bank.replace_columns(
        onset=onsets.onset, x=x, line_anchor=np.nan, row_weight=1.0, rms=1.0, needs_search=1
    )
