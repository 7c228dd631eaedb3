"""Residuals and evidence of hypotheses on the ticks since their onsets, compiled: the sums of ``summed``."""

from math import log, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled.jit import jit, kernel, memory
from contact_tracker.compiled.vectors import NONE, Vector, across, at, cross, inner, mix
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.edge_edge import SINE_SQ_FLOOR
from contact_tracker.contacts.form import Form

LOG_RATIO, CHI_SQ, TICKS, AFTER = range(4)  # in ``Sums.totals``
MOST: Final = 1e100
"""A product is taken the logarithm of before it overflows."""
T, U, TXR = 9, 12, 15  # where the lifted pose has them; R comes first


class Ticks(NamedTuple):
    """W ticks: ``number`` (W,) as ``Window.index``; ``pose`` (W, 25) lifted, of frame 1 in frame 2; ``free``
    (2, W, 2) variances of free motion, of fitted and of certain hypotheses; ``uneven`` (W or 0, 3, 3)."""

    number: NDArray[np.int64]
    pose: Array
    variance: Array
    free: Array
    uneven: Array


class Sums(NamedTuple):
    """As ``summed.Sums`` of one hypothesis: ``gain`` and ``precision`` (K,), and the rest in ``totals``: of
    LOG_RATIO, CHI_SQ, TICKS and AFTER.

    ``residual`` (K,) is that of a tick; ``narrowed`` (K,) by how many times the variance under free motion
    exceeds the noise, multiplied over ticks: a logarithm takes longer.
    """

    totals: Array
    gain: Array
    precision: Array
    residual: Array
    narrowed: Array


@memory
def sums_for(each: int) -> Sums:
    return Sums(np.empty(4), np.empty(each), np.empty(each), np.empty(each), np.empty(each))


@jit
def _turned(r: Array, first: int, v: Vector) -> Vector:
    """The matrix that begins at ``first`` in r, times v."""
    return inner(at(r, first), v), inner(at(r, first + 3), v), inner(at(r, first + 6), v)


@jit
def _faced(form: Form, body_in_1: bool, x: Array, r: Array, residual: Array) -> tuple[float, float, Vector]:
    """As ``Family.measure`` where element 2 is a plane: residuals (K); lever and reach squared, and along."""
    n, nt, h = at(x, form.d2), inner(at(x, form.d2), at(r, T)), x[form.h]
    n_r = mix(n[0], at(r, 0), n[1], at(r, 3))
    n_r = mix(1.0, n_r, n[2], at(r, 6))
    along = n if body_in_1 else n_r
    last = len(residual) - 1
    if form.q1 < 0:
        b1, b2 = across(at(x, form.d1))
        residual[0], residual[1], residual[2] = inner(n_r, b1), inner(n_r, b2), nt - h
        return 0.0, 0.0, along
    q = at(x, form.q1)
    origin = NONE if body_in_1 else mix(-1.0, at(r, U), 0.0, NONE)
    arm = mix(1.0, q, -1.0, origin)
    reach_sq, height = inner(arm, arm), inner(n_r, q)
    if form.d1 >= 0:
        d = at(x, form.d1)
        s = -inner(d, arm)
        residual[0] = inner(n_r, d)
        reach_sq -= s * s
        height += s * residual[0]
    residual[last] = height + nt - h
    if not body_in_1:
        height += nt
    return max(reach_sq - height * height, 0.0), reach_sq, along


@jit
def _crossed(form: Form, x: Array, r: Array, residual: Array) -> tuple[float, float, Vector]:
    """As ``edge_edge.measure``."""
    d1, q1, d2, q2 = at(x, form.d1), at(x, form.q1), at(x, form.d2), at(x, form.q2)
    turned = _turned(r, 0, d1)
    d2_r_m1 = inner(d2, _turned(r, 0, cross(q1, d1)))
    volume = d2_r_m1 + inner(cross(q2, d2), turned) + inner(d2, _turned(r, TXR, d1))
    cosine = inner(d2, turned)
    sine_sq = max(1.0 - cosine * cosine, SINE_SQ_FLOOR)
    w_d1 = inner(q1, d1) + inner(d1, at(r, U)) - inner(q2, turned)
    w_d2 = inner(d2, _turned(r, 0, q1)) + inner(d2, at(r, T)) - inner(d2, q2)
    s = (cosine * w_d2 - w_d1) / sine_sq
    reach_sq = inner(q1, q1) + 2.0 * s * inner(q1, d1) + s * s
    sine = sqrt(sine_sq)
    residual[0] = volume / sine
    along = mix(1.0 / sine, cross(turned, d2), 0.0, NONE)
    return max(reach_sq - d2_r_m1 * d2_r_m1 / sine_sq, 0.0), reach_sq, along


