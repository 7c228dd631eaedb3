"""From the arrays of ``following``, ``search`` and ``summed`` to those of the kernels, and back."""

from functools import cache, lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled import advancing, following, hypothesis, searching, seeing
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.form import shifts, turns
from contact_tracker.lift import T
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
    window: Window,
    scales: Scales,
    log_stay: float,
    margin: float,
    due: bool,
) -> Index:
    """A bank, in place; returns the rows that are to search from scratch."""
    number, zeta, heard = int(window.index[-1]), window.zeta[-1], float(window.activity[-1])
    lifted, sigma = _plain(model.lifted(zeta)), float(np.sqrt(window.variance[-1, 0]))
    tick = following.Newest(number, lifted, zeta[T].copy(), sigma, heard, log_stay)
    table, ticks = (words, words.view(np.int64)), _ticks(window, model.body_in_1)
    lost = np.empty(advancing.GROUPS, np.int64)
    kind, weights = _kind(model, scales.reach_m), _weights(scales)
    return lost[: advancing.advance(kind, *table, ticks, tick, weights, margin, due, lost)]


def learn(model: ContactModel, words: Array, window: Window, scales: Scales, steps: Index) -> None:
    """A bank, in place."""
    table, ticks = (words, words.view(np.int64)), _ticks(window, model.body_in_1)
    following.learn(_kind(model, scales.reach_m), *table, ticks, steps, _weights(scales))


def searched(
    model: ContactModel,
    words: Array,
    window: Window,
    scales: Scales,
    rows: Index,
    told: NDArray[np.bool_],
    relaxed: Array,
    directions: Array,
) -> None:
    """A bank, in place, of which ``rows`` search from what ``search._starts`` gives."""
    kind, ticks = _kind(model, scales.reach_m), _ticks(window, model.body_in_1)
    found = np.empty((searching.KEPT, words.shape[1]))
    starts = told, _plain(relaxed), _plain(directions)
    searching.searched(kind, words, ticks, _weights(scales), rows, *starts, found, found.view(np.int64))


def _weights(scales: Scales) -> following.Weights:
    return following.Weights(_lengths(scales), scales.foreknowledge, scales.independence)


@cache
def _kind(model: ContactModel, reach_m: float) -> hypothesis.Kind:
    family = model.family
    form, fields = family.FORM, layout(model).fields
    where = hypothesis.Where(*(fields[name].first for name in hypothesis.Where._fields))
    sizes = family.SIZE, len(family.COLUMNS), family.ROWS, family.PARAMETERS
    pull, flat = family.SPREAD / reach_m**2, 1.0 - family.SPREAD
    return hypothesis.Kind(form, model.body_in_1, *sizes, turns(form), shifts(form), pull, flat, where)


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
