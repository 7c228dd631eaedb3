"""From the arrays of the numpy code to those of the kernels, and back."""

from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.contacts.family import Array
from contact_tracker.hypotheses.bank import Bank, Onsets
from contact_tracker.hypotheses.compiled import kernels
from contact_tracker.hypotheses.row_layout import layout
from contact_tracker.hypotheses.schedule import patience
from contact_tracker.motion.window import Window

Index = NDArray[np.int64]


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


class Births(Protocol):
    """What is read of ``pruning.Births``."""

    @property
    def turn(self) -> Array: ...
    @property
    def onset(self) -> int: ...
    @property
    def onset_ns(self) -> int: ...


class Moment(Protocol):
    """What is read of ``bank_update.Moment``."""

    @property
    def births(self) -> Births: ...
    @property
    def stamp_ns(self) -> int: ...
    @property
    def window(self) -> Window: ...
    @property
    def before(self) -> Window: ...
    @property
    def change(self) -> Array: ...
    @property
    def log_stay(self) -> Array: ...


class Until(Protocol):
    """What is read of ``bank_update.Until``."""

    @property
    def probability(self) -> float: ...
    @property
    def sureness(self) -> float: ...
    @property
    def due_ns(self) -> Mapping[int, int]: ...


class Strode(NamedTuple):
    """Of each contact the ``words`` of the hypotheses that are kept and of their onsets, and which ``rows``
    they had in the last tick, of all that there were and then began; what each tick has ``weighed``, as in
    ``bank_update.Weighed``."""

    words: list[tuple[Array, Array]]
    rows: list[Index]
    weighed: list[tuple[Array, Array, Array, Index, tuple[Index, Index, Array]]]


def moment(
    one: Moment, assumed: Sequence[tuple[Array, NDArray[np.bool_]]], directions: Sequence[Array | None]
) -> kernels.Moment:
    """With what is ``assumed`` of each contact, rows and what is told (see ``Begins``); with random
    ``directions`` of the body's frame it searches from scratch as well."""
    births = one.births
    window, before = ticks_of(one.window), ticks_of(one.before) if len(one.before.index) else None
    when = births.onset, births.onset_ns, one.stamp_ns
    return kernels.Moment(assumed, directions, births.turn, *when, window, before, one.change, one.log_stay)


def stride(
    words: Sequence[tuple[Array, Array]],
    moments: Sequence[kernels.Moment],
    number: int,
    entry: Array,
    beyond: Sequence[tuple[float, float]],
    scales: Scales,
    margin: float,
    until: Until | None,
) -> Strode:
    """The rows of all banks and of their onsets through some moments; what begins is numbered from ``number``
    on, with the first by this ``entry`` (7,).

    The rest as in ``bank_update.stride``.
    """
    limit = None
    if until is not None:
        limit = kernels.Until(until.probability, until.sureness, list(until.due_ns.items()))
    told = words, moments, number, entry, beyond, _weights(scales), margin, limit
    return Strode(*kernels.strode(_models(scales.reach_m), *told))


@lru_cache(maxsize=64)
def model_of(model: ContactModel, reach_m: float) -> kernels.Model:
    """What kernels know of a contact."""
    family, bank, onsets = model.family, layout(Bank, model), layout(Onsets, model)
    columns = family.COLUMNS.tolist()
    return kernels.Model(
        tuple(family.FORM),
        (family.SIZE, len(columns), family.ROWS, family.PARAMETERS),
        (bank.words, bank.first),
        (onsets.words, onsets.first),
        model.body_in_1,
        model.needed,
        patience(model.needed),
        columns,
        (family.SPREAD / reach_m**2).tolist(),
        family.starts(np.eye(len(columns))[None]).shape[1],
    )


@lru_cache(maxsize=8)
def _models(reach_m: float) -> list[kernels.Model]:
    return [model_of(model, reach_m) for model in CONTACT_MODELS]


@lru_cache(maxsize=2)  # of a tick and of the one before
def ticks_of(window: Window) -> kernels.Ticks:
    """What kernels see of a window."""
    return kernels.Ticks(
        window.index,
        window.zeta,
        window.inverse,
        window.variance,
        window.excess,
        window.unheld,
        window.uneven,
    )


@cache
def _weights(scales: Scales) -> kernels.Weights:
    pull = 0.5 / (2.0 * scales.reach_m) ** 2 * scales.tick_s
    return kernels.Weights(scales.body_radius_m**2, pull, scales.foreknowledge, scales.independence)
