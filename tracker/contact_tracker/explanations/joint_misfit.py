"""Errors that follow the motion of a joint: its play, and markers that bend (docs/theory.md, T44)."""

from typing import Final

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.geometry.linalg import TINY

MOST_PLAY: Final = 100.0
"""Largest ratio to the noise of errors beside those that follow the motion, for joints of one degree of
freedom and for contacts with such motion: joints have play and markers bend. With 50 and 200 the rows of
``joint_play.py`` differ by 5 of 384 cases at most; without it 5 of 489 fewer hinges and balls are named."""
WAVES: Final = 12
"""Number of cosines over the whole way of a joint, and over the time of a drift. With 6, 8 instead of 2 of
the 594 hinges of ``tests/benchmarks/joint_play.py --seeds 0 1`` are sure to be balls."""
CROSSED_WAVES: Final = 3
"""Number of cosines whose amplitude depends on the direction of motion. Without them 42 instead of 38 of 396
hinges with ``--swings 3 6`` are sure to be another joint, and two of three that change sides late in their
swing are balls; with one, one of these (``tests/joints``)."""
SLACK: Final = 0.08
"""Half of the way, as a share of the whole, after which a joint that turns back lies on its other side
(``tests/benchmarks/joint_play.py``)."""
POWER: Final = np.concatenate([[0.0], np.geomspace(1e-2, 1e8, 45)])
"""Ratios of the variance of errors that follow the motion to that of the noise; the likeliest is used."""
STEPS: Final = 8
"""Number of steps of expectation maximisation; with 4 one case of ``joint_play.py`` changes."""


def course_functions(travelled: Array) -> Array:
    """Functions (W, M) of the way (W,) travelled by a joint, whose sum is an error that follows the motion.

    A constant; cosines with the amplitudes of a random walk over the way, averaged over each tick like its
    pose; a play operator, whose value depends on where the joint turned back (Krasnosel'skii and Pokrovskii,
    Systems with Hysteresis, 1989); and products of both.
    """
    way = (travelled - travelled.min()) / max(float(np.ptp(travelled)), TINY)
    order = np.arange(1, WAVES + 1)
    waves = np.cos(np.pi * way[:, None] * order) * np.sinc(0.5 * np.gradient(way)[:, None] * order) / order
    side = np.zeros((len(way), 1))
    for tick, step in enumerate(np.diff(way), 1):
        side[tick] = np.clip(side[tick - 1] + step / SLACK, -1.0, 1.0)
    return np.column_stack([np.ones(len(way)), waves, side, side * waves[:, :CROSSED_WAVES]])


def drift_functions(index: Ints) -> Array:
    """Functions (W, M) of the numbers ``index`` (W,) of ticks, whose sum is a drift of the tracker: cosines
    with the amplitudes of a random walk over the time."""
    time, order = (index - index[0]) / max(int(np.ptp(index)), 1), np.arange(1, WAVES + 1)
    return np.asarray(np.cos(np.pi * time[:, None] * order) / order)


def turns_back(travelled: Array) -> bool:
    """Whether a joint turns back on its way (W,), by more than it takes to lie on its other side."""
    least = 2.0 * SLACK * np.ptp(travelled)
    forth = (np.maximum.accumulate(travelled) - travelled).max()
    back = (travelled - np.minimum.accumulate(travelled)).max()
    return bool(min(forth, back) > least)


def misfit_log_likelihood(white: Array, course: Array | None) -> float:
    """Log-likelihood (nats) of whitened residuals (W, K), relative to zero residuals that are noise.

    They are errors that follow the motion, sums of the functions ``course`` (W, M) with normal amplitudes,
    and noise; without a course noise alone. Both variances are the likeliest, by expectation maximisation;
    each that exceeds the least costs half a log of the number of ticks.
    """
    if course is None:
        return -0.5 * float(np.square(white).sum())
    (ticks, rows), best = white.shape, -np.inf
    noise_sd, deviation, cost_nats = np.eye(rows), np.ones(rows), 0.5 * float(np.log(ticks))
    functions, scale, _ = np.linalg.svd(course, full_matrices=False)
    variance_ratio = 1.0 + POWER[:, None] * np.square(scale)  # (P, M) with the errors, over noise alone
    power_cost = 0.5 * np.log(variance_ratio).sum(axis=1) + cost_nats * (POWER > 0.0)
    for _ in range(STEPS):
        scaled = np.linalg.solve(noise_sd, white.T).T
        axes = np.linalg.eigh(scaled.T @ scaled)[1]
        scaled = scaled @ axes
        amplitudes = functions.T @ scaled
        by_power = power_cost[:, None] + 0.5 * (1.0 / variance_ratio) @ np.square(amplitudes)
        remainder = 0.5 * float(np.square(scaled).sum() - np.square(amplitudes).sum())
        wide = int((deviation > 1.0).sum())
        noise_cost = ticks * float(np.log(deviation).sum()) + 0.5 * cost_nats * wide * (wide + 1)
        best = max(best, -float(by_power.min(axis=0).sum()) - remainder - noise_cost)
        share = 1.0 - 1.0 / variance_ratio[by_power.argmin(axis=0)].T  # of errors in an amplitude
        residual, root = scaled - functions @ (share * amplitudes), noise_sd @ axes
        covariance = root @ (residual.T @ residual + np.diag(share.sum(axis=0))) @ root.T / ticks
        variance, axes = np.linalg.eigh(covariance)
        deviation = np.sqrt(np.clip(variance, 1.0, MOST_PLAY**2))
        noise_sd = (axes * deviation) @ axes.T
    return best
