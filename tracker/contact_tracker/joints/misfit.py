"""Errors that follow the motion of a joint: its play, and markers that bend (docs/theory.md, T44)."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_PLAY: Final = 100.0
"""Joints have play and markers bend: beside what follows the motion, the errors of a joint of one degree of
freedom may be up to this many times the noise, and so may those of contacts where the motion has one."""
WAVES: Final = 12
"""Number of cosines over the whole way of a joint."""
CROSSED_WAVES: Final = 3
"""Number of cosines whose amplitude depends on the direction of motion."""
SLACK: Final = np.array([0.02, 0.08, 0.2])
"""Halves of the ways, over the whole, after which a joint that turns back lies on its other side."""
POWER: Final = np.concatenate([[0.0], np.geomspace(1e-2, 1e8, 45)])
"""Variances of the errors that follow the motion, over that of the noise, of which the likeliest is taken."""
STEPS: Final = 8
TINY: Final = 1e-12
JITTER: Final = 1e-9


def course_functions(travelled: Array) -> Array:
    """Functions (W, M) of the way (W,) that a joint has moved, whose sum is an error that follows it.

    A constant; cosines with the amplitudes of a random walk over the way, averaged over each tick like its
    pose; play operators of several widths, whose value depends on where the joint turned back (Krasnosel'skii
    and Pokrovskii, Systems with Hysteresis, 1989); and products of both.
    """
    way = (travelled - travelled.min()) / max(float(np.ptp(travelled)), TINY)
    order = np.arange(1, WAVES + 1)
    waves = np.cos(np.pi * way[:, None] * order) * np.sinc(0.5 * np.gradient(way)[:, None] * order) / order
    side = np.zeros((len(way), len(SLACK)))
    for now, step in enumerate(np.diff(way), 1):
        side[now] = np.clip(side[now - 1] + step / SLACK, -1.0, 1.0)
    crossed = (side[:, :, None] * waves[:, None, :CROSSED_WAVES]).reshape(len(way), -1)
    return np.concatenate([np.ones((len(way), 1)), waves, side, crossed], axis=1)


def misfit_log_likelihood(white: Array, course: Array) -> float:
    """Log-likelihood (nats) of whitened residuals (W, K), zero if all are zero and known to be noise.

    They are errors that follow the motion, sums of the functions ``course`` (W, M) with normal amplitudes,
    and noise. Both variances are the likeliest, by expectation maximisation; each that exceeds the least
    costs half a log of the number of ticks.
    """
    (ticks, rows), best = white.shape, -np.inf
    noise, each = np.eye(rows), 0.5 * float(np.log(ticks))
    base, scale, _ = np.linalg.svd(course, full_matrices=False)
    fold = 1.0 + POWER[:, None] * np.square(scale)
    cost = 0.5 * np.log(fold).sum(axis=1) + each * (POWER > 0.0)
    for _ in range(STEPS):
        part = np.linalg.solve(noise, white.T).T
        axes = np.linalg.eigh(part.T @ part)[1]
        part = part @ axes
        along = base.T @ part
        following = cost[:, None] + 0.5 * (1.0 / fold) @ np.square(along)
        beside = 0.5 * float(np.square(part).sum() - np.square(along).sum())
        deviation = np.linalg.eigvalsh(noise)
        wide = int((deviation > 1.0 + JITTER).sum())
        widened = ticks * float(np.log(deviation).sum()) + 0.5 * each * wide * (wide + 1)
        best = max(best, -float(following.min(axis=0).sum()) - beside - widened)
        kept = 1.0 - 1.0 / fold[following.argmin(axis=0)].T
        left, root = part - base @ (kept * along), noise @ axes
        covariance = root @ (left.T @ left + np.diag(kept.sum(axis=0))) @ root.T / ticks
        variance, axes = np.linalg.eigh(covariance)
        noise = (axes * np.sqrt(np.clip(variance, 1.0, MOST_PLAY**2))) @ axes.T
    return best
