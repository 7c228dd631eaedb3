"""What geometry costs that was fitted, compiled: the volume in ``evidence.complexity``."""

from math import log

from contact_tracker.compiled.fitting import Work
from contact_tracker.compiled.forms import rows as rows_of
from contact_tracker.compiled.jit import jit
from contact_tracker.compiled.vectors import dot, solve
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
def volume(
    form: Form, x: Array, first: Array, foretold: Array, flat: Array, hessian: Array, work: Work
) -> float:
    """Half the logarithm of how many times the window has narrowed the geometry down.

    ``foretold`` (K,) and ``hessian`` (K, P, P) as in ``evidence.complexity``, where ``given`` is
    ``fit.information`` of the ``first`` lifted tick (C,); ``flat`` (S,). ``work`` is at x (S,).
    """
    after, before, told, (rows, directions) = work.curvature, work.gram, work.slant, hessian.shape[:2]
    for p in range(directions):
        for q in range(p + 1):
            held = work.held[p, q]
            for s in range(len(flat)):
                held += work.free[p, s] * flat[s] * work.free[q, s]
            gained = 0.0
            for k in range(rows):
                held += foretold[k] * hessian[k, p, q]
                gained += hessian[k, p, q]
            before[p, q] = before[q, p] = held
            after[p, q] = after[q, p] = held + gained
    rows_of(form, x, work.rows)
    for k in range(rows):
        off = dot(work.rows[k], first) if k == rows - 1 else 0.0
        for p in range(directions):
            told[p] = dot(work.slopes[p, k], first) + work.leans[p] * off
            for q in range(p + 1):
                before[p, q] += work.weight[k] * told[p] * told[q]
                before[q, p] = before[p, q]
    return 0.5 * (_log_det(after, told) - _log_det(before, told))
