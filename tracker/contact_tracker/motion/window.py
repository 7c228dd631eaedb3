"""The window of the latest ticks, on which evidence is evaluated."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.motion.lifted_pose import R, T, lift_of_inverse
from contact_tracker.motion.tick_averaging import Tick, tick_anisotropy, tick_variances

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_POSE: Final = slice(T[-1] + 1)
"""Where zeta has the rotation, and then the position."""
_TURN: Final = len(R)
"""Number of entries of the rotation."""


@dataclass(frozen=True, eq=False)
class Window:
    """The latest W ticks, oldest first."""

    index: Index
    """(W,) numbers of the ticks on the grid."""
    zeta: Array
    """(W, 25) mean lifted poses."""
    variance: Array
    """(W, 2) noise variance of position (m^2) and rotation (rad^2), mean over the axes."""
    innovation_excess: Array
    """(W, 2) variance of free motion's innovations beyond the noise (m^2, rad^2); zero for ticks without
    frames."""
    position_anisotropy: Array | None = None
    """(W, 3, 3) covariance of the position minus its mean over the axes (m^2); None if isotropic."""
    before: Array | None = None
    """(25,) zeta of the tick before the first; None if there is none."""

    def __len__(self) -> int:
        return len(self.index)

    @cached_property
    def inverse(self) -> Array:
        """Lifts (W, 25) of the inverse poses."""
        return lift_of_inverse(self.zeta)

    @cached_property
    def displacement_variance(self) -> Array:
        """Variances (W, 2) like ``innovation_excess``, of the whole displacement instead of its unpredictable
        part: the free-motion variance for known elements, which cannot follow smooth motion."""
        return np.maximum(self.innovation_excess, self.travel)

    @property
    def travel(self) -> Array:
        """Mean squared displacement (W, 2) since the tick before, per axis (m^2, rad^2).

        Zero where the tick before is not in the window.
        """
        return travel_of(self.zeta, self.index, self.before)

    @property
    def before_lifts(self) -> Array | None:
        """zeta and the lift of the inverse (2, 25) of the tick before the first."""
        return None if self.before is None else np.array([self.before, lift_of_inverse(self.before[None])[0]])

    @property
    def before_newest(self) -> Array | None:
        """zeta (25,) of the tick before the newest; None if there is none."""
        return self.zeta[-2] if len(self) > 1 else self.before

    @property
    def usual_variance(self) -> Array:
        """Median (2,) of the noise over the ticks; for few of them several times faster than
        ``np.median``."""
        rising, half = np.sort(self.variance, axis=0), len(self) // 2
        return np.asarray(0.5 * (rising[len(self) - 1 - half] + rising[half]))

    @property
    def displacement_ratio(self) -> float:
        """``motion_ratio`` of the newest tick by the whole displacement instead of the innovations."""
        moved = self.cut(-1, None).travel[-1]
        return float(np.max(moved / (moved + self.variance[-1])))

    @cached_property
    def motion_ratio(self) -> Array:
        """Motion relative to noise in each tick (W,): 0 at rest, near 1 in motion."""
        return np.asarray(
            np.max(self.innovation_excess / (self.innovation_excess + self.variance), axis=1, initial=0.0)
        )

    @cached_property
    def latest_motion_ratio(self) -> float:
        """``motion_ratio`` of the newest tick, without computing the others."""
        (a, b), (p, q) = self.innovation_excess[-1].tolist(), self.variance[-1].tolist()
        return float(max(a / (a + p), b / (b + q)))

    def then(self, index: int, zeta: Array, excess: Array, variance: Array, uneven: Array) -> "Window":
        """The window after one more tick, with as many ticks as ``variance`` (W, 2) has rows.

        Values that do not depend on the noise are carried over, and computed for the new tick only.
        """
        first = len(self) + 1 - len(variance)
        displaced = np.maximum(excess, travel_to(zeta, self.zeta[-1] if len(self) else None))
        moved_on = Window(
            np.concatenate([self.index[first:], [index]]),
            np.concatenate([self.zeta[first:], zeta[None]]),
            variance,
            np.concatenate([self.innovation_excess[first:], excess[None]]),
            uneven,
            self.zeta[first - 1] if first else self.before,
        )
        inverse = np.concatenate([self.inverse[first:], lift_of_inverse(zeta)[None]])
        return moved_on.with_cached(
            inverse, np.concatenate([self.displacement_variance[first:], displaced[None]])
        )

    def with_cached(self, inverse: Array, displacement_variance: Array) -> "Window":
        """The same window with ``inverse`` and ``displacement_variance`` computed already."""
        vars(self).update(inverse=inverse, displacement_variance=displacement_variance)
        return self

    def hold(self, count: int, most: int) -> "Window":
        """The window of at most ``most`` ticks after ``count`` further ones without frames, which repeat the
        newest."""
        first = max(len(self) + count - most, 0)
        rows = np.minimum(np.arange(first, len(self) + count), len(self) - 1)
        end = int(self.index[-1]) + count + 1
        numbers = np.concatenate([self.index[first:], np.arange(max(end - most, self.index[-1] + 1), end)])
        before = self.zeta[min(first, len(self)) - 1] if first else self.before
        one = replace(self.pick(rows, before), index=numbers)
        return one.with_cached(self.inverse[rows], self.displacement_variance[rows])

    def expired_by(self, after: "Window", count: int = 1) -> "Window":
        """The oldest ticks, which are not in the window ``after`` any more, ``count`` ticks later."""
        return self.cut(0, max(len(self) + count - len(after), 0))

    def cut(self, first: int, end: int | None) -> "Window":
        """The ticks in rows ``first`` to ``end``."""
        rows = slice(*slice(first, end).indices(len(self)))
        return self.pick(rows, self.zeta[rows.start - 1] if rows.start else self.before)

    def pick(self, rows: slice | NDArray[np.generic], before: Array | None = None) -> "Window":
        """A window of some ticks, with ``before`` as the tick before the first."""
        uneven = None if self.position_anisotropy is None else self.position_anisotropy[rows]
        return Window(
            self.index[rows],
            self.zeta[rows],
            self.variance[rows],
            self.innovation_excess[rows],
            uneven,
            before,
        )

    def with_error(self, beyond: tuple[float, float]) -> "Window":
        """The window with noise variances (m^2, rad^2) increased by ``beyond`` in all ticks."""
        if not any(beyond):
            return self
        return replace(self, variance=self.variance + beyond).with_cached(
            self.inverse, self.displacement_variance
        )

    @classmethod
    def join(cls, parts: Sequence["Window"]) -> "Window":
        """Concatenate windows."""
        known = any(p.position_anisotropy is not None for p in parts)
        uneven = [
            np.zeros((len(p), 3, 3)) if p.position_anisotropy is None else p.position_anisotropy
            for p in parts
        ]
        return cls(
            np.concatenate([p.index for p in parts]),
            np.concatenate([p.zeta for p in parts]),
            np.concatenate([p.variance for p in parts]),
            np.concatenate([p.innovation_excess for p in parts]),
            np.concatenate(uneven) if known else None,
            parts[0].before,
        )


class SlidingWindow(NamedTuple):
    """The ``window`` of the last ticks and the ``frames`` (W,) in each."""

    window: Window
    frames: Array


EMPTY_WINDOW = SlidingWindow(
    Window(np.zeros(0, np.int64), np.zeros((0, 25)), np.zeros((0, 2)), np.zeros((0, 2))), np.zeros(0)
)


def advance_window(sliding: SlidingWindow, number: int, tick: Tick, model: Model) -> SlidingWindow:
    """Append a ``tick`` with this ``number``; the window keeps the length that the model prescribes."""
    window, noise, most = sliding.window, tick.noise, _most_ticks(model)
    frames = np.concatenate([sliding.frames, [tick.count]])[-most:]
    variance, uneven = tick_variances(noise, frames, model), tick_anisotropy(noise, frames, model)
    return SlidingWindow(
        window.then(number, tick.zeta, np.array(tick.innovation_excess), variance, uneven), frames
    )


def hold_window(sliding: SlidingWindow, count: int, model: Model) -> SlidingWindow:
    """The window after ``count`` further ticks without frames, in one step."""
    most = _most_ticks(model)
    frames = np.concatenate([sliding.frames, np.zeros(min(count, most))])[-most:]
    return SlidingWindow(sliding.window.hold(count, most), frames)


def _most_ticks(model: Model) -> int:
    return round(model.search.window_s / model.tick_s)


def travel_of(zeta: Array, index: NDArray[np.int64], before: Array | None) -> Array:
    """Mean squared displacements (W, 2) per axis, of position (m^2) and rotation (rad^2), to ticks of
    ``zeta`` (W, 25) from the tick before by ``index`` (W,).

    Zero where the tick before is missing; of the first it is ``before`` (25,).
    """
    pose = zeta[:, _POSE]
    apart = np.empty_like(pose)
    np.subtract(pose[1:], pose[:-1], out=apart[1:])
    apart[:1] = 0.0 if before is None else pose[:1] - before[_POSE]
    apart[1:][index[1:] - index[:-1] != 1] = 0.0
    return _per_axis(apart)


def travel_to(zeta: Array, before: Array | None) -> Array:
    """Mean squared displacement (2,) to one tick of ``zeta`` (25,); zero without ``before``."""
    return np.zeros(2) if before is None else _per_axis(zeta[_POSE] - before[_POSE])


def _per_axis(apart: Array) -> Array:
    # sums row by row, since a product of matrices would round one row differently from several
    square, out = apart * apart, np.empty((*apart.shape[:-1], 2))
    out[..., 0] = square[..., _TURN:].sum(axis=-1) / 3.0
    out[..., 1] = square[..., :_TURN].sum(axis=-1) / 6.0
    return out
