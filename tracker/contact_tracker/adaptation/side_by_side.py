"""Trackers side by side that differ in the noise of a tick, weighed by their evidence.

The first has the model as given. The others start, from the first pose, once the ratio of the noise of
position and orientation is estimated. After some seconds of motion those far behind are dropped, later all
but the best (``comparison``).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.adaptation import rest
from contact_tracker.adaptation.candidates import (
    LASTING_NS,
    RATE_POSES,
    candidates,
    has_less_noise,
    usual_period_s,
    with_other_ticks,
    with_ticks_for,
)
from contact_tracker.adaptation.comparison import (
    TickEvidence,
    are_compared,
    relative_evidence,
    tick_evidence,
)
from contact_tracker.adaptation.mixture import mixture
from contact_tracker.adaptation.rest import NO_REST, Rest
from contact_tracker.config.parameters import Model
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.map.world_map import Map
from contact_tracker.motion import tick_grid
from contact_tracker.motion.free_motion import NO_EXCESS
from contact_tracker.motion.poses import NO_POSES, Poses
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.states import Contact
from contact_tracker.tracking import tracker
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.curved_motion import CurvedMotion
from contact_tracker.tracking.state import TrackerState

Array = NDArray[np.float64]

RATIO_POSES: Final = 60
"""Number of poses from which the ratio of the noise of position and orientation is estimated."""
REST_NATS: Final = 10.0
"""Log weight by which a tracker that takes noise for motion is reduced while the object rests."""


class TrackedTick(NamedTuple):
    """A tick by which a tracker was updated: its ``evidence``, and the belief to report."""

    evidence: TickEvidence
    belief: Belief | None


class FirstTick(NamedTuple):
    """A tick of the first tracker before the others start, and whether the object ``moves`` in it."""

    tick: Tick
    tracked: TrackedTick
    moves: bool


class Averaging(NamedTuple):
    """The first tracker ``before`` and ``after`` it averaged some poses; the others use its averages."""

    before: TrackerState
    after: TrackerState


class SideBySide(NamedTuple):
    """The trackers of one stream; bounded in size, however long the stream.

    Parameters
    ----------
    model, knowledge, lag_s : as given; ticks of the trackers may be longer.
    trackers : none before the rate is known. While the object rests only the first is updated (``rest``).
    log_weight, log_prior : (K,) log weights of the trackers, and the part of them that is no evidence.
    pending : poses so far, until the other trackers start with them; then None.
    first : the ticks so far, of the first tracker.
    latest_ns : stamps of the latest poses, for the rate.
    period_s : the usual time between poses, if it is known in advance: then ticks do not change.
    map : that of before the rate has changed; None if it has not.
    outliers : number of outliers from before.
    changed_since_ns : time since which the rate is another one; None if it is not.
    moved_s : time for which the object has moved.
    rest : whether the object rests, and the ticks by which the others are not updated yet.
    """

    model: Model
    knowledge: PriorMap
    lag_s: float
    trackers: tuple[TrackerState, ...]
    log_weight: Array
    log_prior: Array
    pending: Poses | None
    first: tuple[FirstTick, ...]
    moved_s: float
    rest: Rest
    latest_ns: NDArray[np.int64]
    period_s: float | None
    map: Map | None
    outliers: int
    changed_since_ns: int | None

    @property
    def is_decided(self) -> bool:
        """Whether one tracker is left, and none is to start."""
        return self.pending is None and len(self.trackers) == 1

    @property
    def best(self) -> TrackerState | None:
        """The most probable tracker, at rest perhaps not updated by the latest ticks; None before the rate of
        the stream is known."""
        return self.trackers[int(self.log_weight.argmax())] if self.trackers else None


def begin(model: Model, lag_s: float = 0.0, knowledge: PriorMap = EMPTY_MAP) -> SideBySide:
    """The state before the first pose."""
    return SideBySide(
        model=model,
        knowledge=knowledge,
        lag_s=lag_s,
        trackers=(),
        log_weight=np.zeros(1),
        log_prior=np.zeros(1),
        pending=NO_POSES,
        first=(),
        moved_s=0.0,
        rest=NO_REST,
        latest_ns=NO_POSES.stamp_ns,
        period_s=None,
        map=None,
        outliers=0,
        changed_since_ns=None,
    )


def goes_on(state: SideBySide, stamp_ns: int) -> bool:
    """Whether a pose that follows closes no tick."""
    if not state.trackers:
        return False
    one = state.trackers[0]
    return one.averaging is not None and tick_grid.goes_on(one.averaging, stamp_ns, one.model)


def is_late(state: SideBySide, stamp_ns: int) -> bool:
    """Whether a pose is more than a tick before the current one."""
    if not state.trackers or state.trackers[0].averaging is None:
        return False
    model = state.trackers[0].model
    return stamp_ns < tick_grid.open_since_ns(state.trackers[0].averaging, model) - model.tick_ns


def advance(state: SideBySide, poses: Poses, detail: Detail) -> tuple[SideBySide, list[Belief]]:
    """Advance by poses; returns the beliefs of the ticks that they close."""
    state, beliefs = _advance(state, poses, detail)
    if state.period_s is not None:
        return state, beliefs
    state = state._replace(latest_ns=np.append(state.latest_ns, poses.stamp_ns)[-RATE_POSES:])
    averaging = state.trackers[0].averaging if state.trackers else None
    if averaging is None or not averaging.frames:
        return state, beliefs
    model = with_other_ticks(state.model, state.trackers[0].model, state.latest_ns)
    if model is None:
        return state._replace(changed_since_ns=None), beliefs
    since_ns = int(state.latest_ns[0]) if state.changed_since_ns is None else state.changed_since_ns
    if state.latest_ns[-1] - since_ns < LASTING_NS:
        return state._replace(changed_since_ns=since_ns), beliefs
    state, more = _restart(state, model, detail)
    return state, [*beliefs, *more]


def _advance(state: SideBySide, poses: Poses, detail: Detail) -> tuple[SideBySide, list[Belief]]:
    if state.pending is None:
        return _side_by_side(state, poses, detail)
    left, beliefs = poses, list[Belief]()
    while len(left) and state.pending is not None:
        enough = RATIO_POSES if state.trackers else RATE_POSES
        missing = enough - len(state.pending)
        some, left = left[:missing], left[missing:]
        state = state._replace(pending=Poses.join([state.pending, some]))
        reported = list[Belief]()
        if state.trackers:
            state, reported = _side_by_side(state, some, detail)
            state = _with_others(state, min(detail, Detail.GEOMETRY)) if len(some) == missing else state
        elif len(some) == missing:
            state, reported = _with_first(state, detail)
        beliefs += reported
    if len(left):
        state, reported = _side_by_side(state, left, detail)
        beliefs += reported
    return state, beliefs


def pass_time(state: SideBySide, until_ns: int, detail: Detail) -> tuple[SideBySide, list[Belief]]:
    """Close the ticks that are over, see ``tick_grid.pass_time``; returns their beliefs."""
    if not state.trackers:
        return state, []
    return _with_ticks(state, *tracker.pass_time(state.trackers[0], until_ns), detail)


def finish(state: SideBySide) -> tuple[SideBySide, list[Belief]]:
    """At the end of the stream: beliefs of the last, partial tick and of the ticks within the lag.

    The stream may be continued; the time since is a gap.
    """
    beliefs = list[Belief]()
    if state.pending is not None and len(state.pending):
        if not state.trackers:
            state, beliefs = _with_first(state, Detail.FORMATION)
        state = _with_others(state, Detail.GEOMETRY)
    state = _caught_up(state, state.trackers[0], Detail.FORMATION) if state.trackers else state
    ended = [tracker.finish(one) for one in state.trackers]
    last = zip(*(reported for _, reported in ended), strict=True)
    beliefs += [mixture(some, state.log_weight, state.knowledge.allowed) for some in last]
    return state._replace(trackers=tuple(one for one, _ in ended)), beliefs


def _restart(state: SideBySide, model: Model, detail: Detail) -> tuple[SideBySide, list[Belief]]:
    """Start again with other ticks, at the first pose of the current tick; the map is kept, and the
    beliefs within the lag are reported first."""
    lagging = zip(*(tracker.flush_lag(one) for one in state.trackers), strict=True)
    before = [mixture(some, state.log_weight, state.knowledge.allowed) for some in lagging]
    leader, best = state.trackers[0], state.best
    assert leader.averaging is not None
    assert best is not None
    frames, world = Poses.join(leader.averaging.frames), best.map.before_onsets()
    averaging = tick_grid.begin_at(int(frames.stamp_ns[0]), leader.averaging.origin_m, model)
    first = tracker.start(model, state.lag_s, state.knowledge)._replace(averaging=averaging, map=world)
    again = begin(state.model, state.lag_s, state.knowledge)
    again = again._replace(
        trackers=(first,),
        pending=frames[-RATIO_POSES + 1 :],
        latest_ns=state.latest_ns,
        map=world,
        outliers=state.outliers + leader.outliers,
    )
    again, beliefs = _side_by_side(again, frames, detail)
    return again, [*before, *beliefs]


def _with_first(state: SideBySide, detail: Detail) -> tuple[SideBySide, list[Belief]]:
    """Start the tracker of the model as given, with ticks long enough to hold frames; its beliefs so far."""
    assert state.pending is not None
    period_s = usual_period_s(state.pending.stamp_ns) if state.period_s is None else state.period_s
    first = tracker.start(with_ticks_for(state.model, period_s), state.lag_s, state.knowledge)
    return _side_by_side(state._replace(trackers=(first,)), state.pending, detail)


def _with_others(state: SideBySide, detail: Detail) -> SideBySide:
    """Start the other trackers and update them by the poses so far, whose beliefs were reported already."""
    assert state.pending is not None
    chosen = candidates(state.trackers[0].model, state.pending)
    leader, first = state.trackers[0], state.first
    starts = (tracker.start(one.model, state.lag_s, state.knowledge) for one in chosen[1:])
    begun = [tracker.begin_like(start, leader, state.map) for start in starts]
    ticks = [one.tick for one in first]
    started = [
        _observe(*tracker.follow_ticks(one, one, leader, ticks), detail, tests_curvature=False)
        for one in begun
    ]
    log_prior = np.array([one.log_prior for one in chosen])
    state = state._replace(
        trackers=(*state.trackers, *(one for one, _ in started)),
        log_weight=log_prior,
        log_prior=log_prior,
        pending=None,
        first=(),
        rest=state.rest.restarted(),
    )
    alive = np.arange(len(state.trackers))
    for one, *others in zip(first, *(followed for _, followed in started), strict=True):
        now = [one.tracked, *others]
        state, kept = _weigh_trackers(state, one.tick, [now[i] for i in alive], one.moves)
        alive = alive[kept]
    return state


def _side_by_side(state: SideBySide, poses: Poses, detail: Detail) -> tuple[SideBySide, list[Belief]]:
    """Advance all trackers by poses."""
    return _with_ticks(state, *tracker.accumulate_poses(state.trackers[0], poses), detail)


def _with_ticks(
    state: SideBySide, advanced: TrackerState, closed: Sequence[Tick], detail: Detail
) -> tuple[SideBySide, list[Belief]]:
    """Advance all trackers, of which the first has ``advanced`` its averaging and ``closed`` some ticks;
    those that are dropped are left out of later ticks."""
    leader, *others = state.trackers
    if state.is_decided:
        return _single(state, advanced, closed, detail)
    # frames are averaged once, so that trackers are compared on the same ticks
    averaging, beliefs = Averaging(leader, advanced), list[Belief]()
    state = state._replace(trackers=(advanced, *others))
    while closed:
        first, ahead = state.trackers[0], _rest_ahead(state, closed)
        if _is_gap(state, closed[0], ahead[0]):
            state, reported = _pass_gap(state, closed[: len(ahead)], ahead[-1])
        elif ahead[0].is_waiting:
            state, reported = _update_first(state, closed[: len(ahead)], ahead[-1], detail)
        else:
            state, reported = _update_all(state, averaging, closed[0], ahead[0], detail)
        beliefs += reported
        closed = closed[len(ahead) :]
        if state.trackers[0].model is not first.model:  # the first was dropped
            second, closed = tracker.follow_ticks(state.trackers[0], *averaging, closed)
            state = state._replace(trackers=(second, *state.trackers[1:]))
    first, *others = state.trackers
    if state.rest.is_waiting:
        others = [_averaged_like(one, first) for one in others]
    else:
        others = [tracker.follow_ticks(one, *averaging, [])[0] for one in others]
    return state._replace(trackers=(first, *others)), beliefs


def _rest_ahead(state: SideBySide, closed: Sequence[Tick]) -> list[Rest]:
    """``Rest`` after the next tick, or after each of the next ticks that are processed together: those of a
    gap, or those in which the others wait."""
    first, *others = state.trackers
    can_wait = bool(others) and not first.lag_history.size and not first.knowledge
    is_quietest = not any(has_less_noise(one.model.noise, first.model.noise) for one in others)
    ahead = list[Rest]()
    for tick in closed:
        now = rest.advance(
            ahead[-1] if ahead else state.rest, tick, first.model.tick_s, can_wait, is_quietest
        )
        if not ahead:
            ahead, is_gap = [now], _is_gap(state, tick, now)
        elif (is_gap and not tick.count) or (not is_gap and now.is_waiting):
            ahead.append(now)
        else:
            break
        if not is_gap and not now.is_waiting:
            break
    return ahead


def _is_gap(state: SideBySide, tick: Tick, now: Rest) -> bool:
    """Whether all trackers can pass a tick and the next ones without frames in one step."""
    return (
        not tick.count
        and not now.moves
        and not state.rest.is_waiting
        and state.pending is None
        and all(map(tracker.can_hold, state.trackers))
    )


def _pass_gap(state: SideBySide, ticks: Sequence[Tick], now: Rest) -> tuple[SideBySide, list[Belief]]:
    """Advance all trackers by ticks without frames."""
    first, *others = (tracker.hold(one, len(ticks)) for one in state.trackers)
    if now.is_waiting:
        others = [_averaged_like(one, first) for one in others]
    same = mixture(
        [one.belief for one in (first, *others) if one.belief is not None],
        state.log_weight,
        state.knowledge.allowed,
    )
    beliefs = [replace(same, stamp_ns=tick.stamp_ns) for tick in ticks]
    return state._replace(trackers=(first, *others), rest=now.caught_up()), beliefs


def _update_all(
    state: SideBySide, averaging: Averaging, tick: Tick, now: Rest, detail: Detail
) -> tuple[SideBySide, list[Belief]]:
    """Update all trackers by a tick."""
    state = _caught_up(state, averaging.before, detail)._replace(rest=now)
    first, *others = state.trackers
    gathered = [(first, [tick]), *(tracker.follow_ticks(one, *averaging, [tick]) for one in others)]
    best, details = int(state.log_weight.argmax()), _details(state, detail)
    followed = [_observe(one, own, *of_one) for (one, own), of_one in zip(gathered, details, strict=True)]
    curved = followed[best][0].curved  # tested by one for all
    state = state._replace(trackers=tuple(_with_curved(one, curved) for one, _ in followed))
    state, kept = _weigh_trackers(state, tick, [ticks[0] for _, ticks in followed], now.moves)
    tracked = [followed[i][1][0] for i in kept]
    beliefs = [one.belief for one in tracked if one.belief is not None]
    if not beliefs:  # all have the same lag
        return state, []
    activity = np.array([one.evidence.activity for one in tracked])
    held_for_motion = 0.0 if now.moves else REST_NATS * activity
    return state, [mixture(beliefs, state.log_weight - held_for_motion, state.knowledge.allowed)]


def _update_first(
    state: SideBySide, ticks: Sequence[Tick], now: Rest, detail: Detail
) -> tuple[SideBySide, list[Belief]]:
    """Update the first tracker by ticks in which the others wait."""
    first, *others = state.trackers
    if not state.rest.is_waiting:
        details = _details(state, detail)[1:]
        held = [_held(one, ticks[0], *of_one) for one, of_one in zip(others, details, strict=True)]
        others = [_averaged_like(one, first) for one in held]
    first, followed = _observe(first, ticks, *_details(state, detail)[0])
    beliefs = list[Belief]()
    for tick, (evidence, belief) in zip(ticks, followed, strict=True):
        held_for_motion = np.append(REST_NATS * evidence.activity, np.zeros(len(others)))
        same = [replace(one.belief, stamp_ns=tick.stamp_ns) for one in others if one.belief is not None]
        if belief is not None:
            beliefs.append(
                mixture([belief, *same], state.log_weight - held_for_motion, state.knowledge.allowed)
            )
    return state._replace(trackers=(first, *others), rest=now), beliefs


def _details(state: SideBySide, detail: Detail) -> list[tuple[Detail, bool]]:
    """Of each tracker, the detail of its beliefs, and whether it tests free motion for curved surfaces: only
    the best one looks for further contacts and curvature."""
    best = int(state.log_weight.argmax())
    others = min(detail, Detail.GEOMETRY), False
    return [(detail, True) if i == best else others for i in range(len(state.trackers))]


def _held(one: TrackerState, tick: Tick, detail: Detail, tests_curvature: bool) -> TrackerState:
    """A tracker after the first tick in which it waits, as one without motion."""
    if tracker.can_hold(one):
        return tracker.hold(one, 1, tick.outliers)
    after, _ = tracker.update(one, replace(tick, innovation_excess=NO_EXCESS), detail, tests_curvature)
    return after


def _caught_up(state: SideBySide, leader: TrackerState, detail: Detail) -> SideBySide:
    """The state in which no tracker waits any more."""
    first, *others = state.trackers
    missed, details = state.rest, _details(state, detail)[1:]
    if missed.skipped or missed.kept:
        others = [
            _with_missed(one, leader, missed, *of_one) for one, of_one in zip(others, details, strict=True)
        ]
    return state._replace(trackers=(first, *others), rest=missed.restarted())


def _with_missed(
    one: TrackerState, leader: TrackerState, missed: Rest, detail: Detail, tests_curvature: bool
) -> TrackerState:
    """A waiting tracker after the ticks it missed: the skipped ones as without motion, then those kept."""
    one = tracker.hold(one, missed.skipped, missed.outliers)
    one, own = tracker.follow_ticks(one, leader, leader, missed.kept)
    for after, _ in tracker.update_through_gaps(one, own, detail, tests_curvature):
        one = after
    return one


def _averaged_like(one: TrackerState, first: TrackerState) -> TrackerState:
    """A waiting tracker with the averaging of the first; its free-motion filter will start again."""
    assert first.averaging is not None
    averaging = first.averaging
    return one._replace(averaging=averaging._replace(stream=averaging.stream._replace(free_motion=None)))


def _single(
    state: SideBySide, one: TrackerState, closed: Sequence[Tick], detail: Detail
) -> tuple[SideBySide, list[Belief]]:
    """Advance the only tracker that is left."""
    beliefs = list[Belief]()
    for after, online in tracker.update_each(one, closed, detail):
        one, belief = after, tracker.answer(after, online)
        if belief is not None:
            beliefs.append(belief)
    return state._replace(trackers=(one,)), beliefs


def _observe(
    state: TrackerState, closed: Sequence[Tick], detail: Detail, tests_curvature: bool
) -> tuple[TrackerState, list[TrackedTick]]:
    """Update one tracker by ticks; one of the trackers tests free motion for curved surfaces."""
    followed = list[TrackedTick]()
    for after, online in tracker.update_each(state, closed, detail, tests_curvature):
        followed.append(TrackedTick(tick_evidence(state, after), tracker.answer(after, online)))
        state = after
    return state, followed


def _with_curved(one: TrackerState, curved: CurvedMotion) -> TrackerState:
    """A tracker with the result of another's test for curved surfaces, if its own label is free as well."""
    is_free = one.label is Contact.FREE
    return one._replace(curved=curved._replace(since=one.free_since)) if is_free else one


def _weigh_trackers(
    state: SideBySide, tick: Tick, now: Sequence[TrackedTick], moves: bool
) -> tuple[SideBySide, NDArray[np.int64]]:
    """Weigh the trackers by the evidence of a ``tick``, if the object ``moves`` in it; returns the indices of
    those that are kept."""
    every = np.arange(len(now))
    if len(now) == 1:
        first = (*state.first, FirstTick(tick, now[0], moves))
        return state if state.pending is None else state._replace(first=first), every
    if not moves:
        return state, every
    model = state.trackers[0].model
    log_weight = state.log_weight + relative_evidence([one.evidence for one in now], model.motion)
    moved_s = state.moved_s + model.tick_s
    kept = every[are_compared(log_weight, state.log_prior, moved_s)]
    state = state._replace(
        trackers=tuple(state.trackers[i] for i in kept),
        log_weight=log_weight[kept] - log_weight.max(),
        log_prior=state.log_prior[kept],
        moved_s=moved_s,
    )
    return state, kept
