"""How the hypotheses of one contact learn: each has its own onset, its own window and its own geometry.

``advance`` takes in one tick: windows grow, geometry is refined from where it was, evidence is summed anew.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker import fit
from contact_tracker.bank import Bank, Begin, add, anchors_of, blank, fresh, prior_of
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.given import Given
from contact_tracker.evidence import Scales, Window, complexity
from contact_tracker.summed import Sums, summed

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SEARCH_AGES: Final = (3, 5, 8, 12, 16, 20, 25, 30, 36, 44, 54, 66, 80, 100)
"""After so many ticks with motion a hypothesis searches for its minimum from scratch, not only from where it
was."""
SEARCH_EVERY: Final = 3
"""Searches wait for each other, so that one batch of this many ticks does for all."""
SEARCH_STEPS: Final = 10
REFINE_STEPS: Final = 2
FIRST_TICKS: Final = 6.0
FIRST_STEPS: Final = 6
"""In its first ticks with motion the geometry moves far, and takes so many steps."""
SCREENED: Final = 12
AT_THE_NOISE: Final = 1.2
"""A whitened residual below which there is no better minimum to search for."""
LEAST_GAIN: Final = 1e-3
"""Nats by which another geometry must be better to be taken."""
AT_REST: Final = 1e-7
"""Weight of a tick without motion: it fixes where the object rests, and tells next to nothing."""


def advance(bank: Bank, model: ContactModel, window: Window, scales: Scales, log_stay: float) -> Bank:
    """Take in the newest tick of the window; ``log_stay`` is the price of not having changed in it."""
    if not len(bank):
        return bank
    bank = _grow(bank, model, window)
    bank = replace(bank, lasted=bank.lasted + np.where(bank.onset < window.index[-1], log_stay, 0.0))
    steps = np.where(bank.told < FIRST_TICKS, FIRST_STEPS, REFINE_STEPS)
    before = _before(bank, model, scales)
    bank = _refine(_adopt(bank, model, before), model, before, steps)
    if window.index[-1] % SEARCH_EVERY == 0 and bool(window.activity[-1] > AT_REST):
        bank = _search(bank, model, window, scales, _lost(bank))
    return _evaluate(bank, model, window, scales, before)


def _grow(bank: Bank, model: ContactModel, window: Window) -> Bank:
    """Add the newest tick to the moments, weighted by how far the motion in it rises above the noise."""
    zeta, activity = window.zeta[-1], float(window.activity[-1])
    lifted = model.lifted(zeta)
    begins = bank.onset == window.index[-1]
    weight = np.where(begins, 1.0, max(activity, AT_REST)) / float(window.variance[-1, 0])
    bank = replace(
        bank,
        first=np.where(begins[:, None], lifted / np.sqrt(window.variance[-1, 0]), bank.first),
        moments=bank.moments + weight[:, None, None] * np.outer(lifted, lifted),
        place_sum=bank.place_sum + weight[:, None] * zeta[9:12],
        weight=bank.weight + weight,
        told=bank.told + np.where(begins, 1.0, activity),
    )
    # what begins now touches now, in the directions of the best that there was (minimise solves for the rest)
    return replace(bank, x=model.family.normalise(bank.x, anchors_of(bank, model)))


def _grown(bank: Bank, model: ContactModel, window: Window) -> Bank:
    """As ``_grow`` tick by tick, from the first tick of the window, where all of the bank begin."""
    lifted, variance = model.lifted(window.zeta), window.variance[:, 0]
    heard = np.append(1.0, window.activity[1:])  # the onset is given
    weight = np.maximum(heard, AT_REST) / variance
    count = np.ones(len(bank))
    bank = replace(
        bank,
        first=np.outer(count, lifted[0] / np.sqrt(variance[0])),
        moments=count[:, None, None] * ((lifted * weight[:, None]).T @ lifted),
        place_sum=np.outer(count, weight @ window.zeta[:, 9:12]),
        weight=count * weight.sum(),
        told=count * heard.sum(),
    )
    return replace(bank, x=model.family.normalise(bank.x, anchors_of(bank, model)))


def fit_stretch(
    model: ContactModel, window: Window, scales: Scales, begins: Sequence[Begin] | None = None
) -> Bank:
    """A bank of one hypothesis, fitted from scratch to all ticks of the window.

    It is the best of ``begins``, if given; the bank is empty if there are none.
    """
    begins = [fresh(model)] if begins is None else begins
    nothing = blank(model, 0)
    bank = add(nothing, model, int(window.index[0]), 0, 0, 0.0, nothing.past[:0].sum(axis=0), begins)
    if not len(bank):
        return bank
    bank = _grown(bank, model, window)
    bank = _search(bank, model, window, scales, np.flatnonzero(bank.searched))
    before = _before(bank, model, scales)
    bank = _evaluate(_refine(bank, model, before), model, window, scales, before)
    return bank.pick(np.array([np.argmax(bank.log_likelihood)]))


def settle(bank: Bank, model: ContactModel, window: Window, scales: Scales, ticks: int) -> Bank:
    """Sum up the oldest ``ticks`` of the window, which is about to lose them."""
    if not len(bank) or ticks <= 0:
        return bank
    oldest = window.cut(0, ticks)
    seen = summed(model, bank.x, bank.onset, oldest, scales, bank.certain)
    settled, earned = bank.settled + seen.log_ratio, bank.earned + seen.gain.sum(axis=1)
    return replace(bank, settled=settled, earned=earned)


class Before(NamedTuple):
    """What each hypothesis knew before its window, and where the body was: as long as that does not grow."""

    prior: fit.Prior
    anchors: Array

    def pick(self, rows: Index) -> "Before":
        return Before(self.prior.pick(rows), self.anchors[rows])


def _before(bank: Bank, model: ContactModel, scales: Scales) -> Before:
    anchors = anchors_of(bank, model)
    return Before(prior_of(bank, model, anchors, scales.reach_m), anchors)


def _adopt(bank: Bank, model: ContactModel, before: Before) -> Bank:
    """Let each hypothesis take the geometry of any other where that fits its own window better."""
    costs = fit.every_cost(model.family, bank.moments, bank.row_weight, before.prior, bank.x)
    best = np.argmin(costs, axis=0)
    own = np.arange(len(bank))
    better = costs[best, own] < costs[own, own] - LEAST_GAIN
    return replace(bank, x=np.where(better[:, None], bank.x[best], bank.x))


def _refine(bank: Bank, model: ContactModel, before: Before, steps: int | Index = REFINE_STEPS) -> Bank:
    """Take some steps towards the minimum; the moments carry 1/m^2, the rows weights relative to that."""
    found = fit.minimise(model.family, bank.moments, bank.row_weight, *before, bank.x, steps)
    return replace(bank, x=found.x, hessian=found.hessian)


def _lost(bank: Bank) -> Index:
    """Rows that search: of each age one that assumes nothing and one of those that do, the best.

    What they find is offered to those that began beside them.
    """
    passed = bank.told.astype(np.int64)[:, None] - np.arange(SEARCH_EVERY)
    due = np.isin(passed, SEARCH_AGES).any(axis=1) & (bank.rms > AT_THE_NOISE) & bank.searched
    rows = np.flatnonzero(due)
    kind = 2 * np.searchsorted(SEARCH_AGES, bank.told[rows], side="right") + (bank.source[rows] > 0)
    best = np.lexsort((-bank.joint[rows], kind))
    return np.sort(rows[best[np.unique(kind[best], return_index=True)[1]]])


def _search(bank: Bank, model: ContactModel, window: Window, scales: Scales, rows: Index) -> Bank:
    """Search from scratch for the hypotheses in ``rows``, and keep what is better."""
    if not len(rows):
        return bank
    some = bank.pick(rows)
    before = _before(some, model, scales)
    starts = _starts(some, model, before, int(window.index[-1]))
    count = starts.shape[1]
    each = np.repeat(np.arange(len(rows)), count)
    many, of_many = some.pick(each), before.pick(each)
    told = Given(many.known_mean, many.known).told
    x = np.where(told, many.known_mean, starts.reshape(-1, starts.shape[-1]))
    many = replace(many, x=model.family.normalise(x, of_many.anchors))
    tried = _evaluate(_refine(many, model, of_many, SEARCH_STEPS), model, window, scales, of_many)
    tried = _evaluate(_refine(tried, model, of_many), model, window, scales, of_many)
    best = np.argmax(tried.log_likelihood.reshape(len(rows), count), axis=1)
    won = tried.pick(np.arange(len(rows)) * count + best)
    held = _evaluate(some, model, window, scales, before)
    better = won.log_likelihood > held.log_likelihood
    names = ("x", "hessian", "row_weight")
    changed = {name: vars(bank)[name].copy() for name in names}
    for name in names:
        changed[name][rows[better]] = vars(won)[name][better]
    return replace(bank, **changed)


def _starts(bank: Bank, model: ContactModel, before: Before, seed: int) -> Array:
    """Starts (H, N, S): solutions of the relaxed problem, and the best of many random directions."""
    family = model.family
    size = bank.moments.shape[-1]
    trace = np.trace(bank.moments, axis1=1, axis2=2)[:, None, None]
    regular = bank.moments + 1e-12 * trace * np.eye(size)
    relaxed = family.starts(regular)
    raw = np.random.default_rng(seed).normal(size=(family.RANDOM_STARTS, family.SIZE))
    each = np.repeat(np.arange(len(bank)), len(raw))
    prior, anchors = before.pick(each)
    x = family.normalise(np.tile(raw, (len(bank), 1)), anchors)
    x, cost = fit.complete(family, bank.moments[each], bank.row_weight[each], prior, anchors, x)
    cost = cost.reshape(len(bank), -1)
    best = np.argsort(cost, axis=1)[:, :SCREENED]
    screened = np.take_along_axis(x.reshape(len(bank), -1, family.SIZE), best[..., None], axis=1)
    return np.concatenate([relaxed, screened], axis=1)


def _evaluate(bank: Bank, model: ContactModel, window: Window, scales: Scales, before: Before) -> Bank:
    seen = summed(model, bank.x, bank.onset, window, scales, bank.certain)
    prior, anchors = before
    given = fit.information(model.family, bank.first, bank.row_weight, bank.moments, anchors, bank.x)
    foretold = _foretold(bank, model, scales, seen)
    price = complexity(model.family, bank.x, anchors, bank.hessian, given, foretold, prior)
    earned = seen.gain.sum(axis=1) + bank.earned
    count = np.maximum(seen.ticks, 1)
    return replace(
        bank,
        # geometry never costs more than it has explained
        log_likelihood=bank.lasted
        + scales.independence * (seen.log_ratio + bank.settled - np.minimum(price, earned)),
        row_weight=seen.precision / count[:, None],
        rms=np.sqrt(seen.chi_sq / (count * model.family.ROWS)),
    )


def _foretold(bank: Bank, model: ContactModel, scales: Scales, seen: Sums) -> Array:
    """Share (H, K) of each row's information that free motion, continued, would have given (T19)."""
    ticks = np.maximum(bank.told, 1.0)[:, None]
    mean_gain = seen.gain / np.maximum(seen.after, 1)[:, None]
    needed = model.family.PARAMETERS / model.family.ROWS
    return np.asarray(scales.foreknowledge * needed / ticks * np.exp(-2.0 * mean_gain))
