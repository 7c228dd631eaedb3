"""The families of ``contacts``, compiled: one formula for all, that reads from ``Form`` what a contact has.

Element 1 is a plane (direction d1), a line (d1, q1) or a point (q1); element 2 a plane (d2, h) or a line
(d2, q2). What is computed, and why, is told in the families.
"""

from math import sqrt

from contact_tracker.compiled.jit import jit
from contact_tracker.compiled.vectors import NONE, across, at, cross, inner, mix, outers, put
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.edge_edge import SINE_SQ_FLOOR, TINY
from contact_tracker.contacts.form import Form


@jit
def rows(form: Form, x: Array, out: Array) -> None:
    """As ``Family.rows``, (K, C)."""
    d1, q1, d2 = at(x, form.d1), at(x, form.q1), at(x, form.d2)
    last = len(out) - 1
    if form.q2 >= 0:
        outers(out[0], 0, d2, cross(q1, d1), cross(at(x, form.q2), d2), d1)
        outers(out[0], 9, d2, d1, NONE, NONE)
        out[0, 18] = 0.0
        return
    out[:last] = 0.0
    outers(out[last], 0, d2, q1, NONE, NONE)
    put(out[last], 9, d2)
    out[last, 12] = -x[form.h]
    if last == 1:
        outers(out[0], 0, d2, d1, NONE, NONE)
    elif last == 2:
        b1, b2 = across(d1)
        outers(out[0], 0, d2, b1, NONE, NONE)
        outers(out[1], 0, d2, b2, NONE, NONE)


@jit
def slope(form: Form, x: Array, v: Array, out: Array) -> None:
    """How the rows (K, C) change as x moves along v: ``v @ Family.rows_derivative(x)``."""
    d1, q1, d2 = at(x, form.d1), at(x, form.q1), at(x, form.d2)
    e1, p1, e2 = at(v, form.d1), at(v, form.q1), at(v, form.d2)
    last = len(out) - 1
    if form.q2 >= 0:
        q2, p2 = at(x, form.q2), at(v, form.q2)
        m1 = mix(1.0, cross(p1, d1), 1.0, cross(q1, e1))
        m2 = mix(1.0, cross(p2, d2), 1.0, cross(q2, e2))
        outers(out[0], 0, e2, cross(q1, d1), cross(q2, d2), e1)
        outers(out[0], 9, d2, m1, m2, d1)
        for i in range(9):
            out[0, i] += out[0, 9 + i]
        outers(out[0], 9, e2, d1, d2, e1)
        out[0, 18] = 0.0
        return
    out[:last] = 0.0
    outers(out[last], 0, e2, q1, d2, p1)
    put(out[last], 9, e2)
    out[last, 12] = -v[form.h]
    if last == 1:
        outers(out[0], 0, e2, d1, d2, e1)
    elif last == 2:
        b1, b2 = across(d1)
        outers(out[0], 0, e2, b1, d2, mix(-inner(e1, b1), d1, 0.0, d1))
        outers(out[1], 0, e2, b2, d2, mix(-inner(e1, b2), d1, 0.0, d1))


@jit
def slope_of_last(form: Form, x: Array, v: Array, out: Array) -> None:
    """As ``slope`` of the last row (C,), where v shifts and turns nothing; other entries remain zero."""
    p1, d2 = at(v, form.q1), at(x, form.d2)
    if form.q2 >= 0:
        d1 = at(x, form.d1)
        outers(out, 0, d2, cross(p1, d1), cross(at(v, form.q2), d2), d1)
    else:
        outers(out, 0, d2, p1, NONE, NONE)
        out[12] = -v[form.h]


@jit
def unshift(form: Form, x: Array) -> None:
    """Coordinates zero, in place."""
    for q in (form.q1, form.q2):
        if q >= 0:
            put(x, q, NONE)
    if form.h >= 0:
        x[form.h] = 0.0


@jit
def scale_sq(form: Form, row: Array, moments: Array, turn: Array) -> float:
    """As ``Family.scale_sq``; ``turn`` (9) becomes the derivative of its logarithm by ``outer(d2, d1)``."""
    if form.q2 < 0:
        return 1.0
    total = max(moments[18, 18], TINY)
    cosine_sq: float = 0.0
    for i in range(9):
        turn[i] = 0.0
        for j in range(9):
            turn[i] += moments[i, j] * row[9 + j]
        cosine_sq += row[9 + i] * turn[i]
    scale: float = max(1.0 - cosine_sq / total, SINE_SQ_FLOOR)
    factor = -2.0 / (total * scale) if scale > SINE_SQ_FLOOR else 0.0
    for i in range(9):
        turn[i] *= factor
    return scale


@jit
def normalise(form: Form, x: Array, anchors: Array) -> None:
    """As ``Family.normalise``, in place."""
    for d, q, anchor in ((form.d1, form.q1, 0), (form.d2, form.q2, 3)):
        if d >= 0:
            n = at(x, d)
            n = mix(1.0 / sqrt(inner(n, n)), n, 0.0, n)
            put(x, d, n)
            if q >= 0:
                arm = mix(1.0, at(x, q), -1.0, at(anchors, anchor))
                put(x, q, mix(1.0, at(x, q), -inner(n, arm), n))


@jit
def free(form: Form, x: Array, anchors: Array, out: Array) -> None:
    """As ``Family.tangent``, one direction after the other (P, S)."""
    out[:] = 0.0
    p = 0
    for d, q, anchor in ((form.d1, form.q1, 0), (form.d2, form.q2, 3)):
        if d < 0:
            for i in range(3):
                out[p + i, q + i] = 1.0
            p += 3
            continue
        n = at(x, d)
        b1, b2 = across(n)
        put(out[p], d, b1)
        put(out[p + 1], d, b2)
        if q >= 0:
            arm = mix(1.0, at(x, q), -1.0, at(anchors, anchor))
            put(out[p], q, mix(-inner(arm, b1), n, 0.0, n))
            put(out[p + 1], q, mix(-inner(arm, b2), n, 0.0, n))
            put(out[p + 2], q, b1)
            put(out[p + 3], q, b2)
        p += 2 if q < 0 else 4
    if form.h >= 0:
        out[p, form.h] = 1.0
