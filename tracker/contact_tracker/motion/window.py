"""The ticks that evidence is computed on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contact_tracker.motion.lifted_pose import lift_of_inverse
from contact_tracker.motion.travel import travel_of, travel_to

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Window:
    """The last W ticks, oldest first: what evidence is computed on.

    ``index`` (W,) of the ticks, ``zeta`` (W, 25), ``variance`` (W, 2) noise of position (m^2) and rotation
    (rad^2), mean over the axes; ``excess`` (W, 2) of free motion, zero where the tick has no frames;
    ``uneven`` (W, 3, 3) what the covariance of the position (m^2, in the world's axes) is beyond its mean,
    None where noise is the same in all directions; ``before`` (25,) is the zeta of the tick before the first,
    None where nothing came before.
    """

    index: Index
    zeta: Array
    variance: Array
    excess: Array
    uneven: Array | None = None
    before: Array | None = None

    def __len__(self) -> int:
        return len(self.index)

    @cached_property
    def inverse(self) -> Array:
        """Lifts (W, 25) of the inverse poses."""
        return lift_of_inverse(self.zeta)

    @cached_property
    def unheld(self) -> Array:
        """Variances (W, 2) as in ``excess``, of what nothing but touching would keep from moving: where
        elements are known, free motion is more than what is unpredictable in it."""
        return np.maximum(self.excess, self.travel)

    @property
    def travel(self) -> Array:
        """How far the object moved since the tick before, (W, 2) variances per axis as in ``excess``.

        Zero where the tick before is not in the window.
        """
        return travel_of(self.zeta, self.index, self.before)

    @property
    def usual_variance(self) -> Array:
        """Median (2,) over the ticks; ``np.median`` takes several times as long for few of them."""
        rising, half = np.sort(self.variance, axis=0), len(self) // 2
        return np.asarray(0.5 * (rising[len(self) - 1 - half] + rising[half]))

    @property
    def unrest(self) -> float:
        """As ``activity``, of how far the object moved in the newest tick, however smoothly."""
        moved = self.cut(-1, None).travel[-1]
        return float(np.max(moved / (moved + self.variance[-1])))

    @cached_property
    def activity(self) -> Array:
        """How far the motion in each tick (W,) rises above the noise: 0 at rest, towards 1 in motion."""
        return np.asarray(np.max(self.excess / (self.excess + self.variance), axis=1, initial=0.0))

    @cached_property
    def latest_activity(self) -> float:
        """That of the newest tick; the others' may not be asked for."""
        excess, variance = self.excess[-1].tolist(), self.variance[-1].tolist()
        return float(max(e / (e + v) for e, v in zip(excess, variance, strict=True)))

    def then(self, index: int, zeta: Array, excess: Array, variance: Array, uneven: Array) -> "Window":
        """One tick on: the newest ticks and the one right after, as many as ``variance`` (W, 2) has rows.

        What does not change with the noise is carried along: it is worked out of the new tick alone.
        """
        first = len(self) + 1 - len(variance)
        unheld = np.maximum(excess, travel_to(zeta, self.zeta[-1] if len(self) else None))
        moved_on = Window(
            np.concatenate([self.index[first:], [index]]),
            np.concatenate([self.zeta[first:], zeta[None]]),
            variance,
            np.concatenate([self.excess[first:], excess[None]]),
            uneven,
            self.zeta[first - 1] if first else self.before,
        )
        inverse = np.concatenate([self.inverse[first:], lift_of_inverse(zeta)[None]])
        return moved_on.knowing(inverse, np.concatenate([self.unheld[first:], unheld[None]]))

    def knowing(self, inverse: Array, unheld: Array) -> "Window":
        """The same window, told what is ``inverse`` and ``unheld``."""
        vars(self).update(inverse=inverse, unheld=unheld)
        return self

    def lost_by(self, after: "Window") -> "Window":
        """The oldest ticks, which the window ``after`` the next tick has no more."""
        return self.cut(0, max(len(self) + 1 - len(after), 0))

    def cut(self, first: int, end: int | None) -> "Window":
        """The ticks in rows ``first`` to ``end``."""
        rows = slice(*slice(first, end).indices(len(self)))
        return self.pick(rows, self.zeta[rows.start - 1] if rows.start else self.before)

    def pick(self, rows: slice | NDArray[np.generic], before: Array | None = None) -> "Window":
        """Some ticks by themselves, whatever came before if it is not said."""
        uneven = None if self.uneven is None else self.uneven[rows]
        return Window(
            self.index[rows], self.zeta[rows], self.variance[rows], self.excess[rows], uneven, before
        )

    def with_error(self, beyond: tuple[float, float]) -> "Window":
        """The window with noise variances (m^2, rad^2) larger by ``beyond`` in all ticks."""
        if not any(beyond):
            return self
        return replace(self, variance=self.variance + beyond).knowing(self.inverse, self.unheld)

    @classmethod
    def join(cls, parts: Sequence["Window"]) -> "Window":
        """Windows one after the other."""
        known = any(p.uneven is not None for p in parts)
        uneven = [np.zeros((len(p), 3, 3)) if p.uneven is None else p.uneven for p in parts]
        return cls(
            np.concatenate([p.index for p in parts]),
            np.concatenate([p.zeta for p in parts]),
            np.concatenate([p.variance for p in parts]),
            np.concatenate([p.excess for p in parts]),
            np.concatenate(uneven) if known else None,
            parts[0].before,
        )
