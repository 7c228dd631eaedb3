"""The algorithm of ``fit.minimise`` and ``fit.complete``, compiled: one window after the other."""

from typing import NamedTuple

import numpy as np

from contact_tracker.compiled.forms import free, normalise, rows, scale_sq, slope, slope_of_last, unshift
from contact_tracker.compiled.hypothesis import Kind, Prior, Row
from contact_tracker.compiled.jit import jit, memory
from contact_tracker.compiled.vectors import copy, dot, eliminate, multiply
from contact_tracker.contacts.base import Array
from contact_tracker.fit import (
    FIRST_DAMPING,
    LEAST_CURVATURE,
    LEAST_DAMPING,
    LEAST_SHARE,
    LESS,
    MORE,
    MOST_DAMPING,
)


class Work(NamedTuple):
    """Memory of one window: its ``prior``, and what that needs, ``mean``.

    At its x: ``weight`` (K,) of the rows, ``slopes`` (P, K, C) along the ``free`` directions (P, S), the
    share of the last row that is taken out of its own, since its scale changes, too, ``leans`` (P,), and what
    is ``held`` (P, P) by the prior.

    Where a trial of coordinates has come to: ``rows`` (K, C) and the same times the moments, ``carried``,
    their ``trial_weight`` (K,), free directions before shifting, ``axes``, and slopes of the last row along
    the shifts, ``design`` (L, C), which times the moments are ``moved``. The rest comes between.
    """

    prior: Prior
    mean: Array
    weight: Array
    slopes: Array
    free: Array
    leans: Array
    held: Array
    rows: Array
    carried: Array
    trial_weight: Array
    design: Array
    moved: Array
    axes: Array
    pushed: Array
    gradient: Array
    curvature: Array
    before: Array
    step: Array
    trial: Array
    pull: Array
    pulled: Array
    turn: Array


@memory
def work_for(kind: Kind) -> Work:
    count, columns, size, directions = kind.each, kind.columns, kind.size, kind.free
    prior = Prior(np.empty((size, size)), np.empty(size), np.empty(1), np.empty(6))
    return Work(
        prior=prior,
        mean=np.zeros(size),
        weight=np.empty(count),
        slopes=np.zeros((directions, count, columns)),
        free=np.empty((directions, size)),
        leans=np.zeros(directions),
        held=np.empty((directions, directions)),
        rows=np.empty((count, columns)),
        carried=np.empty((count, columns)),
        trial_weight=np.empty(count),
        design=np.zeros((directions, columns)),
        moved=np.empty((directions, columns)),
        axes=np.empty((directions, size)),
        pushed=np.empty((count, columns)),
        gradient=np.empty(directions),
        curvature=np.empty((directions, directions)),
        before=np.empty((directions, directions)),
        step=np.empty(directions),
        trial=np.empty(size),
        pull=np.empty(size),
        pulled=np.empty(size),
        turn=np.empty(9),
    )


@jit
def complete_one(kind: Kind, row: Row, x: Array, work: Work) -> float:
    """As ``fit.complete`` of one window, x in place; returns the cost."""
    form, shifts, moments = kind.form, kind.shifts, row.moments
    precision, information, anchors = work.prior.precision, work.prior.information, work.prior.anchors
    last, count, size = len(work.rows) - 1, len(shifts), len(x)
    unshift(form, x)
    normalise(form, x, anchors)
    rows(form, x, work.rows)
    free(form, x, anchors, work.axes)
    scale = scale_sq(form, work.rows[last], moments, work.turn)
    for k in range(last + 1):
        multiply(work.rows[k], moments, work.carried[k])
        work.trial_weight[k] = row.row_weight[k] / (scale if k == last else 1.0)
    weight = work.trial_weight[last]
    multiply(x, precision, work.pull)
    for s in range(size):
        work.pull[s] -= information[s]
    normal, shift, pulled, trace = work.curvature[:count, :count], work.step[:count], work.pulled, 0.0
    for i in range(count):
        along = work.axes[shifts[i]]
        slope_of_last(form, x, along, work.design[i])
        multiply(work.design[i], moments, work.moved[i])
        multiply(along, precision, pulled)
        shift[i] = -weight * dot(work.design[i], work.carried[last]) - dot(along, work.pull)
        for j in range(i + 1):
            normal[j, i] = weight * dot(work.design[j], work.moved[i]) + dot(work.axes[shifts[j]], pulled)
        trace += normal[i, i]
    for i in range(count):
        normal[i, i] += LEAST_SHARE * trace + LEAST_CURVATURE
    eliminate(normal, shift)
    for i in range(count):
        along = work.axes[shifts[i]]
        for s in range(size):
            x[s] += shift[i] * along[s]
        for c in range(len(moments)):
            work.rows[last, c] += shift[i] * work.design[i, c]
            work.carried[last, c] += shift[i] * work.moved[i, c]
    squares = 0.0
    for k in range(last + 1):
        squares += work.trial_weight[k] * dot(work.rows[k], work.carried[k])
    multiply(x, precision, work.pull)
    cost: float = 0.5 * (squares + dot(x, work.pull)) - dot(x, information) + work.prior.constant[0]
    return cost


