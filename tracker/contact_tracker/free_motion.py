"""Free motion as a Kalman filter: how surprising would it be that a direction stays put?

Position and orientation of an unconstrained object move smoothly: constant acceleration, disturbed by
white jerk whose strength follows the innovations. What the filter cannot predict, beyond the noise, is the
*excess* (docs/theory.md, T18): the variance with which a freely moving object would have left the
constraint in this tick.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import exp, sqrt
from typing import Final, NamedTuple

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import predict, update
from numpy.typing import NDArray

from contact_tracker.quaternions import from_rotation_vectors, inverse, nearest, product, rotation_vectors

Array = NDArray[np.float64]

# White jerk is this share of what would explain the innovations alone; it minimises the prediction error of
# hand and robot motion alike, between 0.03 and 0.3 it hardly matters.
JERK_SHARE: Final = 0.1
SETTLING_TICKS: Final = 4
NOW_TICKS: Final = 3
"""Over this many ticks an object that has stopped is known to have stopped."""
SHAPE_MEMORY_S: Final = 1.5
STILL: Final = 3.0
"""Innovations up to this many noise variances are those of an object at rest."""
LOG_BIAS: Final = 1.446
"""exp(-E log(chi^2_3 / 3)): from the geometric to the arithmetic mean of squares in three axes."""
TINY: Final = 1e-20
_PRIOR_SPREAD: Final = (1.0, 10.0, 100.0)
_EYE: Final = np.eye(3)
_VALUE: Final = np.eye(3, 9)
"""What of the state is measured."""


@dataclass(frozen=True, eq=False)
class Smooth3:
    """Filter of one smooth vector in R^3: state x (9,) of value, rate and acceleration, covariance P (9, 9).

    Two predictions compete: that the vector moves on as the filter says, and that it stays at ``last``.
    ``log_square`` (2,) and ``weight`` are running sums of the log squared error per axis of each, and of the
    weights (in the log a jolt does not outshine the seconds of rest after it); ``latest`` (n, 2) are the last
    few. Of the filter's errors, ``shape`` (3, 3) is the mean of their directions, with trace 1, ``direction``
    the last one and ``echo`` the mean cosine from one to the next: how much of an error was to be expected.
    """

    x: Array
    covariance: Array
    last: Array
    log_square: Array
    weight: float
    latest: Array
    shape: Array
    direction: Array
    echo: float
    ticks: int

    @classmethod
    def at(cls, value: Array) -> "Smooth3":
        """At rest, as far as is known."""
        spread = np.kron(np.diag(np.square(_PRIOR_SPREAD)), np.eye(3))
        x = np.concatenate([value, np.zeros(6)])
        return cls(x, spread, value, np.zeros(2), 0.0, np.zeros((0, 2)), np.eye(3) / 3.0, np.zeros(3), 0.0, 0)

    @property
    def spread(self) -> float:
        """Mean squared error per axis of the better prediction; infinite before any was made."""
        if not self.weight:
            return float("inf")
        return LOG_BIAS * exp(self.log_square.min() / self.weight)

    def excess(self, variance: float) -> float:
        """Variance per axis, beyond the noise ``variance``, with which the vector moved in the last tick.

        In the log it is the mean over the axes of the motion, less the echo: a constraint is worth what a
        typical axis would be worth, and only what each tick says anew (T18).
        """
        if not self.weight:
            return 0.0
        now = LOG_BIAS * exp(self.latest.mean(axis=0).min())
        moving = min(self.spread, now) - STILL * variance
        if moving <= 0.0:
            return 0.0
        axes = variance + moving * 3.0 * np.maximum(np.linalg.eigvalsh(self.shape), 0.0)
        echo = max(self.echo, 0.0)
        fresh = (1.0 - echo) / (1.0 + echo)
        return variance * max(exp(fresh * np.log(axes / variance).mean()) - 1.0, 0.0)


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """Filters of position (m) and integrated rotation (rad), and the last ``orientation`` (4,) ``xyzw``."""

    position: Smooth3
    turn: Smooth3
    orientation: Array
    turned: Array


@dataclass(frozen=True)
class Excess:
    """Unpredictable motion per axis in a tick beyond the noise: variances in m^2 and rad^2."""

    position_m2: float
    rotation_rad2: float


def begin(rotation: Array, position_m: Array) -> FreeMotion:
    """Start at a first tick with rotation (3, 3), which may be a mean of rotations, and position (3,)."""
    return FreeMotion(Smooth3.at(position_m), Smooth3.at(np.zeros(3)), nearest(rotation), np.zeros(3))


def advance(
    state: FreeMotion,
    rotation: Array,
    position_m: Array,
    variances: tuple[float, float],
    tick_s: float,
    memory_s: float,
) -> tuple[FreeMotion, Excess]:
    """One tick on: the mean pose of the tick and its noise variances (m^2, rad^2) per axis."""
    orientation = nearest(rotation)
    turned = state.turned + rotation_vectors(product(inverse(state.orientation), orientation))
    position = _advance(state.position, position_m, variances[0], tick_s, memory_s)
    turn = _advance(state.turn, turned, variances[1], tick_s, memory_s)
    excess = Excess(position.excess(variances[0]), turn.excess(variances[1]))
    return FreeMotion(position, turn, orientation, turned), excess


def predicted_position(state: FreeMotion, ahead_s: Array) -> Array:
    """Positions (N, 3) that free motion leads to ``ahead_s`` (N,) after the last tick's middle."""
    p, v, a = state.position.x.reshape(3, 3)
    return np.asarray(p + v * ahead_s[:, None] + 0.5 * a * np.square(ahead_s)[:, None])


