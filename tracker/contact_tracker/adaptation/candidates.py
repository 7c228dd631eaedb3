"""Candidate models of a stream: ticks with enough frames, and alternatives of the noise."""

from dataclasses import replace
from math import sqrt
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.geometry import linalg
from contact_tracker.motion.free_motion import can_be_compared
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.sensor_noise import SLOW_PERIOD_S, begin, estimate_noise
from contact_tracker.motion.tick_averaging import tick_variances

FIRST_POSES: Final = 2
"""Number of poses whose distance is the period of the stream until its rate is estimated."""
RATE_POSES: Final = 12
"""Number of poses from which the rate of the stream is estimated: its first, later the latest."""
CHANGED: Final = 2.0
"""The rate has changed if ticks for it are longer or shorter by more than this factor. Trackers then start
again, which costs more than ticks with one pose or with some more than needed."""
LASTING_NS: Final = 1_000_000_000
"""Time for which a rate has to last before ticks follow it: shorter than that, poses are missing."""
TOLERANCE: Final = 1.05
"""Tolerance of the tick's length, for jitter of the periods."""
TICKS_PER_WINDOW: Final = 10
IRREGULAR: Final = 2.0
"""Periods longer than the median by more than this factor are gaps; shorter ones are those of two bodies."""
QUANTILES: Final = np.arange(0.1, 1.0, 0.2)
"""Quantiles of the period, over time, by which the rates of a recording are found."""
NOISE_SCALES: Final = (1.75e-4, 3.5e-4, 7e-4, 1.4e-3, 2.8e-3)
"""Candidates for the noise of a tick: geometric means of its standard deviations in position (m) and
orientation (rad). Within a factor of the square root of two of the true noise contacts are found equally
well."""
LEAST_FACTOR: Final = 1.2
"""A candidate is tracked if its floor exceeds the averaged white noise by this factor."""
WANDER_M: Final = (1.25e-4, 3.5e-4, 1e-3)
"""Candidates for correlated errors of the position, such as those of calibration; those below the noise are
not tracked."""
WANDER_ROTATION_PER_POSITION: Final = 5.0
"""Ratio of correlated errors of orientation and position (rad/m)."""
SHARES: Final = (0.5, 0.25, 0.125)
"""Candidates, in slow streams, for the share of the deviations that is noise."""
LOG_PRIOR_STEP: Final = -1.0
"""Log prior (nats) of each larger floor and each smaller share relative to the one before."""
LOG_PRIOR_WANDER: Final = 12.0
"""Log prior odds (nats) of correlated errors. Few streams have none; a model with them finds contacts in any
case, while without them true contacts may not fit. If there are none, the evidence against them is much
larger after some seconds of motion."""
ROTATION_PER_POSITION: Final = (2.0, 40.0)
"""Range of the ratio of the deviations (rad/m), if the stream does not determine it."""
USUAL_ROTATION_PER_POSITION: Final = 7.0


def usual_period_s(stamp_ns: NDArray[np.int64]) -> float:
    """Mean of the periods within a factor of ``IRREGULAR`` of the median; 0 for a single pose.

    With jitter of the stamps the median itself is biased.
    """
    if len(stamp_ns) < 2:
        return 0.0
    periods = stamp_ns[1:] - stamp_ns[:-1]
    return _mean_near(periods, float(linalg.median(periods)))


def _mean_near(periods: NDArray[np.int64], one: float) -> float:
    """Mean (s) of the periods (ns) within a factor of ``IRREGULAR`` of one."""
    ratio = periods / one
    usual = (ratio <= IRREGULAR) & (ratio >= 1.0 / IRREGULAR)
    return float(periods[usual].mean()) * 1e-9


