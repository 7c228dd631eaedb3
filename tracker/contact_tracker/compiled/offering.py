"""Whose geometry fits another hypothesis better than its own does, compiled."""

from math import inf, isnan
from typing import NamedTuple

import numpy as np

from contact_tracker.compiled.fitting import Work
from contact_tracker.compiled.forms import rows as rows_of
from contact_tracker.compiled.hypothesis import Ints, Kind, know, row_of
from contact_tracker.compiled.jit import jit, memory, part
from contact_tracker.compiled.vectors import copy, multiply
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.edge_edge import SINE_SQ_FLOOR, TINY
from contact_tracker.pace import LEAST_GAIN


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
def costs_for(kind: Kind, count: int) -> Costs:
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


@part
def offer(kind: Kind, table: Array, costs: Costs, cost: Array, giver: Ints, work: Work) -> None:
    """Of each hypothesis whose geometry it takes, as in ``search.adopted``: its own where none is better.

    ``cost`` (N, N) is memory.
    """
    count, first, last = len(table), kind.where.x, kind.where.x + kind.size
    for b in range(count):
        _ask(kind, table, b, costs, work)
    for n in range(count):
        _every_cost(kind, table[n, first:last], costs, cost[n])
        for b in range(count):
            if isnan(cost[n, b]):
                cost[n, b] = inf
    for b in range(count):
        best = b
        for n in range(count):
            if cost[n, b] < cost[best, b]:
                best = n
        giver[b] = best if cost[best, b] < cost[b, b] - LEAST_GAIN else b
