"""The online tracker: ``step(state, pose) -> (state, belief)``, as in the figure of docs/theory.md.

pose -> tick -> window -> hypotheses (fit, evidence) -> weights of the states -> belief
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from contact_tracker.map.sighting import MAP_INSERTION_PROBABILITY
from contact_tracker.map.world_map import Map
from contact_tracker.motion import tick_grid
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.window import SlidingWindow, advance_windows, hold_window
from contact_tracker.states import Contact
from contact_tracker.tracking import ambiguity, measurement_update
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.formation_tracking import follow_formation, pause_formation
from contact_tracker.tracking.posterior import (
    answer,
    flush_lag,
    label_geometry,
    label_sighting,
    open_at_rest,
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
    "begin_like",
    "can_hold",
    "close_tick",
    "finish",
    "flush_lag",
    "hold",
    "pass_time",
    "scales_of",
    "start",
    "step",
    "update",
    "update_each",
    "update_through_gaps",
]


def step(state: TrackerState, pose: Pose) -> tuple[TrackerState, Belief | None]:
    """Advance by one pose; returns a belief if the pose closes a tick, from data up to that tick only.

    After a gap one pose closes several ticks, and the belief is that of the last. ``accumulate_pose`` and
    ``update``, of which this consists, give them all.
    """
    state, closed = accumulate_pose(state, pose)
    belief = None
    for after, online in update_each(state, closed):
        state, belief = after, answer(after, online)
    return state, belief


def finish(state: TrackerState) -> tuple[TrackerState, list[Belief]]:
    """At the end of the stream: beliefs of the last, partial tick and of the ticks within the lag.

    The stream may be continued: ``step`` then treats the time since as a gap, and no tick is reported twice.
    """
    state, closed = close_tick(state)
    beliefs = []
    for after, online in update_each(state, closed):
        state = after
        beliefs.append(answer(state, online))
    rest = flush_lag(state)
    return state._replace(recent=()), [*(b for b in beliefs if b is not None), *rest]


def accumulate_pose(state: TrackerState, pose: Pose) -> tuple[TrackerState, list[Tick]]:
    """Average poses into ticks; returns the ticks that this pose closes (several after a gap).

    The pose is stored until its tick is closed.
    """
    averaging = state.averaging
    if averaging is None or not tick_grid.goes_on(averaging, pose.stamp_ns, state.model):
        return accumulate_poses(state, Poses.collect((pose,)))
    return state._replace(averaging=averaging._replace(frames=(*averaging.frames, pose))), []


def accumulate_poses(state: TrackerState, poses: Poses) -> tuple[TrackerState, list[Tick]]:
    """``accumulate_pose`` for one pose or more."""
    averaging = tick_grid.begin(state.model, poses) if state.averaging is None else state.averaging
    averaging, closed = tick_grid.advance(averaging, poses, state.model)
    return state._replace(averaging=averaging, map=state.map.at_origin(averaging.origin_m)), closed


def pass_time(state: TrackerState, until_ns: int) -> tuple[TrackerState, list[Tick]]:
    """Close the ticks that are over, see ``tick_grid.pass_time``."""
    if state.averaging is None:
        return state, []
    averaging, closed = tick_grid.pass_time(state.averaging, until_ns, state.model)
    return state._replace(averaging=averaging), closed


def begin_like(state: TrackerState, leader: TrackerState, world: Map | None = None) -> TrackerState:
    """The state before the first pose, from which on it can follow the ticks of the ``leader``; the map is
    ``world``, if there is one."""
    assert leader.averaging is not None
    origin_m = leader.averaging.origin_m
    return state._replace(
        averaging=tick_grid.begin_at(leader.averaging.origin_ns, origin_m, state.model),
        map=state.map.at_origin(origin_m) if world is None else world,
    )


def follow_ticks(
    state: TrackerState, leader: TrackerState, advanced: TrackerState, closed: Sequence[Tick]
) -> tuple[TrackerState, list[Tick]]:
    """``accumulate_poses`` with the averages of a ``leader``, see ``tick_grid.follow``."""
    assert state.averaging is not None
    assert leader.averaging is not None
    assert advanced.averaging is not None
    averaging, own = tick_grid.follow(
        state.averaging, leader.averaging, advanced.averaging, closed, state.model
    )
    return state._replace(averaging=averaging), own


def close_tick(state: TrackerState) -> tuple[TrackerState, list[Tick]]:
    """Close the current tick early."""
    if state.averaging is None or not state.averaging.frames:
        return state, []
    averaging, tick = tick_grid.close(state.averaging, state.model)
    return state._replace(averaging=averaging), [tick]


def update(
    state: TrackerState, tick: Tick, detail: Detail = Detail.FORMATION, tests_curvature: bool = True
) -> tuple[TrackerState, Belief]:
    """Update by one tick; the belief has this ``detail``.

    Of trackers side by side, one ``tests_curvature``: whether free motion is on a curved surface.
    """
    ((state, belief),) = update_each(state, [tick], detail, tests_curvature)
    return state, belief


def update_each(
    state: TrackerState,
    ticks: Sequence[Tick],
    detail: Detail = Detail.FORMATION,
    tests_curvature: bool = True,
) -> Iterator[tuple[TrackerState, Belief]]:
    """``update`` by one tick after the other."""
    slidings = advance_windows(state.sliding_window, state.ticks, ticks, state.model)
    for tick, sliding in zip(ticks, slidings, strict=True):
        if measurement_update.is_uninformative(state, tick, sliding):
            state, belief = skip_update(state, tick, sliding)
        else:
            state = measurement_update.update_hypotheses(state, tick, sliding)
            state, belief = read_posterior(state, tick, detail, tests_curvature)
        yield state, belief


def skip_update(state: TrackerState, tick: Tick, sliding: SlidingWindow) -> tuple[TrackerState, Belief]:
    """Pass an uninformative tick: the belief stays as it was."""
    assert state.belief is not None
    state = measurement_update.propagate_without_update(state, sliding, tick.outliers)
    assert state.belief is not None
    return _record_belief(state, tick, replace(state.belief, stamp_ns=tick.stamp_ns))


def can_hold(state: TrackerState) -> bool:
    """Whether ticks without motion can be passed in one step, see ``hold``.

    Not with a lag or known elements, nor directly after motion.
    """
    newest = state.window.innovation_excess[-1:]
    return (
        state.belief is not None and not state.knowledge and not state.lag_history.size and not newest.any()
    )


def hold(state: TrackerState, count: int, outliers: int = 0) -> TrackerState:
    """The state after ``count`` ticks without motion, in one step: as if they had no frames. ``can_hold`` has
    to be true.

    The belief stays as it was, that of the tick before.
    """
    if not count:
        return state
    assert can_hold(state)
    sliding = hold_window(state.sliding_window, count, state.model)
    return measurement_update.propagate_without_update(state, sliding, outliers, count)


def update_through_gaps(
    state: TrackerState, ticks: Sequence[Tick], detail: Detail, tests_curvature: bool = False
) -> Iterator[tuple[TrackerState, int]]:
    """``update_each`` with the empty ticks of a gap in one step: the states, and the number of ticks that led
    to each."""
    first = 0
    while first < len(ticks):
        count = next((i for i, tick in enumerate(ticks[first:]) if tick.count), len(ticks) - first)
        if count and can_hold(state):
            state = hold(state, count)
        else:
            (state, _), count = update(state, ticks[first], detail, tests_curvature), 1
        yield state, count
        first += count


def read_posterior(
    state: TrackerState, tick: Tick, detail: Detail, tests_curvature: bool = True
) -> tuple[TrackerState, Belief]:
    """The belief after a tick, whose evidence is in ``state``; certain elements are added to the memory."""
    belief = state_posterior(state, tick.stamp_ns)
    shared, learns = belief, _should_update_map(state, belief)
    if learns or detail >= Detail.SHARED:  # sharing never raises the label's probability
        state = with_curved_motion(state, belief.contact, tests_curvature)
        shared = share_among_indistinguishable(state, belief)
        learns = learns and _should_update_map(state, shared)
    if detail >= Detail.SHARED:
        belief = shared
    where = label_geometry(state, belief.contact) if detail >= Detail.GEOMETRY else None
    if learns and not shared.inseparable:
        state = state._replace(map=state.map.insert(label_sighting(state, belief.contact, tick.stamp_ns)))
    if where is not None and detail >= Detail.GEOMETRY:
        belief = replace(belief, geometry=where)
    if detail >= Detail.FORMATION:
        state, belief = follow_formation(state, belief, tick)
    else:
        state = pause_formation(state)
    return _record_belief(state, tick, belief)


def _record_belief(state: TrackerState, tick: Tick, belief: Belief) -> tuple[TrackerState, Belief]:
    if tick.count:
        belief = open_at_rest(state, belief)
    if belief.inseparable:
        probability = ambiguity.with_rivals(belief.probability, belief.contact, belief.inseparable)
        belief = replace(belief, probability=probability)
    length = state.lag_history.shape[1]
    recent = (*state.recent, belief)[-length:] if length else ()
    return state._replace(recent=recent, belief=belief), belief


def _should_update_map(state: TrackerState, belief: Belief) -> bool:
    """Whether the labelled contact is certain enough for the map, and due."""
    if (
        state.uses_later_contacts
        or belief.contact is Contact.FREE
        or belief.probability.max() < MAP_INSERTION_PROBABILITY
    ):
        return False
    return belief.stamp_ns >= state.map.due_ns.get(belief.onset_ns, belief.stamp_ns)