@jit
def _add(
    form: Form,
    body_in_1: bool,
    x: Array,
    ticks: Ticks,
    w: int,
    certain: int,
    after: bool,
    lengths: tuple[float, float],
    sums: Sums,
) -> None:
    """What a hypothesis says of tick w."""
    radius_sq, pull = lengths
    residual, totals = sums.residual, sums.totals
    if form.q2 >= 0:
        lever_sq, reach_sq, along = _crossed(form, x, ticks.pose[w], residual)
    else:
        lever_sq, reach_sq, along = _faced(form, body_in_1, x, ticks.pose[w], residual)
    last, position, rotation = len(residual) - 1, ticks.variance[w, 0], ticks.variance[w, 1]
    free_position, free_rotation = ticks.free[certain, w, 0], ticks.free[certain, w, 1]
    for k in range(last + 1):
        noise, excess = rotation, free_rotation
        if k == last:
            noise = position + rotation * lever_sq
            excess = free_position + free_rotation * (lever_sq + radius_sq)
            if len(ticks.uneven):
                for i in range(3):
                    noise += along[i] * inner(at(ticks.uneven[w, i], 0), along)
        whole, square = noise + excess, residual[k] * residual[k]
        inverse = 1.0 / (noise * whole)
        sums.precision[k] += position * whole * inverse
        totals[CHI_SQ] += square * whole * inverse
        if after:
            totals[LOG_RATIO] -= 0.5 * square * excess * inverse
            sums.narrowed[k] *= whole * whole * inverse
            if sums.narrowed[k] > MOST:
                sums.gain[k] += 0.5 * log(sums.narrowed[k])
                sums.narrowed[k] = 1.0
    if after and ticks.free[0, w, 0] > 0.0:
        totals[LOG_RATIO] -= pull * reach_sq


@jit
def add_up(
    form: Form,
    body_in_1: bool,
    x: Array,
    onset: int,
    certain: bool,
    ticks: Ticks,
    lengths: tuple[float, float],
    sums: Sums,
) -> None:
    """As ``summed.summed`` of one hypothesis x (S,)."""
    first, end = len(ticks.number), len(ticks.number)
    while first > 0 and ticks.number[first - 1] >= onset:
        first -= 1
    after = first + 1 if first < end and ticks.number[first] == onset else first
    sums.totals[:] = 0.0
    sums.totals[TICKS], sums.totals[AFTER] = end - first, end - after
    sums.gain[:], sums.precision[:], sums.narrowed[:] = 0.0, 0.0, 1.0
    for w in range(first, end):  # the first tick is given, and tells nothing
        _add(form, body_in_1, x, ticks, w, 1 if certain else 0, w >= after, lengths, sums)
    for k in range(len(sums.gain)):
        sums.gain[k] += 0.5 * log(sums.narrowed[k])
        sums.totals[LOG_RATIO] += sums.gain[k]


@kernel
def summed(
    form: Form,
    body_in_1: bool,
    x: Array,
    onset: NDArray[np.int64],
    certain: NDArray[np.bool_],
    ticks: Ticks,
    lengths: tuple[float, float],
    totals: Array,
    gain: Array,
    precision: Array,
) -> None:
    sums = sums_for(gain.shape[1])
    for b in range(len(x)):
        add_up(form, body_in_1, x[b], onset[b], certain[b], ticks, lengths, sums)
        totals[b], gain[b], precision[b] = sums.totals, sums.gain, sums.precision
