"""Pruning of hypotheses by weight and age, and their search for better minima from many starts."""

from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.lifted_pose import R
from contact_tracker.geometry.linalg import LEAST_SHARE
from contact_tracker.hypotheses import gauss_newton
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import SAME_FIT_RATIO, EvidenceParameters
from contact_tracker.hypotheses.refit import are_near, prior_at_anchors, refit
from contact_tracker.hypotheses.schedule import (
    FOLLOWED_STARTS,
    IS_SEARCH_AGE,
    ROUNDS,
    SEARCH_AGES,
    SEARCH_INTERVAL,
    UNTHINNED_TICKS,
    burn_in_ticks,
)
from contact_tracker.map.pairs import known_entries
from contact_tracker.motion.window import Window


def in_burn_in(bank: Bank, model: ContactModel) -> Bools:
    """Which hypotheses (H,) with open directions may not have converged yet: too few ticks determine them.

    They search, and pruning by weight spares them.
    """
    return bank.needs_search & (bank.effective_ticks <= burn_in_ticks(model.needed))


def prune(bank: Bank, model: ContactModel, tick: int, best: float, margin: float) -> Bank:
    """Drop hypotheses more than ``margin`` nats behind ``best``, and thin onsets, the more the older they
    are.

    The log weights of the result are relative to ``best``.
    """
    joint = bank.log_weight
    keep = (joint > best - margin) | in_burn_in(bank, model)
    old = bank.onset.searchsorted(tick + 1 - UNTHINNED_TICKS)  # they are in order
    if old > 1:
        age = tick + 1 - bank.onset[:old]
        span = 2 ** (np.floor(np.log2(age / UNTHINNED_TICKS)) + 1).astype(np.int64)
        keep[:old] &= best_of(bank.onset[:old] // span + (span << 40), joint[:old])
    bank = bank.pick(keep.nonzero()[0])
    is_used = np.isin(bank.onsets.onset, bank.onset)
    onsets = replace(bank.onsets, words=bank.onsets.words[is_used])
    return replace(bank.replace_columns(log_birth_weight=bank.log_birth_weight - best), onsets=onsets)


def residual(bank: Bank) -> float:
    """Whitened residual of the youngest hypothesis with at least ``UNTHINNED_TICKS`` of motion; nan without
    one."""
    ticks = np.where(bank.effective_ticks >= UNTHINNED_TICKS, bank.effective_ticks, np.inf)
    return float(bank.rms[ticks.argmin()]) if ticks.min(initial=np.inf) < np.inf else np.nan


def best_of(group: Ints, joint: Array) -> Bools:
    """Whether each entry is the best of its group."""
    order = np.lexsort((-joint, group))
    sorted_group, first, best = group[order], np.ones(len(group), bool), np.zeros(len(group), bool)
    np.not_equal(sorted_group[1:], sorted_group[:-1], out=first[1:])
    best[order[first]] = True
    return best


DRAWS: Final = 64
"""Number of sets of random directions, used in turn."""


def is_due(model: ContactModel, tick: int) -> bool:
    """Whether the hypotheses of a contact search in this tick; contacts take turns."""
    return not (tick + model.contact.column) % SEARCH_INTERVAL


def search(bank: Bank, rows: Ints, model: ContactModel, window: Window, scales: EvidenceParameters) -> Bank:
    """Search minima of ``rows`` from many starts, and replace those for which a better one is found."""
    if not len(rows):
        return bank
    x = _search_rows(bank, rows, model, window, scales)
    starts = x.shape[1]
    candidates = bank.pick(rows.repeat(starts)).replace_columns(x=x.reshape(-1, x.shape[-1]))
    candidates = refit(candidates, model, window, scales)
    log_likelihood = candidates.log_likelihood.reshape(-1, starts)
    best = log_likelihood.argmax(axis=1) + starts * np.arange(len(rows))
    improved = np.flatnonzero(log_likelihood.max(axis=1) > bank.log_likelihood[rows])
    return bank.replace_rows(rows[improved], candidates, best[improved])


def select_for_search(bank: Bank, model: ContactModel) -> Ints:
    """Rows that search: for each age, the best hypothesis without a prior and the best with one."""
    age = np.minimum(bank.effective_ticks.astype(np.int64), len(IS_SEARCH_AGE) - 1)
    searches = (are_near(bank) & bank.needs_search) | in_burn_in(bank, model)
    rows = (searches & IS_SEARCH_AGE[age] & (bank.rms > SAME_FIT_RATIO)).nonzero()[0]
    kind = 2 * SEARCH_AGES.searchsorted(bank.effective_ticks[rows], side="right") + (
        bank.prior_index[rows] > 0
    )
    return np.asarray(rows[best_of(kind, bank.log_weight[rows])])


def _search_rows(
    bank: Bank, rows: Ints, model: ContactModel, window: Window, scales: EvidenceParameters
) -> Array:
    """The best geometries (R, n, S) of ``rows``, independent of their present ones.

    Starts are the best among the solutions of the relaxed problem and random directions. (The compiled kernel
    leaves out solutions that too few poses determine.)
    """
    drawn = model.turned(directions(model, window.index[-1]), window.zeta[-1, R].reshape(3, 3))
    moments = bank.second_moment[rows]
    trace = moments.trace(axis1=1, axis2=2)[:, None, None]
    relaxed = model.family.starts(moments + LEAST_SHARE * trace * np.eye(moments.shape[-1]))
    priors, mean = prior_at_anchors(bank, model, scales.reach_m), bank.prior_mean[rows]
    is_given = known_entries(model, mean, bank.prior_information[rows])
    x = np.concatenate([relaxed, np.broadcast_to(drawn, (len(rows), *drawn.shape))], axis=1)
    x = np.where(is_given[:, None], mean[:, None], x)
    windows, of = (bank.second_moment, bank.row_weight, *priors), rows.repeat(x.shape[1])
    x = _cheapest(
        *gauss_newton.complete(model.family, *windows, x.reshape(len(of), -1), of), len(rows), FOLLOWED_STARTS
    )
    for steps, kept in ROUNDS:
        of = rows.repeat(x.shape[1])
        fit = gauss_newton.minimise(model.family, *windows, x.reshape(len(of), -1), steps, of=of)
        x = _cheapest(fit.x, fit.cost, len(rows), kept)
    return x


def _cheapest(x: Array, cost: Array, groups: int, count: int) -> Array:
    """The ``count`` x (B, S) of least cost in each group, ascending (groups, many, S)."""
    best = cost.reshape(groups, -1).argsort(axis=1, kind="stable")[:, :count]
    return np.asarray(x.reshape(groups, -1, x.shape[-1])[np.arange(groups)[:, None], best])


def directions(model: ContactModel, tick: int) -> Array:
    """Random x (N, S) for a tick, in the body's frame: so results do not depend on the world's axes."""
    return np.asarray(drawn(model.family.RANDOM_STARTS, model.family.SIZE)[int(tick) % DRAWS])


@cache
def drawn(count: int, size: int) -> Array:
    """All sets (D, N, S) of random directions of a family."""
    return np.array([np.random.default_rng(seed).normal(size=(count, size)) for seed in range(DRAWS)])
