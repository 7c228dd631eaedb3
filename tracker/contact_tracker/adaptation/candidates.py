"""Models that a stream may need: ticks that hold frames, and floors of the noise to choose from."""

from dataclasses import replace
from math import sqrt
from typing import Final

import numpy as np

from contact_tracker.config.parameters import Model
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.sensor_noise import begin, estimate_noise
from contact_tracker.motion.tick_averaging import tick_variances

TOLERANCE: Final = 1.05
"""A tick that is too short by less than this factor, as of a period that jitters, is long enough."""
TICKS_PER_WINDOW: Final = 10
NOISE_SCALES: Final = (1.75e-4, 3.5e-4, 7e-4, 1.4e-3, 2.8e-3)
"""Candidates for the noise of a tick: geometric means of its deviations in position (m) and orientation
(rad). Within a factor of the square root of two from the true one contacts are found as well as with it."""
LEAST_FACTOR: Final = 1.2
"""A candidate is worth a tracker if it is so much larger than what white noise leaves of the frames."""
SLOW_PERIOD_S: Final = 0.025
"""Poses farther apart than this may differ by motion as much as by noise."""
SHARES: Final = (0.5, 0.25, 0.125)
"""Candidates for how much of it is noise."""
ROTATION_PER_POSITION: Final = (2.0, 40.0)
"""Between what the ratio of the deviations lies (rad/m), if the stream does not tell it."""
USUAL_ROTATION_PER_POSITION: Final = 7.0


def with_ticks_for(model: Model, period_s: float) -> Model:
    """The model with ticks of ``poses_per_tick`` poses of this period at least, as the window allows."""
    needed_s = min(model.poses_per_tick * period_s, model.search.window_s / TICKS_PER_WINDOW)
    return replace(model, tick_s=needed_s) if needed_s > TOLERANCE * model.tick_s else model


def candidates(model: Model, poses: Poses) -> tuple[Model, ...]:
    """The model itself, and copies of it with larger floors of the noise, in rising order.

    Averaging lowers white noise as the model takes it; what a filter has smoothed it lowers less. By how much
    is unknown, but a filter treats position and orientation alike: the ratio of their noise is that of the
    frames.

    Parameters
    ----------
    poses : the first of the stream.
    """
    if not model.noise.estimated:
        return (model,)
    sigma = np.array(estimate_noise(poses))
    known = np.isfinite(sigma).all() and sigma[0] > 0.0
    ratio = (
        float(np.clip(sigma[1] / sigma[0], *ROTATION_PER_POSITION)) if known else USUAL_ROTATION_PER_POSITION
    )
    span_s = float(poses.stamp_ns[-1] - poses.stamp_ns[0]) * 1e-9
    count = max(len(poses) * model.tick_s / max(span_s, model.tick_s), 1.0)
    white = tick_variances(begin(*sigma) if known else begin(0.0, 0.0), np.array(count), model)
    least = LEAST_FACTOR * float(white.prod()) ** 0.25
    floors = [(scale / sqrt(ratio), scale * sqrt(ratio)) for scale in NOISE_SCALES if scale > least]
    slow = span_s > SLOW_PERIOD_S * (len(poses) - 1)
    less = [replace(model, noise=replace(model.noise, estimate_share=share)) for share in SHARES if slow]
    return (model, *less, *(_with_floor(model, *floor) for floor in floors))


def _with_floor(model: Model, position_m: float, rotation_rad: float) -> Model:
    noise = model.noise
    return replace(
        model,
        noise=replace(
            noise,
            floor_position_m=max(position_m, noise.floor_position_m),
            floor_rotation_rad=max(rotation_rad, noise.floor_rotation_rad),
        ),
    )
