"""From the arrays of ``following``, ``search`` and ``summed`` to those of the kernels, and back."""

from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled import following, searching, seeing
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.base import Array
from contact_tracker.contacts.form import shifts, turns
from contact_tracker.lift import T

Index = NDArray[np.int64]
Columns = Mapping[str, NDArray[Any]]

GROWS: Final = ("first", "moments", "place_sum", "weight", "told", "x")
"""Columns of a bank that change when it grows."""


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
) -> seeing.Sums:
    family, ticks = model.family, _ticks(window, model.body_in_1)
    of_x, onset = _plain(x), np.require(onset, np.int64, ("C", "W"))
    lengths = _lengths(scales)
    sums: seeing.Sums = seeing.summed(
        family.FORM, model.body_in_1, family.ROWS, of_x, onset, certain, ticks, lengths
    )
    return sums


def grow(model: ContactModel, bank: Columns, window: Window, least: float) -> dict[str, NDArray[Any]]:
    """The columns that change."""
    zeta, heard = window.zeta[-1], float(window.activity[-1])
    rows = _rows(bank, GROWS)
    kind = _kind(model, 1.0)
    lifted, sigma = _plain(model.lifted(zeta)), float(np.sqrt(window.variance[-1, 0]))
    following.grow(kind, rows, int(window.index[-1]), lifted, zeta[T].copy(), sigma, heard, least)
    return {name: getattr(rows, name) for name in GROWS}


def learn(
    model: ContactModel,
    bank: Columns,
    window: Window,
    scales: Scales,
    steps: Index,
    tolerance: float,
    found: tuple[str, ...],
) -> dict[str, NDArray[Any]]:
    """The columns ``found``, which change."""
    rows, kind = _rows(bank, found), _kind(model, scales.reach_m)
    weights = following.Weights(_lengths(scales), scales.foreknowledge, scales.independence)
    following.learn(kind, rows, _ticks(window, model.body_in_1), steps, tolerance, weights)
    return {name: getattr(rows, name) for name in found}


def offered(model: ContactModel, bank: Columns, scales: Scales, least: float) -> tuple[Index, Index]:
    """Which rows another's geometry fits better, by more than ``least``, and whose fits them best."""
    rows: tuple[Index, Index] = searching.offered(_kind(model, scales.reach_m), _rows(bank, ()), least)
    return rows


def find(
    model: ContactModel,
    bank: Columns,
    scales: Scales,
    which: Index,
    told: NDArray[np.bool_],
    relaxed: Array,
    directions: Array,
    screened: int,
    rounds: Index,
    tolerance: float,
) -> Array:
    """Geometries (R, n, S) that the rows ``which`` find from ``relaxed`` (R, N, S) and ``directions``, with
    what is ``told`` (R, S) of them."""
    rows, kind, starts = _rows(bank, ()), _kind(model, scales.reach_m), (_plain(relaxed), _plain(directions))
    found: Array = searching.find(kind, rows, which, told, *starts, screened, rounds, tolerance)
    return found


@cache
def _kind(model: ContactModel, reach_m: float) -> following.Kind:
    family = model.family
    pull, flat = family.SPREAD / reach_m**2, 1.0 - family.SPREAD
    form = family.FORM
    return following.Kind(form, model.body_in_1, turns(form), shifts(form), pull, flat)


def _rows(bank: Columns, changed: tuple[str, ...]) -> following.Rows:
    """Columns as a kernel takes them: copies of those that it changes."""
    columns = [
        bank[name].copy() if name in changed else _plain(bank[name]) for name in following.Rows._fields
    ]
    return following.Rows(*columns)


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
