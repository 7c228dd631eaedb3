"""Smooth signals in time: random motion of the hand, and blending of motions."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_SINUSOIDS = 24
_LOWEST_HZ = 0.2


def band_limited(rng: np.random.Generator, time_s: Array, count: int, bandwidth_hz: float) -> Array:
    """``count`` independent random signals (N, count) of mean 0 and about unit power below ``bandwidth_hz``.

    Power is normalised over ``time_s`` (N,), so that each signal moves in every leg; in very short legs it
    stays below one.
    """
    shape = (_SINUSOIDS, count)
    frequency = rng.uniform(min(_LOWEST_HZ, bandwidth_hz / 2), bandwidth_hz, shape)
    phase = rng.uniform(0.0, 2.0 * np.pi, shape)
    angle = 2.0 * np.pi * frequency * time_s[:, None, None] + phase
    signal = np.sqrt(2.0 / _SINUSOIDS) * np.sin(angle).sum(axis=1)
    signal -= signal.mean(axis=0)
    return np.asarray(signal / np.maximum(signal.std(axis=0), 0.5), float)


def within(displacement: Array, radius: float) -> Array:
    """Displacements (N, d) softly bounded to less than ``radius``, unchanged where small."""
    length = np.linalg.norm(displacement, axis=-1, keepdims=True)
    return np.asarray(displacement / np.sqrt(1.0 + (length / max(radius, 1e-12)) ** 2), float)


def smooth_step(x: Array) -> Array:
    """0 for x <= 0, 1 for x >= 1, between them with continuous first and second derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x**2), float)


def blend(time_s: Array, duration_s: float, ramp_s: float) -> tuple[Array, Array, Array]:
    """Weights (N,) of the start, the middle and the end of a leg, which sum to one."""
    ramp = min(ramp_s, duration_s / 2.0)
    start = 1.0 - smooth_step(time_s / ramp)
    end = smooth_step((time_s - duration_s) / ramp + 1.0)
    return start, 1.0 - start - end, end


def drift(time_s: Array, settle_s: float) -> Array:
    """Displacement (N,) per unit of speed at time 0; the speed decays within ``settle_s`` before and
    after."""
    return np.asarray(settle_s * np.tanh(time_s / settle_s), float)
