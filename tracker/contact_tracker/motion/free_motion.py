"""Free motion as a Kalman filter: how surprising would it be that a direction stays put?

Position and orientation of an unconstrained object move smoothly: constant acceleration, disturbed by
white jerk whose strength follows the innovations. What the filter cannot predict, beyond the noise, is the
*excess* (docs/theory.md, T18): the variance with which a freely moving object would have left the
constraint in this tick.
"""

from functools import lru_cache
from math import exp
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.rotation import (
    between,
    from_rotation_vectors,
    nearest,
    product,
    rotation_vectors,
)

Array = NDArray[np.float64]

# White jerk is this share of what would explain the innovations alone; it minimises the prediction error of
# hand and robot motion alike, between 0.03 and 0.3 it hardly matters.
JERK_SHARE: Final = 0.1
SETTLING_TICKS: Final = 4
SETTLING_AGAIN_TICKS: Final = 1
"""After a gap that the filter has coasted through."""
LONGEST_COAST_S: Final = 2.0
NOW_TICKS: Final = 3
"""Over this many ticks an object that has stopped is known to have stopped."""
SHAPE_MEMORY_S: Final = 1.5
STILL: Final = 3.0
"""Innovations up to this many noise variances are those of an object at rest."""
LOG_BIAS: Final = 1.446
"""exp(-E log(chi^2_3 / 3)): from the geometric to the arithmetic mean of squares in three axes."""
TINY: Final = 1e-20
PRIOR_SPREAD: Final = (1.0, 10.0, 100.0)
"""Deviations of value, rate and acceleration at first."""
_EYE: Final = np.eye(3)
_VALUE: Final = np.kron(np.eye(2), np.eye(1, 3))
"""(2, 6): what of the states is measured."""
_POWERS: Final = np.arange(3.0)
_SHARES: Final = np.array([1.0, 1.0, 0.5])
"""Of value, rate and acceleration in what is ahead, with the powers of time."""
_POWERS_OF_JERK: Final = 5.0 - np.add.outer(np.arange(3), np.arange(3))
"""Of time, in the covariance of the states that white jerk has moved: its integral is divided by them."""
_REST: Final = np.zeros(6)
_UNIT: Final = np.ones(2)


class FreeMotion(NamedTuple):
    """Filters of two smooth vectors in R^3, the position (m) and the integrated rotation (rad).

    Two predictions compete: that a vector moves on as the filter says, and that it stays at ``last``. Sums
    over ticks fade with time; of errors the logs are added, so that a jolt does not outshine seconds of rest.

    Parameters
    ----------
    x : (2, 3, 3) value, rate and acceleration of each vector, by axis.
    covariance : (6, 6) of the states of both for any one axis: all axes are measured alike.
    last : (2, 3) values of the last tick, at ``orientation`` (4,) ``xyzw``.
    log_squared_error : (2, 2) sum, of each vector and each prediction, of the log squared error per axis.
    weight : sum of the weights of those.
    latest : (n, 2, 2) log squared errors of the last few ticks.
    shape : (2, 3, 3) mean of the directions of the filter's errors, with trace 1.
    direction : (2, 3) those of the last tick.
    autocorrelation : (2,) mean cosine from one error to the next: how much of it was to be expected.
    ticks : so many were taken in.
    """

    x: Array
    covariance: Array
    last: Array
    orientation: Array
    log_squared_error: Array
    weight: float
    latest: Array
    shape: Array
    direction: Array
    autocorrelation: Array
    ticks: int

    @property
    def is_settled(self) -> bool:
        """Whether its predictions have been compared with poses, and there was no gap since."""
        return self.weight > 0.0 and self.ticks >= SETTLING_TICKS

    @property
    def spread(self) -> Array:
        """Mean squared error per axis (2,) of the better prediction; infinite before any was made."""
        if not self.weight:
            return np.full(2, np.inf)
        return np.asarray(LOG_BIAS * np.exp(np.minimum(*self.log_squared_error.T) / self.weight))

    def excess(self, variance: Array) -> Array:
        """Variance per axis (2,), beyond the noise ``variance`` (2,), of the motion in the last tick.

        In the log it is the mean over the axes of the motion, less the echo: a constraint is worth what a
        typical axis would be worth, and only what each tick says anew (T18).
        """
        if not self.weight:
            return np.zeros(2)
        now = LOG_BIAS * np.exp(np.minimum(*self.latest.sum(axis=0).T) / len(self.latest))
        moving = np.maximum(np.minimum(self.spread, now) / variance - STILL, 0.0)
        axes = np.linalg.det(_EYE + (3.0 * moving)[:, None, None] * self.shape)
        echo = np.maximum(self.autocorrelation, 0.0)
        fresh = (1.0 - echo) / (1.0 + echo)
        return np.asarray(variance * (np.maximum(axes, 1.0) ** (fresh / 3.0) - 1.0))


class InnovationExcess(NamedTuple):
    """Unpredictable motion per axis in a tick beyond the noise: variances in m^2 and rad^2."""

    position_m2: float
    rotation_rad2: float


NO_EXCESS: Final = InnovationExcess(0.0, 0.0)


def begin(rotation: Array, position_m: Array) -> FreeMotion:
    """Start at a first tick with rotation (3, 3), which may be a mean of rotations, and position (3,).

    At rest, as far as is known.
    """
    x = np.zeros((2, 3, 3))
    x[0, 0] = position_m
    return FreeMotion(
        x,
        np.diag(np.square(PRIOR_SPREAD * 2)),
        last=x[:, 0],
        orientation=nearest(rotation),
        log_squared_error=np.zeros((2, 2)),
        weight=0.0,
        latest=np.zeros((0, 2, 2)),
        shape=np.array([_EYE, _EYE]) / 3.0,
        direction=np.zeros((2, 3)),
        autocorrelation=np.zeros(2),
        ticks=0,
    )


