"""The paper's fixed-window curves (its Fig. 5): minima of its own objective functions along a recording."""

from dataclasses import dataclass
from functools import reduce
from math import gcd
from typing import Final

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.motion.poses import Poses
from contact_tracker.paper.batched import Batch, form, minimise_batched, random_starts, rows
from contact_tracker.paper.objectives import motion
from contact_tracker.states import Contact

SHIFTS: Final = (1, -1, 3, -3, 9, -9, 27, -27, 1, -1)
"""Offsets of the neighbours from whose minima a window starts again, in turn."""
RANDOM_M: Final = 0.3
"""Standard deviation of the offsets of random starts."""
COARSE: Final = (1e-4, 30)
FINE: Final = (1e-9, 300)
"""Relative gain at which a minimisation stops, and most iterations: from all starts, and finally."""
CHUNK_FRAMES: Final = 20_000
"""Windows that begin within this number of poses are minimised together, to bound memory."""


@dataclass(frozen=True, eq=False)
class WindowCurves:
    """Minima of W windows for the six contacts, in the order of ``CONTACTS``.

    Parameters
    ----------
    stamp_ns : (W,) stamp of each window's last pose.
    minimum : (W, 6) lowest value found of the paper's objective, summed over the window's frames.
    converged : (W, 6) whether that minimisation converged.
    """

    stamp_ns: Ints
    minimum: Array
    converged: Bools

    @property
    def normalised(self) -> Array:
        """(W, 6), each column divided by its maximum, as in the paper's Fig. 5."""
        largest = self.minimum.max(axis=0, initial=0.0)
        return self.minimum / np.where(largest > 0.0, largest, 1.0)


def curves(poses: Poses, frames: int = 500, step: int = 10) -> WindowCurves:
    """Minimise the paper's six objective functions on windows of ``frames`` poses, every ``step`` poses.

    These are the corrected functions (5), (10), (15), (19) and their swapped forms, as Kronecker forms
    (docs/theory.md, T7), minimised by batched Levenberg-Marquardt instead of SLSQP: from the relaxed problems
    of ``contacts``, then from the minima of neighbouring windows, and at random where there are none. The
    world's origin is the mean position; only the minima of f-e depend on it. Those of f-f and e-f depend on
    the body frame of the recording (docs/theory.md, T9, T10).

    A recording shorter than a window has no windows. The result is deterministic.
    """
    if frames < 1 or step < 1:
        raise ValueError("a window needs at least one frame and a step of at least one")
    stamp_ns = poses.stamp_ns[frames - 1 :: step].copy()
    count, at_once = len(stamp_ns), max(CHUNK_FRAMES // step, 1)
    minima = WindowCurves(stamp_ns, np.zeros((count, 6)), np.ones((count, 6), bool))
    position_m = poses.position_m - poses.position_m.mean(axis=0) if count else poses.position_m
    for first in range(0, count, at_once):
        last = min(first + at_once, count)
        span = slice(first * step, (last - 1) * step + frames)
        rotation = poses[span].rotation
        for column, model in enumerate(CONTACT_MODELS):
            best = minimise_windows(model, rotation, position_m[span], frames, step)
            minima.minimum[first:last, column] = best.value
            minima.converged[first:last, column] = best.converged
    return minima


def minimise_windows(
    model: ContactModel, rotation: Array, position_m: Array, frames: int, step: int
) -> Batch:
    """Minima of the paper's objective of one contact on windows of ``T_world_body`` (N, 3, 3) and (N, 3).

    A window starts from the relaxed problems, then from the minima of its neighbours; where it has none, at
    random instead. The random numbers are always the same.
    """
    k, moments = window_sums(model, rotation, position_m, frames, step)
    best, rng = from_relaxed(model, k, moments), np.random.default_rng(0)
    for shift in SHIFTS:
        x, y = random_starts(model.contact, len(k), rng, RANDOM_M)
        source = np.arange(len(k)) + shift
        exists = (source >= 0) & (source < len(k))
        x[exists], y[exists] = best.x[source[exists]], best.y[source[exists]]
        best = best.better(minimise_batched(model.contact, k, x, y, *COARSE))
    return minimise_batched(model.contact, k, best.x, best.y, *FINE)


def from_relaxed(model: ContactModel, k: Array, moments: Array) -> Batch:
    """The best minima, with coarse tolerance, from the solutions of the relaxed problems."""
    x, y = _starts(model, moments)
    batches = (minimise_batched(model.contact, k, x[:, i], y[:, i], *COARSE) for i in range(x.shape[1]))
    return reduce(Batch.better, batches)


def window_sums(
    model: ContactModel, rotation: Array, position_m: Array, frames: int, step: int
) -> tuple[Array, Array]:
    """K (W, n, n) of the paper's objective, and moments (W, C, C) of the relaxed problems, of each window."""
    k = _sums(rows(model.contact, *motion(rotation, position_m)), frames, step)
    return k, _sums(model.lifted(lift(rotation, position_m))[:, None, :], frames, step)


def _sums(a: Array, frames: int, step: int) -> Array:
    """Sums (W, n, n) of ``a.T a`` over the frames of each window, for a (N, r, n); N ends with a window."""
    block = gcd(frames, step)
    parts = a.reshape(len(a) // block, -1, a.shape[-1])
    sums = np.swapaxes(parts, 1, 2) @ parts
    total = np.concatenate([np.zeros((1, *sums.shape[1:])), np.cumsum(sums, axis=0)])
    begin = np.arange(0, len(a) - frames + 1, step) // block
    return np.asarray(total[begin + frames // block] - total[begin])


def _starts(model: ContactModel, moments: Array) -> tuple[Array, Array]:
    """Solutions of the relaxed problems as factors of the Kronecker product, (W, N, a) and (W, N, b)."""
    x = model.family.normalise(model.family.starts(moments), np.zeros(6))
    if "e" in model.contact:
        first, second = _line(x[..., :6]), x[..., 6:]
        second = _line(second) if model.contact is Contact.EE else second
    else:  # a face through the origin, or a point, in homogeneous coordinates
        last = np.full_like(x[..., :1], 0.0 if model.contact is Contact.FF else 1.0)
        first, second = np.concatenate([x[..., :3], last], axis=-1), x[..., 3:]
    body, world = (first, second) if model.body_in_1 else (second, first)
    return form(model.contact).factors(body, world)


def _line(x: Array) -> Array:
    """Direction and moment of a line given by direction and foot."""
    return np.concatenate([x[..., :3], np.cross(x[..., 3:], x[..., :3])], axis=-1)
