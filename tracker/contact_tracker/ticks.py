"""From poses to ticks: short spans of time whose frames are averaged in the lift, outliers left out."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker import free_motion, noise
from contact_tracker.free_motion import Excess, FreeMotion
from contact_tracker.lift import R, T, lift, nearest_rotation
from contact_tracker.model import Model
from contact_tracker.noise import NoiseEstimate
from contact_tracker.poses import Pose, Poses

Array = NDArray[np.float64]

NEIGHBOURS: Final = 5
LONGEST_GAP_S: Final = 5.0
"""A gap in the stream is followed tick by tick up to this time; what is longer passes as one."""


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


@dataclass(frozen=True, eq=False)
class TickState:
    """Where the averaging stands: frames of the tick under way, and what earlier ones have taught."""

    origin_ns: int
    origin_m: Array
    index: int
    frames: tuple[Pose, ...]
    noise: NoiseEstimate
    motion: FreeMotion | None


def begin(model: Model, first: Pose) -> TickState:
    """The grid of ticks and the world's origin start at the first pose."""
    estimate = noise.begin(model.noise.sigma_position_m, model.noise.sigma_rotation_rad)
    return TickState(first.stamp_ns, np.array(first.position_m), 0, (first,), estimate, None)


def advance(state: TickState, pose: Pose, model: Model) -> tuple[TickState, list[Tick]]:
    """Take in one pose; returns the ticks that it closes (usually none or one, more after a gap)."""
    step_ns = round(model.tick_s * 1e9)
    index = (pose.stamp_ns - state.origin_ns) // step_ns
    if index == state.index:
        return replace(state, frames=(*state.frames, pose)), []
    state, tick = close(state, model)
    missed = min(index - state.index, int(LONGEST_GAP_S / model.tick_s)) - 1
    empty = replace(tick, count=0, outliers=0, excess=Excess(0.0, 0.0))
    stamps = [tick.stamp_ns + (i + 1) * step_ns for i in range(missed)]
    gaps = [replace(empty, start_ns=stamp, stamp_ns=stamp) for stamp in stamps]
    if index - state.index - 1 > missed:  # the grid jumps over the rest of a long gap
        state = replace(state, origin_ns=pose.stamp_ns - (state.index + 1 + missed) * step_ns)
        index = state.index + 1 + missed
    if missed:
        state = replace(state, motion=None)
    return replace(state, index=index, frames=(pose,)), [tick, *gaps]


def close(state: TickState, model: Model) -> tuple[TickState, Tick]:
    """Finish the tick under way."""
    frames = Poses.collect(state.frames)
    frames = frames[frames.fresh]  # held poses say nothing new
    estimate = noise.advance(
        state.noise, frames, (model.noise.sigma_position_m, model.noise.sigma_rotation_rad)
    )
    rotation, position = frames.rotation, frames.position_m - state.origin_m
    good = _plausible(state, frames, rotation, position, estimate, model)
    zeta = lift(rotation[good], position[good]).mean(axis=0)
    count = int(good.sum())
    variances = tick_variances(estimate, np.asarray(float(count)), model)
    turn = nearest_rotation(zeta[R].reshape(3, 3))
    if state.motion is None:
        motion, excess = free_motion.begin(turn, zeta[T]), Excess(0.0, 0.0)
    else:
        motion, excess = free_motion.advance(
            state.motion,
            turn,
            zeta[T],
            (float(variances[0]), float(variances[1])),
            model.tick_s,
            model.motion.memory_s,
        )
    stamp_ns = state.frames[-1].stamp_ns
    tick = Tick(state.frames[0].stamp_ns, stamp_ns, zeta, count, len(frames) - count, excess)
    return replace(state, frames=(), noise=estimate, motion=motion), tick


def tick_variances(estimate: NoiseEstimate, count: Array, model: Model) -> tuple[Array, Array]:
    """Noise variances (m^2, rad^2) per axis of the means of ticks with ``count`` frames."""
    frames = np.maximum(count, 1.0)
    return (
        estimate.sigma_position_m**2 / frames + model.noise.floor_position_m**2,
        estimate.sigma_rotation_rad**2 / frames + model.noise.floor_rotation_rad**2,
    )


def tick_unevenness(estimate: NoiseEstimate, count: Array) -> Array:
    """What the covariance (W, 3, 3) of the mean position of ticks with ``count`` (W,) frames, in the world's
    axes, is beyond its mean over the axes (m^2)."""
    covariance = estimate.position_m2
    beyond = covariance - np.eye(3) * np.trace(covariance) / 3.0
    return np.asarray(beyond / np.maximum(count, 1.0)[:, None, None])


def _plausible(
    state: TickState, frames: Poses, rotation: Array, position: Array, estimate: NoiseEstimate, model: Model
) -> NDArray[np.bool_]:
    """Frames that neither leave the others of their tick, seen from free motion, nor the motion by far.

    With all frames implausible the object has jumped: they are taken, and the filter follows.
    """
    everything = np.ones(len(frames), bool)
    if state.motion is None or state.motion.position.weight == 0:
        return _near_their_neighbours(rotation, position, estimate, model)
    middle_s = (state.index - 0.5) * model.tick_s
    ahead = (frames.stamp_ns - state.origin_ns) / 1e9 - middle_s
    off_position = position - free_motion.predicted_position(state.motion, ahead)
    predicted = free_motion.predicted_rotation(state.motion, ahead)
    off_rotation = Rotation.from_matrix(np.swapaxes(predicted, -1, -2) @ rotation).as_rotvec()
    good = everything
    rows = (
        (off_position, estimate.sigma_position_m, state.motion.position),
        (off_rotation, estimate.sigma_rotation_rad, state.motion.turn),
    )
    for off, sigma, motion in rows:
        moved = motion.spread
        if len(frames) >= 3:  # frames stand beside their neighbours: little motion lies between them
            off, moved = (
                off - _local_median(off),
                moved * ((min(NEIGHBOURS, len(frames)) - 1) / len(frames)) ** 2,
            )
        distance = np.linalg.norm(off, axis=1)
        good = good & (distance < model.noise.outlier_sigmas * np.sqrt(sigma**2 + moved))
    return good if good.any() else everything


def _near_their_neighbours(
    rotation: Array, position: Array, estimate: NoiseEstimate, model: Model
) -> NDArray[np.bool_]:
    """While nothing is known of the motion: frames that stand out no more than by their steps."""
    good = np.ones(len(position), bool)
    if len(position) < NEIGHBOURS:
        return good
    turn = Rotation.from_matrix(rotation[0].T @ rotation).as_rotvec()
    for rows, sigma in ((position, estimate.sigma_position_m), (turn, estimate.sigma_rotation_rad)):
        distance = np.linalg.norm(rows - _local_median(rows), axis=1)
        step = float(np.median(np.linalg.norm(np.diff(rows, axis=0), axis=1)))
        good = good & (distance < model.noise.outlier_sigmas * max(sigma, step))
    return good if good.any() else np.ones(len(position), bool)


def _local_median(rows: Array) -> Array:
    """Median over the ``NEIGHBOURS`` rows around each row (as many as there are)."""
    width = min(NEIGHBOURS, len(rows) - 1 + len(rows) % 2)
    medians = np.median(np.lib.stride_tricks.sliding_window_view(rows, width, axis=0), axis=-1)
    centre = np.clip(np.arange(len(rows)) - width // 2, 0, len(medians) - 1)
    return np.asarray(medians[centre])
