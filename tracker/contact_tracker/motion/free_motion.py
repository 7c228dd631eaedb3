"""The free-motion model: a constant-acceleration Kalman filter and the statistics of its innovations.

Position and orientation of an unconstrained object move smoothly: constant acceleration, disturbed by white
jerk whose strength follows the innovations. The variance of the innovations beyond the noise is the *excess*
(docs/theory.md, T18): the variance with which a freely moving object would have left a constraint in this
tick.
"""

from collections.abc import Callable
from functools import cache, lru_cache
from math import exp
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.config.parameters import Model
from contact_tracker.geometry.linalg import (
    between,
    from_rotation_vectors,
    nearest,
    product,
    rotation_vectors,
)

# Share of the innovations that is attributed to white jerk. It minimises the prediction error of hand and
# robot motion alike; between 0.03 and 0.3 it hardly matters.
JERK_SHARE: Final = 0.1
LONGEST_COAST_S: Final = 2.0
"""After a longer gap the filter starts again."""
LONGEST_PREDICTION: Final = 1.5
"""Errors of predictions over more ticks than this do not count for the strength of the motion."""
NOW_TICKS: Final = 3
"""Number of ticks after which an object that has stopped is recognised to rest."""
SETTLING_TICKS: Final = NOW_TICKS + 1
SHAPE_MEMORY_S: Final = 1.5
REST_VARIANCE_RATIO: Final = 3.0
"""Innovations of up to this many noise variances count as rest."""
LOG_BIAS: Final = 6.0 * exp(np.euler_gamma - 2.0)
"""exp(-E log(chi^2_3 / 3)): from the geometric to the arithmetic mean of squares in three axes."""
TINY: Final = 1e-20
PRIOR_SPREAD: Final = (1.0, 10.0, 100.0)
"""Initial standard deviations of value, rate and acceleration."""
_EYE: Final = np.eye(3)
_EYE_6: Final = np.eye(6)
_VALUE: Final = np.kron(np.eye(2), np.eye(1, 3))
"""(2, 6) measurement matrix: the two values."""
_POWERS: Final = np.arange(3.0)
_SHARES: Final = np.array([1.0, 1.0, 0.5])
"""Coefficients of value, rate and acceleration in a prediction, with the powers of time."""
_POWERS_OF_JERK: Final = 5.0 - np.add.outer(np.arange(3), np.arange(3))
"""Divisors of the powers of time in the covariance due to white jerk, from its integral."""
_UNIT: Final = np.ones(2)
_WHOLE: Final = np.ones((2, 2))


class FreeMotion(NamedTuple):
    """Filters of two smooth vectors in R^3, the position (m) and the integrated rotation (rad).

    Two predictions compete: that a vector moves on as the filter predicts, and that it stays at ``last``.
    Sums over ticks are exponentially weighted. Errors are averaged in the log, so that one jolt does not
    dominate seconds of rest.

    Parameters
    ----------
    x : (2, 3, 3) value, rate and acceleration of each vector, by axis.
    covariance : (6, 6) of both vectors' states along any one axis; all axes have the same noise.
    last : (2, 3) values of the last tick, at ``orientation`` (4,) ``xyzw``.
    log_squared_error : (2, 2) weighted sum of the log squared error per axis, by vector and prediction.
    weight : sum of the weights.
    spread : (2,) mean squared error per axis of the better prediction; infinite before any was made.
    latest : (n, 2, 2) log squared errors of the last few ticks.
    shape : (2, 3, 3) mean of the outer products of the filter's error directions, with trace 1.
    direction : (2, 3) error directions of the last tick.
    autocorrelation : (2,) mean cosine between consecutive errors.
    ticks : number of ticks so far.
    stamp_ns : mean time of the frames of the last tick.
    """

    x: Array
    covariance: Array
    last: Array
    orientation: Array
    log_squared_error: Array
    weight: float
    spread: Array
    latest: Array
    shape: Array
    direction: Array
    autocorrelation: Array
    ticks: int
    stamp_ns: int

    @property
    def is_settled(self) -> bool:
        """Whether its predictions have been compared with poses, without a gap since."""
        return self.weight > 0.0 and self.ticks >= SETTLING_TICKS

    def excess(self, variance: Array, rest: Array, share: Array | float = 1.0) -> Array:
        """Variance per axis (2,) of the last tick's unpredictable motion beyond the noise ``variance`` (2,).

        ``share`` (2,) is the part of a whole tick's motion in this tick. The variance is the geometric mean
        over the axes of the motion, reduced by the autocorrelation of the errors: a constraint counts
        like a typical axis, and only by its innovation (T18).
        """
        if not self.weight:
            return np.zeros(2)
        recent = LOG_BIAS * np.exp(np.minimum(*self.latest.sum(axis=0).T) / len(self.latest))
        beyond = np.maximum(np.minimum(self.spread, recent) - REST_VARIANCE_RATIO * rest, 0.0)
        if not beyond.any():
            return np.zeros(2)
        moving = beyond / variance * share
        axes = np.linalg.det(_EYE + (3.0 * moving)[:, None, None] * self.shape)
        correlation = np.maximum(self.autocorrelation, 0.0)
        fresh = (1.0 - correlation) / (1.0 + correlation)
        return np.asarray(variance * (np.maximum(axes, 1.0) ** (fresh / 3.0) - 1.0))


