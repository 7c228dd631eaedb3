"""The living hypotheses of one contact as columns: what each knows, how they join and which are dropped."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.begins import Begins
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.given import Given
from contact_tracker.evidence import weak_prior
from contact_tracker.fit import Prior
from contact_tracker.labels import STATES

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]

PATIENCE: Final = 16
"""Up to this many ticks with motion a hypothesis is kept however bad: its geometry may not be found yet."""
MET_SHARE: Final = 0.35
"""Of the margin: what assumes elements that were met before is dropped sooner, beside it is what assumes
less."""
YOUNG: Final = 24
"""Up to this age in ticks every onset has its own hypothesis; older ones get sparser."""


@dataclass(frozen=True, eq=False)
class Bank:
    """H hypotheses of one contact, in order of onset; C, S, K, P as in ``contacts.base``.

    Parameters
    ----------
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
    past : (H, L, 7) states at the last L ticks (see ``fixed_lag``); L is 0 without lag.
    """

    onset: Index
    onset_ns: Index
    number: Index
    entry: Array
    source: Index
    known_mean: Array
    known: Array
    pivot: Array
    pair: Index
    certain: Bools
    searched: Bools
    met: Bools
    first: Array
    moments: Array
    place_sum: Array
    weight: Array
    told: Array
    x: Array
    hessian: Array
    row_weight: Array
    lasted: Array
    settled: Array
    earned: Array
    log_likelihood: Array
    rms: Array
    past: Array

    def __len__(self) -> int:
        return len(self.onset)

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
        other = object.__new__(Bank)
        vars(other).update({name: column.take(rows, axis=0) for name, column in vars(self).items()})
        return other

    def having(self, **columns: NDArray[Any]) -> "Bank":
        """The same with other columns; ``replace`` takes ten times as long."""
        other = object.__new__(Bank)
        vars(other).update(vars(self), **columns)
        return other

    def putting(self, rows: Index, found: "Bank", which: Index) -> "Bank":
        """The same with the geometry and evidence of ``found``'s hypotheses ``which`` in ``rows``."""
        changed = {name: vars(self)[name].copy() for name in FOUND}
        for name, column in changed.items():
            column[rows] = vars(found)[name].take(which, axis=0)
        return self.having(**changed)


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
    family = model.family
    c, s, k, p = len(family.COLUMNS), family.SIZE, family.ROWS, family.PARAMETERS
    column, index = np.zeros(count), np.zeros(count, np.int64)
    # some directions; points at the body, which starts at the origin
    anywhere = family.normalise((1.0 - family.SPREAD) * (1.0 + np.arange(s) % 2), np.zeros(6))
    return Bank(
        onset=index,
        onset_ns=index,
        number=index,
        entry=column,
        source=index,
        known_mean=np.zeros((count, s)),
        known=np.zeros((count, s, s)),
        pivot=np.full((count, 6), np.nan),
        pair=index,
        certain=np.zeros(count, bool),
        searched=np.ones(count, bool),
        met=np.zeros(count, bool),
        first=np.zeros((count, c)),
        moments=np.zeros((count, c, c)),
        place_sum=np.zeros((count, 3)),
        weight=column,
        told=column,
        x=np.tile(anywhere, (count, 1)),
        hessian=np.zeros((count, k, p, p)),
        row_weight=np.ones((count, k)),
        lasted=column,
        settled=column,
        earned=column,
        log_likelihood=column,
        rms=column + 1.0,
        past=np.zeros((count, lag, len(STATES))),
    )


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
    count = begins.many
    if not count:
        return bank
    new = blank(model, count)
    if len(bank):
        best = int(bank.joint.argmax())
        x, row_weight = bank.x[best], bank.row_weight[best] + np.zeros_like(new.row_weight)
    else:
        x, row_weight = model.turned(new.x, turn), new.row_weight
    new = new.having(
        onset=new.onset + onset,
        onset_ns=new.onset_ns + onset_ns,
        number=np.arange(number, number + count),
        entry=new.entry + entry,
        **begins.assumed,
        x=np.where(Given(begins.known_mean, begins.known).told(model), begins.known_mean, x),
        row_weight=row_weight,
        lasted=begins.log_share,
        log_likelihood=begins.log_share,
        past=past[None].repeat(count, axis=0),
    )
    added = vars(new)
    return bank.having(**{name: np.concatenate((column, added[name])) for name, column in vars(bank).items()})


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
