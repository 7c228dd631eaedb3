"""Free motion as a Kalman filter: how surprising would it be that a direction stays put? (docs/theory.md)

Position and orientation of an unconstrained object move smoothly: constant acceleration, disturbed by white
jerk whose strength follows the innovations. What the filter cannot predict, beyond the noise, is the *excess*:
the variance with which a freely moving object would have left the constraint in this tick.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import predict, update
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

# White jerk is this share of what would explain the innovations alone; it minimises the prediction error of
# hand and robot motion alike, between 0.03 and 0.3 it hardly matters.
JERK_SHARE: Final = 0.1
SETTLING_TICKS: Final = 4
NOW_TICKS: Final = 3
"""Over this many ticks an object that has stopped is known to have stopped."""
SHAPE_MEMORY_S: Final = 1.5
STILL: Final = 2.0
"""Innovations up to this many noise variances are those of an object at rest."""
LOG_BIAS: Final = 1.446
"""exp(-E log(chi^2_3 / 3)): from the geometric to the arithmetic mean of squares in three axes."""
TINY: Final = 1e-20
_PRIOR_SPREAD: Final = (1.0, 10.0, 100.0)


@dataclass(frozen=True, eq=False)
class Smooth3:
    """Filter of one smooth vector in R^3: state x (9,) of value, rate and acceleration, covariance P (9, 9).

    ``log_square`` and ``weight`` are running sums of the log squared innovation per axis and of their weights:
    averaged in the log, a jolt does not outshine the seconds of rest after it; ``latest`` are the last few.
    """

    x: Array
    covariance: Array
    log_square: float = 0.0
    shape: Array = field(default_factory=lambda: np.eye(3) / 3.0)
    latest: tuple[float, ...] = ()
    weight: float = 0.0
    ticks: int = 0


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """Filters of the position (m) and of the integrated rotation (rad), and the last orientation seen."""

    position: Smooth3
    turn: Smooth3
    rotation: Array
    turned: Array


@dataclass(frozen=True)
class Excess:
    """Unpredictable motion per axis in a tick beyond the noise: variances in m^2 and rad^2."""

    position_m2: float
    rotation_rad2: float


def begin(rotation: Array, position_m: Array) -> FreeMotion:
    """Start at a first tick with rotation (3, 3) and position (3,)."""
    spread = np.kron(np.diag(np.square(_PRIOR_SPREAD)), np.eye(3))
    still = np.zeros(6)
    return FreeMotion(
        Smooth3(np.concatenate([position_m, still]), spread),
        Smooth3(np.zeros(9), spread),
        rotation,
        np.zeros(3),
    )


def advance(
    state: FreeMotion,
    rotation: Array,
    position_m: Array,
    variances: tuple[float, float],
    tick_s: float,
    memory_s: float,
) -> tuple[FreeMotion, Excess]:
    """One tick on: the mean pose of the tick and its noise variances (m^2, rad^2) per axis."""
    turned = state.turned + Rotation.from_matrix(state.rotation.T @ rotation).as_rotvec()
    position, excess_position = _advance(state.position, position_m, variances[0], tick_s, memory_s)
    turn, excess_turn = _advance(state.turn, turned, variances[1], tick_s, memory_s)
    return FreeMotion(position, turn, rotation, turned), Excess(excess_position, excess_turn)


def predicted_position(state: FreeMotion, ahead_s: Array) -> Array:
    """Positions (N, 3) that free motion leads to ``ahead_s`` (N,) after the last tick's middle."""
    p, v, a = state.position.x.reshape(3, 3)
    return np.asarray(p + v * ahead_s[:, None] + 0.5 * a * np.square(ahead_s)[:, None])


def predicted_rotation(state: FreeMotion, ahead_s: Array) -> Array:
    """Orientations (N, 3, 3) that free motion leads to ``ahead_s`` (N,) after the last tick's middle."""
    turn, rate, acceleration = state.turn.x.reshape(3, 3)
    ahead = turn - state.turned + rate * ahead_s[:, None] + 0.5 * acceleration * np.square(ahead_s)[:, None]
    return np.asarray(state.rotation @ Rotation.from_rotvec(ahead).as_matrix())


def spread(state: Smooth3) -> float:
    """Variance per axis of the next tick's innovation, as the last ones have shown."""
    return LOG_BIAS * float(np.exp(state.log_square / state.weight)) if state.weight else float("inf")


def _advance(
    state: Smooth3, value: Array, variance: float, tick_s: float, memory_s: float
) -> tuple[Smooth3, float]:
    rate = np.array([[1.0, tick_s, tick_s**2 / 2], [0.0, 1.0, tick_s], [0.0, 0.0, 1.0]])
    unit_jerk = Q_continuous_white_noise(3, tick_s, 1.0)
    excess = max(spread(state) - variance, 0.0) if state.weight else variance
    jerk = JERK_SHARE * excess / unit_jerk[0, 0]
    eye = np.eye(3)
    x, covariance = predict(state.x, state.covariance, F=np.kron(rate, eye), Q=np.kron(unit_jerk * jerk, eye))
    observe = np.kron([[1.0, 0.0, 0.0]], eye)
    innovation = value - observe @ x
    x, covariance = update(x, covariance, value, variance * eye, observe)
    log_square, shape, latest, weight = state.log_square, state.shape, state.latest, state.weight
    if state.ticks >= SETTLING_TICKS:
        fade = np.exp(-tick_s / memory_s)
        log_square = fade * log_square + float(np.log(innovation @ innovation / 3.0 + TINY))
        weight = fade * weight + 1.0
        fade_shape = np.exp(-tick_s / SHAPE_MEMORY_S)
        direction = innovation / np.linalg.norm(innovation + TINY)
        shape = fade_shape * shape + (1.0 - fade_shape) * np.outer(direction, direction)
        latest = (*latest, float(np.log(innovation @ innovation / 3.0 + TINY)))[-NOW_TICKS:]
    after = Smooth3(x, covariance, log_square, shape, latest, weight, state.ticks + 1)
    if not weight:
        return after, 0.0
    now = LOG_BIAS * float(np.exp(np.mean(latest)))
    excess = max(min(spread(after), now) - STILL * variance, 0.0)
    axes = variance + excess * 3.0 * np.maximum(np.linalg.eigvalsh(shape), 0)
    return after, float(np.exp(np.mean(np.log(axes)))) - variance
