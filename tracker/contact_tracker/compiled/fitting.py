"""The algorithm of ``fit.minimise`` and ``fit.complete``, compiled: one window after the other."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled.forms import free, normalise, rows, scale_sq, slope
from contact_tracker.compiled.jit import jit
from contact_tracker.compiled.vectors import dot, multiply, solve
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.form import Form
from contact_tracker.fit import LEAST_CURVATURE, LEAST_SHARE

Ints = NDArray[np.int64]


class Problem(NamedTuple):
    """What ``fit.minimise`` takes of W windows; ``alike`` is ``form.mean_of_alike``."""

    moments: Array
    row_weight: Array
    precision: Array
    information: Array
    constant: Array
    anchors: Array
    alike: Array


class Work(NamedTuple):
    """Memory of one window: at its x the weights (K,) of the rows, their slopes (P, K, C) along the ``free``
    directions (P, S), how much of the last row is in its slopes since its scale ``leans`` (P,) as well, and
    what is ``held`` (P, P) by the prior; and what comes between."""

    weight: Array
    leans: Array
    slopes: Array
    free: Array
    rows: Array
    design: Array
    gradient: Array
    held: Array
    curvature: Array
    step: Array
    trial: Array
    gram: Array
    slant: Array
    pull: Array
    axis: Array
    products: Array
    turn: Array


@jit
def work_for(count: int, columns: int, size: int, directions: int) -> Work:
    return Work(
        weight=np.empty(count),
        leans=np.zeros(directions),
        slopes=np.empty((directions, count, columns)),
        free=np.empty((directions, size)),
        rows=np.empty((count, columns)),
        design=np.empty((size, count, columns)),
        gradient=np.empty(directions),
        held=np.empty((directions, directions)),
        curvature=np.empty((directions, directions)),
        step=np.empty(directions),
        trial=np.empty(size),
        gram=np.empty((directions, directions)),
        slant=np.empty(directions),
        pull=np.empty(size),
        axis=np.zeros(size),
        products=np.empty((2, max(columns, size))),
        turn=np.empty(9),
    )


@jit
def complete_one(form: Form, linear: Ints, problem: Problem, b: int, x: Array, work: Work) -> float:
    """As ``fit.complete`` of window b, x in place; returns the cost."""
    moments, precision, information = problem.moments[b], problem.precision[b], problem.information[b]
    last, columns, count = len(work.rows) - 1, len(moments), len(linear)
    bare, along, design = work.products[0, :columns], work.products[1, :columns], work.design
    gram, slant, normal = work.gram, work.slant, work.curvature[:count, :count]
    for i in linear:
        x[i] = 0.0
    rows(form, x, work.rows)
    weight = problem.row_weight[b, last] / scale_sq(form, work.rows[last], moments, work.turn)
    squares = 0.0
    for k in range(last):  # angles do not depend on coordinates
        multiply(work.rows[k], moments, bare)
        squares += problem.row_weight[b, k] * dot(work.rows[k], bare)
    multiply(work.rows[last], moments, bare)
    squares += weight * dot(work.rows[last], bare)
    multiply(x, precision, work.pull)
    trace = 0.0
    for i in range(count):
        work.axis[linear[i]] = 1.0
        slope(form, x, work.axis, design[i])
        work.axis[linear[i]] = 0.0
        slant[i] = weight * dot(design[i, last], bare)
        work.step[i] = information[linear[i]] - work.pull[linear[i]] - slant[i]
        multiply(design[i, last], moments, along)
        for j in range(i + 1):
            gram[i, j] = gram[j, i] = weight * dot(design[j, last], along)
            normal[i, j] = normal[j, i] = gram[i, j] + precision[linear[i], linear[j]]
        trace += normal[i, i]
    for i in range(count):
        normal[i, i] += LEAST_SHARE * trace + LEAST_CURVATURE
    solve(normal, work.step[:count])
    for i in range(count):
        x[linear[i]] = work.step[i]
    normalise(form, x, problem.anchors[b])
    for i in range(count):
        squares += 2.0 * x[linear[i]] * slant[i]
        for j in range(count):
            squares += x[linear[i]] * gram[i, j] * x[linear[j]]
    multiply(x, precision, work.pull)
    cost: float = 0.5 * (squares + dot(x, work.pull)) - dot(x, information) + problem.constant[b]
    return cost


@jit
def _equations(form: Form, problem: Problem, b: int, x: Array, hessian: Array, work: Work) -> None:
    """As ``fit._normal_equations`` of window b: free directions, gradient, hessian (K, P, P) and held."""
    moments, precision, anchors = problem.moments[b], problem.precision[b], problem.anchors[b]
    last, columns, size, count = len(work.rows) - 1, len(moments), len(x), len(work.gradient)
    along, pulled = work.products[0, :columns], work.products[1, :size]
    rows(form, x, work.rows)
    scale = scale_sq(form, work.rows[last], moments, work.turn)
    free(form, x, anchors, work.free)
    multiply(x, precision, work.pull)
    for p in range(count):
        slope(form, x, work.free[p], work.slopes[p])
        if form.q2 >= 0:  # per metre: the scale changes with x as well
            work.leans[p] = 0.5 * dot(work.turn, work.slopes[p, last, 9:18])
            for c in range(columns):
                work.slopes[p, last, c] -= work.leans[p] * work.rows[last, c]
        work.gradient[p] = dot(work.free[p], work.pull) - dot(work.free[p], problem.information[b])
        multiply(work.free[p], precision, pulled)
        for q in range(p + 1):
            work.held[p, q] = work.held[q, p] = dot(work.free[q], pulled)
    for k in range(last + 1):
        work.weight[k] = problem.row_weight[b, k] / (scale if k == last else 1.0)
        for p in range(count):
            multiply(work.slopes[p, k], moments, along)
            work.gradient[p] += work.weight[k] * dot(work.rows[k], along)
            for q in range(p + 1):
                hessian[k, p, q] = hessian[k, q, p] = work.weight[k] * dot(work.slopes[q, k], along)


@jit
def _step(hessian: Array, damping: float, alike: Array, work: Work) -> float:
    """As ``fit._step``; returns by how much it would lower the cost."""
    curvature, diagonal, ridge = work.curvature, work.slant, work.gram[0]
    for p in range(len(work.step)):
        work.step[p] = -work.gradient[p]
        for q in range(len(work.step)):
            curvature[p, q] = work.held[p, q]
            for k in range(len(hessian)):
                curvature[p, q] += hessian[k, p, q]
        diagonal[p] = curvature[p, p]
    multiply(diagonal, alike, ridge)
    for p in range(len(work.step)):
        curvature[p, p] += damping * ridge[p] + LEAST_CURVATURE
    solve(curvature, work.step)
    return abs(dot(work.gradient, work.step))


@jit
def descend(
    form: Form,
    linear: Ints,
    problem: Problem,
    w: int,
    x: Array,
    steps: int,
    tolerance: float,
    hessian: Array,
    work: Work,
) -> tuple[float, bool]:
    """As ``fit.minimise`` of window w, from x (S,), in place; what ``work`` holds is that at x.

    Returns the cost, and whether it has converged.
    """
    damping, left = 1e-3, steps
    cost = complete_one(form, linear, problem, w, x, work)
    _equations(form, problem, w, x, hessian, work)
    while True:
        if _step(hessian, damping, problem.alike, work) < tolerance:
            return cost, True
        if left <= 0:
            return cost, False
        left -= 1
        multiply(work.step, work.free, work.trial)
        for i in range(len(x)):
            work.trial[i] += x[i]
        normalise(form, work.trial, problem.anchors[w])
        proposed = complete_one(form, linear, problem, w, work.trial, work)
        better = proposed < cost
        damping = min(max(damping * (0.2 if better else 8.0), 1e-9), 1e6)
        if better:
            x[:] = work.trial
            cost = proposed
            _equations(form, problem, w, x, hessian, work)
