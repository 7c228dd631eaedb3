"""The algorithm of ``paper.batched``, compiled: one window after the other."""

from math import sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled.jit import jit, kernel, memory
from contact_tracker.compiled.vectors import across, at, copy, dot, eliminate, inner, multiply, put
from contact_tracker.contacts.base import Array
from contact_tracker.paper.batched import (
    FIRST_DAMPING,
    LEAST_CURVATURE,
    LEAST_DAMPING,
    LEAST_SHARE,
    LESS,
    MORE,
    MOST_DAMPING,
)
from contact_tracker.paper.kronecker import Kind

KINDS: Final[tuple[Kind, ...]] = ("point", "plane", "line")
POINT, PLANE, LINE = range(3)


class Contracted(NamedTuple):
    """K at some x and y: with x put in on the left, ``on_x`` (b, n), or y, ``on_y`` (a, n); on both sides, as
    in ``batched._Contracted``, ``by_x`` (a, a) with y, ``by_y`` (b, b) with x, ``mixed`` (b, a) with x and y.
    """

    x: Array
    y: Array
    on_x: Array
    on_y: Array
    by_x: Array
    by_y: Array
    mixed: Array


class Work(NamedTuple):
    """Memory of a step: directions in which x and y may move, ``free_x`` (P, a) and ``free_y`` (Q, b), what
    these are after a matrix, ``bent`` (6,), and gradient, curvature and step of both (P + Q)."""

    free_x: Array
    free_y: Array
    bent: Array
    gradient: Array
    curvature: Array
    step: Array


@memory
def _contracted(a: int, b: int) -> Contracted:
    n = a * b
    return Contracted(
        np.empty(a),
        np.empty(b),
        np.empty((b, n)),
        np.empty((a, n)),
        np.empty((a, a)),
        np.empty((b, b)),
        np.empty((b, a)),
    )


@memory
def _work(kind_x: int, kind_y: int, a: int, b: int) -> Work:
    p, q = 4 if kind_x == LINE else 3, 4 if kind_y == LINE else 3
    free = np.zeros((p, a)), np.zeros((q, b))
    return Work(*free, np.empty(6), np.empty(p + q), np.empty((p + q, p + q)), np.empty(p + q))


@jit
def _contract(k: Array, here: Contracted) -> float:
    """As ``batched._contracted`` at the x and y there; returns the value."""
    x, y, on_x, on_y = here.x, here.y, here.on_x, here.on_y
    a, b = len(x), len(y)
    on_x[:] = 0.0
    on_y[:] = 0.0
    for i in range(a):
        for j in range(b):
            row, by_x, by_y = k[i * b + j], on_x[j], on_y[i]
            for c in range(a * b):
                by_x[c] += x[i] * row[c]
                by_y[c] += y[j] * row[c]
    for i in range(a):
        for h in range(a):
            here.by_x[i, h] = dot(on_y[i, h * b : h * b + b], y)
    for j in range(b):
        here.by_y[j] = 0.0
        for h in range(a):
            part = on_x[j, h * b : h * b + b]
            here.mixed[j, h] = dot(part, y)
            for c in range(b):
                here.by_y[j, c] += x[h] * part[c]
    value = 0.0
    for i in range(a):
        value += x[i] * dot(here.by_x[i], x)
    return value


@jit
def _free(kind: int, e: Array, out: Array) -> None:
    """As ``batched._tangent``, a direction a row; what is never anything else is zero there already."""
    if kind == POINT:
        out[0, 0] = out[1, 1] = out[2, 2] = 1.0
        return
    u, v = across(at(e, 0))
    put(out[0], 0, u)
    put(out[1], 0, v)
    if kind == PLANE:
        out[2, 3] = 1.0
        return
    along_u, along_v = inner(at(e, 3), u), inner(at(e, 3), v)
    for i in range(3):
        out[0, 3 + i], out[1, 3 + i] = -e[i] * along_u, -e[i] * along_v
    put(out[2], 3, u)
    put(out[3], 3, v)


