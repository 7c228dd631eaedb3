"""The window of the latest ticks, on which evidence is evaluated: its rests, and the directions of motion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.config.parameters import Model
from contact_tracker.geometry import linalg
from contact_tracker.geometry.lifted_pose import R, T, lift_of_inverse
from contact_tracker.geometry.linalg import EYE, LEAST_SHARE, TINY
from contact_tracker.motion.free_motion import NOW_TICKS, REST_VARIANCE_RATIO
from contact_tracker.motion.poses import ARM_M
from contact_tracker.motion.tick_averaging import Tick, tick_anisotropy, tick_variances

REST_S: Final = 1.0
"""Shortest time in one place that is a rest."""
TREND: Final = 2.0
"""Largest variance of the poses of a rest over half their mean squared step (inverse of von Neumann's ratio):
one in 700 spans of ten ticks of white noise exceeds it, and a steady motion has 18."""
_POSE: Final = slice(T[-1] + 1)
"""Entries of zeta that are the rotation, and then the position."""
_TURN: Final = len(R)
"""Number of entries of the rotation."""


@dataclass(frozen=True, eq=False)
class Window:
    """The latest W ticks, oldest first."""

    index: Ints
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
    frames: Array | None = None
    """(W,) number of frames in each tick; None where it does not matter."""

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
        pose = self.zeta[:, _POSE]
        apart = np.empty_like(pose)
        np.subtract(pose[1:], pose[:-1], out=apart[1:])
        apart[:1] = 0.0 if self.before is None else pose[:1] - self.before[_POSE]
        apart[1:][self.index[1:] - self.index[:-1] != 1] = 0.0
        return _per_axis(apart)

    def log_speed(self, tick_s: float) -> float | None:
        """Log of the mean speed (m/s) since the tick with frames before the newest; None if it has none, or
        there is none before it."""
        assert self.frames is not None
        with_frames = self.frames.nonzero()[0]
        if not self.frames[-1:].any() or len(with_frames) < 2:
            return None
        before = with_frames[-2]
        moved_m = self.zeta[-1, T] - self.zeta[before, T]
        seconds = tick_s * float(self.index[-1] - self.index[before])
        return float(np.log(max(np.sqrt(moved_m @ moved_m) / seconds, TINY)))

    @property
    def before_newest(self) -> Array | None:
        """zeta (25,) of the tick before the newest; None if there is none."""
        return self.zeta[-2] if self.index.size > 1 else self.before

    @cached_property
    def usual_variance(self) -> Array:
        """Median (2,) of the noise over the ticks."""
        return linalg.median(self.variance)

    @property
    def displacement_ratio(self) -> float:
        """``motion_ratio`` of the newest tick by the whole displacement instead of the innovations."""
        moved = self.cut(-1).travel[-1]
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

    def append(
        self,
        index: int,
        zeta: Array,
        excess: Array,
        variance: Array,
        uneven: Array,
        frames: Array | None = None,
    ) -> "Window":
        """The window after one more tick, with as many ticks as ``variance`` (W, 2) has rows.

        Values that do not depend on the noise are carried over, and computed for the new tick only.
        """
        first = self.index.size + 1 - len(variance)
        displaced = (
            np.maximum(excess, _per_axis((zeta - self.zeta[-1])[_POSE])) if self.index.size else excess
        )
        moved_on = Window(
            np.concatenate([self.index[first:], [index]]),
            np.concatenate([self.zeta[first:], zeta[None]]),
            variance,
            np.concatenate([self.innovation_excess[first:], excess[None]]),
            uneven,
            self.zeta[first - 1] if first else self.before,
            frames,
        )
        vars(moved_on).update(
            inverse=np.concatenate([self.inverse[first:], lift_of_inverse(zeta)[None]]),
            displacement_variance=np.concatenate([self.displacement_variance[first:], displaced[None]]),
        )
        return moved_on

    def expired_by(self, later: "Window") -> "Window":
        """The oldest tick, if it is not in the window ``later`` any more, a tick later."""
        return self.cut(0, max(self.index.size + 1 - later.index.size, 0))

    def cut(self, first: int, end: int | None = None) -> "Window":
        """The ticks in rows ``first`` to ``end``."""
        first, end, _ = slice(first, end).indices(self.index.size)
        return self.pick(slice(first, end), self.zeta[first - 1] if first else self.before)

    def since(self, onset: int) -> "Window":
        """The ticks since number ``onset``; as the same object in each call."""
        views: dict[int, Window] = vars(self).setdefault("_since", {})
        first = int(self.index.searchsorted(onset))
        if first not in views:
            views[first] = self.pick(slice(first, None))
        return views[first]

    def pick(self, rows: slice | NDArray[np.generic], before: Array | None = None) -> "Window":
        """A window of some ticks, with ``before`` as the tick before the first."""
        return Window(
            self.index[rows],
            self.zeta[rows],
            self.variance[rows],
            self.innovation_excess[rows],
            None if self.position_anisotropy is None else self.position_anisotropy[rows],
            before,
            None if self.frames is None else self.frames[rows],
        )

    def with_error(self, beyond: tuple[float, float]) -> "Window":
        """The window with noise variances (m^2, rad^2) increased by ``beyond`` in all ticks."""
        if not any(beyond):
            return self
        noisier = replace(self, variance=self.variance + beyond)
        vars(noisier).update(inverse=self.inverse, displacement_variance=self.displacement_variance)
        return noisier

    @classmethod
    def join(cls, parts: Sequence["Window"]) -> "Window":
        """Concatenate windows."""
        is_uneven = any(p.position_anisotropy is not None for p in parts)
        uneven = [
            np.zeros((len(p), 3, 3)) if p.position_anisotropy is None else p.position_anisotropy
            for p in parts
        ]
        frames = [p.frames for p in parts if p.frames is not None]
        return cls(
            np.concatenate([p.index for p in parts]),
            np.concatenate([p.zeta for p in parts]),
            np.concatenate([p.variance for p in parts]),
            np.concatenate([p.innovation_excess for p in parts]),
            np.concatenate(uneven) if is_uneven else None,
            parts[0].before,
            np.concatenate(frames) if len(frames) == len(parts) else None,
        )


EMPTY_WINDOW: Final = Window(
    np.zeros(0, np.int64), np.zeros((0, 25)), np.zeros((0, 2)), np.zeros((0, 2)), frames=np.zeros(0)
)


def window_of(ticks: Sequence[Tick], model: Model) -> Window:
    """All ticks of a recording, at least one, with the noise estimate of its end."""
    noise, count = ticks[-1].noise, np.array([float(tick.count) for tick in ticks])
    return Window(
        np.arange(len(ticks)),
        np.array([tick.zeta for tick in ticks]),
        tick_variances(noise, count, model),
        np.array([tick.innovation_excess for tick in ticks]),
        tick_anisotropy(noise, count, model),
        frames=count,
    )


def advance_window(window: Window, number: int, tick: Tick, model: Model) -> Window:
    """Append a ``tick`` with this ``number``; the window keeps the length that the model prescribes."""
    assert window.frames is not None
    frames = np.append(window.frames, tick.count)[-round(model.search.window_s / model.tick_s) :]
    variance, uneven = tick_variances(tick.noise, frames, model), tick_anisotropy(tick.noise, frames, model)
    return window.append(number, tick.zeta, np.array(tick.innovation_excess), variance, uneven, frames)


def _per_axis(apart: Array) -> Array:
    # sums row by row, since a product of matrices would round one row differently from several
    square, out = apart * apart, np.empty((*apart.shape[:-1], 2))
    out[..., 0] = square[..., _TURN:].sum(axis=-1) / 3.0
    out[..., 1] = square[..., :_TURN].sum(axis=-1) / 6.0
    return out


class NewestRest(NamedTuple):
    """Whether the newest tick ``is_in_rest``, ``completes`` the first ``REST_S`` of a rest, or ``ends``
    one as the first after it."""

    is_in_rest: bool = False
    completes: bool = False
    ends: bool = False


NO_REST: Final = NewestRest()


def newest_rest(window: Window, tick_s: float) -> NewestRest:
    """Whether the object rests in the newest tick; not if that has no frames."""
    if window.frames is None or not window.frames[-1]:
        return NO_REST
    count = rest_ticks(tick_s)
    filled = np.flatnonzero(window.frames)[-2 * count :]
    if (
        filled.size > count
    ):  # two ticks of both newest spans alone may scatter too much: the usual case in motion
        apart = _per_axis(window.zeta[filled[-2], _POSE] - window.zeta[filled[-count], _POSE])
        if (apart > 2.0 * (count - 1) * REST_VARIANCE_RATIO * window.variance.max(axis=0)).any():
            return NO_REST
    newest = _still(window, filled[-1 - count :], count)
    is_in_rest, rested = bool(newest[-1:].any()), bool(newest[-2:-1].any())
    completes = is_in_rest and not rested and not _still(window, filled[:-1], count).any()
    return NewestRest(is_in_rest, completes, rested and not is_in_rest)


def at_rest(window: Window, tick_s: float) -> Bools:
    """Which ticks (W,) belong to a rest: within ``REST_S`` their poses scatter like noise about their mean.

    The excess of single ticks does not decide it: noise has some now and then, and steady motion has none. An
    object that only vibrates rests, too: from tick to tick its poses scatter without a trend, up to as much
    as single poses do by noise. A tick without frames belongs to a rest if it lies within one.
    """
    assert window.frames is not None
    count = rest_ticks(tick_s)
    resting, filled = np.zeros(len(window), bool), np.flatnonzero(window.frames)
    for first in np.flatnonzero(_still(window, filled, count, may_vibrate=True)):
        resting[filled[first] : filled[first + count - 1] + 1] = True
    return resting


@cache
def rest_ticks(tick_s: float) -> int:
    """Number of ticks of the shortest rest."""
    return max(round(REST_S / tick_s), NOW_TICKS + 1)


def _still(window: Window, filled: NDArray[np.intp], count: int, may_vibrate: bool = False) -> Bools:
    """In which spans of ``count`` consecutive ticks with frames, whose rows are ``filled``, the object stays
    where it is."""
    if filled.size < count:
        return np.zeros(0, bool)
    spans = filled[np.arange(filled.size - count + 1)[:, None] + np.arange(count)]
    pose = window.zeta[:, _POSE][spans]
    scatter = _per_axis(pose - pose.mean(axis=1, keepdims=True)).sum(axis=1) / (count - 1)
    allowed = REST_VARIANCE_RATIO * window.variance[spans].mean(axis=1)
    if may_vibrate:
        assert window.frames is not None
        of_pose = allowed * window.frames[spans].mean(axis=1)[:, None]
        without_trend = 0.5 * TREND * _per_axis(np.diff(pose, axis=1)).mean(axis=1)
        allowed = np.maximum(allowed, np.minimum(of_pose, without_trend))
    return np.asarray((scatter <= allowed).all(axis=1))


DIRECTIONS: Final = 6
"""Degrees of freedom of a rigid object."""
STRIDE_TICKS: Final = 5
"""Steps in ticks between which twists are taken, long enough for slow motion to exceed the noise."""
LEVER_M: Final = ARM_M
USED: Final = 10.0
"""A direction is used if its mean squared motion is this many times the variance of the noise."""
ONE_AXIS: Final = 0.14
"""Motion has one degree of freedom if its second largest component is below this share of the largest (turns
scaled by the lever above): hinges, sliders and screws with their errors."""
NO_MOTION: Final = LEAST_SHARE
"""Added to weights and least divisors: without motion they are zero."""
_AXIS: Final = np.array([np.cross(b, a) for a in EYE for b in EYE]).T
"""(3, 9): maps a row-major matrix to its antisymmetric part as a vector: of a rotation twice the sine of its
angle times its axis; of ``a b^T`` it is ``b x a``."""
_TRACE: Final = EYE.ravel()
LEVERS_M: Final = np.repeat([1.0, LEVER_M], 3)
"""Factors (6,) of shifts and turns, or of derivatives by turns and by shifts, that give both one unit."""


class TwistPower(NamedTuple):
    """Mean square (6, 6) of an object's twists in steps of ``STRIDE_TICKS``: the shift of the world's point
    ``centre_m`` (3,) with the object, then the turn about the world's axes; ``sigma`` (6,) by noise alone.
    The same ``at_origin``, with the shift of the body's origin, and ``origin_sigma``."""

    power: Array
    centre_m: Array
    sigma: Array
    at_origin: Array
    origin_sigma: Array


def twist_power(window: Window) -> TwistPower:
    """How a window of more than ``STRIDE_TICKS`` moves (T24).

    Rotation about one axis has a constant twist, so it is one direction, however far it goes; translation in
    a plane is two.
    """
    pose = window.zeta[:, : T[-1] + 1].T.copy()  # R comes before T; numbers of all ticks side by side
    rotation, place = pose[: T[0]].reshape(3, 3, -1), pose[T[0] :]
    centre = place.mean(axis=1, keepdims=True)
    place -= centre
    before, after = place[:, :-STRIDE_TICKS], place[:, STRIDE_TICKS:]
    step = (rotation[:, None, :, STRIDE_TICKS:] * rotation[:, :, :-STRIDE_TICKS]).sum(axis=2).reshape(9, -1)
    # tan of half the angle along the axis, twice: exact about an axis
    turned = _AXIS @ step / np.maximum(0.5 + 0.5 * (_TRACE @ step), NO_MOTION)
    middle = 0.5 * (before + after)
    shifted = after - before - _AXIS @ (middle[:, None] * turned).reshape(9, -1)
    weight = window.motion_ratio[STRIDE_TICKS:] + NO_MOTION
    position, rotational = 2.0 * window.usual_variance
    lever_sq = np.vdot(middle, middle) / len(weight) * 2.0 / 3.0
    powers = [
        (twist * weight) @ twist.T / weight.sum()
        for twist in (np.concatenate([shift, turned]) for shift in (shifted, after - before))
    ]
    sigmas = [np.sqrt([v] * 3 + [rotational] * 3) for v in (position + rotational * lever_sq, position)]
    return TwistPower(powers[0], centre[:, 0], sigmas[0], powers[1], sigmas[1])


@lru_cache(maxsize=8)
def used_directions(window: Window) -> int:
    """Number of directions in which the object moves beyond the noise: the rank of its twists (T24).

    Motion that is nearly all in one direction has one degree of freedom, whatever the noise (``ONE_AXIS``).
    An object that turns while it is carried has more twists than directions, as its axis moves: then those
    of the shifts of its origin count.
    """
    if len(window) <= STRIDE_TICKS:
        return 0
    power, _, sigma, at_origin, origin_sigma = twist_power(window)
    used = _rank(power, sigma)
    if used < 2:
        return used
    rising = linalg.eigenvalues(power * (LEVERS_M[:, None] * LEVERS_M))
    if rising[-2] < ONE_AXIS**2 * rising[-1]:
        return 1
    return min(used, max(_rank(at_origin, origin_sigma), 2))


def turns_about_one_axis(window: Window) -> bool:
    """Whether motion has one degree of freedom, which turns the object: that of a hinge or a screw."""
    if used_directions(window) != 1:
        return False
    shifts, turns = np.split(twist_power(window).power.diagonal() * LEVERS_M**2, 2)
    return bool(turns.sum() > ONE_AXIS**2 * (shifts.sum() + turns.sum()))


def moves_in(window: Window, tick_s: float) -> list[Window]:
    """The moves between rests, each with a tick of the rests beside it."""
    edges = np.flatnonzero(np.diff(~at_rest(window, tick_s), prepend=False, append=False)).reshape(-1, 2)
    return [window.cut(max(first - 1, 0), end + 1) for first, end in edges.tolist()]


def _rank(power: Array, sigma: Array) -> int:
    return int(np.count_nonzero(linalg.eigenvalues(power / (sigma[:, None] * sigma)) > USED))
