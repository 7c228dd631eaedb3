"""From the arrays of the numpy code to those of the kernels, and back."""

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contact_tracker.compiled import kernels
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.contacts.base import Array
from contact_tracker.labels import Contact
from contact_tracker.lift import R
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
    def latest_activity(self) -> float: ...


class Scales(Protocol):
    """What is read of ``evidence.Scales``."""

    def __hash__(self) -> int: ...
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
    """Totals (B, 4), that is log ratio, chi squared, ticks and ticks after the first, and ``gain`` and
    ``precision`` (B, K), as in ``summed.Sums``."""
    return kernels.summed(
        model_of(model, scales.reach_m), x, onset, certain, ticks_of(window, model), _weights(scales)
    )


def advance(
    words: Sequence[Array],
    births: Sequence[Birth],
    assumed: Sequence[tuple[Array, NDArray[np.bool_]]],
    windows: Sequence[Window],
    scales: Scales,
    log_stay: Array,
    margin: float,
    directions: Sequence[Array | None],
    rival: float,
) -> tuple[list[tuple[Index, Array, float, float]], float]:
    """The rows of all banks and those of ``births`` of one tick, which ``bank.assuming`` gives, a tick on;
    with random ``directions`` of the body's frame they search from scratch as well.

    Of each contact which rows are kept, and these, their weights against the best, the log of their sum and
    ``bank.residual``; and the best log weight of all and the ``rival``.
    """
    return kernels.advanced(
        [model_of(model, scales.reach_m) for model in CONTACT_MODELS],
        words,
        assumed,
        births[0].turn,
        births[0].onset,
        births[0].onset_ns,
        [birth.number for birth in births],
        [birth.entry for birth in births],
        [ticks_of(window, model) for window, model in zip(windows, CONTACT_MODELS, strict=True)],
        [window.latest_activity for window in windows],
        _weights(scales),
        log_stay.tolist(),
        float(margin),
        directions,
        rival,
    )


def learn(model: ContactModel, words: Array, window: Window, scales: Scales, steps: Index) -> None:
    """A bank, in place."""
    kernels.learned(model_of(model, scales.reach_m), words, ticks_of(window, model), steps, _weights(scales))


def searched(
    model: ContactModel, words: Array, window: Window, scales: Scales, rows: Index, directions: Array
) -> None:
    """A bank, in place, of which ``rows`` search, from random ``directions`` of the body's frame as well."""
    kind, ticks = model_of(model, scales.reach_m), ticks_of(window, model)
    turn = window.zeta[-1, R].reshape(3, 3)
    kernels.searched(kind, words, ticks, rows, directions, turn, _weights(scales))


def minimised(contact: Contact, k: Array, x: Array, y: Array, tolerance: float, iterations: int) -> Batch:
    """As ``batched.minimise_batched``."""
    f = form(contact)
    return Batch(*kernels.minimised(f.x, f.y, k, x, y, tolerance, iterations))


@lru_cache(maxsize=64)
def model_of(model: ContactModel, reach_m: float) -> kernels.Model:
    """What kernels know of a contact."""
    family, row = model.family, layout(model)
    columns = family.COLUMNS.tolist()
    return kernels.Model(
        tuple(family.FORM),
        (family.SIZE, len(columns), family.ROWS, family.PARAMETERS),
        row.words,
        {name: field.first for name, field in row.fields.items()},
        model.body_in_1,
        model.needed,
        patience(model.needed),
        columns,
        (family.SPREAD / reach_m**2).tolist(),
        family.starts(np.eye(len(columns))[None]).shape[1],
    )


def ticks_of(window: Window, model: ContactModel) -> kernels.Ticks:
    """What kernels see of a window: the body's pose, or what stands around it as seen from there."""
    return _ticks(window, model.body_in_1)


@lru_cache(maxsize=4)  # all contacts see the same
def _ticks(window: Window, body_in_1: bool) -> kernels.Ticks:
    pose = window.zeta if body_in_1 else window.inverse
    return kernels.Ticks(window.index, pose, window.variance, window.free, window.uneven)


@cache
def _weights(scales: Scales) -> kernels.Weights:
    pull = 0.5 / (2.0 * scales.reach_m) ** 2 * scales.tick_s
    return kernels.Weights(scales.body_radius_m**2, pull, scales.foreknowledge, scales.independence)
