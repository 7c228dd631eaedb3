"""How hypotheses find their minimum from afar: where others are, or from many random starts."""

from collections.abc import Callable
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.hypotheses import gauss_newton
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.element_prior import ElementPrior
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.hypotheses.pruning import best_of, is_protected, within_far_margin
from contact_tracker.hypotheses.refit import prior_at_anchors, refit
from contact_tracker.hypotheses.schedule import (
    AGES,
    AT_THE_NOISE,
    DUE,
    EVERY,
    LEAST_GAIN,
    LIFT,
    MET_PATIENCE,
    ROUNDS,
    SCREENED,
    WEIGHED,
    burn_in_ticks,
)
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]

DRAWS: Final = 64
"""So many sets of random directions take turns."""


def is_due(model: ContactModel, tick: int) -> bool:
    """Whether hypotheses search in a tick: contacts take turns."""
    return not (tick + model.contact.column) % EVERY


def exchange_geometry(bank: Bank, model: ContactModel, window: Window, scales: EvidenceParameters) -> Bank:
    """Let hypotheses take the geometry of their ``best_donors``."""
    donor = best_donors(bank, model, scales)
    recipient = np.flatnonzero(donor != np.arange(len(bank)))
    if not len(recipient):
        return bank
    found = refit(bank.pick(recipient).replace_columns(x=bank.x[donor[recipient]]), model, window, scales)
    return bank.replace_rows(recipient, found, np.arange(len(recipient)))


def best_donors(bank: Bank, model: ContactModel, scales: EvidenceParameters) -> Index:
    """Of each hypothesis that does not fit the row (H,) whose geometry fits its window best; its own where
    none is better.

    Who is hopeless neither offers nor takes: whether it has been dropped must not matter.
    """
    donor = np.arange(len(bank))
    recipients, donors = np.flatnonzero(accepts_donor(bank)), np.flatnonzero(is_competitive(bank, model))
    if not len(recipients) or not len(donors):
        return donor
    candidates = bank.pick(recipients)
    known = prior_at_anchors(candidates, model, scales).prior
    costs = gauss_newton.every_cost(
        model.family, candidates.second_moment, candidates.row_weight, known, bank.x
    )
    costs = np.where(np.isnan(costs), np.inf, costs)
    own, costs = costs[recipients, np.arange(len(recipients))], costs[donors]
    gains = costs.min(axis=0) < own - LEAST_GAIN
    donor[recipients[gains]] = donors[costs.argmin(axis=0)[gains]]
    return donor


def is_competitive(bank: Bank, model: ContactModel) -> Bools:
    """Which hypotheses (H,) are near the best, or may be once they are found."""
    return within_far_margin(bank) | in_burn_in(bank, model)


def accepts_donor(bank: Bank) -> Bools:
    """Which hypotheses (H,) take the geometry of others, where it is better."""
    return (bank.rms > AT_THE_NOISE) & (within_far_margin(bank) | is_protected(bank))


def in_burn_in(bank: Bank, model: ContactModel) -> Bools:
    """Which hypotheses (H,) search and offer however bad: their geometry may not be found yet."""
    share = np.where(bank.from_landmark, MET_PATIENCE, 1.0)
    return (bank.effective_ticks <= share * burn_in_ticks(model.needed)) & bank.needs_search


def search(
    bank: Bank,
    rows: Index,
    model: ContactModel,
    scales: EvidenceParameters,
    drawn: Array,
    weigh: Callable[[Bank, Index], Bank],
) -> Bank:
    """Let ``rows`` search from scratch, and keep what is better.

    Parameters
    ----------
    drawn : (N, S) or (R, N, S) directions to start from, beside those of the relaxed problem.
    weigh : refits hypotheses that were found; given are they, and the row of ``bank`` that each is of.
    """
    if not len(rows):
        return bank
    x = _found(bank, rows, model, scales, drawn)
    many = x.shape[1]
    of = rows.repeat(many)
    some = bank.pick(of).replace_columns(x=x.reshape(-1, x.shape[-1]))
    for _ in range(WEIGHED):
        some = weigh(some, of)
    told = some.log_likelihood.reshape(-1, many)
    best = told.argmax(axis=1) + many * np.arange(len(rows))
    improved = np.flatnonzero(told.max(axis=1) > bank.log_likelihood[rows])
    return bank.replace_rows(rows[improved], some, best[improved])


def select_for_search(bank: Bank, model: ContactModel) -> Index:
    """Rows that search: of each age one that assumes nothing and one of those that do, the best.

    What they find is offered to those that began beside them.
    """
    age = np.minimum(bank.effective_ticks.astype(np.int64), len(DUE) - 1)
    rows = (DUE[age] & (bank.rms > AT_THE_NOISE) & bank.needs_search & is_competitive(bank, model)).nonzero()[
        0
    ]
    kind = 2 * AGES.searchsorted(bank.effective_ticks[rows], side="right") + (bank.prior_index[rows] > 0)
    return np.asarray(rows[best_of(kind, bank.log_weight[rows])])


def _found(bank: Bank, rows: Index, model: ContactModel, scales: EvidenceParameters, drawn: Array) -> Array:
    """The best geometries (R, n, S) that ``rows`` find without regard to where they are.

    They start from the best of the relaxed problem's solutions and of the directions ``drawn``.
    (Compiled, solutions that too few poses leave open are no starts.)
    """
    moments = bank.second_moment[rows]
    trace = moments.trace(axis1=1, axis2=2)[:, None, None]
    relaxed = model.family.starts(moments + LIFT * trace * np.eye(moments.shape[-1]))
    known, mean = prior_at_anchors(bank, model, scales), bank.prior_mean[rows]
    told = ElementPrior(mean, bank.prior_information[rows]).is_given(model)
    x = np.concatenate([relaxed, np.broadcast_to(drawn, (len(rows), *drawn.shape[-2:]))], axis=1)
    x = np.where(told[:, None], mean[:, None], x)
    windows, of = (bank.second_moment, bank.row_weight, *known), rows.repeat(x.shape[1])
    x = _least(
        *gauss_newton.complete(model.family, *windows, x.reshape(len(of), -1), of), len(rows), SCREENED
    )
    for steps, kept in ROUNDS:
        of = rows.repeat(x.shape[1])
        found = gauss_newton.minimise(model.family, *windows, x.reshape(len(of), -1), steps, of=of)
        x = _least(found.x, found.cost, len(rows), kept)
    return x


def _least(x: Array, cost: Array, groups: int, many: int) -> Array:
    """Of each group of x (B, S) as ``many`` as cost least, in order (groups, many, S)."""
    best = cost.reshape(groups, -1).argsort(axis=1, kind="stable")[:, :many]
    return np.asarray(x.reshape(groups, -1, x.shape[-1])[np.arange(groups)[:, None], best])


def directions(model: ContactModel, tick: int) -> Array:
    """Random x (N, S) for a tick, in the body's frame: they turn with the world in which they are told."""
    return _drawn(model.family.RANDOM_STARTS, model.family.SIZE, int(tick) % DRAWS)


@cache
def _drawn(count: int, size: int, seed: int) -> Array:
    return np.random.default_rng(seed).normal(size=(count, size))
