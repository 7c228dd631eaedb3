"""The living hypotheses of one contact: what is known of each, and what has been seen since its onset."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.hypotheses.row_layout import Array, Column, Index, Symmetric, Table, layout
from contact_tracker.states import STATES


@dataclass(frozen=True, eq=False)
class Onsets(Table):
    """O onsets of hypotheses of one contact, in order, and the windows since then: all hypotheses that began
    together share one. C as in ``contacts.base``.

    Columns
    -------
    onset, onset_ns : (O,) first tick, and when it began.
    weight, place_sum, moments : (O,), (O, 3), (O, C, C) weighted sums over the window.
    told : (O,) how many ticks with motion it has.
    first : (O, C) lifted first tick over its noise: what was given at the onset.
    """

    onset = Column(np.int64)
    onset_ns = Column(np.int64)
    weight = Column(np.float64)
    told = Column(np.float64)
    place_sum = Column(np.float64, 3)
    first = Column(np.float64, "C")
    moments = Symmetric("C")

    def __reduce__(self) -> tuple[Any, ...]:
        return Onsets, (self.words, self.layout)


@dataclass(frozen=True, eq=False)
class Bank(Table):
    """H hypotheses of one contact, in order of onset; C, S, K as in ``contacts.base``.

    Parameters
    ----------
    onsets : those of all hypotheses, and maybe more. What they have is known of each hypothesis as well:
        ``weight``, ``told``, ``place_sum``, ``first``, ``moments`` (H, ...).
    past : (H, L, 7) states at the last L ticks (see ``fixed_lag``); L is 0 without lag.

    Columns
    -------
    onset : (H,) first tick: which of the onsets is its own.
    number : (H,) tells hypotheses apart over the whole recording.
    entry : (H,) log weight with which it began.
    grace : (H,) it is kept until ``told`` is beyond that, however bad (but old onsets get sparser all the
        same); set when it begins, if it may search, and put off when it falls.
    source, known_mean, known : (H,), (H, S), (H, S, S) which elements it assumes to be known (0: none), and
        the prior on x that they are.
    pivot : (H, 6) where lines are anchored that go through a known point; NaN where the body is.
    pair, certain, searched, met : (H,) which of the pairs of elements that the user knows it assumes, whether
        both are given by that, whether directions are left that have to be searched for, and whether it
        assumes elements that were met before.
    x : (H, S) geometry that fits the window best.
    row_weight : (H, K) precision of the residuals relative to that of the position.
    lasted : (H,) log prior probability of what it assumes and of having lasted so long.
    settled, earned : (H,) of the log-likelihood ratio and of its gain, those of the ticks that have left the
        window.
    log_likelihood : (H,) of all data since the onset, against free motion.
    rms : (H,) whitened root mean square residual.
    """

    onsets: Onsets
    past: Array

    onset = Column(np.int64)
    number = Column(np.int64)
    source = Column(np.int64)
    pair = Column(np.int64)
    certain = Column(np.bool_)
    searched = Column(np.bool_)
    met = Column(np.bool_)
    entry = Column(np.float64)
    grace = Column(np.float64)
    known_mean = Column(np.float64, "S")
    known = Symmetric("S")
    pivot = Column(np.float64, 6)
    x = Column(np.float64, "S")
    row_weight = Column(np.float64, "K")
    lasted = Column(np.float64)
    settled = Column(np.float64)
    earned = Column(np.float64)
    log_likelihood = Column(np.float64)
    rms = Column(np.float64)

    def __reduce__(self) -> tuple[Any, ...]:
        return Bank, (self.words, self.layout, self.onsets, self.past)

    @cached_property
    def window(self) -> Index:
        """Row (H,) of each hypothesis in the table of onsets; raises ValueError if one has none."""
        onsets = self.onsets.onset
        row = onsets.searchsorted(self.onset)
        if not np.array_equal(onsets[row[row < len(onsets)]], self.onset):
            raise ValueError("a hypothesis without its onset")
        return row

    @cached_property
    def weight(self) -> Array:
        return self.onsets.weight[self.window]

    @cached_property
    def told(self) -> Array:
        return self.onsets.told[self.window]

    @cached_property
    def place_sum(self) -> Array:
        return self.onsets.place_sum[self.window]

    @cached_property
    def first(self) -> Array:
        return self.onsets.first[self.window]

    @cached_property
    def moments(self) -> Array:
        return self.onsets.moments[self.window]

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

    def alone(self, row: int) -> "Bank":
        """One hypothesis with its onset."""
        own = self.words[row : row + 1]
        since = int(self.onsets.cells("onset").searchsorted(self.cells("onset")[row]))
        onsets = Onsets(self.onsets.words[since : since + 1], self.onsets.layout)
        one = Bank(own, self.layout, onsets, self.past[row : row + 1])
        vars(one)["window"] = _FIRST
        return one

    def pick(self, rows: Index) -> "Bank":
        """The hypotheses in ``rows``, which need not be in order."""
        words, past = self.words.take(rows, axis=0), self.past.take(rows, axis=0)
        return Bank(words, self.layout, self.onsets, past)

    def seeing(self, **columns: NDArray[Any] | float) -> "Bank":
        """The same with other columns (O, ...) of the onsets."""
        return replace(self, onsets=self.onsets.having(**columns))

    def putting(self, rows: Index, found: "Bank", which: Index) -> "Bank":
        """The same with the geometry and evidence of ``found``'s hypotheses ``which`` in ``rows``."""
        other = self.copy()
        for name in FOUND:
            other.cells(name)[rows] = found.cells(name)[which]
        return other


_FIRST: Final = np.zeros(1, np.int64)
FOUND: Final = ("x", "row_weight", "log_likelihood", "rms")
"""Columns that change when a hypothesis learns."""


@lru_cache(maxsize=256)
def blank(model: ContactModel, count: int, lag: int = 0) -> Bank:
    """``count`` hypotheses of which nothing is known, each with an onset of its own, in ticks 0, 1, ..."""
    family, row, of_onset = model.family, layout(Bank, model), layout(Onsets, model)
    onsets = Onsets(np.zeros((count, of_onset.words)), of_onset).having(onset=np.arange(count))
    bank = Bank(np.zeros((count, row.words)), row, onsets, np.zeros((count, lag, len(STATES))))
    # some directions; points at the body, which starts at the origin
    x = family.normalise((1.0 - family.SPREAD) * (1.0 + np.arange(family.SIZE) % 2), np.zeros(6))
    return bank.having(onset=onsets.onset, x=x, pivot=np.nan, row_weight=1.0, rms=1.0, searched=1)
