"""How the hypotheses of all contacts live: each has its own onset, its own window and its own geometry."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker import compiled
from contact_tracker.bank import Birth, add, assuming, blank, joined, prune, residual
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


class Living(NamedTuple):
    """What lives on after a tick: a bank of each contact, its ``log_weight``, -inf of an empty one, and its
    ``residual``; and the ``best`` log weight, against which all are."""

    banks: list[Bank]
    log_weight: list[float]
    residual: list[float]
    best: float


def advance(
    banks: Sequence[Bank],
    births: Sequence[Birth],
    windows: Sequence[Window],
    scales: Scales,
    log_stay: Array,
    margin: float,
    rival: float,
) -> Living:
    """Take in the newest tick of the windows, one for each contact, and what begins with it, and drop what is
    hopeless beside the best of all or the ``rival``; ``log_stay`` (6,) is the price of not having changed.

    What is further behind the best than the ``margin`` (nats) waits for another geometry, and what is behind
    at all may wait for some ticks: its moments grow.
    """
    now = births[0].onset
    if compiled.in_use():
        from contact_tracker.compiled import calls

        born = [assuming(model, birth.begins) for model, birth in zip(CONTACT_MODELS, births, strict=True)]
        drawn = [directions(model, now) if is_due(model, now) else None for model in CONTACT_MODELS]
        words = [bank.words for bank in banks]
        left, best = calls.advance(words, births, born, windows, scales, log_stay, margin, drawn, rival)
        kept = [
            Bank(rows, bank.layout, joined(bank, birth, which))
            for bank, birth, (which, rows, _, _) in zip(banks, births, left, strict=True)
        ]
        return Living(kept, [row[2] for row in left], [row[3] for row in left], best)
    grown = [
        _advanced(bank, model, birth, window, scales, float(price), margin)
        for bank, model, birth, window, price in zip(
            banks, CONTACT_MODELS, births, windows, log_stay, strict=True
        )
    ]
    best = max(rival, *(bank.best for bank in grown))
    kept = [prune(b, model, now, best, margin) for b, model in zip(grown, CONTACT_MODELS, strict=True)]
    return Living(kept, [bank.log_weight for bank in kept], [residual(bank) for bank in kept], best)


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
    due, old = is_due(model, birth.onset), len(bank)
    bank = add(bank, model, birth)
    waits = not due and bank.told >= FIRST_TICKS
    idle = bank.joint < -np.where(waits, min(margin, FAR_NATS), margin)
    # what assumes met elements begins with them: one tick, which is given, changes no weight
    idle |= bank.met & (np.arange(len(bank)) >= old)
    bank = follow(grow(bank, model, window, log_stay), model, window, scales, idle)
    if due:
        bank = adopted(bank, model, window, scales)
        if window.latest_activity > AT_REST:
            bank = searched(bank, lost(bank, model), model, window, scales)
    return bank


def settle(bank: Bank, model: ContactModel, oldest: Window, scales: Scales) -> Bank:
    """Sum up the ``oldest`` ticks, which the window is about to lose."""
    if not len(bank) or bank.onset[0] > oldest.index[-1]:  # they are in order
        return bank
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
