"""The living hypotheses of one contact: what each knew before, how they join and which are dropped."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.birth import Begins
from contact_tracker.hypotheses.evidence import weak_prior
from contact_tracker.hypotheses.quadratic_prior import Prior
from contact_tracker.hypotheses.schedule import FAR_NATS, RESIDUAL_TICKS, YOUNG

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Birth(NamedTuple):
    """What begins in a tick: ``onset`` and ``onset_ns`` of hypotheses that are numbered from ``number`` on,
    one for each of ``begins``; the log weight ``entry`` and the ``past`` (L, 7) that they all have.

    Where nothing is known they start from the geometry of the best one so far, but a face beside a known one
    is parallel to that; the first ones from any, the same whatever the world's axes are: ``turn`` (3, 3) is
    the body's orientation.
    """

    begins: Begins
    onset: int
    onset_ns: int
    number: int
    entry: float
    past: Array
    turn: Array


class Births(NamedTuple):
    """A ``Birth`` of each contact, numbered one contact after the other; ``entry`` (7,) and ``past``
    (7, L, 7) are those of all states."""

    begins: tuple[Begins, ...]
    onset: int
    onset_ns: int
    number: int
    entry: Array
    past: Array
    turn: Array

    @property
    def many(self) -> int:
        return sum(begins.many for begins in self.begins)

    def of(self, column: int) -> Birth:
        """Those of one contact."""
        number = self.number + sum(begins.many for begins in self.begins[:column])
        when, own = (self.onset, self.onset_ns, number), (float(self.entry[column]), self.past[column])
        return Birth(self.begins[column], *when, *own, self.turn)


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


def add(bank: Bank, model: ContactModel, birth: Birth) -> Bank:
    """The bank with what begins."""
    begins, old = birth.begins, len(bank)
    if not begins.many:
        return bank
    told = begins.told
    words = np.concatenate([bank.words, begins.rows.words])
    onsets = replace(bank.onsets, words=np.pad(bank.onsets.words, ((0, 1), (0, 0))))
    onsets.cells("onset")[-1], onsets.cells("onset_ns")[-1] = birth.onset, birth.onset_ns
    past = joined(bank.past, birth.past, begins.many, np.arange(len(words)))
    both = Bank(words, bank.layout, onsets, past)
    new = Bank(words[old:], bank.layout, onsets, past[old:])
    if old:
        best = bank.leader
        x, new.cells("row_weight")[:] = bank.x[best], bank.row_weight[best]
    else:
        x = model.turned(new.cells("x"), birth.turn)
    new.cells("x")[:] = model.faced(np.where(told, begins.rows.known_mean, x), told, birth.turn)
    new.cells("onset")[:] = birth.onset
    new.cells("number")[:] = birth.number + np.arange(begins.many)
    new.cells("entry")[:] = birth.entry
    return both


def joined(past: Array, of_new: Array, many: int, rows: Index) -> Array:
    """Past (R, L, 7) of some ``rows``: of hypotheses with a ``past`` (H, L, 7), and of so ``many`` new ones,
    which all have the same (L, 7)."""
    if not past.shape[1]:
        return np.empty((len(rows), *past.shape[1:]))
    return np.concatenate([past, of_new[None].repeat(many, axis=0)])[rows]


def is_near(bank: Bank) -> Bools:
    """Which hypotheses (H,) are not far behind what was the best before this tick."""
    return bank.joint >= -FAR_NATS


def has_grace(bank: Bank) -> Bools:
    """Which hypotheses (H,) are kept, and may take the geometry of others, however bad."""
    return bank.told <= bank.grace


def prune(bank: Bank, now: int, best: float, margin: float) -> Bank:
    """Drop what is hopeless against ``best``, and thin out onsets the more the older they are.

    Log weights are against ``best`` from then on.
    """
    joint = bank.joint
    keep = (joint > best - margin) | has_grace(bank)
    old = bank.onset.searchsorted(now + 1 - YOUNG)  # they are in order
    if old > 1:
        age = now + 1 - bank.onset[:old]
        span = 2 ** (np.floor(np.log2(age / YOUNG)) + 1).astype(np.int64)
        keep[:old] &= best_of(bank.onset[:old] // span + (span << 40), joint[:old])
    bank = bank.pick(keep.nonzero()[0])
    lives = np.isin(bank.onsets.onset, bank.onset)
    onsets = replace(bank.onsets, words=bank.onsets.words[lives])
    return replace(bank.having(entry=bank.entry - best), onsets=onsets)


def residual(bank: Bank) -> float:
    """Whitened residual of the hypothesis that has seen ``RESIDUAL_TICKS`` with motion, or few more; nan
    without one."""
    seen = np.where(bank.told >= RESIDUAL_TICKS, bank.told, np.inf)
    return float(bank.rms[seen.argmin()]) if seen.min(initial=np.inf) < np.inf else np.nan


def best_of(group: Index, joint: Array) -> Bools:
    """Whether each is the best of its group."""
    order = np.lexsort((-joint, group))
    sorted_group, first, best = group[order], np.ones(len(group), bool), np.zeros(len(group), bool)
    np.not_equal(sorted_group[1:], sorted_group[:-1], out=first[1:])
    best[order[first]] = True
    return best
