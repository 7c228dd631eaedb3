"""How hypotheses find their minimum from afar: where others are, or from many random starts."""

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker import compiled, fit
from contact_tracker.bank import best_of
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.given import Given
from contact_tracker.evidence import Scales, Window
from contact_tracker.following import AT_REST, before, follow
from contact_tracker.lift import R
from contact_tracker.table import Bank

Array = NDArray[np.float64]
Index = NDArray[np.int64]

AGES: Final = (3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 30, 36, 44, 54, 66, 80, 100)
"""After so many ticks with motion a hypothesis searches: what fitted the first of them need not fit more."""
EVERY: Final = 3
"""Searches wait for each other, so that one batch of this many ticks does for all."""
_AGES: Final = np.array(AGES, float)
_DUE: Final = np.any([np.isin(np.arange(AGES[-1] + EVERY + 1) - i, AGES) for i in range(EVERY)], axis=0)
"""Whether an age has been passed since the last batch."""
DRAWS: Final = 64
"""So many sets of random directions take turns."""
SCREENED: Final = 7
"""So many of all starts are followed at all, those that cost least before a step is taken."""
ROUNDS: Final = ((2, 5), (2, 3), (3, 2))
"""So many steps, and on from so many of the best."""
AT_THE_NOISE: Final = 1.2
"""A whitened residual below which there is no better minimum to search for."""
LEAST_GAIN: Final = 1e-3
"""Nats by which another geometry must be better to be taken."""


def search(bank: Bank, model: ContactModel, window: Window, scales: Scales) -> Bank:
    """Let hypotheses take the geometry of others where that is better, and some search from scratch."""
    if not len(bank) or (window.index[-1] + model.contact.column) % EVERY:
        return bank
    taker, giver = _offered(bank, model, scales)
    if len(taker):
        adopted = follow(bank.pick(taker).having(x=bank.x[giver]), model, window, scales)
        bank = bank.putting(taker, adopted, np.arange(len(taker)))
    return searched(bank, _lost(bank), model, window, scales) if window.activity[-1] > AT_REST else bank


def searched(bank: Bank, rows: Index, model: ContactModel, window: Window, scales: Scales) -> Bank:
    """Let ``rows`` search from scratch, and keep what is better."""
    if not len(rows):
        return bank
    x = _from_scratch(bank, rows, model, window, scales)
    many = x.shape[1]
    some = bank.pick(rows.repeat(many)).having(x=x.reshape(-1, x.shape[-1]))
    for _ in range(2):  # the weights of the rows follow the geometry
        some = follow(some, model, window, scales)
    told = some.log_likelihood.reshape(-1, many)
    best = told.argmax(axis=1) + many * np.arange(len(rows))
    better = np.flatnonzero(told.max(axis=1) > bank.log_likelihood[rows])
    return bank.putting(rows[better], some, best[better])


def _offered(bank: Bank, model: ContactModel, scales: Scales) -> tuple[Index, Index]:
    """Rows for which the geometry of another is better, and those whose geometry is the best for them."""
    if compiled.in_use():
        from contact_tracker.compiled import calls

        return calls.offered(model, bank.words, scales, LEAST_GAIN)
    prior = before(bank, model, scales).prior
    costs = fit.every_cost(model.family, bank.moments, bank.row_weight, prior, bank.x)
    taker = np.flatnonzero(costs.min(axis=0) < costs.diagonal() - LEAST_GAIN)
    return taker, costs.argmin(axis=0)[taker]


def _lost(bank: Bank) -> Index:
    """Rows that search: of each age one that assumes nothing and one of those that do, the best.

    What they find is offered to those that began beside them.
    """
    age = np.minimum(bank.told.astype(np.int64), len(_DUE) - 1)
    rows = (_DUE[age] & (bank.rms > AT_THE_NOISE) & bank.searched).nonzero()[0]
    kind = 2 * _AGES.searchsorted(bank.told[rows], side="right") + (bank.source[rows] > 0)
    return np.asarray(rows[best_of(kind, bank.joint[rows])])


def _from_scratch(bank: Bank, rows: Index, model: ContactModel, window: Window, scales: Scales) -> Array:
    """The best geometries (R, n, S) that ``rows`` find without regard to where they are.

    They start from the best of the relaxed problem's solutions and many random directions.
    """
    moments = bank.moments[rows]
    trace = moments.trace(axis1=1, axis2=2)[:, None, None]
    relaxed = model.family.starts(moments + 1e-12 * trace * np.eye(moments.shape[-1]))
    directions = _directions(model, window, int(window.index[-1]))
    mean = bank.known_mean[rows]
    told = Given(mean, bank.known[rows]).told(model)
    if compiled.in_use():
        from contact_tracker.compiled import calls

        how = SCREENED, np.array(ROUNDS), fit.TOLERANCE
        return calls.find(model, bank.words, scales, rows, told, relaxed, directions, *how)
    known = before(bank, model, scales)
    drawn = np.broadcast_to(directions, (len(rows), *directions.shape))
    x = np.where(told[:, None], mean[:, None], np.concatenate([relaxed, drawn], axis=1))
    windows, of = (bank.moments, bank.row_weight, *known), rows.repeat(x.shape[1])
    x = _least(*fit.complete(model.family, *windows, x.reshape(len(of), -1), of), len(rows), SCREENED)
    for steps, kept in ROUNDS:
        of = rows.repeat(x.shape[1])
        found = fit.minimise(model.family, *windows, x.reshape(len(of), -1), steps, of=of)
        x = _least(found.x, found.cost, len(rows), kept)
    return x


def _least(x: Array, cost: Array, groups: int, many: int) -> Array:
    """Of each group of x (B, S) as ``many`` as cost least, in order (groups, many, S)."""
    best = cost.reshape(groups, -1).argsort(axis=1, kind="stable")[:, :many]
    return np.asarray(x.reshape(groups, -1, x.shape[-1])[np.arange(groups)[:, None], best])


def _directions(model: ContactModel, window: Window, seed: int) -> Array:
    """Random x (N, S), drawn in the body's frame: they turn with the world in which they are told."""
    x = _drawn(model.family.RANDOM_STARTS, model.family.SIZE, seed % DRAWS)
    return model.turned(x, window.zeta[-1, R].reshape(3, 3))


@cache
def _drawn(count: int, size: int, seed: int) -> Array:
    return np.random.default_rng(seed).normal(size=(count, size))
