"""From the arrays of ``fit`` to those of the kernels, and back; arguments are those of ``fit``."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled import fitting
from contact_tracker.contacts.base import Array, Family


class Prior(Protocol):
    """What is read of ``fit.Prior``."""

    @property
    def precision(self) -> Array: ...
    @property
    def information(self) -> Array: ...
    @property
    def constant(self) -> Array: ...


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


def _problem(moments: Array, row_weight: Array, prior: Prior, anchors: Array) -> fitting.Problem:
    arrays = moments, row_weight, prior.precision, prior.information, prior.constant, anchors
    return fitting.Problem(*map(_plain, arrays))


def _plain(values: Array) -> Array:
    """In order and writable, as a kernel is compiled for: another layout would have another one compiled."""
    return np.require(values, np.float64, ("C", "W"))
