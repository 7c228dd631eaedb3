"""What ``search`` does, compiled: which geometries of others are better, and where many starts lead to."""

from math import isnan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled.fitting import Work, complete_one, descend, work_for
from contact_tracker.compiled.forms import rows as rows_of
from contact_tracker.compiled.hypothesis import Ints, Kind, know, row_of
from contact_tracker.compiled.jit import jit, kernel, memory
from contact_tracker.compiled.vectors import copy, multiply
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.edge_edge import SINE_SQ_FLOOR, TINY


class Costs(NamedTuple):
    """What N hypotheses ask of a geometry, a column each: the upper triangles of their ``moments`` and of the
    ``precision`` of what they knew before, ``information``, ``constant`` and ``row_weight``; and what comes
    between."""

    moments: Array
    precision: Array
    information: Array
    constant: Array
    row_weight: Array
    rows: Array
    pairs: Array
    squares: Array
    cosines: Array


@memory
def _costs_for(kind: Kind, count: int) -> Costs:
    of_moments, of_prior = kind.columns * (kind.columns + 1) // 2, kind.size * (kind.size + 1) // 2
    return Costs(
        moments=np.empty((of_moments, count)),
        precision=np.empty((of_prior, count)),
        information=np.empty((kind.size, count)),
        constant=np.empty(count),
        row_weight=np.empty((kind.each, count)),
        rows=np.empty((kind.each, kind.columns)),
        pairs=np.empty(max(of_moments, of_prior)),
        squares=np.empty(count),
        cosines=np.empty(count),
    )


@jit
def _ask(kind: Kind, table: Array, b: int, costs: Costs, work: Work) -> None:
    """Write down what hypothesis b asks."""
    row = row_of(kind, table, b)
    know(kind, row, table[b, kind.where.weight], work.mean, work.prior)
    for matrix, out in ((row.moments, costs.moments), (work.prior.precision, costs.precision)):
        i = 0
        for c in range(len(matrix)):
            for d in range(c, len(matrix)):
                out[i, b] = matrix[c, d]
                i += 1
    for s in range(kind.size):
        costs.information[s, b] = work.prior.information[s]
    for k in range(kind.each):
        costs.row_weight[k, b] = row.row_weight[k]
    costs.constant[b] = work.prior.constant[0]


@jit
def _pairs(v: Array, out: Array) -> None:
    """All products of two entries, each once, times how often it is in ``v M v`` of a symmetric M."""
    i = 0
    for a in range(len(v)):
        out[i] = v[a] * v[a]
        for b in range(a + 1, len(v)):
            out[i + b - a] = 2.0 * v[a] * v[b]
        i += len(v) - a


@jit
def _every_cost(kind: Kind, x: Array, costs: Costs, out: Array) -> None:
    """As ``fit.every_cost`` of one geometry x (S,), (N,)."""
    form, each, pairs, squares = kind.form, kind.each, costs.pairs, costs.squares
    total = len(costs.moments) - 1  # the square of the lift's 1
    rows_of(form, x, costs.rows)
    _pairs(x, pairs)
    multiply(pairs[: len(costs.precision)], costs.precision, squares)
    multiply(x, costs.information, out)
    for b in range(len(out)):
        out[b] = 0.5 * squares[b] - out[b] + costs.constant[b]
    for k in range(each):
        _pairs(costs.rows[k], pairs)
        multiply(pairs[: len(costs.moments)], costs.moments, squares)
        if form.q2 >= 0:  # per metre, see edge_edge.scale_sq
            copy(costs.rows[k, 9:18], costs.rows[k, :9])
            for c in range(9, 19):
                costs.rows[k, c] = 0.0
            _pairs(costs.rows[k], pairs)
            multiply(pairs[: len(costs.moments)], costs.moments, costs.cosines)
            for b in range(len(out)):
                mean_sq = costs.cosines[b] / max(costs.moments[total, b], TINY)
                squares[b] /= max(1.0 - mean_sq, SINE_SQ_FLOOR)
        for b in range(len(out)):
            out[b] += 0.5 * costs.row_weight[k, b] * squares[b]


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


@jit
def _find(
    kind: Kind,
    table: Array,
    b: int,
    told: NDArray[np.bool_],
    screened: int,
    rounds: Ints,
    tolerance: float,
    x: Array,
    cost: Array,
    hessian: Array,
    work: Work,
) -> None:
    """Bring starts x (N, S) to where hypothesis b costs least, the best ones first."""
    row, left = row_of(kind, table, b), screened
    know(kind, row, table[b, kind.where.weight], work.mean, work.prior)
    for i in range(len(x)):
        for s in range(kind.size):
            if told[s]:
                x[i, s] = row.known_mean[s]
        cost[i] = complete_one(kind, row, x[i], work)
    _best(x, cost, screened)
    for r in range(len(rounds)):
        for i in range(left):
            cost[i], _ = descend(kind, row, x[i], rounds[r, 0], tolerance, hessian, work)
        few = min(left, rounds[r, 1])
        _best(x[:left], cost[:left], few)
        left = few


@kernel
def offered(kind: Kind, table: Array, least: float, giver: Ints) -> None:
    count, first, last = len(table), kind.where.x, kind.where.x + kind.size
    work, costs, cost = work_for(kind), _costs_for(kind, count), np.empty((count, count))
    for b in range(count):
        _ask(kind, table, b, costs, work)
    for n in range(count):
        _every_cost(kind, table[n, first:last], costs, cost[n])
    for b in range(count):
        best = np.argmin(cost[:, b])
        giver[b] = best if cost[best, b] < cost[b, b] - least else b


@kernel
def find(
    kind: Kind,
    table: Array,
    which: Ints,
    told: NDArray[np.bool_],
    relaxed: Array,
    directions: Array,
    screened: int,
    rounds: Ints,
    tolerance: float,
    out: Array,
) -> None:
    work, hessian = work_for(kind), np.empty((kind.each, kind.free, kind.free))
    few, many = relaxed.shape[1], relaxed.shape[1] + len(directions)
    cost, x = np.empty(many), np.empty((many, kind.size))
    for r in range(len(which)):
        for i in range(many):
            copy(relaxed[r, i] if i < few else directions[i - few], x[i])
        _find(kind, table, which[r], told[r], screened, rounds, tolerance, x, cost, hessian, work)
        for i in range(out.shape[1]):
            copy(x[i], out[r, i])
