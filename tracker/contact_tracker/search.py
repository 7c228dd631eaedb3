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


def search(bank: Bank, model: ContactModel, window: Window, scales: Scales) -> Bank:
    """Let hypotheses take the geometry of others where that is better, and some search from scratch."""
    if (window.index[-1] + model.contact.column) % EVERY:
        return bank
    known = before(bank, model, scales)
    costs = fit.every_cost(model.family, bank.moments, bank.row_weight, known.prior, bank.x)
    best, own = np.argmin(costs, axis=0), np.arange(len(bank))
    better = np.flatnonzero(costs[best, own] < costs[own, own] - LEAST_GAIN)
    if len(better):
        adopted = bank.pick(better).having(x=bank.x[best[better]])
        bank = bank.putting(better, follow(adopted, model, window, scales))
    return searched(bank, _lost(bank), model, window, scales) if window.activity[-1] > AT_REST else bank


def searched(bank: Bank, rows: Index, model: ContactModel, window: Window, scales: Scales) -> Bank:
    """Let ``rows`` search from scratch, and keep what is better."""
    if not len(rows):
        return bank
    held = bank.pick(rows)
    found = _from_scratch(held, model, window, scales)
    better = np.flatnonzero(found.log_likelihood > held.log_likelihood)
    return bank.putting(rows[better], found.pick(better))


def _lost(bank: Bank) -> Index:
    """Rows that search: of each age one that assumes nothing and one of those that do, the best.

    What they find is offered to those that began beside them.
    """
    age = np.minimum(bank.told.astype(np.int64), len(_DUE) - 1)
    rows = np.flatnonzero(_DUE[age] & (bank.rms > AT_THE_NOISE) & bank.searched)
    kind = 2 * np.searchsorted(AGES, bank.told[rows], side="right") + (bank.source[rows] > 0)
    best = np.lexsort((-bank.joint[rows], kind))
    return np.sort(rows[best[np.unique(kind[best], return_index=True)[1]]])


def _from_scratch(bank: Bank, model: ContactModel, window: Window, scales: Scales) -> Bank:
    """The best that each hypothesis finds without regard to where it is."""
    known = before(bank, model, scales)
    starts = _starts(bank, model, known, window)
    told = Given(bank.known_mean, bank.known).told[:, None]
    x = np.where(told, bank.known_mean[:, None], starts)
    row = np.arange(len(bank))[:, None]
    x = model.family.normalise(x, known.anchors[:, None])
    for steps, kept in ROUNDS:
        of = np.repeat(row, x.shape[1])
        flat = x.reshape(-1, x.shape[-1])
        found = fit.minimise(model.family, bank.moments, bank.row_weight, *known, flat, steps, of=of)
        best = np.argsort(found.cost.reshape(len(bank), -1), axis=1)[:, :kept]
        x = found.x.reshape(x.shape)[row, best]
    some = bank.pick(np.repeat(row, x.shape[1])).having(x=x.reshape(-1, x.shape[-1]))
    for _ in range(2):  # the weights of the rows follow the geometry
        some = follow(some, model, window, scales)
    best = np.argmax(some.log_likelihood.reshape(len(bank), -1), axis=1)
    return some.pick(row[:, 0] * x.shape[1] + best)


def _starts(bank: Bank, model: ContactModel, known: Before, window: Window) -> Array:
    """Starts (H, N, S): solutions of the relaxed problem, and the best of many random directions."""
    family, (prior, anchors) = model.family, known
    size = bank.moments.shape[-1]
    trace = np.trace(bank.moments, axis1=1, axis2=2)[:, None, None]
    relaxed = family.starts(bank.moments + 1e-12 * trace * np.eye(size))
    x = _directions(model, window, int(window.index[-1]))
    of = np.repeat(np.arange(len(bank)), len(x))
    x = family.normalise(np.tile(x, (len(bank), 1)), anchors[of])
    x, cost = fit.complete(family, bank.moments, bank.row_weight, prior, anchors, x, of)
    best = np.argsort(cost.reshape(len(bank), -1), axis=1)[:, :SCREENED]
    screened = np.take_along_axis(x.reshape(len(bank), -1, family.SIZE), best[..., None], axis=1)
    return np.concatenate([relaxed, screened], axis=1)


def _directions(model: ContactModel, window: Window, seed: int) -> Array:
    """Random x (N, S), drawn in the body's frame: they turn with the world in which they are told."""
    x = np.random.default_rng(seed).normal(size=(model.family.RANDOM_STARTS, model.family.SIZE))
    return model.turned(x, window.zeta[-1, R].reshape(3, 3))
