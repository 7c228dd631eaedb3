"""From the arrays of ``fit``, ``evidence`` and ``summed`` to those of the kernels, and back."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled import fitting, pricing, seeing
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.base import Array, Family, lift_of_inverse


class Prior(Protocol):
    """What is read of ``fit.Prior``."""

    @property
    def precision(self) -> Array: ...
    @property
    def information(self) -> Array: ...
    @property
    def constant(self) -> Array: ...


class Window(Protocol):
    """What is read of ``evidence.Window``."""

    @property
    def index(self) -> NDArray[np.int64]: ...
    @property
    def zeta(self) -> Array: ...
    @property
    def variance(self) -> Array: ...
    @property
    def excess(self) -> Array: ...
    @property
    def uneven(self) -> Array | None: ...
    @property
    def travel(self) -> Array: ...


class Scales(Protocol):
    """What is read of ``evidence.Scales``."""

    @property
    def reach_m(self) -> float: ...
    @property
    def body_radius_m(self) -> float: ...
    @property
    def tick_s(self) -> float: ...


def minimise(
    family: Family,
    moments: Array,
    row_weight: Array,
    prior: Prior,
    anchors: Array,
    x: Array,
    steps: NDArray[np.int64],
    tolerance: float,
) -> fitting.Found:
    count, rows, free = len(x), family.ROWS, family.PARAMETERS
    found = fitting.Found(
        np.array(x, np.float64, order="C"),
        np.empty(count),
        np.empty((count, rows, free, free)),
        np.empty(count, np.bool_),
    )
    problem = _problem(moments, row_weight, prior, anchors)
    fitting.minimise(family.FORM, family.LINEAR, problem, steps, tolerance, found)
    return found


def complete(
    family: Family, moments: Array, row_weight: Array, prior: Prior, anchors: Array, x: Array
) -> tuple[Array, Array]:
    completed, cost = np.array(x, np.float64, order="C"), np.empty(len(x))
    problem = _problem(moments, row_weight, prior, anchors)
    fitting.complete(family.FORM, family.LINEAR, problem, completed, cost, family.PARAMETERS)
    return completed, cost


def information(
    family: Family, lifted: Array, row_weight: Array, moments: Array, anchors: Array, x: Array
) -> Array:
    out = np.empty((len(x), family.PARAMETERS, family.PARAMETERS))
    pricing.information(family.FORM, *map(_plain, (lifted, row_weight, moments, anchors, x)), out)
    return out


def volume(
    family: Family,
    x: Array,
    anchors: Array,
    hessian: Array,
    given: Array,
    foretold: Array,
    precision: Array,
    flat: Array,
) -> Array:
    """The first term of ``evidence.complexity``."""
    out = np.empty(len(x))
    pricing.volume(family.FORM, *map(_plain, (x, anchors, hessian, given, foretold, precision, flat)), out)
    return out


def summed(
    model: ContactModel,
    x: Array,
    onset: NDArray[np.int64],
    window: Window,
    scales: Scales,
    certain: NDArray[np.bool_],
) -> seeing.Sums:
    count, rows = len(x), model.family.ROWS
    free = [window.excess, np.maximum(window.excess, window.travel) if certain.any() else window.excess]
    ticks = seeing.Ticks(
        np.require(window.index, np.int64, ("C", "W")),
        _plain(window.zeta if model.body_in_1 else lift_of_inverse(window.zeta)),
        _plain(window.variance),
        np.array(free),
        np.empty((0, 3, 3)) if window.uneven is None else _plain(window.uneven),
    )
    sums = seeing.Sums(
        np.zeros(count),
        np.zeros((count, rows)),
        np.zeros((count, rows)),
        np.zeros(count),
        np.zeros(count, np.int64),
        np.zeros(count, np.int64),
    )
    pull = 0.5 / (2.0 * scales.reach_m) ** 2 * scales.tick_s
    lengths = scales.body_radius_m**2, pull
    seeing.summed(
        model.family.FORM,
        model.body_in_1,
        _plain(x),
        np.require(onset, np.int64, ("C", "W")),
        certain.astype(np.int64),
        ticks,
        lengths,
        sums,
    )
    return sums


def _problem(moments: Array, row_weight: Array, prior: Prior, anchors: Array) -> fitting.Problem:
    arrays = moments, row_weight, prior.precision, prior.information, prior.constant, anchors
    return fitting.Problem(*map(_plain, arrays))


def _plain(values: Array) -> Array:
    """In order and writable, as a kernel is compiled for: another layout would have another one compiled."""
    return (
        values
        if values.flags.carray and values.dtype == np.float64
        else np.array(values, np.float64, order="C")
    )
