"""The living hypotheses of one contact as columns: what each knows, how they join and which are dropped."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from contact_tracker.begins import Begins
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.given import Given
from contact_tracker.evidence import weak_prior
from contact_tracker.fit import Prior
from contact_tracker.labels import STATES
from contact_tracker.table import WORD, layout

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]
Entry = TypeVar("Entry", np.int64, np.float64, np.bool_)

PATIENCE: Final = 16
"""Up to this many ticks with motion a hypothesis is kept however bad: its geometry may not be found yet."""
MET_SHARE: Final = 0.35
"""Of the margin: what assumes elements that were met before is dropped sooner, beside it is what assumes
less."""
YOUNG: Final = 24
"""Up to this age in ticks every onset has its own hypothesis; older ones get sparser."""


class _Column(Generic[Entry]):
    """A column of the table, by the name it has in ``Bank``."""

    def __init__(self, kind: type[Entry]) -> None:
        self._is_flag = kind is np.bool_

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, bank: "Bank", owner: type) -> NDArray[Entry]:
        view: NDArray[Any] = bank.table[self._name]
        column = view != 0 if self._is_flag else view
        vars(bank)[self._name] = column  # which is found first from now on
        return column


@dataclass(frozen=True, eq=False)
class Bank:
    """H hypotheses of one contact, in order of onset; C, S, K, P as in ``contacts.base``.

    Parameters
    ----------
    words : (H, words) what is known of each, in a row of the ``layout`` that ``table`` tells.
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
    x, hessian : (H, S), (H, K, P, P) geometry that fits the window best, and its information by row.
    row_weight : (H, K) precision of the residuals relative to that of the position.
    lasted : (H,) log prior probability of what it assumes and of having lasted so long.
    settled, earned : (H,) of the log-likelihood ratio and of its gain, those of the ticks that have left the
        window.
    log_likelihood : (H,) of all data since the onset, against free motion.
    rms : (H,) whitened root mean square residual.
    """

    words: Array
    layout: np.dtype[Any]
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
    known_mean = _Column(np.float64)
    known = _Column(np.float64)
    pivot = _Column(np.float64)
    first = _Column(np.float64)
    moments = _Column(np.float64)
    place_sum = _Column(np.float64)
    weight = _Column(np.float64)
    told = _Column(np.float64)
    x = _Column(np.float64)
    hessian = _Column(np.float64)
    row_weight = _Column(np.float64)
    lasted = _Column(np.float64)
    settled = _Column(np.float64)
    earned = _Column(np.float64)
    log_likelihood = _Column(np.float64)
    rms = _Column(np.float64)

    def __len__(self) -> int:
        return len(self.words)

    def __reduce__(self) -> tuple[Any, ...]:
        return Bank, (self.words, self.layout, self.past)

    @cached_property
    def table(self) -> NDArray[Any]:
        """The columns (H,) by their names, in the same memory."""
        return self.words.view(self.layout)[:, 0]

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
            other.table[name] = column
        return other

    def copy(self) -> "Bank":
        """The same in memory of its own, as long as nobody else sees it to be written to."""
        return Bank(self.words.copy(), self.layout, self.past)

    def putting(self, rows: Index, found: "Bank", which: Index) -> "Bank":
        """The same with the geometry and evidence of ``found``'s hypotheses ``which`` in ``rows``."""
        other = self.copy()
        for name in FOUND:
            other.table[name][rows] = found.table[name][which]
        return other


FOUND: Final = ("x", "hessian", "row_weight", "log_likelihood", "rms")
"""Columns that change when a hypothesis learns."""


def anchors_of(bank: Bank, model: ContactModel) -> Array:
    """Where each hypothesis has its lines: through known points, or nearest to where the body was on average
    over its window; (H, 6) as in ``contacts.base``."""
    anchors = model.anchors(bank.place_sum / bank.weight[:, None])
    return np.where(np.isnan(bank.pivot), anchors, bank.pivot)


def prior_of(bank: Bank, model: ContactModel, anchors: Array, reach_m: float) -> Prior:
    """What each hypothesis knew of its geometry before its window."""
    weak = weak_prior(model.family, anchors, reach_m)
    if not bank.source.any():
        return weak
    return weak + Prior.around(bank.known_mean, bank.known, weak.flat)


@lru_cache(maxsize=256)
def blank(model: ContactModel, count: int, lag: int = 0) -> Bank:
    """``count`` hypotheses of which nothing is known."""
    family, row = model.family, layout(model)
    bank = Bank(np.zeros((count, row.itemsize // WORD)), row, np.zeros((count, lag, len(STATES))))
    # some directions; points at the body, which starts at the origin
    x = family.normalise((1.0 - family.SPREAD) * (1.0 + np.arange(family.SIZE) % 2), np.zeros(6))
    return bank.having(x=x, pivot=np.nan, row_weight=1.0, rms=1.0, searched=1)


def add(
    bank: Bank,
    model: ContactModel,
    onset: int,
    onset_ns: int,
    number: int,
    entry: float,
    past: Array,
    turn: Array,
    begins: Begins,
) -> Bank:
    """Hypotheses from tick ``onset`` on, one for each of ``begins``, numbered from ``number`` on.

    Where nothing is known they start from the geometry of the best one so far; the first ones from any, the
    same whatever the world's axes are: ``turn`` (3, 3) is the body's orientation.
    """
    count, old = begins.many, len(bank)
    if not count:
        return bank
    words, told = _assuming(model, begins)
    words = np.concatenate([bank.words, words])
    both = Bank(words, bank.layout, np.concatenate([bank.past, past[None].repeat(count, axis=0)]))
    new = both.table[old:]
    if old:
        best = int(bank.joint.argmax())
        x, new["row_weight"] = bank.x[best], bank.row_weight[best]
    else:
        x = model.turned(new["x"], turn)
    new["x"] = np.where(told, begins.known_mean, x)
    new["onset"], new["onset_ns"], new["entry"] = onset, onset_ns, entry
    new["number"] = np.arange(number, number + count)
    return both


@lru_cache(maxsize=32)  # for as long as nothing is learnt the same may begin
def _assuming(model: ContactModel, begins: Begins) -> tuple[Array, Bools]:
    """Hypotheses (n, words) that have seen nothing yet, and what (n, S) of their x is known."""
    new = blank(model, begins.many).having(**begins.assumed)
    new = new.having(lasted=begins.log_share, log_likelihood=begins.log_share)
    return new.words, Given(begins.known_mean, begins.known).told(model)


def prune(bank: Bank, now: int, best: float, margin: float) -> Bank:
    """Drop what is hopeless against ``best``, and thin out onsets the more the older they are."""
    joint = bank.joint
    margins = np.where(bank.met, MET_SHARE * margin, margin)
    keep = (joint > best - margins) | ((bank.told <= PATIENCE) & bank.searched)
    old = bank.onset.searchsorted(now + 1 - YOUNG)  # they are in order
    if old > 1:
        age = now + 1 - bank.onset[:old]
        span = 2 ** (np.floor(np.log2(age / YOUNG)) + 1).astype(np.int64)
        keep[:old] &= best_of(bank.onset[:old] // span + (span << 40), joint[:old])
    return bank if keep.all() else bank.pick(keep.nonzero()[0])


def best_of(group: Index, joint: Array) -> Bools:
    """Whether each is the best of its group."""
    order = np.lexsort((-joint, group))
    sorted_group, first, best = group[order], np.ones(len(group), bool), np.zeros(len(group), bool)
    np.not_equal(sorted_group[1:], sorted_group[:-1], out=first[1:])
    best[order[first]] = True
    return best
