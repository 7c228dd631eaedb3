"""From the arrays of the numpy code to those of the kernels, and back."""

from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from typing import NamedTuple, Protocol

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
from contact_tracker.rows import layout
from contact_tracker.table import Bank, Onsets, blank
from contact_tracker.window import Window

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
    """What is read of ``bank.Births``."""

    @property
    def turn(self) -> Array: ...
    @property
    def onset(self) -> int: ...
    @property
    def onset_ns(self) -> int: ...


class Moment(Protocol):
    """What is read of ``hypotheses.Moment``."""

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
    """What is read of ``hypotheses.Until``."""

    @property
    def probability(self) -> float: ...
    @property
    def sureness(self) -> float: ...
    @property
    def due_ns(self) -> Mapping[int, int]: ...


class Strode(NamedTuple):
    """Of each contact the ``words`` of the hypotheses that are kept and of their onsets, and which ``rows``
    they had in the last tick, of all that there were and then began; what each tick has ``weighed``, as in
    ``hypotheses.Weighed``."""

    words: list[tuple[Array, Array]]
    rows: list[Index]
    weighed: list[tuple[Array, Array, Array, Index, tuple[Index, Index, Array]]]


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
        model_of(model, scales.reach_m), x, onset, certain, ticks_of(window), _weights(scales)
    )


def moment(
    one: Moment, assumed: Sequence[tuple[Array, NDArray[np.bool_]]], directions: Sequence[Array | None]
) -> kernels.Moment:
    """With what is ``assumed`` of each contact, rows and what is told (see ``Begins``); with random
    ``directions`` of the body's frame it searches from scratch as well."""
    births = one.births
    window, before = ticks_of(one.window), ticks_of(one.before) if len(one.before.index) else None
    when = births.onset, births.onset_ns, one.stamp_ns
    return kernels.Moment(assumed, directions, births.turn, *when, window, before, one.change, one.log_stay)


def begun(
    model: ContactModel,
    first: Sequence[Array],
    second: Sequence[Array],
    near_m: Array | None,
    log_share: Sequence[float],
    pair: Sequence[int],
    certain: Sequence[bool],
    met: Sequence[bool],
) -> tuple[Array, NDArray[np.bool_]]:
    """Words of the rows of ``begins.begun``, and what is told, by the rows of ``given.rows_of``."""
    told = first, second, near_m, log_share, pair, certain, met
    return kernels.begun(model_of(model, 1.0), blank(model, 1).words, *told)  # the reach is not asked for


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

    The rest as in ``hypotheses.stride``.
    """
    limit = None
    if until is not None:
        limit = kernels.Until(until.probability, until.sureness, list(until.due_ns.items()))
    told = words, moments, number, entry, beyond, _weights(scales), margin, limit
    return Strode(*kernels.strode(_models(scales.reach_m), *told))


def learn(
    model: ContactModel, words: Array, onsets: Array, window: Window, scales: Scales, steps: Index
) -> None:
    """A bank, in place."""
    kernels.learned(model_of(model, scales.reach_m), words, onsets, ticks_of(window), steps, _weights(scales))


def shown(
    model: ContactModel,
    rows: tuple[Array, Array],
    variance: Array,
    off: Array,
    vague: Array,
    information: Array | None,
    reach_m: float,
) -> tuple[Array, Array, Array, Array, Array]:
    """As ``observability.shown`` of the first of a bank's ``rows``; ``off`` (C, 6 C) is what a lifted pose
    changes by when it is a little off, ``vague`` (S, S) what is known of x from the outset."""
    kind = model_of(model, reach_m)
    return kernels.shown(kind, *rows, variance.tolist(), off, vague, information)


def searched(
    model: ContactModel,
    words: Array,
    onsets: Array,
    window: Window,
    scales: Scales,
    rows: Index,
    directions: Array,
) -> None:
    """A bank, in place, of which ``rows`` search, from random ``directions`` of the body's frame as well."""
    kind, ticks = model_of(model, scales.reach_m), ticks_of(window)
    turn = window.zeta[-1, R].reshape(3, 3)
    kernels.searched(kind, words, onsets, ticks, rows, directions, turn, _weights(scales))


def rivals(words: Sequence[Array], label: Contact, onset: int, slack: int, far: float) -> tuple[Array, Array]:
    """Evidence and residuals of ``separability.Rivals``, from the rows of all banks."""
    return kernels.rivals(_models(1.0), words, label.column, onset, slack, far)  # the reach is not asked for


def polished(
    model: ContactModel, words: Array, onsets: Array, window: Window, reach_m: float
) -> tuple[Array, Array, Array, Array, bool, bool]:
    """As ``polish._settle`` of a bank's first hypothesis: its x (S,), row_weight (K,), moments (C, C) and
    information (P, P); whether the first and the last tick belong."""
    return kernels.polished(model_of(model, reach_m), words, onsets, ticks_of(window))


def minimised(contact: Contact, k: Array, x: Array, y: Array, tolerance: float, iterations: int) -> Batch:
    """As ``batched.minimise_batched``."""
    f = form(contact)
    return Batch(*kernels.minimised(f.x, f.y, k, x, y, tolerance, iterations))


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
