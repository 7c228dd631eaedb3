"""The window of the last ticks slides on with each tick, and sees all of them with today's noise."""

from threading import Lock
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker import compiled
from contact_tracker.averaging import Tick, tick_unevenness, tick_variances, variances
from contact_tracker.model import Model
from contact_tracker.window import Index, Window

Array = NDArray[np.float64]

LEAST_ROOM: Final = 64
"""So many rows of a trail are free at first, and as many more as the window has."""


class _Rows(NamedTuple):
    """Of N ticks what does not change with the noise, as in ``Window``, and how many frames each has."""

    number: Index
    zeta: Array
    inverse: Array
    excess: Array
    unheld: Array
    frames: Array

    def cut(self, first: int, end: int) -> "_Rows":
        """The ticks in rows ``first`` to ``end``."""
        number, *columns = self
        return _Rows(number[first:end], *(column[first:end] for column in columns))


class _Trail:
    """Ticks one after the other, of which windows see parts: each row is written once, and none is copied as
    windows slide on, until there is no room."""

    def __init__(self, room: int, window: Window, frames: Array) -> None:
        self._one_by_one = Lock()  # a window is a value: several may go on from it
        seen = _Rows(window.index, window.zeta, window.inverse, window.excess, window.unheld, frames)
        number, *columns = seen
        empty = (np.empty((room, *column.shape[1:])) for column in columns)
        self.rows = _Rows(np.empty_like(number, shape=room), *empty)
        self.written = len(window)
        for column, known in zip(self.rows, seen, strict=True):
            column[: self.written] = known

    def claim(self, row: int) -> bool:
        """Whether a row is free, for who asks to write it."""
        with self._one_by_one:
            is_free = self.written == row < len(self.rows.number)
            self.written += is_free
        return is_free


class Sliding(NamedTuple):
    """The ``window`` of the last ticks and the ``frames`` (W,) in each; where kernels are in use, the
    ``trail`` of which they are the rows before ``end``."""

    window: Window
    frames: Array
    trail: _Trail | None = None
    end: int = 0

    def __reduce__(self) -> tuple[Any, ...]:
        return Sliding, (self.window, self.frames)  # others may have gone on along the trail


NOTHING_SEEN = Sliding(
    Window(np.zeros(0, np.int64), np.zeros((0, 25)), np.zeros((0, 2)), np.zeros((0, 2))), np.zeros(0)
)


def slid(sliding: Sliding, number: int, tick: Tick, model: Model) -> Sliding:
    """On to a ``tick`` of this ``number``; the window stays as short as the model says."""
    window, noise, most = sliding.window, tick.noise, round(model.search.window_s / model.tick_s)
    if not compiled.in_use():
        frames = np.concatenate([sliding.frames, [tick.count]])[-most:]
        variance, uneven = tick_variances(noise, frames, model), tick_unevenness(noise, frames)
        return Sliding(window.then(number, tick.zeta, np.array(tick.excess), variance, uneven), frames)
    from contact_tracker.compiled import kernels

    trail, end = _with_room(sliding)
    lost = max(len(window) + 1 - most, 0)
    first, newest = end - len(window) + lost, (number, tick.zeta, tick.excess, float(tick.count))
    known = *variances(noise, model), noise.position_m2
    variance, uneven = kernels.slid(trail.rows, first, end, *newest, *known)
    seen = trail.rows.cut(first, end + 1)
    before = window.zeta[lost - 1] if lost else window.before
    moved_on = Window(seen.number, seen.zeta, variance, seen.excess, uneven, before)
    return Sliding(moved_on.knowing(seen.inverse, seen.unheld), seen.frames, trail, end + 1)


def _with_room(sliding: Sliding) -> tuple[_Trail, int]:
    """A trail with a row of one's own right after those that the window sees, and which that is."""
    trail, end = sliding.trail, sliding.end
    if trail is None or not trail.claim(end):  # no room, or what came next was something else before
        end = len(sliding.window)
        trail = _Trail(2 * end + LEAST_ROOM, sliding.window, sliding.frames)
        trail.claim(end)
    return trail, end
