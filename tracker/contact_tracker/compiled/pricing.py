"""What ticks tell of geometry and what it costs, compiled: ``fit.information``, ``evidence.complexity``."""

from math import log
from typing import Any

import numpy as np

from contact_tracker.compiled.forms import free, rows, scale_sq, slope
from contact_tracker.compiled.jit import SOURCES, jit, kernel
from contact_tracker.compiled.vectors import dot, multiply, solve
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.form import Form


@jit
def _log_det(a: Array, spare: Array) -> float:
    """Logarithm of the determinant's size; a is lost."""
    spare[:] = 0.0
    solve(a, spare)
    total = 0.0
    for i in range(len(a)):
        total += log(abs(a[i, i]))
    return total


@jit
def tell(
    form: Form, lifted: Array, row_weight: Array, moments: Array, anchors: Array, x: Array, out: Array
) -> None:
    """As ``fit.information``."""
    count, columns, directions = row_weight.shape[1], lifted.shape[1], out.shape[1]
    of_x, slopes = np.empty((count, columns)), np.empty((count, columns))
    tangent, jacobian = np.empty((directions, x.shape[1])), np.empty((count, directions))
    turn = np.empty(9)
    for b in range(len(x)):
        rows(form, x[b], of_x)
        scale = scale_sq(form, of_x[count - 1], moments[b], turn)
        free(form, x[b], anchors[b], tangent)
        for p in range(directions):
            slope(form, x[b], tangent[p], slopes)
            for k in range(count):
                jacobian[k, p] = dot(slopes[k], lifted[b])
        for p in range(directions):
            for q in range(directions):
                out[b, p, q] = 0.0
                for k in range(count):
                    weight = row_weight[b, k] / (scale if k == count - 1 else 1.0)
                    out[b, p, q] += weight * jacobian[k, p] * jacobian[k, q]


@jit
def volume(
    form: Form,
    x: Array,
    anchors: Array,
    hessian: Array,
    given: Array,
    foretold: Array,
    precision: Array,
    flat: Array,
    out: Array,
) -> None:
    """Half the logarithm of how many times the window has narrowed the geometry down, (B,): the first term of
    ``evidence.complexity``."""
    size, directions = x.shape[1], given.shape[1]
    tangent, pulled = np.empty((directions, size)), np.empty(size)
    before, after = np.empty((directions, directions)), np.empty((directions, directions))
    for b in range(len(x)):
        free(form, x[b], anchors[b], tangent)
        for p in range(directions):
            multiply(tangent[p], precision[b], pulled)
            for s in range(size):
                pulled[s] += tangent[p, s] * flat[s]
            for q in range(directions):
                before[p, q] = dot(tangent[q], pulled)
                after[p, q] = 0.0
                for k in range(hessian.shape[1]):
                    before[p, q] += foretold[b, k] * hessian[b, k, p, q]
                    after[p, q] += hessian[b, k, p, q]
        for p in range(directions):
            for q in range(directions):
                after[p, q] += before[p, q]
                before[p, q] += given[b, p, q]
        spare = pulled[:directions]
        out[b] = 0.5 * (_log_det(after, spare) - _log_det(before, spare))


def _kernel(sources: str) -> Any:
    @kernel
    def information(
        form: Form, lifted: Array, row_weight: Array, moments: Array, anchors: Array, x: Array, out: Array
    ) -> None:
        assert sources
        tell(form, lifted, row_weight, moments, anchors, x, out)

    return information


information = _kernel(SOURCES)
