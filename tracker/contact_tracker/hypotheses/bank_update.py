"""The update of the hypothesis banks of all contacts by a tick: birth, refit, evidence, search, pruning."""

from collections.abc import Sequence

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
from contact_tracker.hypotheses.pruning import Birth, add, joined, prune, residual
from contact_tracker.hypotheses.refit import accumulate, is_deferred, recover_fallen, refit
from contact_tracker.hypotheses.schedule import REST_WEIGHT
from contact_tracker.hypotheses.tick_update import (
    LiveHypotheses,
    TickInput,
    TickWeights,
)
from contact_tracker.motion.lifted_pose import R
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]


def update(
    banks: Sequence[Bank],
    tick_input: TickInput,
    extra_variance: Sequence[tuple[float, float]],
    scales: EvidenceParameters,
    margin: float,
) -> tuple[list[Bank], TickWeights]:
    """Update the banks by a tick: add births and data, refit, weigh, search and prune.

    A hypothesis is pruned if it is more than ``margin`` nats behind the best of all (free motion included)
    right after its contact has searched; before a search it may only have lost its minimum. Hypotheses that
    are far behind (see ``schedule``) accumulate moments and are refitted only when a search is due.

    Parameters
    ----------
    banks : of each contact.
    tick_input : the tick.
    extra_variance : of each contact, noise variance (m^2, rad^2) beyond that of the window.
    scales : parameters of the evidence.
    margin : nats, see above.
    """
    if not compiled.in_use():
        return update_reference(banks, tick_input, extra_variance, scales, margin)
    from contact_tracker.hypotheses.compiled import calls

    births, left = tick_input.births, list[Bank]()
    kept = calls.update(banks, tick_input, extra_variance, scales, margin)
    for column, (bank, (words, since), rows) in enumerate(zip(banks, kept.words, kept.rows, strict=True)):
        past = bank.lag_history
        if past.shape[1]:
            past = joined(past, births.lag_history[column], births.proposals[column].count, rows)
        elif len(past) != len(rows):
            past = np.empty((len(rows), *past.shape[1:]))
        left.append(Bank(words, bank.layout, Onsets(since, bank.onsets.layout), past))
    return left, TickWeights(*kept.weighed[:-1], LiveHypotheses(*kept.weighed[-1]))


def update_reference(
    banks: Sequence[Bank],
    tick_input: TickInput,
    extra_variance: Sequence[tuple[float, float]],
    scales: EvidenceParameters,
    margin: float,
) -> tuple[list[Bank], TickWeights]:
    """``update`` in numpy: the reference of the compiled kernels."""
    births, window, before, log_stay = tick_input
    now = births.onset
    updated, oldest = [], before.expired_by(window)
    for column, (bank, model) in enumerate(zip(banks, CONTACT_MODELS, strict=True)):
        settled = marginalise_expired_ticks(bank, model, oldest.with_error(extra_variance[column]), scales)
        own, survival = window.with_error(extra_variance[column]), float(log_stay[column])
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
    return kept, weighed


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
    due = is_due(model, birth.onset)
    bank = add(bank, model, birth)
    unchanged = is_deferred(bank) & (not due)
    was = bank.log_weight
    bank = refit(accumulate(bank, model, window, scales, log_stay), model, window, scales, unchanged)
    bank = recover_fallen(bank, was, model, window, scales)
    if due:
        bank = exchange_geometry(bank, model, window, scales)
        if window.latest_motion_ratio > REST_WEIGHT:
            drawn = model.turned(directions(model, window.index[-1]), window.zeta[-1, R].reshape(3, 3))
            rows = select_for_search(bank, model)
            bank = search(
                bank, rows, model, scales, drawn, lambda some, _: refit(some, model, window, scales)
            )
    return bank


def marginalise_expired_ticks(
    bank: Bank, model: ContactModel, oldest: Window, scales: EvidenceParameters
) -> Bank:
    """Add the evidence of the ``oldest`` ticks, which the window has lost, to the sums before the window."""
    if not len(bank) or not len(oldest) or bank.onset[0] > oldest.index[-1]:  # they are in order
        return bank
    sums = sum_evidence(model, bank.x, bank.onset, oldest, scales, bank.elements_known)
    return bank.replace_columns(
        llr_before_window=bank.llr_before_window + sums.log_ratio,
        gain_before_window=bank.gain_before_window + sums.gain.sum(axis=1),
    )