def coasted(state: FreeMotion, count: int, tick_s: float, memory_s: float) -> FreeMotion | None:
    """After ``count`` ticks without a pose; None if that is too long, or of too little motion, to go on with.

    What is known of the strength of the motion is kept. The filter settles again before its errors count:
    they are those of a longer prediction.
    """
    if count * tick_s > LONGEST_COAST_S or state.ticks <= SETTLING_TICKS:
        return None
    tick = transition(tick_s, memory_s)
    x, covariance = state.x.reshape(6, 3), state.covariance
    for _ in range(count):
        unexplained = np.maximum(state.spread - covariance.diagonal()[::3], 0.0)
        jerk = tick.jerk_covariance * (unexplained * (JERK_SHARE / tick.jerk_covariance[0, 0])).repeat(3)
        x, covariance = tick.matrix @ x, tick.matrix @ covariance @ tick.matrix.T + jerk
    return state._replace(
        x=x.reshape(2, 3, 3), covariance=covariance, ticks=SETTLING_TICKS - SETTLING_AGAIN_TICKS
    )


def predicted(state: FreeMotion, ahead_s: Array) -> tuple[Array, Array]:
    """Positions (N, 3) and orientations (N, 4) ``ahead_s`` (N,) after the middle of the last tick."""
    position, turn = ahead_s[:, None] ** _POWERS * _SHARES @ state.x
    return position, product(state.orientation, from_rotation_vectors(turn - state.last[1]))


class Transition(NamedTuple):
    """What one tick does to the states of the filter."""

    matrix: Array
    """(6, 6)"""
    jerk_covariance: Array
    """(6, 6) by a unit of white jerk."""
    fade: float
    """By how much it makes errors count less."""
    fade_shape: float
    """By how much it makes the known shape of errors count less."""


@lru_cache(maxsize=8)
def transition(tick_s: float, memory_s: float) -> Transition:
    """Of a tick of this length, where errors are remembered for ``error_memory_s``."""
    rate = np.array([[1.0, tick_s, tick_s**2 / 2], [0.0, 1.0, tick_s], [0.0, 0.0, 1.0]])
    grown = np.array([tick_s**2 / 2, tick_s, 1.0])  # what a unit of jerk has made of the states by then
    jerk = np.asarray(np.outer(grown, grown) * tick_s / _POWERS_OF_JERK, float)
    both = np.eye(2)
    fade, fade_shape = exp(-tick_s / memory_s), exp(-tick_s / SHAPE_MEMORY_S)
    return Transition(np.kron(both, rate), np.kron(both, jerk), fade, fade_shape)


def advance(
    state: FreeMotion,
    rotation: Array,
    position_m: Array,
    variance: Array,
    tick_s: float,
    memory_s: float,
) -> tuple[FreeMotion, InnovationExcess]:
    """One tick on: the mean pose of the tick and its noise ``variance`` (2,) per axis (m^2, rad^2)."""
    tick = transition(tick_s, memory_s)
    fade, fade_shape = tick.fade, tick.fade_shape
    orientation = nearest(rotation)
    value = np.array([position_m, state.last[1] + rotation_vectors(between(state.orientation, orientation))])
    x, covariance, innovation = _filtered(state, value, variance, tick)
    ticks = state.ticks + 1
    if state.ticks < SETTLING_TICKS:
        state = state._replace(x=x, covariance=covariance, last=value, orientation=orientation, ticks=ticks)
        return state, NO_EXCESS
    errors = np.array([innovation, value - state.last])
    squares = (errors * errors).sum(axis=2).T
    log_square = np.log(squares / 3.0 + TINY)
    direction = innovation / (np.sqrt(squares[:, :1]) + TINY)
    state = FreeMotion(
        x,
        covariance,
        last=value,
        orientation=orientation,
        log_squared_error=fade * state.log_squared_error + log_square,
        weight=fade * state.weight + 1.0,
        latest=np.concatenate([state.latest[1 - NOW_TICKS :], log_square[None]]),
        shape=fade_shape * state.shape + (1.0 - fade_shape) * direction[:, :, None] * direction[:, None],
        direction=direction,
        autocorrelation=fade_shape * state.autocorrelation
        + (1.0 - fade_shape) * (direction * state.direction).sum(axis=1),
        ticks=ticks,
    )
    excess = state.excess(variance)
    return state, InnovationExcess(float(excess[0]), float(excess[1]))


def _filtered(
    state: FreeMotion, value: Array, variance: Array, tick: Transition
) -> tuple[Array, Array, Array]:
    """States (2, 3, 3) and covariance after the values (2, 3) of a tick, which were off by so much (2, 3)."""
    from filterpy.kalman import predict, update  # kernels do without: it takes longer to load than all else

    x, covariance = predict(state.x.reshape(6, 3), state.covariance, F=tick.matrix)
    x = x.reshape(2, 3, 3)
    # what the filter's own uncertainty explains of its errors is no jerk: it would feed itself
    carried = covariance.diagonal()[::3]
    unexplained = np.maximum(state.spread - variance - carried, 0.0) if state.weight else variance
    covariance = covariance + tick.jerk_covariance * (
        unexplained * (JERK_SHARE / tick.jerk_covariance[0, 0])
    ).repeat(3)
    innovation = value - x[:, 0]
    # the gain is what a measurement of 1 makes of 0
    gain, covariance = update(_REST, covariance, _UNIT, variance * np.eye(2), _VALUE)
    return x + gain.reshape(2, 3, 1) * innovation[:, None], covariance, innovation
