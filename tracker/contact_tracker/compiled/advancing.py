"""What ``hypotheses.advance`` does to all hypotheses of one contact in a tick, compiled."""

from math import isnan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled.following import (
    Minds,
    Weights,
    grow_one,
    learn_one,
    minds_for,
    steps_of,
)
from contact_tracker.compiled.hypothesis import Ints, Kind, joint_of
from contact_tracker.compiled.jit import jit, kernel
from contact_tracker.compiled.offering import costs_for, offer
from contact_tracker.compiled.searching import hunt_for, search_one
from contact_tracker.compiled.seeing import Ticks
from contact_tracker.compiled.vectors import at, copy, inner
from contact_tracker.contacts.base import Array
from contact_tracker.pace import AGES, AT_REST, AT_THE_NOISE, DUE, FAR_NATS, FIRST_TICKS

GROUPS = 2 * (len(AGES) + 1)


class Birth(NamedTuple):
    """As ``bank.Birth``: ``words`` (n, words) of hypotheses that have seen nothing, and what (n, S) is
    ``told`` of their geometry."""

    words: Array
    told: NDArray[np.bool_]
    turn: Array
    onset: int
    onset_ns: int
    number: int
    entry: float


@jit
def _join(kind: Kind, old: Array, birth: Birth, table: Array, whole: Ints) -> None:
    """As ``bank.add``, into ``table`` (H + n, words)."""
    where, count, best = kind.where, len(old), 0
    for b in range(count):
        copy(old[b], table[b])
        if joint_of(kind.where, old, b) > joint_of(kind.where, old, best):
            best = b
    d = kind.form.d2 if kind.body_in_1 else kind.form.d1
    for i in range(len(birth.words)):
        b = count + i
        row = table[b]
        copy(birth.words[i], row)
        whole[b, where.onset], whole[b, where.onset_ns] = birth.onset, birth.onset_ns
        whole[b, where.number], row[where.entry] = birth.number + i, birth.entry
        if count:
            for k in range(kind.each):
                row[where.row_weight + k] = old[best, where.row_weight + k]
        elif d >= 0:
            v = at(birth.words[i], where.x + d)
            for j in range(3):
                row[where.x + d + j] = inner(at(birth.turn[j], 0), v)
        for s in range(kind.size):
            if birth.told[i, s]:
                row[where.x + s] = row[where.known_mean + s]
            elif count:
                row[where.x + s] = old[best, where.x + s]


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
    if told > kind.patience and joint_of(where, table, b) < -FAR_NATS:
        return -1
    due = DUE[min(int(told), len(DUE) - 1)]
    if not (due and table[b, where.rms] > AT_THE_NOISE and whole[b, where.searched] != 0):
        return -1
    passed = 0
    while passed < len(AGES) and AGES[passed] <= told:
        passed += 1
    return 2 * passed + (1 if whole[b, where.source] > 0 else 0)


@jit
def _lost(kind: Kind, table: Array, whole: Ints, best: Ints, lost: Ints) -> int:
    """As ``search.lost``, into ``lost``; returns how many. ``best`` (GROUPS,) is memory."""
    best[:] = -1
    for b in range(len(table)):
        group = _group(kind, table, whole, b)
        if group >= 0:
            rival, joint = best[group], joint_of(kind.where, table, b)
            if (
                rival < 0
                or joint > joint_of(kind.where, table, rival)
                or isnan(joint_of(kind.where, table, rival))
            ):
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
    old: Array,
    birth: Birth,
    table: Array,
    whole: Ints,
    ticks: Ticks,
    heard: float,
    weights: Weights,
    log_stay: float,
    margin: float,
    directions: Array,
    found: Array,
    as_whole: Ints,
) -> None:
    minds, count, due = minds_for(kind), len(table), len(directions) > 0
    _join(kind, old, birth, table, whole)
    for b in range(count):
        waits = not due and table[b, kind.where.told] >= FIRST_TICKS
        far = joint_of(kind.where, table, b) < -(min(margin, FAR_NATS) if waits else margin)
        grow_one(kind, table, whole, b, ticks, heard, log_stay, minds.work)
        if not far:
            learn_one(kind, table, whole, b, ticks, steps_of(kind, table, b), weights, minds)
    if not due:
        return
    giver = np.empty(count, np.int64)
    offer(kind, table, costs_for(kind, count), np.empty((count, count)), giver, minds.work)
    _adopt(kind, table, whole, ticks, weights, giver, np.empty((count, kind.size)), minds)
    if heard <= AT_REST:
        return
    lost, hunt = np.empty(GROUPS, np.int64), hunt_for(kind, directions, found, as_whole)
    for i in range(_lost(kind, table, whole, np.empty(GROUPS, np.int64), lost)):
        search_one(kind, table, lost[i], directions, ticks, weights, hunt, minds)
