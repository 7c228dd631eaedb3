"""What geometry costs that was fitted, compiled: the volume in ``evidence.complexity``."""

from math import log

from contact_tracker.compiled.fitting import Work
from contact_tracker.compiled.forms import rows as rows_of
from contact_tracker.compiled.jit import jit
from contact_tracker.compiled.vectors import dot, eliminate
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.form import Form


@jit
def volume(
    form: Form, x: Array, first: Array, foretold: Array, flat: Array, hessian: Array, work: Work
) -> float:
    """Half the logarithm of how many times the window has narrowed the geometry down.

    ``foretold`` (K,) and ``hessian`` (K, P, P) as in ``evidence.complexity``, where ``given`` is
    ``fit.information`` of the ``first`` lifted tick (C,); ``flat`` (S,). ``work`` is at x (S,).
    """
    after, before, told, (rows, directions) = work.curvature, work.before, work.step, hessian.shape[:2]
    for p in range(directions):
        for q in range(p, directions):
            held = work.held[p, q]
            for s in range(len(flat)):
                held += work.free[p, s] * flat[s] * work.free[q, s]
            gained = 0.0
            for k in range(rows):
                held += foretold[k] * hessian[k, p, q]
                gained += hessian[k, p, q]
            before[p, q], after[p, q] = held, held + gained
    rows_of(form, x, work.rows)
    for k in range(rows):
        off = dot(work.rows[k], first) if k == rows - 1 else 0.0
        for p in range(directions):
            told[p] = dot(work.slopes[p, k], first) + work.leans[p] * off
            for q in range(p + 1):
                before[q, p] += work.weight[k] * told[p] * told[q]
    told[:] = 0.0
    eliminate(after, told)
    eliminate(before, told)
    ratio = 1.0
    for p in range(directions):
        ratio *= abs(after[p, p] / before[p, p])
    return 0.5 * log(ratio)