@jit
def _equations(here: Contracted, work: Work) -> None:
    """Gradient, and the upper triangle of the curvature."""
    p, q, curvature = len(work.free_x), len(work.free_y), work.curvature
    a, b = len(here.x), len(here.y)
    for i in range(p):
        bent = work.bent[:a]
        multiply(work.free_x[i], here.by_x, bent)
        work.gradient[i] = dot(bent, here.x)
        for j in range(i, p):
            curvature[i, j] = dot(bent, work.free_x[j])
    for i in range(q):
        bent = work.bent[:a]
        multiply(work.free_y[i], here.mixed, bent)
        for j in range(p):
            curvature[j, p + i] = dot(bent, work.free_x[j])
        bent = work.bent[:b]
        multiply(work.free_y[i], here.by_y, bent)
        work.gradient[p + i] = dot(bent, here.y)
        for j in range(i, q):
            curvature[p + i, p + j] = dot(bent, work.free_y[j])


@jit
def _damp(curvature: Array, damping: float) -> None:
    """As in ``batched._step``."""
    largest = 0.0
    for i in range(len(curvature)):
        largest = max(largest, curvature[i, i])
    floor = LEAST_SHARE * largest + LEAST_CURVATURE
    for i in range(len(curvature)):
        curvature[i, i] += damping * (curvature[i, i] + floor) + floor


@jit
def _move(kind: int, e: Array, step: Array, free: Array, out: Array) -> None:
    """As ``batched._move``, a ``step`` along the directions."""
    multiply(step, free, out)
    for i in range(len(e)):
        out[i] += e[i]
    if kind == POINT:
        return
    norm = sqrt(inner(at(out, 0), at(out, 0)))
    for i in range(3):
        out[i] /= norm
    if kind == LINE:
        along = inner(at(out, 0), at(out, 3))
        for i in range(3):
            out[3 + i] -= along * out[i]


@jit
def _try(
    kinds: tuple[int, int], k: Array, here: Contracted, damping: float, work: Work, there: Contracted
) -> float:
    """A step from ``here``; returns the value ``there``."""
    _free(kinds[0], here.x, work.free_x)
    _free(kinds[1], here.y, work.free_y)
    _equations(here, work)
    _damp(work.curvature, damping)
    for i in range(len(work.step)):
        work.step[i] = -work.gradient[i]
    eliminate(work.curvature, work.step)
    p = len(work.free_x)
    _move(kinds[0], here.x, work.step[:p], work.free_x, there.x)
    _move(kinds[1], here.y, work.step[p:], work.free_y, there.y)
    return _contract(k, there)


@kernel
def minimise(
    kinds: tuple[int, int],
    k: Array,
    x: Array,
    y: Array,
    tolerance: float,
    iterations: int,
    values: Array,
    converged: NDArray[np.bool_],
) -> None:
    """As ``batched.minimise_batched``; x and y in place."""
    a, b = x.shape[1], y.shape[1]
    here, there, work = _contracted(a, b), _contracted(a, b), _work(kinds[0], kinds[1], a, b)
    for w in range(len(k)):
        copy(x[w], here.x)
        copy(y[w], here.y)
        value, damping, converged[w] = _contract(k[w], here), FIRST_DAMPING, False
        for _ in range(iterations):
            tried = _try(kinds, k[w], here, damping, work, there)
            gain = value - tried
            if gain > 0.0:
                done = gain <= tolerance * value
                value, damping = tried, max(damping * LESS, LEAST_DAMPING)
                here, there = there, here
            else:
                done = damping >= MOST_DAMPING
                damping = min(damping * MORE, MOST_DAMPING)
            if done:
                converged[w] = True
                break
        copy(here.x, x[w])
        copy(here.y, y[w])
        values[w] = value
