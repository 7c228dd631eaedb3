"""The paper's fixed-window curves (its Fig. 5): minima of its own objective functions along a recording."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from math import gcd
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.labels import CONTACTS, Contact
from contact_tracker.paper.batched import Batch, minimise_batched, random_starts
from contact_tracker.paper.kronecker import matrix
from contact_tracker.paper.objectives import motion
from contact_tracker.poses import Poses

Array = NDArray[np.float64]

STARTS: Final = 3
SHIFTS: Final = (1, -1, 3, -3, 9, -9, 27, -27, 1, -1)
_SPREAD_M: Final = 0.3
_CHUNK: Final = 1024
_COARSE: Final = (1e-4, 30)  # relative gain at which to stop, and iterations at most


@dataclass(frozen=True, eq=False)
class WindowCurves:
    """W windows by the six contacts, in the order of ``CONTACTS``.

    Parameters
    ----------
    stamp_ns : (W,) stamp of each window's last pose: the value is what was known then.
    minimum : (W, 6) lowest value found of the paper's objective, summed over the window's frames.
    converged : (W, 6) whether that minimisation converged.
    """

    stamp_ns: NDArray[np.int64]
    minimum: Array
    converged: NDArray[np.bool_]

    @property
    def normalised(self) -> Array:
        """(W, 6), each column divided by its maximum, as the paper draws it."""
        largest = self.minimum.max(axis=0, initial=0.0)
        return self.minimum / np.where(largest > 0.0, largest, 1.0)


def curves(poses: Poses, frames: int = 500, step: int = 10) -> WindowCurves:
    """Minimise the paper's six objective functions on windows of ``frames`` poses, every ``step`` poses.

    What is minimised are the paper's own functions (5), (10), (15), (19) and their swapped forms, corrected,
    in their Kronecker forms (docs/theory.md, T7), with batched Levenberg-Marquardt in place of SLSQP: random
    starts as in the paper, then each window tries its neighbours' minima. The world's origin is set amid the
    positions; of the minima, only that of f-e depends on it. Those of f-f and e-f depend on where the body
    frame is, which is the recording's (docs/theory.md, T9, T10).

    A recording shorter than a window has no windows. The result is the same for the same poses.
    """
    if frames < 1 or step < 1:
        raise ValueError("a window needs at least one frame and a step of at least one")
    first = np.arange(0, max(len(poses) - frames + 1, 0), step)
    minimum, converged = np.zeros((len(first), 6)), np.ones((len(first), 6), bool)
    if len(first):
        rotation, p = motion(poses.rotation, poses.position_m - poses.position_m.mean(axis=0))
        for column, contact in enumerate(CONTACTS):
            for windows in _chunks(len(first)):
                k = window_matrices(contact, rotation, p, first[windows], frames, step)
                found = minimise_windows(contact, k)
                minimum[windows, column], converged[windows, column] = found.value, found.converged
    return WindowCurves(poses.stamp_ns[first + frames - 1], minimum, converged)


def _chunks(count: int) -> Iterator[slice]:
    """Long recordings go in pieces: one K of e-e takes 10 kB."""
    for start in range(0, count, _CHUNK):
        yield slice(start, min(start + _CHUNK, count))


def window_matrices(
    contact: Contact, rotation: Array, p: Array, first: NDArray[np.int64], frames: int, step: int
) -> Array:
    """K (W, n, n) of windows that begin at ``first``, from sums over blocks that windows share."""
    block = gcd(frames, step)
    span = slice(first[0], first[-1] + frames)
    rotation, p = rotation[span].reshape(-1, block, 3, 3), p[span].reshape(-1, block, 3)
    sums = matrix(contact, rotation, p)
    total = np.concatenate([np.zeros((1, *sums.shape[1:])), np.cumsum(sums, axis=0)])
    begin = (first - first[0]) // block
    k: Array = total[begin + frames // block] - total[begin]
    return k


def minimise_windows(contact: Contact, k: Array) -> Batch:
    """The lowest minimum of each window: random starts, then the neighbours' minima, then with care."""
    starts = random_starts(contact, STARTS, np.random.default_rng(0), _SPREAD_M)
    windows = len(k)
    best = reduce(
        Batch.better,
        (
            minimise_batched(contact, k, np.tile(x, (windows, 1)), np.tile(y, (windows, 1)), *_COARSE)
            for x, y in zip(*starts, strict=True)
        ),
    )
    for shift in SHIFTS:
        source = np.clip(np.arange(windows) + shift, 0, windows - 1)
        best = best.better(minimise_batched(contact, k, best.x[source], best.y[source], *_COARSE))
    return minimise_batched(contact, k, best.x, best.y)
