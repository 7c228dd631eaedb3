"""The window of the last ticks slides on with each tick, and sees all of them with today's noise."""

import numpy as np
from numpy.typing import NDArray

from contact_tracker import compiled
from contact_tracker.model import Model
from contact_tracker.noise import NoiseEstimate
from contact_tracker.ticks import Tick, tick_unevenness, tick_variances, variances
from contact_tracker.window import Window

Array = NDArray[np.float64]


def slid(
    window: Window, frames: Array, number: int, tick: Tick, noise: NoiseEstimate, model: Model
) -> tuple[Window, Array]:
    """The ``window`` with a ``tick`` of this ``number``, at most ``Search.window_s`` long.

    And how many frames its ticks have; ``frames`` (W,) are those of the ticks before.
    """
    most = round(model.search.window_s / model.tick_s)
    if compiled.in_use():
        from contact_tracker.compiled import kernels

        ticks = window.index, window.zeta, window.inverse, window.free, frames
        newest = number, tick.zeta, tick.excess, float(tick.count)
        known = *variances(noise, model), noise.position_m2
        index, *columns, counts = kernels.slid(*ticks, *newest, most, *known)
        return window.carried(index, *columns), counts
    frames = np.concatenate([frames, [tick.count]])[-most:]
    variance, uneven = tick_variances(noise, frames, model), tick_unevenness(noise, frames)
    return window.then(number, tick.zeta, np.array(tick.excess), variance, uneven), frames