InnovationExcess = tuple[float, float]
"""Unpredictable motion per axis in a tick beyond the noise: variances in m^2 and rad^2."""
NO_EXCESS: Final[InnovationExcess] = (0.0, 0.0)


def begin(rotation: Array, position_m: Array, stamp_ns: int, autocorrelation: float = 0.0) -> FreeMotion:
    """Start at rest, at a first tick with rotation (3, 3), possibly a mean of rotations, and position (3,);
    the ``autocorrelation`` of errors is assumed until some are known."""
    x = np.zeros((2, 3, 3))
    x[0, 0] = position_m
    return FreeMotion(
        x,
        np.diag(np.square(PRIOR_SPREAD * 2)),
        last=x[:, 0],
        orientation=nearest(rotation),
        log_squared_error=np.zeros((2, 2)),
        weight=0.0,
        spread=np.full(2, np.inf),
        latest=np.zeros((0, 2, 2)),
        shape=np.array([_EYE, _EYE]) / 3.0,
        direction=np.zeros((2, 3)),
        autocorrelation=np.full(2, autocorrelation),
        ticks=0,
        stamp_ns=stamp_ns,
    )


def can_go_on(state: FreeMotion, stamp_ns: int) -> bool:
    """Whether the filter can continue with a tick of this mean time, or the gap before it is too long."""
    gap_s = (stamp_ns - state.stamp_ns) * 1e-9
    return 0.0 < gap_s <= LONGEST_COAST_S


def is_predictable(state: FreeMotion, stamp_ns: int, tick_s: float) -> bool:
    """Whether prediction errors over the time since the last tick are known."""
    return state.is_settled and (stamp_ns - state.stamp_ns) * 1e-9 <= LONGEST_PREDICTION * tick_s


def predicted(state: FreeMotion, ahead_s: Array) -> tuple[Array, Array]:
    """Positions (N, 3) and orientations (N, 4) ``ahead_s`` (N,) after the time of the last tick."""
    position, turn = ahead_s[:, None] ** _POWERS * _SHARES @ state.x
    return position, product(state.orientation, from_rotation_vectors(turn - state.last[1]))


def moves_on(state: FreeMotion, stamp_ns: int, variance: Array) -> bool:
    """Whether the predicted motion until then exceeds the noise ``variance`` (2,).

    False after a time over which nothing is predicted.
    """
    ahead_s = (stamp_ns - state.stamp_ns) * 1e-9
    if ahead_s > LONGEST_COAST_S:
        return False
    way = ahead_s ** _POWERS[1:] * _SHARES[1:] @ state.x[:, 1:]
    return bool(((way * way).sum(axis=1) > 3.0 * REST_VARIANCE_RATIO * variance).any())


@lru_cache(maxsize=64)
def transition(elapsed_s: float) -> tuple[Array, Array]:
    """The matrix (6, 6) of the transition of the filter's states over ``elapsed_s``, and the process noise
    (6, 6) per unit of white jerk."""
    rate = np.array([[1.0, elapsed_s, elapsed_s**2 / 2], [0.0, 1.0, elapsed_s], [0.0, 0.0, 1.0]])
    grown = np.array([elapsed_s**2 / 2, elapsed_s, 1.0])  # effect of a unit impulse of jerk on the states
    jerk = np.asarray(np.outer(grown, grown) * elapsed_s / _POWERS_OF_JERK, float)
    vectors = np.eye(2)
    return np.kron(vectors, rate), np.kron(vectors, jerk)


def advance(
    state: FreeMotion,
    rotation: Array,
    position_m: Array,
    variance: Array,
    rest: Array,
    stamp_ns: int,
    tick_s: float,
    memory_s: float,
) -> tuple[FreeMotion, InnovationExcess]:
    """Advance by a tick: the mean pose of its frames, its noise ``variance`` (2,) per axis (m^2, rad^2), and
    the mean time of its frames.

    Ticks need not be ``tick_s`` apart, since frames may be missing. Errors are scaled to a prediction over
    ``tick_s``; the excess is for the time that has passed.
    """
    elapsed_s = round((stamp_ns - state.stamp_ns) * 1e-9, 4)
    orientation = nearest(rotation)
    value = np.array([position_m, state.last[1] + rotation_vectors(between(state.orientation, orientation))])
    prediction = _predict(state, variance, elapsed_s, tick_s)
    innovation, errors = value - prediction.x[:, 0], value - state.last
    x, covariance = _updated(prediction, innovation, variance)
    squares = np.array([(innovation * innovation).sum(axis=1), (errors * errors).sum(axis=1)]).T
    settled = state.ticks >= SETTLING_TICKS
    state = state._replace(
        x=x,
        covariance=covariance,
        last=value,
        orientation=orientation,
        ticks=state.ticks + 1,
        stamp_ns=stamp_ns,
    )
    if not settled:
        return state, NO_EXCESS
    if elapsed_s <= LONGEST_PREDICTION * tick_s:
        of_tick = squares * prediction.per_tick
        state = _with_errors(state, of_tick, innovation / (np.sqrt(squares[:, :1]) + TINY), tick_s, memory_s)
        share = prediction.share
    else:  # no prediction: only the displacement is known
        share = np.where(squares[:, 1] > 3.0 * REST_VARIANCE_RATIO * rest, prediction.share, 0.0)
    excess = state.excess(variance, rest, share)
    return state, (float(excess[0]), float(excess[1]))


