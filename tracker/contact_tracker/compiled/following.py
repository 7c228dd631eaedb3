"""What ``following`` does to a bank in every tick, compiled: its moments grow, and it learns from them."""

from math import exp, isnan, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled import seeing
from contact_tracker.compiled.fitting import Problem, Work, descend, work_for
from contact_tracker.compiled.forms import normalise
from contact_tracker.compiled.jit import SOURCES, jit, kernel, memory
from contact_tracker.compiled.pricing import volume
from contact_tracker.compiled.seeing import Sums, Ticks, add_up, nothing
from contact_tracker.compiled.vectors import at, dot, multiply, put
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.form import Form

Ints = NDArray[np.int64]


class Rows(NamedTuple):
    """Columns of ``bank.Bank``, those first that nothing here changes."""

    onset: Ints
    certain: NDArray[np.bool_]
    known_mean: Array
    known: Array
    pivot: Array
    lasted: Array
    settled: Array
    earned: Array
    first: Array
    moments: Array
    place_sum: Array
    weight: Array
    told: Array
    x: Array
    hessian: Array
    row_weight: Array
    log_likelihood: Array
    rms: Array


class Kind(NamedTuple):
    """What sort of contact it is: see ``contacts``; ``pull`` (S,) of the weak prior and where it is ``flat``
    (S,)."""

    form: Form
    body_in_1: bool
    turns: Ints
    shifts: Ints
    pull: Array
    flat: Array


class Weights(NamedTuple):
    """``lengths`` as ``seeing.add_up`` takes them; the rest as in ``evidence.Scales``."""

    lengths: tuple[float, float]
    foreknowledge: float
    independence: float


@jit
def _anchors(kind: Kind, rows: Rows, b: int, out: Array) -> None:
    """As ``bank.anchors_of``."""
    put(out, 0, at(out, -1))
    put(out, 3, at(out, -1))
    first = 3 if kind.body_in_1 else 0
    for i in range(3):
        out[first + i] = rows.place_sum[b, i] / rows.weight[b]
    for i in range(6):
        if not isnan(rows.pivot[b, i]):
            out[i] = rows.pivot[b, i]


@memory
def problem_of(kind: Kind, rows: Rows) -> Problem:
    """As ``following.before``."""
    count, size = rows.x.shape
    precision, information = np.zeros((count, size, size)), np.zeros((count, size))
    constant, anchors, mean = np.zeros(count), np.empty((count, 6)), np.zeros(size)
    for b in range(count):
        _anchors(kind, rows, b, anchors[b])
        if kind.form.q1 >= 0:
            put(mean, kind.form.q1, at(anchors[b], 0))
        if kind.form.q2 >= 0:
            put(mean, kind.form.q2, at(anchors[b], 3))
        multiply(rows.known_mean[b], rows.known[b], information[b])
        constant[b] = 0.5 * dot(information[b], rows.known_mean[b])
        precision[b] = rows.known[b]
        for s in range(size):
            weak = kind.pull[s] * mean[s]
            precision[b, s, s] += kind.pull[s]
            information[b, s] += weak
            constant[b] += 0.5 * weak * mean[s]
    known = precision, information, constant
    return Problem(kind.form, kind.turns, kind.shifts, rows.moments, rows.row_weight, *known, anchors)


@jit
def _weigh(
    kind: Kind,
    rows: Rows,
    problem: Problem,
    weights: Weights,
    seen: Sums,
    b: int,
    foretold: Array,
    work: Work,
) -> None:
    """As ``following._weighed`` of hypothesis b; ``work`` is at its x, ``foretold`` (K,) is memory."""
    each, directions, ticks = len(foretold), rows.hessian.shape[2], max(seen.ticks[b], 1)
    share = weights.foreknowledge * directions / each / max(rows.told[b], 1.0)
    for k in range(each):
        foretold[k] = share * exp(-2.0 * seen.gain[b, k] / max(seen.after[b], 1))
    x = rows.x[b]
    price = volume(kind.form, x, rows.first[b], foretold, kind.flat, rows.hessian[b], work)
    multiply(x, problem.precision[b], work.pull)
    price += 0.5 * dot(x, work.pull) - dot(x, problem.information[b]) + problem.constant[b]
    earned = rows.earned[b] + seen.gain[b].sum()
    told = seen.log_ratio[b] + rows.settled[b] - min(price, earned)
    rows.log_likelihood[b] = rows.lasted[b] + weights.independence * told
    rows.rms[b] = sqrt(seen.chi_sq[b] / (ticks * each))
    for k in range(each):
        rows.row_weight[b, k] = seen.precision[b, k] / ticks


def _kernels(sources: str) -> tuple[Any, Any]:
    @kernel
    def grow(
        kind: Kind,
        rows: Rows,
        number: int,
        lifted: Array,
        place: Array,
        sigma: float,
        heard: float,
        least: float,
    ) -> None:
        assert sources
        anchors, columns = np.empty(6), len(lifted)
        for b in range(len(rows.x)):
            begins = rows.onset[b] == number
            weight = (1.0 if begins else max(heard, least)) / (sigma * sigma)
            for c in range(columns):
                if begins:
                    rows.first[b, c] = lifted[c] / sigma
                for d in range(columns):
                    rows.moments[b, c, d] += weight * lifted[c] * lifted[d]
            for i in range(3):
                rows.place_sum[b, i] += weight * place[i]
            rows.weight[b] += weight
            rows.told[b] += 1.0 if begins else heard
            _anchors(kind, rows, b, anchors)
            normalise(kind.form, rows.x[b], anchors)

    @kernel
    def learn(kind: Kind, rows: Rows, ticks: Ticks, steps: Ints, tolerance: float, weights: Weights) -> None:
        assert sources
        (count, size), (_, each, directions, _) = rows.x.shape, rows.hessian.shape
        problem, seen = problem_of(kind, rows), nothing(count, each)
        work = work_for(each, rows.first.shape[1], size, directions)
        looks, foretold = seeing.work_for(each), np.empty(each)
        for b in range(count):
            if steps[b] < 0:
                continue
            x, hessian = rows.x[b], rows.hessian[b]
            descend(problem, b, x, steps[b], tolerance, hessian, work)
            onset, certain = rows.onset[b], rows.certain[b]
            add_up(kind.form, kind.body_in_1, x, onset, certain, ticks, weights.lengths, seen, b, looks)
            _weigh(kind, rows, problem, weights, seen, b, foretold, work)

    return grow, learn


grow, learn = _kernels(SOURCES)
