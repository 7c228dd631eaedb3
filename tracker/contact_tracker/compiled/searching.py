"""How hypotheses search from scratch, compiled: where many starts lead to, and whether that is better."""

from math import isnan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled.fitting import Work, complete_one, descend
from contact_tracker.compiled.following import Minds, Weights, learn_one, minds_for, steps_of
from contact_tracker.compiled.hypothesis import Ints, Kind, Row, know, row_of
from contact_tracker.compiled.jit import jit, kernel, memory, part
from contact_tracker.compiled.relaxing import Relaxed, relax, relaxed_for
from contact_tracker.compiled.seeing import Ticks
from contact_tracker.compiled.vectors import at, copy
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


class Hunt(NamedTuple):
    """Memory of a search: geometries ``x`` (N, S) with their ``cost`` (N,), and a ``hessian``; which are
    ``told`` (S,); rows that are ``found`` (KEPT, words), the same ``as_whole`` numbers; ``relaxed`` problems.
    """

    x: Array
    cost: Array
    hessian: Array
    told: NDArray[np.bool_]
    found: Array
    as_whole: Ints
    relaxed: Relaxed


@memory
def hunt_for(kind: Kind, directions: Array, found: Array, as_whole: Ints) -> Hunt:
    many = kind.relaxed + len(directions)
    return Hunt(
        np.empty((many, kind.size)),
        np.empty(many),
        np.empty((kind.each, kind.free, kind.free)),
        np.empty(kind.size, np.bool_),
        found,
        as_whole,
        relaxed_for(kind),
    )


@jit
def _tell(kind: Kind, row: Row, told: NDArray[np.bool_]) -> None:
    """As ``Given.told``."""
    for s in range(kind.size):
        told[s] = row.known[s, s] > 0.0
    for d in (kind.form.d1, kind.form.d2):
        if d >= 0:
            v = at(row.known_mean, d)
            for i in range(3):
                told[d + i] = v[0] != 0.0 or v[1] != 0.0 or v[2] != 0.0


@jit
def _find(kind: Kind, row: Row, directions: Array, hunt: Hunt, work: Work) -> int:
    """As ``search._found`` of one hypothesis; the best of ``hunt.x`` come first, and their number is
    returned."""
    told, few = hunt.told, relax(kind, row.moments, hunt.x[: kind.relaxed], hunt.relaxed)
    many = few + len(directions)
    x, cost = hunt.x[:many], hunt.cost[:many]
    _tell(kind, row, told)
    for i in range(many):
        if i >= few:
            copy(directions[i - few], x[i])
        for s in range(kind.size):
            if told[s]:
                x[i, s] = row.known_mean[s]
        cost[i] = complete_one(kind, row, x[i], work)
    left = min(SCREENED, many)
    _best(x, cost, left)
    for r in range(len(_STEPS)):
        for i in range(left):
            cost[i], _ = descend(kind, row, x[i], _STEPS[r], TOLERANCE, hunt.hessian, work)
        few = min(left, _KEPT[r])
        _best(x[:left], cost[:left], few)
        left = few
    return left


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


@part
def search_one(
    kind: Kind,
    table: Array,
    b: int,
    directions: Array,
    ticks: Ticks,
    weights: Weights,
    hunt: Hunt,
    minds: Minds,
) -> None:
    """As ``search.searched`` of hypothesis b."""
    row, work, found, best = row_of(kind, table, b), minds.work, hunt.found, 0
    know(kind, row, table[b, kind.where.weight], work.mean, work.prior)
    for i in range(_find(kind, row, directions, hunt, work)):
        copy(table[b], found[i])
        copy(hunt.x[i], found[i, kind.where.x : kind.where.x + kind.size])
        for _ in range(WEIGHED):
            steps = steps_of(kind, found, i)
            learn_one(kind, found, hunt.as_whole, i, ticks, steps, weights, minds)
        if found[i, kind.where.log_likelihood] > found[best, kind.where.log_likelihood]:
            best = i
    _put(kind, table, b, found, best)


@kernel
def searched(
    kind: Kind,
    table: Array,
    which: Ints,
    directions: Array,
    ticks: Ticks,
    weights: Weights,
    found: Array,
    as_whole: Ints,
) -> None:
    minds, hunt = minds_for(kind), hunt_for(kind, directions, found, as_whole)
    for r in range(len(which)):
        search_one(kind, table, which[r], directions, ticks, weights, hunt, minds)