def _with_errors(
    state: FreeMotion, squares: Array, direction: Array, tick_s: float, memory_s: float
) -> FreeMotion:
    """Update the statistics by the squared errors (2, 2) of both predictions and the directions (2, 3) of the
    filter's errors."""
    fade, fade_shape = exp(-tick_s / memory_s), exp(-tick_s / SHAPE_MEMORY_S)
    log_square = np.log(squares / 3.0 + TINY)
    summed, weight = fade * state.log_squared_error + log_square, fade * state.weight + 1.0
    return state._replace(
        log_squared_error=summed,
        weight=weight,
        spread=LOG_BIAS * np.exp(np.minimum(summed[:, 0], summed[:, 1]) / weight),
        latest=np.concatenate([state.latest[1 - NOW_TICKS :], log_square[None]]),
        shape=fade_shape * state.shape + (1.0 - fade_shape) * direction[:, :, None] * direction[:, None],
        direction=direction,
        autocorrelation=fade_shape * state.autocorrelation
        + (1.0 - fade_shape) * (direction * state.direction).sum(axis=1),
    )


class _Prediction(NamedTuple):
    """Predicted states ``x`` (2, 3, 3) and ``covariance`` (6, 6).

    ``per_tick`` (2, 2) are factors that scale squared errors of both predictions to those of a whole tick;
    ``share`` (2,) is the unpredictable motion of the time that has passed, relative to a whole tick.
    """

    x: Array
    covariance: Array
    per_tick: Array
    share: Array


def _predict(state: FreeMotion, variance: Array, elapsed_s: float, tick_s: float) -> _Prediction:
    predict, (matrix, by_jerk) = kalman_prediction(), transition(tick_s)
    x, carried = predict(state.x.reshape(6, 3), state.covariance, F=matrix)
    # errors that the filter's own uncertainty explains are no jerk, else the estimate would feed back on
    # itself
    explained = carried.diagonal()[::3]
    unexplained = np.maximum(state.spread - variance - explained, 0.0) if state.weight else variance
    jerk = unexplained * (JERK_SHARE / by_jerk[0, 0])
    covariance_of_tick = carried + by_jerk * jerk.repeat(3)
    if elapsed_s == round(tick_s, 4):
        return _Prediction(x.reshape(2, 3, 3), covariance_of_tick, _WHOLE, _UNIT)
    matrix, by_jerk = transition(elapsed_s)
    x, covariance = predict(state.x.reshape(6, 3), state.covariance, F=matrix)
    covariance = covariance + by_jerk * jerk.repeat(3)
    of_tick, of_time = covariance_of_tick.diagonal()[::3], covariance.diagonal()[::3]
    stays = min(tick_s / elapsed_s, 1.0) ** 2  # the error of "it stays" grows with the distance moved
    per_tick = np.array([(of_tick + variance) / (of_time + variance), [stays, stays]]).T
    return _Prediction(x.reshape(2, 3, 3), covariance, per_tick, of_time / of_tick)


@cache
def kalman_prediction() -> "Callable[..., tuple[Array, Array]]":
    """The prediction of ``filterpy``, whose import takes longer than many ticks."""
    from filterpy.kalman import predict

    function: Callable[..., tuple[Array, Array]] = predict
    return function


def _updated(prediction: _Prediction, innovation: Array, variance: Array) -> tuple[Array, Array]:
    """States (2, 3, 3) and covariance after measurements with this ``innovation`` (2, 3); the errors of the
    two vectors are independent."""
    prior = prediction.covariance
    gain = prior[:, ::3] / (prior.diagonal()[::3] + variance)
    kept = _EYE_6 - gain @ _VALUE
    covariance = kept @ prior @ kept.T + (gain * variance) @ gain.T  # Joseph's form stays positive definite
    return prediction.x + gain.sum(axis=1).reshape(2, 3, 1) * innovation[:, None], covariance


def can_be_compared(model: Model) -> bool:
    """Whether poses with ticks of this model follow each other closely enough for free motion to be
    predicted; otherwise no tick has evidence."""
    return model.tick_s < max(model.poses_per_tick, 1.0) * LONGEST_COAST_S
