"""Add births to a bank, and prune it."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.birth import BirthProposals
from contact_tracker.hypotheses.evidence import weak_prior
from contact_tracker.hypotheses.quadratic_prior import Prior
from contact_tracker.hypotheses.schedule import FAR_NATS, RESIDUAL_TICKS, UNTHINNED_TICKS

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Birth(NamedTuple):
    """Hypotheses of one contact that begin in a tick.

    Entries of x without prior start from the best hypothesis so far (a face opposite to a known one is
    parallel to it); in an empty bank they start from fixed directions in the body's frame.
    """

    proposals: BirthProposals
    """With the prior of each."""
    onset: int
    """Index of the tick."""
    onset_ns: int
    """Time at which the tick began."""
    number: int
    """Number of the first hypothesis; the others follow."""
    log_birth_weight: float
    """Log weight of the contact's birth."""
    lag_history: Array
    """(L, 7) probabilities of the states before."""
    turn: Array
    """(3, 3) orientation of the body."""


class Births(NamedTuple):
    """A ``Birth`` of each contact, numbered one contact after the other."""

    proposals: tuple[BirthProposals, ...]
    """Per contact."""
    onset: int
    onset_ns: int
    number: int
    """Number of the first hypothesis of the first contact."""
    log_birth_weight: Array
    """(7,) per state."""
    lag_history: Array
    """(7, L, 7) per state."""
    turn: Array
    """(3, 3) orientation of the body."""

    @property
    def total(self) -> int:
        """Number of births of all contacts."""
        return sum([len(begins.rows.words) for begins in self.proposals])

    def of(self, column: int) -> Birth:
        """The births of one contact."""
        number = self.number + sum(begins.count for begins in self.proposals[:column])
        when, own = (
            (self.onset, self.onset_ns, number),
            (float(self.log_birth_weight[column]), self.lag_history[column]),
        )
        return Birth(self.proposals[column], *when, *own, self.turn)


def anchors_of(bank: Bank, model: ContactModel) -> Array:
    """Anchors (H, 6) of each hypothesis' lines as in ``contacts.family``: known points, or the mean position
    of the body in its window."""
    anchors = model.anchors(bank.weighted_position_sum / bank.weight[:, None])
    return np.where(np.isnan(bank.line_anchor), anchors, bank.line_anchor)


def prior_of(bank: Bank, model: ContactModel, anchors: Array, reach_m: float) -> Prior:
    """Prior of each hypothesis: the weak prior, and that of its known elements."""
    weak = weak_prior(model.family, anchors, reach_m)
    if not bank.prior_index.any():
        return weak
    return weak + Prior.around(bank.prior_mean, bank.prior_information, weak.flat)


def add(bank: Bank, model: ContactModel, birth: Birth) -> Bank:
    """The bank with the birth's hypotheses added."""
    begins, old = birth.proposals, len(bank)
    if not begins.count:
        return bank
    given = begins.is_given
    words = np.concatenate([bank.words, begins.rows.words])
    onsets = replace(bank.onsets, words=np.pad(bank.onsets.words, ((0, 1), (0, 0))))
    onsets.raw_column("onset")[-1], onsets.raw_column("onset_ns")[-1] = birth.onset, birth.onset_ns
    past = joined(bank.lag_history, birth.lag_history, begins.count, np.arange(len(words)))
    both = Bank(words, bank.layout, onsets, past)
    new = Bank(words[old:], bank.layout, onsets, past[old:])
    if old:
        best = bank.best_row
        x, new.raw_column("row_weight")[:] = bank.x[best], bank.row_weight[best]
    else:
        x = model.turned(new.raw_column("x"), birth.turn)
    new.raw_column("x")[:] = model.faced(np.where(given, begins.rows.prior_mean, x), given, birth.turn)
    new.raw_column("onset")[:] = birth.onset
    new.raw_column("number")[:] = birth.number + np.arange(begins.count)
    new.raw_column("log_birth_weight")[:] = birth.log_birth_weight
    return both


def joined(past: Array, of_new: Array, many: int, rows: Index) -> Array:
    """Lag histories (R, L, 7) of ``rows`` of: the old hypotheses, ``past`` (H, L, 7), then ``many`` new ones
    with the common history ``of_new`` (L, 7)."""
    if not past.shape[1]:
        return np.empty((len(rows), *past.shape[1:]))
    return np.concatenate([past, of_new[None].repeat(many, axis=0)])[rows]


def within_far_margin(bank: Bank) -> Bools:
    """Which hypotheses (H,) are within ``FAR_NATS`` of the best before this tick."""
    return bank.log_weight >= -FAR_NATS


def is_protected(bank: Bank) -> Bools:
    """Which hypotheses (H,) are protected from pruning by weight, and may receive the geometry of others."""
    return bank.effective_ticks <= bank.protected_until


def prune(bank: Bank, now: int, best: float, margin: float) -> Bank:
    """Drop hypotheses more than ``margin`` nats behind ``best``, and thin onsets, the more the older they
    are.

    The log weights of the result are relative to ``best``.
    """
    joint = bank.log_weight
    keep = (joint > best - margin) | is_protected(bank)
    old = bank.onset.searchsorted(now + 1 - UNTHINNED_TICKS)  # they are in order
    if old > 1:
        age = now + 1 - bank.onset[:old]
        span = 2 ** (np.floor(np.log2(age / UNTHINNED_TICKS)) + 1).astype(np.int64)
        keep[:old] &= best_of(bank.onset[:old] // span + (span << 40), joint[:old])
    bank = bank.pick(keep.nonzero()[0])
    is_used = np.isin(bank.onsets.onset, bank.onset)
    onsets = replace(bank.onsets, words=bank.onsets.words[is_used])
    return replace(bank.replace_columns(log_birth_weight=bank.log_birth_weight - best), onsets=onsets)


def residual(bank: Bank) -> float:
    """Whitened residual of the youngest hypothesis with at least ``RESIDUAL_TICKS`` of motion; nan without
    one."""
    ticks = np.where(bank.effective_ticks >= RESIDUAL_TICKS, bank.effective_ticks, np.inf)
    return float(bank.rms[ticks.argmin()]) if ticks.min(initial=np.inf) < np.inf else np.nan


def best_of(group: Index, joint: Array) -> Bools:
    """Whether each entry is the best of its group."""
    order = np.lexsort((-joint, group))
    sorted_group, first, best = group[order], np.ones(len(group), bool), np.zeros(len(group), bool)
    np.not_equal(sorted_group[1:], sorted_group[:-1], out=first[1:])
    best[order[first]] = True
    return best