@jit
def _equations(kind: Kind, row: Row, x: Array, hessian: Array, work: Work) -> None:
    """As ``fit._normal_equations`` of one window, at the x where ``complete_one`` has just come to: free
    directions, gradient, hessian (K, P, P) and held."""
    form, turns, shifts, moments = kind.form, kind.turns, kind.shifts, row.moments
    precision, information = work.prior.precision, work.prior.information
    last, count = len(work.rows) - 1, len(work.gradient)
    free(form, x, work.prior.anchors, work.free)
    hessian[:last] = 0.0
    copy(work.trial_weight, work.weight)
    weight = work.weight[last]
    for s in range(len(x)):
        work.pull[s] -= information[s]  # complete_one has left x times the precision there
    for p in range(count):
        multiply(work.free[p], precision, work.pulled)
        work.gradient[p] = dot(work.free[p], work.pull)
        for q in range(p + 1):
            work.held[p, q] = work.held[q, p] = dot(work.free[q], work.pulled)
    for i in range(len(shifts)):
        p = shifts[i]
        copy(work.design[i], work.slopes[p, last])
        work.gradient[p] += weight * dot(work.design[i], work.carried[last])
        for j in range(i + 1):
            q = shifts[j]
            hessian[last, p, q] = hessian[last, q, p] = weight * dot(work.design[j], work.moved[i])
    for i in range(len(turns)):
        p = turns[i]
        slope(form, x, work.free[p], work.slopes[p])
        if form.q2 >= 0:  # per metre: the scale changes with x as well
            work.leans[p] = 0.5 * dot(work.turn, work.slopes[p, last, 9:18])
            for c in range(len(moments)):
                work.slopes[p, last, c] -= work.leans[p] * work.rows[last, c]
        for k in range(last + 1):
            multiply(work.slopes[p, k], moments, work.pushed[k])
            work.gradient[p] += work.weight[k] * dot(work.slopes[p, k], work.carried[k])
            for j in range(i + 1):
                q = turns[j]
                hessian[k, p, q] = hessian[k, q, p] = work.weight[k] * dot(work.slopes[q, k], work.pushed[k])
        for j in range(len(shifts)):
            q = shifts[j]
            hessian[last, p, q] = hessian[last, q, p] = weight * dot(work.design[j], work.pushed[last])


@jit
def _step(kind: Kind, hessian: Array, damping: float, work: Work) -> float:
    """As ``fit._step``; returns by how much it would lower the cost."""
    curvature = work.curvature
    for p in range(len(work.step)):
        work.step[p] = -work.gradient[p]
        for q in range(p, len(work.step)):
            curvature[p, q] = work.held[p, q]
            for k in range(len(hessian)):
                curvature[p, q] += hessian[k, p, q]
        curvature[p, p] += LEAST_CURVATURE
    for p in kind.turns:
        curvature[p, p] += damping
    eliminate(curvature, work.step)
    return abs(dot(work.gradient, work.step))


@jit
def descend(
    kind: Kind, row: Row, x: Array, steps: int, tolerance: float, hessian: Array, work: Work
) -> tuple[float, bool]:
    """As ``fit.minimise`` of one window, from x (S,), in place; what ``work`` holds at an x is at that one.

    Returns the cost, and whether it has converged.
    """
    damping, left, cost = FIRST_DAMPING, steps, np.inf
    copy(x, work.trial)
    while True:  # what is compiled into this is long: once each, it stays at hand
        proposed = complete_one(kind, row, work.trial, work)
        better = proposed < cost
        if better or left == steps:
            copy(work.trial, x)
            cost = proposed
            _equations(kind, row, x, hessian, work)
        if left < steps:
            damping = min(max(damping * (LESS if better else MORE), LEAST_DAMPING), MOST_DAMPING)
        if _step(kind, hessian, damping, work) < tolerance:
            return cost, True
        if left <= 0:
            return cost, False
        left -= 1
        multiply(work.step, work.free, work.trial)
        for i in range(len(x)):
            work.trial[i] += x[i]
