"""Fit hypotheses to windows whose ends are known."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.hypotheses.bank import Bank, Onsets, blank
from contact_tracker.hypotheses.birth import BirthProposals, uninformed_proposal
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.hypotheses.global_search import directions, search
from contact_tracker.hypotheses.pruning import Birth, add
from contact_tracker.hypotheses.refit import accumulate_window, refit_in_windows
from contact_tracker.motion.lifted_pose import R
from contact_tracker.motion.window import Window

Index = NDArray[np.int64]


def fit_window(
    model: ContactModel, window: Window, scales: EvidenceParameters, proposals: BirthProposals | None = None
) -> Bank:
    """A bank of one hypothesis, fitted to all ticks of the window.

    It is the best of the ``proposals``, if given; the bank is empty if there are none.
    """
    given = uninformed_proposal(model) if proposals is None else proposals
    return fit_windows(model, [window], scales, [given])[0]


def fit_windows(
    model: ContactModel,
    windows: Sequence[Window],
    scales: EvidenceParameters,
    proposals: Sequence[BirthProposals],
) -> list[Bank]:
    """``fit_window`` for many windows in one batch.

    Parameters
    ----------
    windows : in order of time; no two begin with the same tick.
    proposals : birth proposals of each window.
    """
    births = [_begun(model, *one, scales) for one in zip(windows, proposals, strict=True)]
    of = np.arange(len(windows)).repeat([len(bank) for bank in births])
    bank = refit_in_windows(_joined(births), of, model, windows, scales)
    rows = np.flatnonzero(bank.needs_search)
    turns = np.array([window.zeta[-1, R].reshape(3, 3) for window in windows]).reshape(-1, 3, 3)
    drawn = np.array([model.turned(directions(model, windows[i].index[-1]), turns[i]) for i in of[rows]])
    bank = search(
        bank,
        rows,
        model,
        scales,
        drawn,
        lambda some, row: refit_in_windows(some, of[row], model, windows, scales),
    )
    own = [np.flatnonzero(of == i) for i in range(len(windows))]
    return [
        bank.pick(rows[[bank.log_likelihood[rows].argmax()]]) if len(rows) else nothing
        for rows, nothing in zip(own, births, strict=True)
    ]


def _begun(
    model: ContactModel, window: Window, proposals: BirthProposals, scales: EvidenceParameters
) -> Bank:
    """A bank of all proposals, with the ticks of the window accumulated."""
    nothing, turn = blank(model, 0), window.zeta[0, R].reshape(3, 3)
    birth = Birth(proposals, int(window.index[0]), 0, 0, 0.0, nothing.lag_history.sum(axis=0), turn)
    bank = add(nothing, model, birth)
    return accumulate_window(bank, model, window, scales) if len(bank) else bank


def _joined(banks: Sequence[Bank]) -> Bank:
    """One bank from those of all windows."""
    onsets = np.concatenate([bank.onsets.words for bank in banks])
    return Bank(
        np.concatenate([bank.words for bank in banks]),
        banks[0].layout,
        Onsets(onsets, banks[0].onsets.layout),
        np.concatenate([bank.lag_history for bank in banks]),
    )