def predicted_orientation(state: FreeMotion, ahead_s: Array) -> Array:
    """Orientations (N, 4), ``xyzw``, that it leads to ``ahead_s`` (N,) after the last tick's middle."""
    turn, rate, acceleration = state.turn.x.reshape(3, 3)
    ahead = turn - state.turned + rate * ahead_s[:, None] + 0.5 * acceleration * np.square(ahead_s)[:, None]
    return product(state.orientation, from_rotation_vectors(ahead))


class _Tick(NamedTuple):
    """What one tick does to value, rate and acceleration (9,), ``jerk`` (9, 9) by a unit of white jerk."""

    onward: Array
    jerk: Array
    jerk_of_value: float


@lru_cache(maxsize=8)
def _tick(tick_s: float) -> _Tick:
    rate = np.array([[1.0, tick_s, tick_s**2 / 2], [0.0, 1.0, tick_s], [0.0, 0.0, 1.0]])
    jerk = Q_continuous_white_noise(3, tick_s, 1.0)
    return _Tick(np.kron(rate, _EYE), np.kron(jerk, _EYE), float(jerk[0, 0]))


def _advance(state: Smooth3, value: Array, variance: float, tick_s: float, memory_s: float) -> Smooth3:
    tick = _tick(tick_s)
    x, covariance = predict(state.x, state.covariance, F=tick.onward)
    # what the filter's own uncertainty explains of its errors is no jerk: it would feed itself
    carried = float(covariance[:3, :3].trace()) / 3.0
    unexplained = max(state.spread - variance - carried, 0.0) if state.weight else variance
    covariance = covariance + tick.jerk * (JERK_SHARE * unexplained / tick.jerk_of_value)
    innovation = value - x[:3]
    x, covariance = update(x, covariance, value, variance * _EYE, _VALUE)
    ticks = state.ticks + 1
    if state.ticks < SETTLING_TICKS:
        return replace(state, x=x, covariance=covariance, last=value, ticks=ticks)
    stayed = value - state.last
    squares = np.array([innovation @ innovation, stayed @ stayed])
    log_square = np.log(squares / 3.0 + TINY)
    fade, fade_shape = exp(-tick_s / memory_s), exp(-tick_s / SHAPE_MEMORY_S)
    direction = innovation / (sqrt(squares[0]) + TINY)
    return Smooth3(
        x,
        covariance,
        last=value,
        log_square=fade * state.log_square + log_square,
        weight=fade * state.weight + 1.0,
        latest=np.concatenate([state.latest, log_square[None]])[-NOW_TICKS:],
        shape=fade_shape * state.shape + (1.0 - fade_shape) * direction[:, None] * direction,
        direction=direction,
        echo=fade_shape * state.echo + (1.0 - fade_shape) * float(direction @ state.direction),
        ticks=ticks,
    )
