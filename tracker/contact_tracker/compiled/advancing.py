"""What ``hypotheses.advanced`` does to all hypotheses of one contact in a tick, compiled."""

from math import isnan

import numpy as np

from contact_tracker.compiled.following import (
    Minds,
    Newest,
    Weights,
    grow_one,
    learn_one,
    minds_for,
    steps_of,
)
from contact_tracker.compiled.hypothesis import Ints, Kind
from contact_tracker.compiled.jit import jit, kernel
from contact_tracker.compiled.offering import costs_for, offer
from contact_tracker.compiled.seeing import Ticks
from contact_tracker.compiled.vectors import copy
from contact_tracker.contacts.base import Array
from contact_tracker.pace import AGES, AT_REST, AT_THE_NOISE, DUE

_AGES = np.array(AGES, float)
GROUPS = 2 * (len(AGES) + 1)


@jit
def _adopt(
    kind: Kind, table: Array, whole: Ints, ticks: Ticks, weights: Weights, giver: Ints, x: Array, minds: Minds
) -> None:
    """Let hypotheses take the geometry of their ``giver``; x (N, S) is memory."""
    first, last = kind.where.x, kind.where.x + kind.size
    for b in range(len(table)):
        copy(table[b, first:last], x[b])
    for b in range(len(table)):
        if giver[b] != b:
            copy(x[giver[b]], table[b, first:last])
            learn_one(kind, table, whole, b, ticks, steps_of(kind, table, b), weights, minds)


@jit
def _group(kind: Kind, table: Array, whole: Ints, b: int) -> int:
    """Of hypothesis b, as in ``search.lost``; -1 if it does not search."""
    where, told = kind.where, table[b, kind.where.told]
    due = DUE[min(int(told), len(DUE) - 1)]
    if not (due and table[b, where.rms] > AT_THE_NOISE and whole[b, where.searched] != 0):
        return -1
    passed = 0
    while passed < len(_AGES) and _AGES[passed] <= told:
        passed += 1
    return 2 * passed + (1 if whole[b, where.source] > 0 else 0)


@jit
def _joint(kind: Kind, table: Array, b: int) -> float:
    joint: float = table[b, kind.where.entry] + table[b, kind.where.log_likelihood]
    return joint


@jit
def _lost(kind: Kind, table: Array, whole: Ints, best: Ints, lost: Ints) -> int:
    """As ``search.lost``, into ``lost``; returns how many. ``best`` (GROUPS,) is memory."""
    best[:] = -1
    for b in range(len(table)):
        group = _group(kind, table, whole, b)
        if group >= 0:
            rival, joint = best[group], _joint(kind, table, b)
            if rival < 0 or joint > _joint(kind, table, rival) or isnan(_joint(kind, table, rival)):
                best[group] = b
    count = 0
    for group in range(GROUPS):
        if best[group] >= 0:
            lost[count] = best[group]
            count += 1
    return count


@kernel
def advance(
    kind: Kind,
    table: Array,
    whole: Ints,
    ticks: Ticks,
    tick: Newest,
    weights: Weights,
    margin: float,
    due: bool,
    lost: Ints,
) -> int:
    minds, count = minds_for(kind), len(table)
    for b in range(count):
        hopeless = _joint(kind, table, b) < -margin
        grow_one(kind, table, whole, b, tick, minds.work.prior.anchors)
        if not hopeless:
            learn_one(kind, table, whole, b, ticks, steps_of(kind, table, b), weights, minds)
    if not due:
        return 0
    giver = np.empty(count, np.int64)
    offer(kind, table, costs_for(kind, count), np.empty((count, count)), giver, minds.work)
    _adopt(kind, table, whole, ticks, weights, giver, np.empty((count, kind.size)), minds)
    if tick.heard <= AT_REST:
        return 0
    return _lost(kind, table, whole, np.empty(GROUPS, np.int64), lost)
