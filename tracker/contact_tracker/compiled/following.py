"""What ``following`` does to a bank in every tick, compiled: its moments grow, and it learns from them."""

from math import exp, sqrt
from typing import NamedTuple

import numpy as np

from contact_tracker.compiled.fitting import Work, descend, work_for
from contact_tracker.compiled.forms import normalise
from contact_tracker.compiled.hypothesis import Ints, Kind, Row, anchor, know, row_of
from contact_tracker.compiled.jit import jit, kernel, memory, part
from contact_tracker.compiled.pricing import volume
from contact_tracker.compiled.seeing import (
    AFTER,
    CHI_SQ,
    LOG_RATIO,
    TICKS,
    Sums,
    T,
    Ticks,
    U,
    add_up,
    sums_for,
)
from contact_tracker.compiled.vectors import NONE, at, dot, mix, multiply
from contact_tracker.contacts.base import Array
from contact_tracker.fit import TOLERANCE
from contact_tracker.pace import AT_REST, FIRST_STEPS, FIRST_TICKS, REFINE_STEPS


class Weights(NamedTuple):
    """``lengths`` as ``seeing.add_up`` takes them; the rest as in ``evidence.Scales``."""

    lengths: tuple[float, float]
    foreknowledge: float
    independence: float


@jit
def _weigh(
    kind: Kind, row: Row, numbers: Array, weights: Weights, sums: Sums, foretold: Array, work: Work
) -> None:
    """As ``following._weighed``; ``work`` is at the hypothesis' x, ``numbers`` its row of the table,
    ``foretold`` (K,) memory."""
    x, prior, where, ticks = row.x, work.prior, kind.where, max(sums.totals[TICKS], 1.0)
    share = weights.foreknowledge * kind.needed / max(numbers[where.told], 1.0)
    earned = numbers[where.earned]
    for k in range(kind.each):
        foretold[k] = share * exp(-2.0 * sums.gain[k] / max(sums.totals[AFTER], 1.0))
        earned += sums.gain[k]
        row.row_weight[k] = sums.precision[k] / ticks
    price = volume(kind.form, x, row.first, foretold, kind.flat, row.hessian, work)
    multiply(x, prior.precision, work.pull)
    price += 0.5 * dot(x, work.pull) - dot(x, prior.information) + prior.constant[0]
    told = sums.totals[LOG_RATIO] + numbers[where.settled] - min(price, earned)
    numbers[where.log_likelihood] = numbers[where.lasted] + weights.independence * told
    numbers[where.rms] = sqrt(sums.totals[CHI_SQ] / (ticks * kind.each))


class Minds(NamedTuple):
    """Memory for what hypotheses learn, one after the other: of ``fitting`` and of ``seeing``, ``foretold``
    (K,)."""

    work: Work
    sums: Sums
    foretold: Array


@memory
def minds_for(kind: Kind) -> Minds:
    return Minds(work_for(kind), sums_for(kind.each), np.empty(kind.each))


@jit
def grow_one(
    kind: Kind, table: Array, whole: Ints, b: int, ticks: Ticks, heard: float, log_stay: float, work: Work
) -> None:
    """As ``following.grow`` of hypothesis b, by the newest of ``ticks``, in which so much motion is
    ``heard``."""
    row, numbers, where = row_of(kind, table, b), table[b], kind.where
    pose, precision = ticks.pose[-1], 1.0 / ticks.variance[-1, 0]
    begins = whole[b, where.onset] == ticks.number[-1]
    weight = precision * (1.0 if begins else max(heard, AT_REST))
    for c in range(kind.columns):
        entry = pose[kind.lifted[c]]
        if begins:
            row.first[c] = entry * sqrt(precision)
        for d in range(kind.columns):
            row.moments[c, d] += weight * entry * pose[kind.lifted[d]]
    place = at(pose, T) if kind.body_in_1 else mix(-1.0, at(pose, U), 0.0, NONE)
    for i in range(3):
        row.place_sum[i] += weight * place[i]
    numbers[where.weight] += weight
    numbers[where.told] += 1.0 if begins else heard
    numbers[where.lasted] += 0.0 if begins else log_stay
    anchor(kind, row, numbers[where.weight], work.prior.anchors)
    normalise(kind.form, row.x, work.prior.anchors)


@part
def learn_one(
    kind: Kind, table: Array, whole: Ints, b: int, ticks: Ticks, steps: int, weights: Weights, minds: Minds
) -> None:
    """As ``following.learn`` of hypothesis b."""
    row, numbers, work, sums = row_of(kind, table, b), table[b], minds.work, minds.sums
    know(kind, row, numbers[kind.where.weight], work.mean, work.prior)
    descend(kind, row, row.x, steps, TOLERANCE, row.hessian, work)
    onset, certain = whole[b, kind.where.onset], whole[b, kind.where.certain] != 0
    add_up(kind.form, kind.body_in_1, row.x, onset, certain, ticks, weights.lengths, sums)
    _weigh(kind, row, numbers, weights, sums, minds.foretold, work)


@jit
def steps_of(kind: Kind, table: Array, b: int) -> int:
    """How many steps hypothesis b takes in every tick."""
    return FIRST_STEPS if table[b, kind.where.told] < FIRST_TICKS else REFINE_STEPS


@kernel
def learn(kind: Kind, table: Array, whole: Ints, ticks: Ticks, steps: Ints, weights: Weights) -> None:
    minds = minds_for(kind)
    for b in range(len(table)):
        if steps[b] >= 0:
            learn_one(kind, table, whole, b, ticks, steps[b], weights, minds)