def period_for_all_s(stamp_ns: NDArray[np.int64], model: Model) -> float:
    """The usual period of that stretch of a recording whose ticks suit the whole best.

    Lost are the stretches whose poses are too far apart for these ticks, and the ticks in which the contact
    changes, as often as the model has it.
    """
    if len(stamp_ns) < 2:
        return 0.0
    periods = np.diff(stamp_ns)
    beside = np.concatenate([periods[:1], periods, periods[-1:]])
    local = np.minimum(periods, np.minimum(beside[:-2], beside[2:]))  # not those of gaps
    order = np.argsort(local)
    passed = periods[order].cumsum()
    middle = order[np.searchsorted(passed, (QUANTILES * passed[-1]).astype(np.int64))]

    def lost(period_s: float) -> float:
        ticks = with_ticks_for(model, period_s)
        if not can_be_compared(ticks):
            return 1.0
        tick_s = ticks.tick_s
        apart = float(periods[local * 1e-9 > TOLERANCE * tick_s].sum() / periods.sum())
        return apart + (1.0 - apart) * min(tick_s * model.transitions.leave_per_s, 1.0)

    return min((_mean_near(periods, float(one)) for one in local[middle]), key=lost)


def with_ticks_for(model: Model, period_s: float) -> Model:
    """The model with ticks of at least ``poses_per_tick`` poses of this period, but at most a tenth of the
    window."""
    return replace(model, tick_s=tick_s) if (tick_s := tick_for(model, period_s)) != model.tick_s else model


def tick_for(model: Model, period_s: float) -> float:
    """The length (s) of these ticks: that of the model if it is enough."""
    needed_s = min(model.poses_per_tick * period_s, model.search.window_s / TICKS_PER_WINDOW)
    return needed_s if needed_s > TOLERANCE * model.tick_s else model.tick_s


def with_other_ticks(model: Model, now: Model, latest_ns: NDArray[np.int64]) -> Model | None:
    """``model`` with ticks for the rate of the latest poses; None if those of ``now`` suit it as well."""
    if len(latest_ns) < RATE_POSES:
        return None
    tick_s = tick_for(model, usual_period_s(latest_ns))
    if 1.0 / CHANGED <= tick_s / now.tick_s <= CHANGED:
        return None
    other = replace(model, tick_s=tick_s)
    return other if can_be_compared(other) else None


def candidates(model: Model, poses: Poses) -> tuple[tuple[Model, float], ...]:
    """The model, and copies with other noise, each with its log prior odds (nats) against the first.

    Averaging reduces filtered noise less than white noise, by an unknown factor. A filter has the same effect
    on position and orientation, so the ratio of their noise is that of the frames. In slow streams the noise
    may be smaller than the differences of frames, and there may be correlated errors.

    Parameters
    ----------
    poses : the first of the stream.
    """
    unchanged = model, 0.0
    if not model.noise.estimated or not can_be_compared(model):
        return (unchanged,)
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
    larger = [_with_floor(model, scale / sqrt(ratio), scale * sqrt(ratio)) for scale in floors]
    is_slow = span_s > SLOW_PERIOD_S * (len(poses) - 1)
    smaller = [_with_noise(model, estimate_share=share) for share in SHARES if is_slow]
    correlated = [
        _with_noise(model, wander_position_m=scale, wander_rotation_rad=scale * WANDER_ROTATION_PER_POSITION)
        for scale in WANDER_M
        if scale > white[0] ** 0.5
    ]
    return (
        unchanged,
        *((one, LOG_PRIOR_STEP * i) for some in (smaller, larger) for i, one in enumerate(some, 1)),
        *((one, LOG_PRIOR_WANDER) for one in correlated),
    )


def _with_noise(model: Model, **changes: Any) -> Model:
    return replace(model, noise=replace(model.noise, **changes))


def _with_floor(model: Model, position_m: float, rotation_rad: float) -> Model:
    floor_position_m = max(position_m, model.noise.floor_position_m)
    floor_rotation_rad = max(rotation_rad, model.noise.floor_rotation_rad)
    return _with_noise(model, floor_position_m=floor_position_m, floor_rotation_rad=floor_rotation_rad)
