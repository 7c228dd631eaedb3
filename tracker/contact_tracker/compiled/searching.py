"""What ``search`` does, compiled: which geometries of others are better, and where many starts lead to."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled.fitting import Problem, complete_one, descend, work_for
from contact_tracker.compiled.following import Kind, Rows, problem_of
from contact_tracker.compiled.forms import rows as rows_of
from contact_tracker.compiled.jit import SOURCES, jit, kernel, memory
from contact_tracker.compiled.vectors import multiply
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.edge_edge import SINE_SQ_FLOOR, TINY

Ints = NDArray[np.int64]


@jit
def _pairs(v: Array, out: Array) -> None:
    """All products of two entries, each once, times how often it is in ``v M v`` of a symmetric M."""
    i = 0
    for a in range(len(v)):
        out[i] = v[a] * v[a]
        for b in range(a + 1, len(v)):
            out[i + b - a] = 2.0 * v[a] * v[b]
        i += len(v) - a


@memory
def _halves(matrices: Array, size: int) -> Array:
    """Upper triangles of the first ``size`` rows of symmetric matrices, each a column: for ``_pairs``."""
    out = np.empty((size * (size + 1) // 2, len(matrices)))
    for m in range(len(matrices)):
        i = 0
        for a in range(size):
            for b in range(a, size):
                out[i, m] = matrices[m, a, b]
                i += 1
    return out


@memory
def _every_cost(kind: Kind, rows: Rows, problem: Problem) -> Array:
    """As ``fit.every_cost`` of the rows' own geometries, (N, N)."""
    form, (count, size), (_, each) = kind.form, rows.x.shape, rows.row_weight.shape
    columns = rows.moments.shape[1]
    moments, precision = _halves(rows.moments, columns), _halves(problem.precision, size)
    turns = _halves(rows.moments, 9) if form.q2 >= 0 else moments
    information = np.ascontiguousarray(problem.information.T)
    of_x, of_moments, of_prior = np.empty((each, columns)), np.empty(len(moments)), np.empty(len(precision))
    squares, pulls, cosines, cost = (
        np.empty(count),
        np.empty(count),
        np.empty(count),
        np.empty((count, count)),
    )
    for n in range(count):
        rows_of(form, rows.x[n], of_x)
        _pairs(rows.x[n], of_prior)
        multiply(of_prior, precision, squares)
        multiply(rows.x[n], information, pulls)
        for b in range(count):
            cost[n, b] = 0.5 * squares[b] - pulls[b] + problem.constant[b]
        for k in range(each):
            _pairs(of_x[k], of_moments)
            multiply(of_moments, moments, squares)
            if form.q2 >= 0:
                _pairs(of_x[k, 9:18], of_moments[:45])
                multiply(of_moments[:45], turns, cosines)
                for b in range(count):
                    total = max(rows.moments[b, 18, 18], TINY)
                    squares[b] /= max(1.0 - cosines[b] / total, SINE_SQ_FLOOR)
            for b in range(count):
                cost[n, b] += 0.5 * rows.row_weight[b, k] * squares[b]
    return cost


@memory
def _smallest(cost: Array, many: int) -> Ints:
    """Where the smallest are, in order."""
    return np.argsort(cost, kind="mergesort")[:many]


def _kernels(sources: str) -> tuple[Any, Any]:
    @kernel
    def offered(kind: Kind, rows: Rows, least: float) -> tuple[Ints, Ints]:
        assert sources
        cost = _every_cost(kind, rows, problem_of(kind, rows))
        taker, giver, many = np.empty(len(cost), np.int64), np.empty(len(cost), np.int64), 0
        for b in range(len(cost)):
            best = np.argmin(cost[:, b])
            if cost[best, b] < cost[b, b] - least:
                taker[many], giver[many] = b, best
                many += 1
        return taker[:many], giver[:many]

    @kernel
    def find(
        kind: Kind,
        rows: Rows,
        which: Ints,
        told: NDArray[np.bool_],
        relaxed: Array,
        directions: Array,
        screened: int,
        rounds: Ints,
        tolerance: float,
    ) -> Array:
        assert sources
        size, (_, each, free, _) = directions.shape[1], rows.hessian.shape
        problem = problem_of(kind, rows)
        work = work_for(each, rows.moments.shape[1], size, free)
        hessian = np.empty((each, free, free))
        many, last = relaxed.shape[1] + len(directions), rounds[-1, 1]
        out, cost, drawn = np.empty((len(which), last, size)), np.empty(many), np.empty((many, size))
        for r in range(len(which)):
            b, mean = which[r], rows.known_mean[which[r]]
            drawn[: relaxed.shape[1]], drawn[relaxed.shape[1] :] = relaxed[r], directions
            for i in range(many):
                for s in range(size):
                    if told[r, s]:
                        drawn[i, s] = mean[s]
                cost[i] = complete_one(problem, b, drawn[i], work)
            x = drawn[_smallest(cost, screened)]
            for steps, kept in rounds:
                reached = np.empty(len(x))
                for i in range(len(x)):
                    reached[i], _ = descend(problem, b, x[i], steps, tolerance, hessian, work)
                x = x[_smallest(reached, kept)]
            out[r] = x
        return out

    return offered, find


offered, find = _kernels(SOURCES)
