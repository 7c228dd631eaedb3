"""A hypothesis as kernels see it: its row of the table, and what it knew before its window."""

from math import isnan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled.jit import jit
from contact_tracker.compiled.vectors import at, dot, multiply, put
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.form import Form

Ints = NDArray[np.int64]


class Where(NamedTuple):
    """At which word of a row the columns of ``table.Bank`` begin."""

    onset: int
    onset_ns: int
    number: int
    source: int
    certain: int
    searched: int
    met: int
    entry: int
    lasted: int
    settled: int
    earned: int
    weight: int
    told: int
    log_likelihood: int
    rms: int
    known_mean: int
    known: int
    pivot: int
    first: int
    moments: int
    place_sum: int
    x: int
    hessian: int
    row_weight: int


class Kind(NamedTuple):
    """What sort of contact it is, see ``contacts``: the sizes S, C, K (of ``each`` pose) and P (``free``);
    how many poses are ``needed``, and the ``patience`` that follows; which entries of a pose are ``lifted``
    (C,), which directions are ``turns`` and ``shifts``; ``pull`` (S,) of the weak prior, ``flat`` where it
    has none; how many starts are ``relaxed``.
    """

    form: Form
    body_in_1: bool
    size: int
    columns: int
    lifted: Ints
    each: int
    free: int
    needed: float
    patience: float
    turns: Ints
    shifts: Ints
    pull: Array
    flat: Array
    where: Where
    relaxed: int


class Row(NamedTuple):
    """Columns of one hypothesis, as they lie in the table."""

    known_mean: Array
    known: Array
    pivot: Array
    first: Array
    moments: Array
    place_sum: Array
    x: Array
    hessian: Array
    row_weight: Array


class Prior(NamedTuple):
    """As ``fit.Prior`` of one hypothesis, and its ``anchors`` (6,); ``constant`` (1,)."""

    precision: Array
    information: Array
    constant: Array
    anchors: Array


@jit
def row_of(kind: Kind, table: Array, b: int) -> Row:
    """The b-th of a table (H, words)."""
    row, size, columns, each, free = table[b], kind.size, kind.columns, kind.each, kind.free
    where = kind.where
    return Row(
        row[where.known_mean : where.known_mean + size],
        row[where.known : where.known + size * size].reshape((size, size)),
        row[where.pivot : where.pivot + 6],
        row[where.first : where.first + columns],
        row[where.moments : where.moments + columns * columns].reshape((columns, columns)),
        row[where.place_sum : where.place_sum + 3],
        row[where.x : where.x + size],
        row[where.hessian : where.hessian + each * free * free].reshape((each, free, free)),
        row[where.row_weight : where.row_weight + each],
    )


@jit
def joint_of(where: Where, table: Array, b: int) -> float:
    """As ``Bank.joint`` of the b-th."""
    joint: float = table[b, where.entry] + table[b, where.log_likelihood]
    return joint


@jit
def anchor(kind: Kind, row: Row, weight: float, out: Array) -> None:
    """As ``bank.anchors_of``."""
    put(out, 0, at(out, -1))
    put(out, 3, at(out, -1))
    first = 3 if kind.body_in_1 else 0
    for i in range(3):
        out[first + i] = row.place_sum[i] / weight
    for i in range(6):
        if not isnan(row.pivot[i]):
            out[i] = row.pivot[i]


@jit
def know(kind: Kind, row: Row, weight: float, mean: Array, prior: Prior) -> None:
    """As ``following.before``; ``mean`` (S,) is memory, zero but for points."""
    anchors = prior.anchors
    anchor(kind, row, weight, anchors)
    if kind.form.q1 >= 0:
        put(mean, kind.form.q1, at(anchors, 0))
    if kind.form.q2 >= 0:
        put(mean, kind.form.q2, at(anchors, 3))
    multiply(row.known_mean, row.known, prior.information)
    prior.constant[0] = 0.5 * dot(prior.information, row.known_mean)
    for s in range(kind.size):
        for r in range(kind.size):
            prior.precision[s, r] = row.known[s, r]
        weak = kind.pull[s] * mean[s]
        prior.precision[s, s] += kind.pull[s]
        prior.information[s] += weak
        prior.constant[0] += 0.5 * weak * mean[s]
