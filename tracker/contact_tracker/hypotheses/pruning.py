"""The living hypotheses of one contact: what each knew before, how they join and which are dropped."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.birth import BirthProposals
from contact_tracker.hypotheses.evidence import weak_prior
from contact_tracker.hypotheses.quadratic_prior import Prior
from contact_tracker.hypotheses.schedule import FAR_NATS, RESIDUAL_TICKS, YOUNG

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Birth(NamedTuple):
    """Hypotheses of one contact that begin in a tick.

    Where nothing is known they start from the geometry of the best one so far, but a face beside a known one
    is parallel to that; the first ones from any, the same whatever the world's axes are.
    """

    proposals: BirthProposals
    """What each assumes."""
    onset: int
    """The tick."""
    onset_ns: int
    """When it began."""
    number: int
    """Of the first of them; the others follow."""
    log_birth_weight: float
    """With which the contact begins."""
    lag_history: Array
    """(L, 7) the states before."""
    turn: Array
    """(3, 3) the orientation of the body."""


class Births(NamedTuple):
    """A ``Birth`` of each contact, numbered one contact after the other."""

    proposals: tuple[BirthProposals, ...]
    """Of each contact."""
    onset: int
    onset_ns: int
    number: int
    """Of the first of the first contact."""
    log_birth_weight: Array
    """(7,) of each state."""
    lag_history: Array
    """(7, L, 7) of each state."""
    turn: Array
    """(3, 3) the orientation of the body."""

    @property
    def total(self) -> int:
        """Of all contacts."""
        return sum(begins.count for begins in self.proposals)

    def of(self, column: int) -> Birth:
        """Those of one contact."""
        number = self.number + sum(begins.count for begins in self.proposals[:column])
        when, own = (
            (self.onset, self.onset_ns, number),
            (float(self.log_birth_weight[column]), self.lag_history[column]),
        )
        return Birth(self.proposals[column], *when, *own, self.turn)


def anchors_of(bank: Bank, model: ContactModel) -> Array:
    """Where each hypothesis has its lines: through known points, or nearest to where the body was on average
    over its window; (H, 6) as in ``contacts.family``."""
    anchors = model.anchors(bank.weighted_position_sum / bank.weight[:, None])
    return np.where(np.isnan(bank.line_anchor), anchors, bank.line_anchor)


def prior_of(bank: Bank, model: ContactModel, anchors: Array, reach_m: float) -> Prior:
    """What each hypothesis knew of its geometry before its window."""
    weak = weak_prior(model.family, anchors, reach_m)
    if not bank.prior_index.any():
        return weak
    return weak + Prior.around(bank.prior_mean, bank.prior_information, weak.flat)


def add(bank: Bank, model: ContactModel, birth: Birth) -> Bank:
    """The bank with what begins."""
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
    """History (R, L, 7) of some ``rows``: of hypotheses with a ``past`` (H, L, 7), and of ``many`` new ones,
    which all have the same ``of_new`` (L, 7)."""
    if not past.shape[1]:
        return np.empty((len(rows), *past.shape[1:]))
    return np.concatenate([past, of_new[None].repeat(many, axis=0)])[rows]


def within_far_margin(bank: Bank) -> Bools:
    """Which hypotheses (H,) are not far behind what was the best before this tick."""
    return bank.log_weight >= -FAR_NATS


def is_protected(bank: Bank) -> Bools:
    """Which hypotheses (H,) are kept, and may take the geometry of others, however bad."""
    return bank.effective_ticks <= bank.protected_until


def prune(bank: Bank, now: int, best: float, margin: float) -> Bank:
    """Drop what is hopeless against ``best``, and thin out onsets the more the older they are.

    Log weights are against ``best`` from then on.
    """
    joint = bank.log_weight
    keep = (joint > best - margin) | is_protected(bank)
    old = bank.onset.searchsorted(now + 1 - YOUNG)  # they are in order
    if old > 1:
        age = now + 1 - bank.onset[:old]
        span = 2 ** (np.floor(np.log2(age / YOUNG)) + 1).astype(np.int64)
        keep[:old] &= best_of(bank.onset[:old] // span + (span << 40), joint[:old])
    bank = bank.pick(keep.nonzero()[0])
    lives = np.isin(bank.onsets.onset, bank.onset)
    onsets = replace(bank.onsets, words=bank.onsets.words[lives])
    return replace(bank.replace_columns(log_birth_weight=bank.log_birth_weight - best), onsets=onsets)


def residual(bank: Bank) -> float:
    """Whitened residual of the hypothesis that has seen ``RESIDUAL_TICKS`` with motion, or few more; nan
    without one."""
    ticks = np.where(bank.effective_ticks >= RESIDUAL_TICKS, bank.effective_ticks, np.inf)
    return float(bank.rms[ticks.argmin()]) if ticks.min(initial=np.inf) < np.inf else np.nan


def best_of(group: Index, joint: Array) -> Bools:
    """Whether each is the best of its group."""
    order = np.lexsort((-joint, group))
    sorted_group, first, best = group[order], np.ones(len(group), bool), np.zeros(len(group), bool)
    np.not_equal(sorted_group[1:], sorted_group[:-1], out=first[1:])
    best[order[first]] = True
    return best
