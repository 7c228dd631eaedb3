"""The window of the last ticks slides on with each tick, and sees all of them with today's noise."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.motion.tick_averaging import Tick, tick_anisotropy, tick_variances
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]


class SlidingWindow(NamedTuple):
    """The ``window`` of the last ticks and the ``frames`` (W,) in each."""

    window: Window
    frames: Array


EMPTY_WINDOW = SlidingWindow(
    Window(np.zeros(0, np.int64), np.zeros((0, 25)), np.zeros((0, 2)), np.zeros((0, 2))), np.zeros(0)
)


def advance_window(sliding: SlidingWindow, number: int, tick: Tick, model: Model) -> SlidingWindow:
    """On to a ``tick`` of this ``number``; the window stays as short as the model says."""
    window, noise, most = sliding.window, tick.noise, round(model.search.window_s / model.tick_s)
    frames = np.concatenate([sliding.frames, [tick.count]])[-most:]
    variance, uneven = tick_variances(noise, frames, model), tick_anisotropy(noise, frames)
    return SlidingWindow(
        window.then(number, tick.zeta, np.array(tick.innovation_excess), variance, uneven), frames
    )
