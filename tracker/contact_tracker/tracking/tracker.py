"""The tracker, online: ``step(state, pose) -> (state, belief)``. It reads like the figure in docs/theory.md.

pose -> tick -> window -> hypotheses (fit, evidence) -> weights of the states -> belief
"""

from collections.abc import Sequence
from dataclasses import replace

from contact_tracker.landmarks.landmark_memory import MAP_INSERTION_PROBABILITY
from contact_tracker.motion import tick_grid
from contact_tracker.motion.lifted_pose import T
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.window import SlidingWindow
from contact_tracker.states import Contact
from contact_tracker.tracking import measurement_update
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.formation_tracking import follow_formation, pause_formation
from contact_tracker.tracking.posterior import (
    answer,
    flush_lag,
    label_geometry,
    share_among_indistinguishable,
    state_posterior,
    with_curved_motion,
)
from contact_tracker.tracking.state import TrackerState, scales_of, start

__all__ = [
    "TrackerState",
    "accumulate_pose",
    "accumulate_poses",
    "answer",
    "close_tick",
    "finish",
    "flush_lag",
    "scales_of",
    "start",
    "step",
    "update",
]


def step(state: TrackerState, pose: Pose) -> tuple[TrackerState, Belief | None]:
    """Take in one pose; a belief comes out when the pose closes a tick, from data up to that tick only.

    After a gap in the stream one pose closes several ticks, of which the last is told; who wants them all
    calls what this is made of: ``accumulate_pose``, ``update`` and ``answer``.
    """
    state, closed = accumulate_pose(state, pose)
    belief = None
    for tick in closed:
        state, online = update(state, tick)
        belief = answer(state, online)
    return state, belief


def finish(state: TrackerState) -> tuple[TrackerState, list[Belief]]:
    """The stream has ended: beliefs of the last, partial tick and of what the lag still holds back.

    Should it go on after all, it has paused: ``step`` takes the next pose as it does after a gap, and says
    nothing twice.
    """
    state, closed = close_tick(state)
    beliefs = []
    for tick in closed:
        state, online = update(state, tick)
        beliefs.append(answer(state, online))
    rest = flush_lag(state)
    return state._replace(recent=()), [*(b for b in beliefs if b is not None), *rest]


def accumulate_pose(state: TrackerState, pose: Pose) -> tuple[TrackerState, list[Tick]]:
    """Average poses into ticks; returns the ticks that this pose closes (several after a gap).

    The pose is kept as it is until its tick is over.
    """
    averaging = state.averaging
    if averaging is None or not tick_grid.goes_on(averaging, pose.stamp_ns, state.model):
        return accumulate_poses(state, Poses.collect((pose,)))
    return state._replace(averaging=averaging._replace(frames=(*averaging.frames, pose))), []


def accumulate_poses(state: TrackerState, poses: Poses) -> tuple[TrackerState, list[Tick]]:
    """The same of many poses at once, of which there are some."""
    averaging = tick_grid.begin(state.model, poses) if state.averaging is None else state.averaging
    averaging, closed = tick_grid.advance(averaging, poses, state.model)
    return state._replace(averaging=averaging), closed


def follow_ticks(
    state: TrackerState, leader: TrackerState, advanced: TrackerState, closed: Sequence[Tick]
) -> tuple[TrackerState, list[Tick]]:
    """The same by poses that a ``leader`` has averaged, see ``tick_grid.follow``."""
    assert state.averaging is not None
    assert leader.averaging is not None
    assert advanced.averaging is not None
    averaging, own = tick_grid.follow(
        state.averaging, leader.averaging, advanced.averaging, closed, state.model
    )
    return state._replace(averaging=averaging), own


def close_tick(state: TrackerState) -> tuple[TrackerState, list[Tick]]:
    """Close the tick under way."""
    if state.averaging is None or not state.averaging.frames:
        return state, []
    averaging, tick = tick_grid.close(state.averaging, state.model)
    return state._replace(averaging=averaging), [tick]


def update(
    state: TrackerState, tick: Tick, detail: Detail = Detail.FORMATION, judges: bool = True
) -> tuple[TrackerState, Belief]:
    """Take in one tick, and tell of it in ``detail``.

    It ``judges`` whether free motion keeps to a curved surface, unless another one does that for it.
    """
    sliding = measurement_update.advanced_window(state, tick)
    if measurement_update.is_uninformative(state, tick):
        return skip_update(state, tick, sliding)
    return read_posterior(measurement_update.update_hypotheses(state, tick, sliding), tick, detail, judges)


def skip_update(state: TrackerState, tick: Tick, sliding: SlidingWindow) -> tuple[TrackerState, Belief]:
    """Wait through a tick that says nothing: what was believed is believed on."""
    assert state.belief is not None
    return _record_belief(
        measurement_update.propagate_without_update(state, tick, sliding),
        replace(state.belief, stamp_ns=tick.stamp_ns),
    )


def read_posterior(
    state: TrackerState, tick: Tick, detail: Detail, judges: bool = True
) -> tuple[TrackerState, Belief]:
    """See what is believed after the tick, which has just been weighed, and learn from it."""
    belief = state_posterior(state, tick.stamp_ns)
    shared, learns = belief, _should_update_map(state, belief)
    if learns or detail >= Detail.SHARED:  # which leaves the label no more than it has
        state = with_curved_motion(state, belief.contact, judges)
        shared = share_among_indistinguishable(state, belief)
        learns = learns and _should_update_map(state, shared)
    if detail >= Detail.SHARED:
        belief = shared
    where = label_geometry(state, belief.contact) if learns or detail >= Detail.GEOMETRY else None
    if learns and where is not None:
        assert state.averaging is not None
        position_m = state.window.zeta[-1, T] + state.averaging.origin_m
        state = state._replace(memory=state.memory.insert(where, belief.onset_ns, tick.stamp_ns, position_m))
    if where is not None and detail >= Detail.GEOMETRY:
        belief = replace(belief, geometry=where)
    if detail >= Detail.FORMATION:
        state, belief = follow_formation(state, belief, tick)
    else:
        state = pause_formation(state)
    return _record_belief(state, belief)


def _record_belief(state: TrackerState, belief: Belief) -> tuple[TrackerState, Belief]:
    length = state.lag_history.shape[1]
    recent = (*state.recent, belief)[-length:] if length else ()
    return state._replace(recent=recent, belief=belief), belief


def _should_update_map(state: TrackerState, belief: Belief) -> bool:
    """Elements that are certain enough are remembered, and looked at again now and then."""
    if belief.contact is Contact.FREE or belief.probability.max() < MAP_INSERTION_PROBABILITY:
        return False
    return state.memory.is_due(belief.onset_ns, belief.stamp_ns)
