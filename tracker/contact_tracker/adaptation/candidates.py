"""Models that a stream may need: ticks that hold frames, and noise to choose from."""

from dataclasses import replace
from math import sqrt
from typing import Final, NamedTuple

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
WANDER_M: Final = (1.25e-4, 3.5e-4, 1e-3)
"""Candidates for errors of the position that last, as of calibration, where they are no less than noise."""
WANDER_ROTATION_PER_POSITION: Final = 5.0
"""By how much they turn (rad/m)."""
SLOW_PERIOD_S: Final = 0.045
"""Poses farther apart than this may differ by motion as much as by noise."""
SHARES: Final = (0.5, 0.25, 0.125)
"""Candidates for how much of the deviations is noise then."""
LOG_PRIOR_STEP: Final = -1.0
"""A larger floor is less probable than the one before, and a smaller share (nats)."""
LOG_PRIOR_WANDER: Final = 12.0
"""Errors that last are so much more probable than none: few streams are without, and contacts are found with
them all the same, while without them true contacts do not fit. Where there are none the evidence against
them is much larger after some seconds of motion."""
ROTATION_PER_POSITION: Final = (2.0, 40.0)
"""Between what the ratio of the deviations lies (rad/m), if the stream does not tell it."""
USUAL_ROTATION_PER_POSITION: Final = 7.0


def with_ticks_for(model: Model, period_s: float) -> Model:
    """The model with ticks of ``poses_per_tick`` poses of this period at least, as the window allows."""
    needed_s = min(model.poses_per_tick * period_s, model.search.window_s / TICKS_PER_WINDOW)
    return replace(model, tick_s=needed_s) if needed_s > TOLERANCE * model.tick_s else model


class Candidate(NamedTuple):
    """A model, and the log prior probability (nats) against that of the first."""

    model: Model
    log_prior: float


def candidates(model: Model, poses: Poses) -> tuple[Candidate, ...]:
    """The model itself, and copies of it that take the noise to be different.

    Averaging lowers white noise as the model takes it; what a filter has smoothed it lowers less. By how much
    is unknown, but a filter treats position and orientation alike: the ratio of their noise is that of the
    frames. Of slow streams noise may be less than what frames differ by; and there may be errors that last.

    Parameters
    ----------
    poses : the first of the stream.
    """
    alone = Candidate(model, 0.0)
    if not model.noise.estimated:
        return (alone,)
    sigma = np.array(estimate_noise(poses))
    known = np.isfinite(sigma).all() and sigma[0] > 0.0
    ratio = (
        float(np.clip(sigma[1] / sigma[0], *ROTATION_PER_POSITION)) if known else USUAL_ROTATION_PER_POSITION
    )
    span_s = (int(poses.stamp_ns[-1]) - int(poses.stamp_ns[0])) * 1e-9
    count = max(len(poses) * model.tick_s / max(span_s, model.tick_s), 1.0)
    white = tick_variances(begin(*sigma) if known else begin(0.0, 0.0), np.array(count), model)
    least = float(white.prod()) ** 0.25
    floors = [scale for scale in NOISE_SCALES if scale > LEAST_FACTOR * least]
    more = [_with_floor(model, scale / sqrt(ratio), scale * sqrt(ratio)) for scale in floors]
    is_slow = span_s > SLOW_PERIOD_S * (len(poses) - 1)
    less = [replace(model, noise=replace(model.noise, estimate_share=share)) for share in SHARES if is_slow]
    lasting = [_with_wander(model, scale) for scale in WANDER_M if scale > white[0] ** 0.5]
    return (
        alone,
        *(Candidate(one, LOG_PRIOR_STEP * i) for some in (less, more) for i, one in enumerate(some, 1)),
        *(Candidate(one, LOG_PRIOR_WANDER) for one in lasting),
    )


def _with_wander(model: Model, position_m: float) -> Model:
    rotation_rad = position_m * WANDER_ROTATION_PER_POSITION
    noise = replace(model.noise, wander_position_m=position_m, wander_rotation_rad=rotation_rad)
    return replace(model, noise=noise)


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
