"""How hypotheses search from scratch, compiled: where many starts lead to, and whether that is better."""

from math import isnan

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled.fitting import Work, complete_one, descend
from contact_tracker.compiled.following import Minds, Weights, learn_one, minds_for, steps_of
from contact_tracker.compiled.hypothesis import Ints, Kind, know, row_of
from contact_tracker.compiled.jit import jit, kernel, part
from contact_tracker.compiled.seeing import Ticks
from contact_tracker.compiled.vectors import copy
from contact_tracker.contacts.base import Array
from contact_tracker.fit import TOLERANCE
from contact_tracker.pace import ROUNDS, SCREENED, WEIGHED

KEPT = min(kept for _, kept in ROUNDS)
_STEPS = np.array([steps for steps, _ in ROUNDS])
_KEPT = np.array([kept for _, kept in ROUNDS])


@jit
def _best(x: Array, cost: Array, many: int) -> None:
    """Bring the ``many`` of x (N, S) that cost least to the front, in order; equal ones stay in theirs."""
    for i in range(many):
        best = i
        for j in range(i + 1, len(cost)):
            if cost[j] < cost[best] or (isnan(cost[best]) and not isnan(cost[j])):
                best = j
        for j in range(best, i, -1):  # keeps the order of the others
            cost[j], cost[j - 1] = cost[j - 1], cost[j]
            for s in range(x.shape[1]):
                x[j, s], x[j - 1, s] = x[j - 1, s], x[j, s]


@part
def find(
    kind: Kind,
    table: Array,
    b: int,
    told: NDArray[np.bool_],
    x: Array,
    cost: Array,
    hessian: Array,
    work: Work,
) -> int:
    """Bring starts x (N, S) to where hypothesis b costs least, as ``search._found`` does; the best ones come
    first, and their number is returned."""
    row, left = row_of(kind, table, b), min(SCREENED, len(x))
    know(kind, row, table[b, kind.where.weight], work.mean, work.prior)
    for i in range(len(x)):
        for s in range(kind.size):
            if told[s]:
                x[i, s] = row.known_mean[s]
        cost[i] = complete_one(kind, row, x[i], work)
    _best(x, cost, left)
    for r in range(len(_STEPS)):
        for i in range(left):
            cost[i], _ = descend(kind, row, x[i], _STEPS[r], TOLERANCE, hessian, work)
        few = min(left, _KEPT[r])
        _best(x[:left], cost[:left], few)
        left = few
    return left


@jit
def _weigh(
    kind: Kind, found: Array, as_whole: Ints, few: int, ticks: Ticks, weights: Weights, minds: Minds
) -> int:
    """Weigh the first ``few`` rows of what was found; returns the best."""
    best = 0
    for i in range(few):
        for _ in range(WEIGHED):
            learn_one(kind, found, as_whole, i, ticks, steps_of(kind, found, i), weights, minds)
        if found[i, kind.where.log_likelihood] > found[best, kind.where.log_likelihood]:
            best = i
    return best


@jit
def _put(kind: Kind, table: Array, b: int, found: Array, best: int) -> None:
    """Give hypothesis b the geometry and evidence of the best, if that is better."""
    where = kind.where
    if not found[best, where.log_likelihood] > table[b, where.log_likelihood]:
        return
    of_hessian = kind.each * kind.free * kind.free
    for first, count in (
        (where.x, kind.size),
        (where.hessian, of_hessian),
        (where.row_weight, kind.each),
        (where.log_likelihood, 1),
        (where.rms, 1),
    ):
        for i in range(first, first + count):
            table[b, i] = found[best, i]


@kernel
def searched(
    kind: Kind,
    table: Array,
    ticks: Ticks,
    weights: Weights,
    which: Ints,
    told: NDArray[np.bool_],
    relaxed: Array,
    directions: Array,
    found: Array,
    as_whole: Ints,
) -> None:
    minds, hessian = minds_for(kind), np.empty((kind.each, kind.free, kind.free))
    few, many = relaxed.shape[1], relaxed.shape[1] + len(directions)
    cost, x = np.empty(many), np.empty((many, kind.size))
    for r in range(len(which)):
        for i in range(many):
            copy(relaxed[r, i] if i < few else directions[i - few], x[i])
        left = find(kind, table, which[r], told[r], x, cost, hessian, minds.work)
        for i in range(left):
            copy(table[which[r]], found[i])
            copy(x[i], found[i, kind.where.x : kind.where.x + kind.size])
        best = _weigh(kind, found, as_whole, left, ticks, weights, minds)
        _put(kind, table, which[r], found, best)
