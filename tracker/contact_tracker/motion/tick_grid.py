"""The grid of ticks: short spans of time, counted from the first pose."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.motion import sensor_noise
from contact_tracker.motion.poses import NO_POSES, Pose, Poses
from contact_tracker.motion.tick_averaging import (
    Array,
    StreamState,
    Tick,
    TickRun,
    average_run,
    empty_tick,
    with_excess,
)

LONGEST_GAP_S: Final = 5.0
"""A gap in the stream is filled with empty ticks up to this time; a longer rest is skipped."""
EMPTY_TICKS: Final = 1000
EMPTY_PER_TICK: Final = 10
"""Gaps are filled with so many empty ticks in any case, and with so many for each tick with frames: a small
file can have thousands of gaps."""


class TickState(NamedTuple):
    """State of the averaging: frames of the current tick, its ``number`` on the grid, the ``last`` tick
    before it, the estimates of the stream, and how many ticks before it were ``empty``."""

    origin_ns: int
    origin_m: Array
    number: int
    frames: tuple[Poses | Pose, ...]
    last: Tick | None
    stream: StreamState
    empty: int = 0


def begin(model: Model, poses: Poses) -> TickState:
    """Start the grid of ticks and the world's origin at the first of the poses, which are not used
    otherwise."""
    return begin_at(int(poses.stamp_ns[0]), poses.position_m[0].copy(), model)


def begin_at(origin_ns: int, origin_m: Array, model: Model) -> TickState:
    """Start the grid at this time, and the world's origin at this place."""
    estimate = sensor_noise.begin(model.noise.sigma_position_m, model.noise.sigma_rotation_rad)
    learnt = StreamState(estimate, sensor_noise.EMPTY_BUFFER, None, NO_POSES)
    return TickState(origin_ns, origin_m, 0, (), None, learnt)


def goes_on(state: TickState, stamp_ns: int, model: Model) -> bool:
    """Whether a pose belongs to the current tick."""
    return stamp_ns < state.origin_ns + (state.number + 1) * model.tick_ns


def advance(state: TickState, poses: Poses, model: Model) -> tuple[TickState, list[Tick]]:
    """Advance by one pose or more; returns the ticks that they close."""
    left, closed = Poses.join((*state.frames, poses)), list[Tick]()
    while True:
        first_ns, last_ns = int(left.stamp_ns[0]), int(left.stamp_ns.max())
        if not goes_on(state, first_ns, model):
            state, empty = _missed(state, first_ns, model, bool(closed) or _has_closed_early(state, model))
            closed += empty
        if goes_on(state, last_ns, model):  # the usual case online
            return state._replace(frames=(left,)), closed
        number = (left.stamp_ns - state.origin_ns) // model.tick_ns
        number = np.maximum.accumulate(np.maximum(number, state.number))  # closed ticks stay closed
        ends = np.flatnonzero(number[1:] > number[:-1]) + 1
        follows = number[ends - 1] == state.number + np.arange(len(ends))
        many = len(ends) if follows.all() else int(follows.argmin())
        state, some = _run(state, left, ends[:many], model)
        closed += some
        left = left[int(ends[many - 1]) :]


def pass_time(state: TickState, until_ns: int, model: Model) -> tuple[TickState, list[Tick]]:
    """Close the current tick if it ends by this time, or, where no poses come, all ticks that do.

    Later poses in the time of closed ticks will be in the next one.
    """
    if goes_on(state, until_ns, model) or (state.last is None and not state.frames):
        return state, []
    if state.frames:
        state, tick = close(state, model)
        return state._replace(number=state.number + 1), [tick]
    return _missed(state, until_ns, model, _has_closed_early(state, model))


def open_since_ns(state: TickState, model: Model) -> int:
    """Where the current tick begins; its end if it was closed early."""
    return state.origin_ns + (state.number + _has_closed_early(state, model)) * model.tick_ns


def follow(
    state: TickState, leader: TickState, advanced: TickState, closed: Sequence[Tick], model: Model
) -> tuple[TickState, list[Tick]]:
    """``advance`` with the averages of a ``leader`` whose model differs in the noise of a tick only.

    ``advanced`` is the leader after the poses, and ``closed`` are the ticks that they closed. Means, outliers
    and the noise of a frame are the leader's; the innovation excess is not.
    """
    motion, ticks = state.stream.free_motion, list[Tick]()
    is_rest = bool(closed) and _has_closed_early(leader, model) and goes_on(leader, closed[0].start_ns, model)
    for tick in closed:
        own = tick
        if tick.count:
            motion, own = with_excess(None if is_rest else motion, tick, model, is_rest)
            is_rest = False
        ticks.append(own)
    last = ticks[-1] if ticks else state.last
    return advanced._replace(last=last, stream=advanced.stream._replace(free_motion=motion)), ticks


def close(state: TickState, model: Model) -> tuple[TickState, Tick]:
    """Close the current tick early; later poses in its time will form another tick."""
    frames = Poses.join(state.frames)
    state, (tick,) = _run(state, frames, np.array([len(frames)]), model)
    return state._replace(frames=()), tick


def _run(
    state: TickState, frames: Poses, ends: NDArray[np.int64], model: Model
) -> tuple[TickState, list[Tick]]:
    """Close the current tick and those that follow without a gap, see ``TickRun``."""
    run = TickRun(frames, ends, state.origin_m, _has_closed_early(state, model), state.last)
    learnt, closed = average_run(state.stream, run, model)
    return state._replace(number=state.number + len(ends) - 1, last=closed[-1], stream=learnt), closed


def _has_closed_early(state: TickState, model: Model) -> bool:
    """Whether the current tick is the rest of one that was closed early."""
    return state.last is not None and state.last.stamp_ns >= state.origin_ns + state.number * model.tick_ns


def _missed(state: TickState, stamp_ns: int, model: Model, is_closed: bool) -> tuple[TickState, list[Tick]]:
    """Go to the tick of this time, with empty ticks for a gap of the stream; ``is_closed`` says whether the
    current one is."""
    if not is_closed:
        state = state._replace(number=state.number - 1)
    step_ns = model.tick_ns
    number = (stamp_ns - state.origin_ns) // step_ns
    missed = max(min(number - state.number, int(LONGEST_GAP_S / model.tick_s)) - 1, 0)
    missed = min(missed, max(EMPTY_TICKS + EMPTY_PER_TICK * (state.number - state.empty) - state.empty, 0))
    empty = list[Tick]()
    if missed:
        assert state.last is not None
        stamps = [state.last.stamp_ns + (i + 1) * step_ns for i in range(missed)]
        empty = [empty_tick(state.last, stamp, stamp) for stamp in stamps]
    if number - state.number - 1 > missed:  # skip the rest of a long gap
        number = state.number + 1 + missed
        state = state._replace(origin_ns=stamp_ns - number * step_ns)
    last = empty[-1] if empty else state.last
    return state._replace(number=number, empty=state.empty + missed, last=last), empty
