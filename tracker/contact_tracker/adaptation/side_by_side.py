"""Trackers side by side that differ in the noise of a tick, weighed by their evidence.

The first is the model's. Others begin, with the poses so far, once these tell the ratio of the noise of
position and orientation. After some seconds of motion those that are far behind are dropped, after some more
all but the best (``comparison``).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.adaptation import rest
from contact_tracker.adaptation.candidates import candidates, usual_period_s, with_ticks_for
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

RATE_POSES: Final = 12
"""So many poses tell the rate of the stream."""
RATIO_POSES: Final = 60
"""So many tell the ratio of the noise of position and orientation."""
REST_NATS: Final = 10.0
"""So much less counts a tracker that takes noise for motion, as long as the object rests."""


class TrackedTick(NamedTuple):
    """A tick that a tracker has taken in: its ``evidence``, and the answer."""

    evidence: TickEvidence
    belief: Belief | None


class FirstTick(NamedTuple):
    """A tick before there are other trackers, and whether the object ``moves`` in it."""

    tracked: TrackedTick
    moves: bool


class Averaging(NamedTuple):
    """The first tracker ``before`` and ``after`` it averaged some poses, which the others follow."""

    before: TrackerState
    after: TrackerState


class SideBySide(NamedTuple):
    """The trackers of one stream; bounded in size however long it is.

    While the object rests, the first tracker goes on alone, see ``rest``.

    ``model`` as asked for; the ``trackers``, none before the rate is known, and their ``log_weight``
    (K,), in which ``log_prior`` (K,) is what is no evidence; ``pending``, the poses so far as long as other
    trackers may begin with them, and what the ticks in them were to the first tracker (``first``); for how
    long the object has moved (s).
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

    @property
    def is_decided(self) -> bool:
        """Whether one tracker is left, and none is to begin."""
        return self.pending is None and len(self.trackers) == 1

    @property
    def best(self) -> TrackerState | None:
        """The most probable tracker; None before the rate of the stream is known."""
        return self.trackers[int(self.log_weight.argmax())] if self.trackers else None


def begin(model: Model, lag_s: float = 0.0, knowledge: PriorMap = EMPTY_MAP) -> SideBySide:
    """No pose has come yet."""
    return SideBySide(model, knowledge, lag_s, (), np.zeros(1), np.zeros(1), NO_POSES, (), 0.0, NO_REST)


def goes_on(state: SideBySide, stamp_ns: int) -> bool:
    """Whether a pose that follows closes no tick."""
    if not state.trackers:
        return False
    one = state.trackers[0]
    return one.averaging is not None and tick_grid.goes_on(one.averaging, stamp_ns, one.model)


def advance(state: SideBySide, poses: Poses, detail: Detail) -> tuple[SideBySide, list[Belief]]:
    """Take in poses; the beliefs of the ticks that they close."""
    if state.pending is None:
        return _side_by_side(state, poses, detail)
    left, beliefs = poses, list[Belief]()
    while len(left) and state.pending is not None:
        enough = RATIO_POSES if state.trackers else RATE_POSES
        missing = enough - len(state.pending)
        some, left = left[:missing], left[missing:]
        state = state._replace(pending=Poses.join([state.pending, some]))
        said = list[Belief]()
        if state.trackers:
            state, said = _side_by_side(state, some, detail)
            state = _with_others(state, min(detail, Detail.GEOMETRY)) if len(some) == missing else state
        elif len(some) == missing:
            state, said = _with_first(state, detail)
        beliefs += said
    if len(left):
        state, said = _side_by_side(state, left, detail)
        beliefs += said
    return state, beliefs


def finish(state: SideBySide) -> tuple[SideBySide, list[Belief]]:
    """The stream has ended: beliefs of the last, partial tick and of what the lag still holds back.

    Should it go on after all, it has paused, as after a gap.
    """
    beliefs = list[Belief]()
    if state.pending is not None and len(state.pending):
        if not state.trackers:
            state, beliefs = _with_first(state, Detail.FORMATION)
        state = _with_others(state, Detail.GEOMETRY)
    state = _caught_up(state, state.trackers[0]) if state.trackers else state
    ended = [tracker.finish(one) for one in state.trackers]
    last = zip(*(said for _, said in ended), strict=True)
    beliefs += [mixture(some, state.log_weight) for some in last]
    return state._replace(trackers=tuple(one for one, _ in ended)), beliefs


