"""Updates of the hypothesis banks: by a tick, and by whole windows whose ends are known.

Birth, refit, evidence, search, pruning.
"""

from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Final, NamedTuple, Self

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.geometry.lifted_pose import R
from contact_tracker.hypotheses import compiled
from contact_tracker.hypotheses.bank import Bank, Onsets, blank
from contact_tracker.hypotheses.births import (
    Birth,
    BirthProposals,
    TickInput,
    add,
    join_histories,
    uninformed_proposal,
)
from contact_tracker.hypotheses.evidence import EvidenceParameters, sum_evidence
from contact_tracker.hypotheses.global_search import (
    is_due,
    prune,
    residual,
    search,
    select_for_search,
)
from contact_tracker.hypotheses.refit import (
    accumulate,
    accumulate_window,
    are_near,
    recover_fallen,
    refit,
)
from contact_tracker.hypotheses.schedule import REST_WEIGHT
from contact_tracker.motion.window import Window

_TABLES: Final = attrgetter("words", "onsets.words")
_BIRTHS: Final = attrgetter("rows.words", "is_given")


class LiveHypotheses(NamedTuple):
    """The hypotheses (A,) of all banks after a tick, free motion last."""

    state: Ints
    onset: Ints
    log_likelihood: Array

    @classmethod
    def of(cls, banks: Sequence[Bank], tick: int) -> Self:
        """The hypotheses of ``banks``, and free motion in this tick."""
        return cls(
            np.arange(len(banks) + 1).repeat([*map(len, banks), 1]),
            np.append(Bank.of_all(banks, "onset"), tick),
            np.append(Bank.of_all(banks, "log_likelihood"), 0.0),
        )

    def at_tick(self, tick: int) -> Self:
        """The same hypotheses in this tick, which carries no information."""
        onset = self.onset.copy()
        onset[-1] = tick
        return self._replace(onset=onset)


class TickWeights(NamedTuple):
    """Weights of states and hypotheses after a tick."""

    log_birth_weight: Array
    """(7,) log birth weight of each state."""
    log_state_weight: Array
    """(7,) log weight of each state relative to the best hypothesis; -inf for an empty bank."""
    residual: Array
    """(6,) whitened residual of each contact."""
    best: Ints
    """(6, 3) row, onset tick and onset time (ns) of the best hypothesis in each bank; -1 if it is empty."""
    live_hypotheses: LiveHypotheses


def update_banks(
    banks: Sequence[Bank],
    tick_input: TickInput,
    parameters: Model,
    scales: EvidenceParameters,
) -> tuple[list[Bank], TickWeights]:
    """Update the banks by a tick: add births and data, refit, weigh, search and prune.

    A hypothesis is pruned if it is more than ``margin_nats`` behind the best of all (free motion included)
    right after its contact has searched; before a search it may only have lost its minimum. Hypotheses that
    are far behind (see ``schedule``) accumulate moments and are refitted only when a search is due.

    Parameters
    ----------
    banks : of each contact.
    tick_input : the tick.
    parameters : the model, with the margin and the noise of each contact beyond that of the window.
    scales : parameters of the evidence.
    """
    if not compiled.in_use():
        return update_reference(banks, tick_input, parameters, scales)
    from contact_tracker.hypotheses.compiled import calls, kernels

    updated, window_before = list[Bank](), tick_input.window_before
    # per contact: the words kept, and their rows among the old rows followed by the births
    kept, kept_rows, weights = kernels.update(
        calls.models(scales.reach_m),
        [*map(_TABLES, banks)],
        [*map(_BIRTHS, tick_input.proposals)],
        tick_input.window.zeta[-1, R].reshape(3, 3),
        tick_input.onset,
        tick_input.onset_ns,
        tick_input.number,
        tick_input.log_birth_weight,
        calls.ticks_of(tick_input.window),
        calls.ticks_of(window_before) if window_before.index.size else None,
        tick_input.log_survival,
        parameters.noise.extra_contact_variance,
        calls.weights_of(scales),
        parameters.search.margin_nats,
    )
    for column, (bank, (words, since), rows) in enumerate(zip(banks, kept, kept_rows, strict=True)):
        past = bank.lag_history
        if past.shape[1]:
            past = join_histories(
                past, tick_input.lag_history[column], tick_input.proposals[column].count, rows
            )
        elif len(past) != len(rows):
            past = np.empty((len(rows), *past.shape[1:]))
        updated.append(Bank(words, bank.layout, Onsets(since, bank.onsets.layout), past))
    return updated, TickWeights(*weights[:-1], LiveHypotheses(*weights[-1]))


