"""Which hypotheses are dropped, compiled: as ``bank.prune``."""

from contact_tracker.compiled.hypothesis import Ints, Where, joint_of
from contact_tracker.compiled.jit import jit, kernel
from contact_tracker.compiled.vectors import copy
from contact_tracker.contacts.base import Array
from contact_tracker.pace import MET_SHARE, YOUNG


@jit
def _has_chances(
    where: Where, table: Array, whole: Ints, b: int, best: float, margin: float, patience: float
) -> bool:
    share = MET_SHARE if whole[b, where.met] != 0 else 1.0
    patient: bool = table[b, where.told] <= patience and whole[b, where.searched] != 0
    return patient or joint_of(where, table, b) > best - share * margin


@jit
def _span(where: Where, whole: Ints, b: int, now: int) -> tuple[int, int]:
    """Of so many ticks' onsets one is kept, and which span of them it is in."""
    onset = whole[b, where.onset]
    age, ticks = now + 1 - onset, 2
    if age <= YOUNG:
        return 1, onset
    while age >= YOUNG * ticks:
        ticks *= 2
    return ticks, onset // ticks


@jit
def _is_best(where: Where, table: Array, whole: Ints, b: int, now: int) -> bool:
    """Of those whose onsets share a span, which stand beside each other; of equally good ones the first."""
    span, joint = _span(where, whole, b, now), joint_of(where, table, b)
    if span[0] == 1:
        return True
    c = b - 1
    while c >= 0 and _span(where, whole, c, now) == span:
        if joint_of(where, table, c) >= joint:
            return False
        c -= 1
    c = b + 1
    while c < len(table) and _span(where, whole, c, now) == span:
        if joint_of(where, table, c) > joint:
            return False
        c += 1
    return True


@kernel
def prune(
    where: Where,
    table: Array,
    whole: Ints,
    now: int,
    best: float,
    margin: float,
    patience: float,
    rows: Ints,
    kept: Array,
) -> int:
    count = 0
    for b in range(len(table)):
        chances = _has_chances(where, table, whole, b, best, margin, patience)
        if chances and _is_best(where, table, whole, b, now):
            rows[count] = b
            copy(table[b], kept[count])
            kept[count, where.entry] -= best
            count += 1
    return count
