"""How the hypotheses of one contact live: each has its own onset, its own window and its own geometry."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from contact_tracker import compiled
from contact_tracker.bank import Birth, add, assuming, blank, joined
from contact_tracker.begins import Begins, fresh
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.evidence import Scales, Window
from contact_tracker.following import follow, grow, grow_whole
from contact_tracker.lift import R
from contact_tracker.pace import AT_REST, FAR_NATS, FIRST_TICKS
from contact_tracker.search import adopted, directions, is_due, lost, searched
from contact_tracker.summed import summed
from contact_tracker.table import Bank

Array = NDArray[np.float64]


def advance(
    banks: Sequence[Bank],
    births: Sequence[Birth],
    windows: Sequence[Window],
    scales: Scales,
    log_stay: Array,
    margin: float,
) -> list[Bank]:
    """Take in the newest tick of the windows, one for each contact, and what begins with it; ``log_stay`` is
    the price of not having changed in it.

    What is further behind the best than the ``margin`` (nats) waits for another geometry, and what is behind
    at all may wait for some ticks: its moments grow.
    """
    return [
        _advanced(bank, contact, birth, window, scales, float(price), margin)
        for bank, contact, birth, window, price in zip(
            banks, CONTACT_MODELS, births, windows, log_stay, strict=True
        )
    ]


def _advanced(
    bank: Bank,
    model: ContactModel,
    birth: Birth,
    window: Window,
    scales: Scales,
    log_stay: float,
    margin: float,
) -> Bank:
    if not len(bank) and not birth.begins.many:
        return bank
    due = is_due(model, window)
    if compiled.in_use():
        from contact_tracker.compiled import calls

        born, drawn = assuming(model, birth.begins), directions(model, window) if due else None
        words = calls.advance(model, bank.words, birth, born, window, scales, log_stay, margin, drawn)
        return Bank(words, bank.layout, joined(bank, birth))
    bank = add(bank, model, birth)
    waits = not due and bank.told >= FIRST_TICKS
    far = bank.joint < -np.where(waits, min(margin, FAR_NATS), margin)
    bank = follow(grow(bank, model, window, log_stay), model, window, scales, far)
    if due:
        bank = adopted(bank, model, window, scales)
        if window.activity[-1] > AT_REST:
            bank = searched(bank, lost(bank, model), model, window, scales)
    return bank


def settle(bank: Bank, model: ContactModel, window: Window, scales: Scales, ticks: int) -> Bank:
    """Sum up the oldest ``ticks`` of the window, which is about to lose them."""
    if not (bank.onset <= window.index[ticks - 1]).any():
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
    birth = Birth(begins, int(window.index[0]), 0, 0, 0.0, nothing.past.sum(axis=0), turn)
    bank = add(nothing, model, birth)
    if not len(bank):
        return bank
    bank = follow(grow_whole(bank, model, window), model, window, scales)
    bank = searched(bank, np.flatnonzero(bank.searched), model, window, scales)
    return bank.pick(np.array([bank.log_likelihood.argmax()]))
