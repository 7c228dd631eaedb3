"""From the arrays of the numpy code to those of the kernels, and back."""

from functools import cache, lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled import (
    advancing,
    dropping,
    following,
    hypothesis,
    products,
    searching,
    seeing,
)
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.form import shifts, turns
from contact_tracker.labels import Contact
from contact_tracker.pace import patience
from contact_tracker.paper.batched import Batch
from contact_tracker.paper.kronecker import form
from contact_tracker.table import layout

Index = NDArray[np.int64]


class Window(Protocol):
    """What is read of ``evidence.Window``."""

    def __hash__(self) -> int: ...
    @property
    def index(self) -> Index: ...
    @property
    def zeta(self) -> Array: ...
    @property
    def inverse(self) -> Array: ...
    @property
    def variance(self) -> Array: ...
    @property
    def uneven(self) -> Array | None: ...
    @property
    def free(self) -> Array: ...
    @property
    def activity(self) -> Array: ...


class Scales(Protocol):
    """What is read of ``evidence.Scales``."""

    @property
    def reach_m(self) -> float: ...
    @property
    def body_radius_m(self) -> float: ...
    @property
    def tick_s(self) -> float: ...
    @property
    def foreknowledge(self) -> float: ...
    @property
    def independence(self) -> float: ...


class Birth(Protocol):
    """What is read of ``bank.Birth``."""

    @property
    def turn(self) -> Array: ...
    @property
    def onset(self) -> int: ...
    @property
    def onset_ns(self) -> int: ...
    @property
    def number(self) -> int: ...
    @property
    def entry(self) -> float: ...


def summed(
    model: ContactModel,
    x: Array,
    onset: Index,
    window: Window,
    scales: Scales,
    certain: NDArray[np.bool_],
) -> tuple[Array, Array, Array]:
    """``totals`` (B, 4) as in ``seeing.Sums``, and ``gain`` and ``precision`` (B, K)."""
    form, rows = model.family.FORM, (len(x), model.family.ROWS)
    sums = np.empty((len(x), 4)), np.empty(rows), np.empty(rows)
    seen = _plain(x), _plain(onset), _plain(certain), _ticks(window, model.body_in_1), _lengths(scales)
    seeing.summed(form, model.body_in_1, *seen, *sums)
    return sums


def advance(
    model: ContactModel,
    words: Array,
    birth: Birth,
    assumed: tuple[Array, NDArray[np.bool_]],
    window: Window,
    scales: Scales,
    log_stay: float,
    margin: float,
    directions: Array | None,
) -> Array:
    """The rows of a bank and those of a ``birth``, which ``bank.assuming`` gives, a tick on; with random
    ``directions`` they search from scratch as well."""
    table = np.empty((len(words) + len(assumed[0]), words.shape[1]))
    advancing.advance(
        _kind(model, scales.reach_m),
        words,
        advancing.Birth(*assumed, birth.turn, birth.onset, birth.onset_ns, birth.number, birth.entry),
        table,
        table.view(np.int64),
        _ticks(window, model.body_in_1),
        float(window.activity[-1]),
        _weights(scales),
        log_stay,
        float(margin),
        *_hunting(words, directions),
    )
    return table


def prune(model: ContactModel, words: Array, now: int, best: float, margin: float) -> tuple[Index, Array]:
    """Which rows of a bank are kept, and these, their weights against ``best``."""
    rows, kept = np.empty(len(words), np.int64), np.empty(words.shape)
    chances = float(best), float(margin), patience(model.needed)
    many = dropping.prune(_where(model), words, words.view(np.int64), now, *chances, rows, kept)
    return rows[:many], kept[:many]


def learn(model: ContactModel, words: Array, window: Window, scales: Scales, steps: Index) -> None:
    """A bank, in place."""
    table, ticks = (words, words.view(np.int64)), _ticks(window, model.body_in_1)
    following.learn(_kind(model, scales.reach_m), *table, ticks, steps, _weights(scales))


def searched(
    model: ContactModel, words: Array, window: Window, scales: Scales, rows: Index, directions: Array
) -> None:
    """A bank, in place, of which ``rows`` search, from random ``directions`` as well."""
    kind, ticks = _kind(model, scales.reach_m), _ticks(window, model.body_in_1)
    drawn, found, as_whole = _hunting(words, directions)
    searching.searched(kind, words, rows, drawn, ticks, _weights(scales), found, as_whole)


def minimised(contact: Contact, k: Array, x: Array, y: Array, tolerance: float, iterations: int) -> Batch:
    """As ``batched.minimise_batched``."""
    kinds = products.KINDS.index(form(contact).x), products.KINDS.index(form(contact).y)
    found = Batch(np.empty(len(k)), np.array(x, order="C"), np.array(y, order="C"), np.empty(len(k), bool))
    products.minimise(kinds, _plain(k), found.x, found.y, tolerance, iterations, found.value, found.converged)
    return found


def _hunting(words: Array, directions: Array | None) -> tuple[Array, Array, Index]:
    """Directions, and memory for what is found."""
    found = np.empty((searching.KEPT, words.shape[1]))
    return _plain(np.empty((0, 0)) if directions is None else directions), found, found.view(np.int64)


def _weights(scales: Scales) -> following.Weights:
    return following.Weights(_lengths(scales), float(scales.foreknowledge), float(scales.independence))


@cache
def _kind(model: ContactModel, reach_m: float) -> hypothesis.Kind:
    family = model.family
    form, where = family.FORM, _where(model)
    columns = np.array(family.COLUMNS, np.int64)
    sizes = family.SIZE, len(columns), columns, family.ROWS, family.PARAMETERS
    poses = model.needed, patience(model.needed)
    pull, flat = family.SPREAD / reach_m**2, 1.0 - family.SPREAD
    relaxed = family.starts(np.eye(len(columns))[None]).shape[1]
    return hypothesis.Kind(
        form, model.body_in_1, *sizes, *poses, turns(form), shifts(form), pull, flat, where, relaxed
    )


@cache
def _where(model: ContactModel) -> hypothesis.Where:
    fields = layout(model).fields
    return hypothesis.Where(*(fields[name].first for name in hypothesis.Where._fields))


@lru_cache(maxsize=4)  # all contacts see the same
def _ticks(window: Window, body_in_1: bool) -> seeing.Ticks:
    return seeing.Ticks(
        np.require(window.index, np.int64, ("C", "W")),
        _plain(window.zeta if body_in_1 else window.inverse),
        _plain(window.variance),
        window.free,
        np.empty((0, 3, 3)) if window.uneven is None else _plain(window.uneven),
    )


def _lengths(scales: Scales) -> tuple[float, float]:
    return scales.body_radius_m**2, 0.5 / (2.0 * scales.reach_m) ** 2 * scales.tick_s


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """In order and writable, as a kernel is compiled for: another layout would have another one compiled."""
    return values if values.flags.carray else np.array(values, order="C")
