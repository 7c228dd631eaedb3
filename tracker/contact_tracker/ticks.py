"""From poses to ticks: short spans of time whose frames are averaged in the lift, outliers left out."""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker import compiled, free_motion, noise
from contact_tracker.free_motion import NO_EXCESS, Excess, FreeMotion
from contact_tracker.lift import R, T, mean_lift
from contact_tracker.model import Model
from contact_tracker.noise import Heard, NoiseEstimate
from contact_tracker.poses import NO_POSES, Pose, Poses
from contact_tracker.quaternions import between, rotation_vectors

Array = NDArray[np.float64]

NEIGHBOURS: Final = 5
LONGEST_GAP_S: Final = 5.0
"""A gap in the stream is followed tick by tick up to this time; what is longer passes as one."""
_EYE: Final = np.eye(3)


@dataclass(frozen=True, eq=False)
class Tick:
    """The frames of one tick.

    ``start_ns``, ``stamp_ns`` of its first and last frame; ``zeta`` (25,) mean lift, world origin at
    the first pose; ``count`` of frames used (0: a gap), ``outliers`` left out; ``excess`` of free motion.
    """

    start_ns: int
    stamp_ns: int
    zeta: Array
    count: int
    outliers: int
    excess: Excess


class TickState(NamedTuple):
    """Where the averaging stands: frames of the tick under way, the ``last`` one before that, and what those
    before have taught."""

    origin_ns: int
    origin_m: Array
    number: int
    frames: tuple[Poses | Pose, ...]
    last: Tick | None
    noise: NoiseEstimate
    heard: Heard
    motion: FreeMotion | None


def begin(model: Model, poses: Poses) -> TickState:
    """The grid of ticks and the world's origin start at the first of the poses; none is taken in yet."""
    estimate = noise.begin(model.noise.sigma_position_m, model.noise.sigma_rotation_rad)
    origin_m = poses.position_m[0].copy()
    return TickState(int(poses.stamp_ns[0]), origin_m, 0, (), None, estimate, noise.NOTHING_HEARD, None)


def goes_on(state: TickState, pose: Pose, model: Model) -> bool:
    """Whether a pose that follows closes no tick: it may wait to be taken in with the ``frames``."""
    return pose.stamp_ns < _end_ns(state, model)


def _end_ns(state: TickState, model: Model) -> int:
    """When the tick under way is over."""
    return state.origin_ns + (state.number + 1) * model.tick_ns


def advance(state: TickState, poses: Poses, model: Model) -> tuple[TickState, list[Tick], Poses]:
    """Take in poses, of which there are some, as far as the tick goes that is under way.

    Returns
    -------
    The ticks that are closed, usually none or one, more after a gap; and the poses that are still to be taken
    in, from the first on that was too late for those.
    """
    step_ns = model.tick_ns
    end_ns = _end_ns(state, model)
    if poses.stamp_ns[-1] < end_ns:
        return state._replace(frames=(*state.frames, poses)), [], NO_POSES
    inside = int(poses.stamp_ns.searchsorted(end_ns))
    if inside:
        state = state._replace(frames=(*state.frames, poses[:inside]))
    stamp_ns = int(poses.stamp_ns[inside])
    number = (stamp_ns - state.origin_ns) // step_ns
    closed = []
    if state.frames:  # none right after the end of a stream that goes on
        state, tick = close(state, model)
        closed.append(tick)
    missed = max(min(number - state.number, int(LONGEST_GAP_S / model.tick_s)) - 1, 0)
    if missed:
        assert state.last is not None
        empty = replace(state.last, count=0, outliers=0, excess=NO_EXCESS)
        stamps = [empty.stamp_ns + (i + 1) * step_ns for i in range(missed)]
        closed += [replace(empty, start_ns=stamp, stamp_ns=stamp) for stamp in stamps]
        state = state._replace(motion=None)
    if number - state.number - 1 > missed:  # the grid jumps over the rest of a long gap
        number = state.number + 1 + missed
        state = state._replace(origin_ns=stamp_ns - number * step_ns)
    return state._replace(number=number), closed, poses[inside:]


def close(state: TickState, model: Model) -> tuple[TickState, Tick]:
    """Finish the tick under way; the rest of its time, should more come in that, is another tick, which tells
    nothing of the motion: it is not a tick's time from its neighbours."""
    frames = Poses.join(state.frames)
    first_ns = state.origin_ns + state.number * model.tick_ns
    is_rest = state.last is not None and state.last.stamp_ns >= first_ns
    if is_rest:
        state = state._replace(motion=None)
    start_ns, stamp_ns = int(frames.stamp_ns[0]), int(frames.stamp_ns[-1])
    frames = frames.fresh  # held poses say nothing new
    prior = model.noise.sigma_position_m, model.noise.sigma_rotation_rad
    heard, estimate = noise.advance(state.heard, state.noise, frames, prior)
    good, zeta = _averaged(state, frames, estimate, model)
    used = int(np.count_nonzero(good))
    variance = tick_variances(estimate, np.array(float(used)), model)
    turn = zeta[R].reshape(3, 3)
    if is_rest:
        motion, excess = None, NO_EXCESS
    elif state.motion is None:
        motion, excess = free_motion.begin(turn, zeta[T]), NO_EXCESS
    else:
        motion, excess = free_motion.advance(
            state.motion, turn, zeta[T], variance, model.tick_s, model.motion.memory_s
        )
    tick = Tick(start_ns, stamp_ns, zeta, used, len(frames) - used, excess)
    return state._replace(frames=(), last=tick, noise=estimate, heard=heard, motion=motion), tick