def update_reference(
    banks: Sequence[Bank],
    tick_input: TickInput,
    parameters: Model,
    scales: EvidenceParameters,
) -> tuple[list[Bank], TickWeights]:
    """``update_banks`` in numpy: the reference of the compiled kernels."""
    window, extra_variance = tick_input.window, parameters.noise.extra_contact_variance
    tick, updated, oldest = tick_input.onset, list[Bank](), tick_input.window_before.expired_by(window)
    for column, (bank, model) in enumerate(zip(banks, CONTACT_MODELS, strict=True)):
        settled = marginalise_expired_ticks(bank, model, oldest.with_error(extra_variance[column]), scales)
        noisier, log_stay = window.with_error(extra_variance[column]), float(tick_input.log_survival[column])
        updated.append(_update_contact(settled, model, tick_input.birth(column), noisier, scales, log_stay))
    free = float(tick_input.log_birth_weight[-1])
    best = max(free, *(bank.best for bank in updated))
    kept = [
        prune(bank, model, tick, best, parameters.search.margin_nats if is_due(model, tick) else np.inf)
        for bank, model in zip(updated, CONTACT_MODELS, strict=True)
    ]
    weights = TickWeights(
        tick_input.log_birth_weight,
        np.array([*(bank.log_total_weight for bank in kept), free - best]),
        np.array([residual(bank) for bank in kept]),
        np.array([bank.leader for bank in kept]),
        LiveHypotheses.of(kept, tick),
    )
    return kept, weights


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
    rows, old_weight = np.flatnonzero(are_near(bank) | due), bank.log_weight
    bank = refit(accumulate(bank, model, window, scales, log_stay), model, window, scales, rows)
    bank = recover_fallen(bank, old_weight, model, window, scales)
    if not due or window.latest_motion_ratio <= REST_WEIGHT:
        return bank
    return search(bank, select_for_search(bank, model), model, window, scales)


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


def fit_window(
    model: ContactModel, window: Window, scales: EvidenceParameters, proposals: BirthProposals | None = None
) -> Bank:
    """A bank of one hypothesis, fitted to all ticks of the window.

    It is the best of the ``proposals``, if given; the bank is empty if there are none.
    """
    begins = uninformed_proposal(model) if proposals is None else proposals
    nothing, turn = blank(model, 0), window.zeta[0, R].reshape(3, 3)
    birth = Birth(begins, int(window.index[0]), 0, 0, 0.0, nothing.lag_history.sum(axis=0), turn)
    bank = add(nothing, model, birth)
    if not len(bank):
        return bank
    bank = accumulate_window(bank, model, window, scales)
    if compiled.in_use() and model in CONTACT_MODELS:
        from contact_tracker.hypotheses.compiled import calls

        words, onsets = calls.fit_window(
            calls.model_of(model, scales.reach_m),
            bank.words,
            bank.onsets.words,
            calls.ticks_of(window),
            window.zeta[-1, R].reshape(3, 3),
            int(window.index[-1]),
            calls.weights_of(scales),
        )
        bank = replace(bank, words=words, onsets=replace(bank.onsets, words=onsets))
    else:
        bank = refit(bank, model, window, scales)
        bank = search(bank, np.flatnonzero(bank.needs_search), model, window, scales)
    return bank.pick(np.array([bank.log_likelihood.argmax()]))