def _with_first(state: SideBySide, detail: Detail) -> tuple[SideBySide, list[Belief]]:
    """With the tracker of the model itself, whose ticks hold frames, and what it says of the poses so far."""
    assert state.pending is not None
    period_s = usual_period_s(state.pending.stamp_ns)
    first = tracker.start(with_ticks_for(state.model, period_s), state.lag_s, state.knowledge)
    return _side_by_side(state._replace(trackers=(first,)), state.pending, detail)


def _with_others(state: SideBySide, detail: Detail) -> SideBySide:
    """With the other trackers after the poses so far: what they say of those comes too late."""
    assert state.pending is not None
    chosen = candidates(state.trackers[0].model, state.pending)
    starts = (tracker.start(one.model, state.lag_s, state.knowledge) for one in chosen[1:])
    started = [_observe(*tracker.accumulate_poses(start, state.pending), detail, False) for start in starts]
    first, log_prior = state.first, np.array([one.log_prior for one in chosen])
    state = state._replace(
        trackers=(*state.trackers, *(one for one, _ in started)),
        log_weight=log_prior,
        log_prior=log_prior,
        pending=None,
        first=(),
        rest=state.rest.restarted(),
    )
    alive = np.arange(len(state.trackers))
    for (tracked, moves), *others in zip(first, *(followed for _, followed in started), strict=True):
        now = [tracked, *others]
        state, kept = _weigh_trackers(state, [now[i] for i in alive], moves)
        alive = alive[kept]
    return state


def _side_by_side(state: SideBySide, poses: Poses, detail: Detail) -> tuple[SideBySide, list[Belief]]:
    """All trackers advance by poses; one that is dropped meanwhile has no say in later ticks."""
    leader, *others = state.trackers
    advanced, closed = tracker.accumulate_poses(leader, poses)
    if state.is_decided:
        return _single(state, advanced, closed, detail)
    # frames are averaged once: the ticks that trackers are compared by are the same
    averaging, beliefs = Averaging(leader, advanced), list[Belief]()
    state = state._replace(trackers=(advanced, *others))
    while closed:
        first, ahead = state.trackers[0], _rest_ahead(state, closed)
        if _is_gap(state, closed[0], ahead[0]):
            state, said = _pass_gap(state, closed[: len(ahead)], ahead[-1])
        elif ahead[0].is_waiting:
            state, said = _rest_on(state, closed[: len(ahead)], ahead[-1], detail)
        else:
            state, said = _take_in(state, averaging, closed[0], ahead[0], detail)
        beliefs += said
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
    """The rest after the next tick, or after all of the next ticks that go together: those of a gap, or those
    through which the others wait."""
    first, *others = state.trackers
    can_wait = bool(others) and not first.lag_history.size and not first.knowledge
    share = first.model.noise.estimate_share
    is_quietest = all(one.model.noise.estimate_share >= share for one in others)
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
    """Whether all trackers can pass a tick, and those that follow without frames, in one step."""
    return (
        not tick.count
        and not now.moves
        and not state.rest.is_waiting
        and state.pending is None
        and all(map(tracker.can_hold, state.trackers))
    )


def _pass_gap(state: SideBySide, ticks: Sequence[Tick], now: Rest) -> tuple[SideBySide, list[Belief]]:
    """All trackers pass ticks without frames."""
    trackers = tuple(tracker.hold(one, len(ticks)) for one in state.trackers)
    same = mixture([one.belief for one in trackers if one.belief is not None], state.log_weight)
    beliefs = [replace(same, stamp_ns=tick.stamp_ns) for tick in ticks]
    return state._replace(trackers=trackers, rest=now.caught_up()), beliefs


def _take_in(
    state: SideBySide, averaging: Averaging, tick: Tick, now: Rest, detail: Detail
) -> tuple[SideBySide, list[Belief]]:
    """All trackers take in a tick."""
    state = _caught_up(state, averaging.before)._replace(rest=now)
    first, *others = state.trackers
    gathered = [(first, [tick]), *(tracker.follow_ticks(one, *averaging, [tick]) for one in others)]
    judge = int(state.log_weight.argmax())
    followed = [
        _observe(one, own, detail if i == judge else min(detail, Detail.GEOMETRY), i == judge)
        for i, (one, own) in enumerate(gathered)
    ]
    curved = followed[judge][0].curved  # one judges it for all
    state = state._replace(trackers=tuple(_with_curved(one, curved) for one, _ in followed))
    state, kept = _weigh_trackers(state, [ticks[0] for _, ticks in followed], now.moves)
    tracked = [followed[i][1][0] for i in kept]
    beliefs = [one.belief for one in tracked if one.belief is not None]
    if not beliefs:  # they lag alike
        return state, []
    activity = np.array([one.evidence.activity for one in tracked])
    held_for_motion = 0.0 if now.moves else REST_NATS * activity
    return state, [mixture(beliefs, state.log_weight - held_for_motion)]


