"""How the hypotheses of all contacts live: each has its onset, a window since then and its own geometry."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.hypotheses import compiled
from contact_tracker.hypotheses.bank import Bank, Onsets, blank
from contact_tracker.hypotheses.birth import Begins, fresh
from contact_tracker.hypotheses.evidence import Scales
from contact_tracker.hypotheses.evidence_sums import summed
from contact_tracker.hypotheses.global_search import adopted, directions, is_due, lost, searched
from contact_tracker.hypotheses.pruning import Birth, Births, add, joined, prune, residual
from contact_tracker.hypotheses.refit import caught, follow, grow, grow_whole, waits
from contact_tracker.hypotheses.schedule import AT_REST
from contact_tracker.motion.lifted_pose import R
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]

MOST: Final = 12
"""So many ticks at most are taken in at once: what is worked out for those after one that teaches something
is lost."""


class Alive(NamedTuple):
    """The hypotheses (A,) that are alive after a tick, free motion last."""

    state: Index
    onset: Index
    log_likelihood: Array

    @classmethod
    def of(cls, banks: Sequence[Bank], now: int) -> Self:
        """Those of all banks, and free motion in the tick ``now``."""
        return cls(
            np.arange(len(banks) + 1).repeat([*map(len, banks), 1]),
            np.append(Bank.of_all(banks, "onset"), now),
            np.append(Bank.of_all(banks, "log_likelihood"), 0.0),
        )


class Moment(NamedTuple):
    """A tick as hypotheses meet it: what begins, and when the tick ends; the window with it, and that
    ``before``; the log chances of a ``change`` (7, 7) at its beginning, and the price ``log_stay`` (7,) of
    not having changed."""

    births: Births
    stamp_ns: int
    window: Window
    before: Window
    change: Array
    log_stay: Array


class Weighed(NamedTuple):
    """What a tick has made of the hypotheses: the ``entry`` (7,) with which states began, the ``log_left``
    weight (7,) of each against the best hypothesis, -inf of an empty one; the ``residual`` (6,) of each
    contact, and which hypothesis ``leaders`` (6,) are, -1 of an empty bank; all that is ``alive``."""

    entry: Array
    log_left: Array
    residual: Array
    leaders: Index
    alive: Alive


class Until(NamedTuple):
    """When ticks are to be looked at: one contact has this posterior ``probability``, where weights count by
    their power ``sureness``, and its onset is none of those that are due later (``due_ns``)."""

    probability: float
    sureness: float
    due_ns: Mapping[int, int]


class Living(NamedTuple):
    """What lives on: a bank of each contact, and what each tick has ``weighed``."""

    banks: list[Bank]
    weighed: list[Weighed]


def ticks_at_once(banks: Sequence[Bank]) -> int:
    """So many ticks ``update`` may take in one call: one, where numpy does the work, or answers lag."""
    return MOST if compiled.in_use() and not banks[0].past.shape[1] else 1


def update(
    banks: Sequence[Bank],
    moments: Sequence[Moment],
    beyond: Sequence[tuple[float, float]],
    scales: Scales,
    margin: float,
    until: Until | None = None,
) -> Living:
    """Take in the newest tick of a window and what begins with it, and drop what is hopeless beside the best
    of all, free motion included; then the next ``moments``, as long as there is nothing to look at.

    Hopeless is what is further behind the best than the ``margin`` (nats) when its contact has just searched:
    before that it may only have lost its minimum. What is far behind (see ``schedule``) may wait for that,
    while its moments grow. What the window ``before`` had more is summed up. Noise of each contact is
    ``beyond`` (m^2, rad^2) that of the windows.

    With the first tick, states begin by its entry; with the others by what was weighed before, whatever their
    births say. Where ``ticks_at_once`` is one, there is one.
    """
    assert len(moments) == 1 or ticks_at_once(banks) > 1
    if not compiled.in_use():
        return reference(banks, moments[0], beyond, scales, margin)
    from contact_tracker.hypotheses.compiled import calls

    first, words = moments[0].births, [(bank.words, bank.onsets.words) for bank in banks]
    seen = [calls.moment(moment, *_begun(moment.births)) for moment in moments]
    kept = calls.stride(words, seen, first.number, first.entry, beyond, scales, margin, until)
    last = moments[len(kept.weighed) - 1].births
    pasts = [
        joined(bank.past, past, begins.many, rows)
        for bank, begins, past, rows in zip(banks, last.begins, last.past[:-1], kept.rows, strict=True)
    ]
    left = [
        Bank(words, bank.layout, Onsets(since, bank.onsets.layout), past)
        for bank, past, (words, since) in zip(banks, pasts, kept.words, strict=True)
    ]
    return Living(left, [Weighed(*told[:-1], Alive(*told[-1])) for told in kept.weighed])


def reference(
    banks: Sequence[Bank],
    moment: Moment,
    beyond: Sequence[tuple[float, float]],
    scales: Scales,
    margin: float,
) -> Living:
    """``update`` by one tick, in numpy."""
    births, _, window, before, _, log_stay = moment
    now = births.onset
    grown, oldest = [], before.lost_by(window)
    for column, (bank, model) in enumerate(zip(banks, CONTACT_MODELS, strict=True)):
        settled = settle(bank, model, oldest.with_error(beyond[column]), scales)
        own, price = window.with_error(beyond[column]), float(log_stay[column])
        grown.append(_advanced(settled, model, births.of(column), own, scales, price))
    free = float(births.entry[-1])
    best = max(free, *(bank.best for bank in grown))
    kept = [
        prune(bank, now, best, margin if is_due(model, now) else np.inf)
        for bank, model in zip(grown, CONTACT_MODELS, strict=True)
    ]
    weighed = Weighed(
        births.entry,
        np.array([*(bank.log_weight for bank in kept), free - best]),
        np.array([residual(bank) for bank in kept]),
        np.array([bank.leader for bank in kept]),
        Alive.of(kept, now),
    )
    return Living(kept, [weighed])


def _begun(births: Births) -> tuple[list[tuple[Array, Bools]], list[Array | None]]:
    """What is assumed of each contact by what begins, and random directions where it searches."""
    assumed = [(begins.rows.words, begins.told) for begins in births.begins]
    now = births.onset
    return assumed, [directions(model, now) if is_due(model, now) else None for model in CONTACT_MODELS]


def _advanced(
    bank: Bank,
    model: ContactModel,
    birth: Birth,
    window: Window,
    scales: Scales,
    log_stay: float,
) -> Bank:
    if not len(bank) and not birth.begins.many:
        return bank
    due, old = is_due(model, birth.onset), len(bank)
    bank = add(bank, model, birth)
    # what assumes met elements begins with them: one tick, which is given, changes no weight
    idle = waits(bank) & (not due) | bank.met & (np.arange(len(bank)) >= old)
    was = bank.joint
    bank = follow(grow(bank, model, window, log_stay), model, window, scales, idle)
    bank = caught(bank, was, model, window, scales)
    if due:
        bank = adopted(bank, model, window, scales)
        if window.latest_activity > AT_REST:
            bank = searched(bank, lost(bank, model), model, window, scales)
    return bank


def settle(bank: Bank, model: ContactModel, oldest: Window, scales: Scales) -> Bank:
    """Sum up the ``oldest`` ticks, which the window has lost."""
    if not len(bank) or not len(oldest) or bank.onset[0] > oldest.index[-1]:  # they are in order
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
