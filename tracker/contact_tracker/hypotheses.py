"""How the hypotheses of one contact live: each has its own onset, its own window and its own geometry."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from contact_tracker.bank import add, blank
from contact_tracker.begins import Begins, fresh
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.evidence import Scales, Window
from contact_tracker.following import follow, grow, grow_whole
from contact_tracker.lift import R
from contact_tracker.search import search, searched
from contact_tracker.summed import summed
from contact_tracker.table import Bank

Array = NDArray[np.float64]


def advance(
    banks: Sequence[Bank], windows: Sequence[Window], scales: Scales, log_stay: Array, margin: float
) -> list[Bank]:
    """Take in the newest tick of the windows, one for each contact; ``log_stay`` is the price of not having
    changed in it.

    What is further behind the best than the ``margin`` (nats) waits for another geometry: its moments grow.
    All contacts take one step before any takes the next: what computes it is at hand then.
    """
    hopeless = [bank.joint < -margin for bank in banks]
    living = [
        (grow(bank, contact, window, float(price)), contact, window)
        for bank, contact, window, price in zip(banks, CONTACT_MODELS, windows, log_stay, strict=True)
    ]
    living = [
        (follow(bank, contact, window, scales, far), contact, window)
        for (bank, contact, window), far in zip(living, hopeless, strict=True)
    ]
    return [search(bank, contact, window, scales) for bank, contact, window in living]


def settle(bank: Bank, model: ContactModel, window: Window, scales: Scales, ticks: int) -> Bank:
    """Sum up the oldest ``ticks`` of the window, which is about to lose them."""
    if ticks <= 0 or not (bank.onset <= window.index[ticks - 1]).any():
        return bank
    oldest = window.cut(0, ticks)
    seen = summed(model, bank.x, bank.onset, oldest, scales, bank.certain)
    return bank.having(settled=bank.settled + seen.log_ratio, earned=bank.earned + seen.gain.sum(axis=1))


def fit_stretch(model: ContactModel, window: Window, scales: Scales, begins: Begins | None = None) -> Bank:
    """A bank of one hypothesis, fitted from scratch to all ticks of the window.

    It is the best of ``begins``, if given; the bank is empty if there are none.
    """
    begins = fresh(model) if begins is None else begins
    nothing, turn = blank(model, 0), window.zeta[0, R].reshape(3, 3)
    past = nothing.past[:0].sum(axis=0)
    bank = add(nothing, model, int(window.index[0]), 0, 0, 0.0, past, turn, begins)
    if not len(bank):
        return bank
    bank = follow(grow_whole(bank, model, window), model, window, scales)
    bank = searched(bank, np.flatnonzero(bank.searched), model, window, scales)
    return bank.pick(np.array([bank.log_likelihood.argmax()]))
