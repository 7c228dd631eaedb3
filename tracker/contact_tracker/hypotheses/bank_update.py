"""How the hypotheses of all contacts live: each has its onset, a window since then and its own geometry."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.hypotheses import compiled
from contact_tracker.hypotheses.bank import Bank, Onsets
from contact_tracker.hypotheses.evidence import EvidenceParameters, sum_evidence
from contact_tracker.hypotheses.global_search import (
    directions,
    exchange_geometry,
    is_due,
    search,
    select_for_search,
)
from contact_tracker.hypotheses.pruning import Birth, Births, add, joined, prune, residual
from contact_tracker.hypotheses.refit import accumulate, is_deferred, recover_fallen, refit
from contact_tracker.hypotheses.schedule import AT_REST
from contact_tracker.hypotheses.tick_update import (
    BankUpdate,
    LiveHypotheses,
    StopCondition,
    TickInput,
    TickWeights,
)
from contact_tracker.motion.lifted_pose import R
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]

MOST: Final = 12
"""So many ticks at most are taken in at once: what is worked out for those after one that teaches something
is lost."""


def ticks_at_once(banks: Sequence[Bank]) -> int:
    """So many ticks ``update`` may take in one call: one, where numpy does the work, or answers lag."""
    return MOST if compiled.in_use() and not banks[0].lag_history.shape[1] else 1


def update(
    banks: Sequence[Bank],
    moments: Sequence[TickInput],
    beyond: Sequence[tuple[float, float]],
    scales: EvidenceParameters,
    margin: float,
    until: StopCondition | None = None,
) -> BankUpdate:
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
        return update_reference(banks, moments[0], beyond, scales, margin)
    from contact_tracker.hypotheses.compiled import calls

    first, words = moments[0].births, [(bank.words, bank.onsets.words) for bank in banks]
    inputs = [calls.tick_input(moment, *_begun(moment.births)) for moment in moments]
    kept = calls.update(words, inputs, first.number, first.log_birth_weight, beyond, scales, margin, until)
    last = moments[len(kept.weighed) - 1].births
    pasts = [
        joined(bank.lag_history, past, begins.count, rows)
        for bank, begins, past, rows in zip(
            banks, last.proposals, last.lag_history[:-1], kept.rows, strict=True
        )
    ]
    left = [
        Bank(words, bank.layout, Onsets(since, bank.onsets.layout), past)
        for bank, past, (words, since) in zip(banks, pasts, kept.words, strict=True)
    ]
    return BankUpdate(
        left, [TickWeights(*weights[:-1], LiveHypotheses(*weights[-1])) for weights in kept.weighed]
    )


def update_reference(
    banks: Sequence[Bank],
    moment: TickInput,
    beyond: Sequence[tuple[float, float]],
    scales: EvidenceParameters,
    margin: float,
) -> BankUpdate:
    """``update`` by one tick, in numpy."""
    births, _, window, before, _, log_stay = moment
    now = births.onset
    updated, oldest = [], before.expired_by(window)
    for column, (bank, model) in enumerate(zip(banks, CONTACT_MODELS, strict=True)):
        settled = marginalise_expired_ticks(bank, model, oldest.with_error(beyond[column]), scales)
        own, survival = window.with_error(beyond[column]), float(log_stay[column])
        updated.append(_update_contact(settled, model, births.of(column), own, scales, survival))
    free = float(births.log_birth_weight[-1])
    best = max(free, *(bank.best for bank in updated))
    kept = [
        prune(bank, now, best, margin if is_due(model, now) else np.inf)
        for bank, model in zip(updated, CONTACT_MODELS, strict=True)
    ]
    weighed = TickWeights(
        births.log_birth_weight,
        np.array([*(bank.log_total_weight for bank in kept), free - best]),
        np.array([residual(bank) for bank in kept]),
        np.array([bank.best_row for bank in kept]),
        LiveHypotheses.of(kept, now),
    )
    return BankUpdate(kept, [weighed])


def _begun(births: Births) -> tuple[list[tuple[Array, Bools]], list[Array | None]]:
    """What is assumed of each contact by what begins, and random directions where it searches."""
    assumed = [(begins.rows.words, begins.is_given) for begins in births.proposals]
    now = births.onset
    return assumed, [directions(model, now) if is_due(model, now) else None for model in CONTACT_MODELS]


def _update_contact(
    bank: Bank,
    model: ContactModel,
    birth: Birth,
    window: Window,
    scales: EvidenceParameters,
    log_stay: float,
) -> Bank:
    if not len(bank) and not birth.proposals.count:
        return bank
    due, old = is_due(model, birth.onset), len(bank)
    bank = add(bank, model, birth)
    # what assumes met elements begins with them: one tick, which is given, changes no weight
    unchanged = is_deferred(bank) & (not due) | bank.from_landmark & (np.arange(len(bank)) >= old)
    was = bank.log_weight
    bank = refit(accumulate(bank, model, window, scales, log_stay), model, window, scales, unchanged)
    bank = recover_fallen(bank, was, model, window, scales)
    if due:
        bank = exchange_geometry(bank, model, window, scales)
        if window.latest_motion_ratio > AT_REST:
            drawn = model.turned(directions(model, window.index[-1]), window.zeta[-1, R].reshape(3, 3))
            rows = select_for_search(bank, model)
            bank = search(
                bank, rows, model, scales, drawn, lambda some, _: refit(some, model, window, scales)
            )
    return bank


def marginalise_expired_ticks(
    bank: Bank, model: ContactModel, oldest: Window, scales: EvidenceParameters
) -> Bank:
    """Sum up the ``oldest`` ticks, which the window has lost."""
    if not len(bank) or not len(oldest) or bank.onset[0] > oldest.index[-1]:  # they are in order
        return bank
    inputs = sum_evidence(model, bank.x, bank.onset, oldest, scales, bank.elements_known)
    return bank.replace_columns(
        llr_before_window=bank.llr_before_window + inputs.log_ratio,
        gain_before_window=bank.gain_before_window + inputs.gain.sum(axis=1),
    )
