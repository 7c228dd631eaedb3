"""How hypotheses find their minimum from afar: where others are, or from many random starts."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker import fit
from contact_tracker.bank import Bank
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.given import Given
from contact_tracker.evidence import Scales, Window
from contact_tracker.following import AT_REST, Before, before, follow
from contact_tracker.lift import R

Array = NDArray[np.float64]
Index = NDArray[np.int64]

AGES: Final = (3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 30, 36, 44, 54, 66, 80, 100)
"""After so many ticks with motion a hypothesis searches: what fitted the first of them need not fit more."""
EVERY: Final = 3
"""Searches wait for each other, so that one batch of this many ticks does for all."""
_DUE: Final = np.any([np.isin(np.arange(AGES[-1] + EVERY + 1) - i, AGES) for i in range(EVERY)], axis=0)
"""Whether an age has been passed since the last batch."""
SCREENED: Final = 4
ROUNDS: Final = ((3, 5), (4, 3), (5, 2))
"""So many steps from all starts, and on from so many of the best."""
AT_THE_NOISE: Final = 1.2
"""A whitened residual below which there is no better minimum to search for."""
LEAST_GAIN: Final = 1e-3
"""Nats by which another geometry must be better to be taken."""
_NONE: Final = np.zeros(0, np.int64)
_ANYWHERE: Final = np.zeros(6)


def search(bank: Bank, model: ContactModel, window: Window, scales: Scales) -> Bank:
    """Let hypotheses take the geometry of others where that is better, and some search from scratch."""
    if (window.index[-1] + model.contact.column) % EVERY:
        return bank
    known = before(bank, model, scales)
    costs = fit.every_cost(model.family, bank.moments, bank.row_weight, known.prior, bank.x)
    best = costs.argmin(axis=0)
    better = np.flatnonzero(costs.min(axis=0) < costs.diagonal() - LEAST_GAIN)
    if len(better):
        adopted = bank.pick(better).having(x=bank.x[best[better]])
        adopted = follow(adopted, model, window, scales)
        bank = bank.putting(better, adopted, np.arange(len(better)))
    rows = _lost(bank) if window.activity[-1] > AT_REST else _NONE
    return _searched(bank, rows, model, window, scales, known)


def searched(bank: Bank, model: ContactModel, window: Window, scales: Scales) -> Bank:
    """Let all that have directions to search for do so from scratch, and keep what is better."""
    rows = np.flatnonzero(bank.searched)
    return _searched(bank, rows, model, window, scales, before(bank, model, scales))


def _searched(
    bank: Bank, rows: Index, model: ContactModel, window: Window, scales: Scales, known: Before
) -> Bank:
    """Let ``rows`` search from scratch, and keep what is better."""
    if not len(rows):
        return bank
    found = _from_scratch(bank, rows, model, window, scales, known)
    told = found.log_likelihood.reshape(len(rows), -1)
    best = told.argmax(axis=1)
    better = np.flatnonzero(told.max(axis=1) > bank.log_likelihood[rows])
    return bank.putting(rows[better], found, (np.arange(len(rows)) * told.shape[1] + best)[better])


def _lost(bank: Bank) -> Index:
    """Rows that search: of each age one that assumes nothing and one of those that do, the best.

    What they find is offered to those that began beside them.
    """
    age = np.minimum(bank.told.astype(np.int64), len(_DUE) - 1)
    rows = np.flatnonzero(_DUE[age] & (bank.rms > AT_THE_NOISE) & bank.searched)
    kind = 2 * np.searchsorted(AGES, bank.told[rows], side="right") + (bank.source[rows] > 0)
    best = np.lexsort((-bank.joint[rows], kind))
    return np.sort(rows[best[np.unique(kind[best], return_index=True)[1]]])


def _from_scratch(
    bank: Bank, rows: Index, model: ContactModel, window: Window, scales: Scales, known: Before
) -> Bank:
    """What ``rows`` find without regard to where they are: the same number of hypotheses for each."""
    family, windows = model.family, (bank.moments, bank.row_weight, *known)
    x = _starts(bank, rows, model, known, window)
    mean = bank.known_mean[rows]
    x = np.where(Given(mean, bank.known[rows]).told(model)[:, None], mean[:, None], x)
    x = family.normalise(x, known.anchors[rows, None])
    row = np.arange(len(rows))[:, None]
    for steps, kept in ROUNDS:
        of = rows.repeat(x.shape[1])
        found = fit.minimise(family, *windows, x.reshape(len(of), -1), steps, of=of)
        best = found.cost.reshape(len(rows), -1).argsort(axis=1)[:, :kept]
        x = found.x.reshape(x.shape)[row, best]
    some = bank.pick(rows.repeat(x.shape[1])).having(x=x.reshape(-1, x.shape[-1]))
    for _ in range(2):  # the weights of the rows follow the geometry
        some = follow(some, model, window, scales)
    return some


def _starts(bank: Bank, rows: Index, model: ContactModel, known: Before, window: Window) -> Array:
    """Starts (R, N, S): solutions of the relaxed problem, and the best of many random directions."""
    family, moments, (prior, anchors) = model.family, bank.moments[rows], known
    trace = moments.trace(axis1=1, axis2=2)[:, None, None]
    relaxed = family.starts(moments + 1e-12 * trace * np.eye(moments.shape[-1]))
    x = family.normalise(_directions(model, window, int(window.index[-1])), _ANYWHERE)
    of, x = rows.repeat(len(x)), np.concatenate([x] * len(rows))
    x, cost = fit.complete(family, bank.moments, bank.row_weight, prior, anchors, x, of)
    best = cost.reshape(len(rows), -1).argsort(axis=1)[:, :SCREENED]
    screened = x.reshape(len(rows), -1, family.SIZE)[np.arange(len(rows))[:, None], best]
    return np.concatenate([relaxed, screened], axis=1)


def _directions(model: ContactModel, window: Window, seed: int) -> Array:
    """Random x (N, S), drawn in the body's frame: they turn with the world in which they are told."""
    x = np.random.default_rng(seed).normal(size=(model.family.RANDOM_STARTS, model.family.SIZE))
    return model.turned(x, window.zeta[-1, R].reshape(3, 3))