def variances(estimate: NoiseEstimate, model: Model) -> tuple[tuple[float, float], tuple[float, float]]:
    """Noise per axis (m^2, rad^2) of one frame, which averaging lowers, and the floor, which it does not."""
    sensor = estimate.sigma_position_m**2, estimate.sigma_rotation_rad**2
    return sensor, (model.noise.floor_position_m**2, model.noise.floor_rotation_rad**2)


def tick_variances(estimate: NoiseEstimate, count: Array, model: Model) -> Array:
    """Noise variances (..., 2) per axis (m^2, rad^2) of the means of ticks with ``count`` (...) frames."""
    parts = np.empty((*count.shape, 2))
    parts[..., 0], parts[..., 1] = 1.0 / np.maximum(count, 1.0), 1.0
    # for so few columns this takes less than sums of arrays, and than ``@``
    return np.asarray(np.dot(parts, np.array(variances(estimate, model))))


def tick_unevenness(estimate: NoiseEstimate, count: Array) -> Array:
    """What the covariance (W, 3, 3) of the mean position of ticks with ``count`` (W,) frames, in the world's
    axes, is beyond its mean over the axes (m^2)."""
    covariance = estimate.position_m2
    beyond = covariance - _EYE * (covariance.trace() / 3.0)
    share = 1.0 / np.maximum(count, 1.0)
    return np.asarray(np.dot(share[:, None], beyond.reshape(1, 9))).reshape(-1, 3, 3)


def _averaged(
    state: TickState, frames: Poses, estimate: NoiseEstimate, model: Model
) -> tuple[NDArray[np.bool_], Array]:
    """Which frames (N,) are plausible, and their mean lift (25,)."""
    sigma_sq = np.array([estimate.sigma_position_m, estimate.sigma_rotation_rad]) ** 2
    ahead_s = (frames.stamp_ns - state.origin_ns) / 1e9 - (state.number - 0.5) * model.tick_s
    outlier_sigmas = model.noise.outlier_sigmas
    if compiled.in_use():
        from contact_tracker.compiled import kernels

        columns = frames.position_m, frames.quat_xyzw, ahead_s
        return kernels.averaged(*columns, state.motion, state.origin_m, sigma_sq, outlier_sigmas)
    good = _plausible(frames, ahead_s, state.motion, state.origin_m, sigma_sq, outlier_sigmas)
    used = frames if good.all() else frames[good]
    return good, mean_lift(used.rotation, used.position_m - state.origin_m)


def _plausible(
    frames: Poses,
    ahead_s: Array,
    motion: FreeMotion | None,
    origin_m: Array,
    sigma_sq: Array,
    outlier_sigmas: float,
) -> NDArray[np.bool_]:
    """Frames that neither leave the others of their tick, seen from free motion, nor the motion by far;
    ``ahead_s`` (N,) after the middle of the tick before, with noise ``sigma_sq`` (2,).

    While nothing is known of the motion: that stand out no more than by their steps. With all frames
    implausible the object has jumped: they are taken, and the filter follows.
    """
    count, everything = len(frames), np.ones(len(frames), bool)
    if motion is not None and motion.weight:
        at, facing = free_motion.predicted(motion, ahead_s)
        off, spread = _off(frames, at + origin_m, facing), motion.spread
        if count >= 3:  # frames stand beside their neighbours: little motion lies between them
            off = off - _local_median(off)
            spread = spread * ((min(NEIGHBOURS, count) - 1) / count) ** 2
        allowed_sq = sigma_sq + spread
    elif count >= NEIGHBOURS:
        off = _off(frames, frames.position_m[0], frames.quat_xyzw[0])
        step_sq = np.median(_distance_sq(off[1:] - off[:-1]), axis=0)
        off, allowed_sq = off - _local_median(off), np.maximum(sigma_sq, step_sq)
    else:
        return everything
    good = (_distance_sq(off) < outlier_sigmas**2 * allowed_sq).all(axis=1)
    return np.asarray(good if good.any() else everything)


def _off(frames: Poses, position_m: Array, quat_xyzw: Array) -> Array:
    """How far (N, 6) frames are from one or N poses: by position, and by the turn in the body's axes."""
    turn = rotation_vectors(between(quat_xyzw, frames.quat_xyzw))
    return np.concatenate([frames.position_m - position_m, turn], axis=1)


def _distance_sq(off: Array) -> Array:
    """Squared lengths (N, 2) of both halves of the rows (N, 6)."""
    return np.asarray((off * off).reshape(-1, 2, 3).sum(axis=2))


def _local_median(rows: Array) -> Array:
    """Median over the ``NEIGHBOURS`` rows around each row (as many as there are)."""
    width = min(NEIGHBOURS, len(rows) - 1 + len(rows) % 2)
    windows = np.array([rows[i : len(rows) - width + 1 + i] for i in range(width)])
    windows.partition(width // 2, axis=0)
    centre = np.arange(len(rows)) - width // 2
    return np.asarray(windows[width // 2].take(centre, axis=0, mode="clip"))