def _rest_on(
    state: SideBySide, ticks: Sequence[Tick], now: Rest, detail: Detail
) -> tuple[SideBySide, list[Belief]]:
    """The first tracker takes in ticks through which the others wait."""
    first, *others = state.trackers
    if not state.rest.is_waiting:
        others = [_averaged_like(_held(one, ticks[0]), first) for one in others]
    judges = not state.log_weight.argmax()
    first, followed = _observe(first, ticks, detail if judges else min(detail, Detail.GEOMETRY), judges)
    beliefs = list[Belief]()
    for tick, (evidence, belief) in zip(ticks, followed, strict=True):
        held_for_motion = np.append(REST_NATS * evidence.activity, np.zeros(len(others)))
        same = [replace(one.belief, stamp_ns=tick.stamp_ns) for one in others if one.belief is not None]
        if belief is not None:
            beliefs.append(mixture([belief, *same], state.log_weight - held_for_motion))
    return state._replace(trackers=(first, *others), rest=now), beliefs


def _held(one: TrackerState, tick: Tick) -> TrackerState:
    """A tracker after the first tick through which it waits, as one without motion."""
    if tracker.can_hold(one):
        return tracker.hold(one, 1, tick.outliers)
    after, _ = tracker.update(one, replace(tick, innovation_excess=NO_EXCESS), Detail.GEOMETRY, judges=False)
    return after


def _caught_up(state: SideBySide, leader: TrackerState) -> SideBySide:
    """No tracker waits any more: they take in the latest ticks, and those before as without motion."""
    first, *others = state.trackers
    missed = state.rest
    if missed.skipped or missed.kept:
        others = [_with_missed(one, leader, missed) for one in others]
    return state._replace(trackers=(first, *others), rest=missed.restarted())


def _with_missed(one: TrackerState, leader: TrackerState, missed: Rest) -> TrackerState:
    """A waiting tracker after what it has missed."""
    one = tracker.hold(one, missed.skipped, missed.outliers)
    one, own = tracker.follow_ticks(one, leader, leader, missed.kept)
    for after, _ in tracker.update_through_gaps(one, own, Detail.GEOMETRY):
        one = after
    return one


def _averaged_like(one: TrackerState, first: TrackerState) -> TrackerState:
    """A waiting tracker with the averaging of the first; its filter of free motion begins again."""
    assert first.averaging is not None
    averaging = first.averaging
    return one._replace(averaging=averaging._replace(stream=averaging.stream._replace(free_motion=None)))


def _single(
    state: SideBySide, one: TrackerState, closed: Sequence[Tick], detail: Detail
) -> tuple[SideBySide, list[Belief]]:
    """The one that is left goes on: there is nothing to weigh."""
    beliefs = list[Belief]()
    for after, online in tracker.update_each(one, closed, detail):
        one, belief = after, tracker.answer(after, online)
        if belief is not None:
            beliefs.append(belief)
    return state._replace(trackers=(one,)), beliefs


def _observe(
    state: TrackerState, closed: Sequence[Tick], detail: Detail, judges: bool
) -> tuple[TrackerState, list[TrackedTick]]:
    """One tracker takes in ticks; the one that ``judges`` free motion does so for all."""
    followed = list[TrackedTick]()
    for after, online in tracker.update_each(state, closed, detail, judges):
        followed.append(TrackedTick(tick_evidence(state, after), tracker.answer(after, online)))
        state = after
    return state, followed


def _with_curved(one: TrackerState, curved: CurvedMotion) -> TrackerState:
    """What another one has judged holds for a tracker that takes the motion to be free as well."""
    is_free = one.label is Contact.FREE
    return one._replace(curved=curved._replace(since=one.free_since)) if is_free else one


def _weigh_trackers(
    state: SideBySide, now: Sequence[TrackedTick], moves: bool
) -> tuple[SideBySide, NDArray[np.int64]]:
    """Weigh the trackers by what a tick in which the object ``moves`` was to each; which of them are kept."""
    every = np.arange(len(now))
    if len(now) == 1:
        first = (*state.first, FirstTick(now[0], moves))
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
