"""Trackers side by side that differ in the noise of a tick, weighed by their evidence.

The first is the model's. Others begin, with the poses so far, once these tell the ratio of the noise of
position and orientation. After some seconds of motion those that are far behind are dropped, after some more
all but the best (``comparison``).
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.adaptation.candidates import candidates, usual_period_s, with_ticks_for
from contact_tracker.adaptation.comparison import (
    TickEvidence,
    are_compared,
    is_moving,
    latest_lifted_poses,
    relative_evidence,
    tick_evidence,
)
from contact_tracker.adaptation.mixture import mixture
from contact_tracker.config.parameters import Model
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.motion import tick_grid
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
    """A tick that a tracker has taken in: its ``evidence``, its ``latest_lifted_poses``, and the answer."""

    evidence: TickEvidence
    lifted_poses: Array
    belief: Belief | None


class SideBySide(NamedTuple):
    """The trackers of one stream; bounded in size however long it is.

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
    first: tuple[TrackedTick, ...]
    moved_s: float

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
    return SideBySide(model, knowledge, lag_s, (), np.zeros(1), np.zeros(1), NO_POSES, (), 0.0)


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
    rest, beliefs = poses, list[Belief]()
    while len(rest) and state.pending is not None:
        enough = RATIO_POSES if state.trackers else RATE_POSES
        missing = enough - len(state.pending)
        some, rest = rest[:missing], rest[missing:]
        state = state._replace(pending=Poses.join([state.pending, some]))
        said = list[Belief]()
        if state.trackers:
            state, said = _side_by_side(state, some, detail)
            state = _with_others(state, min(detail, Detail.GEOMETRY)) if len(some) == missing else state
        elif len(some) == missing:
            state, said = _with_first(state, detail)
        beliefs += said
    if len(rest):
        state, said = _side_by_side(state, rest, detail)
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
    ended = [tracker.finish(one) for one in state.trackers]
    rest = zip(*(said for _, said in ended), strict=True)
    beliefs += [mixture(some, state.log_weight) for some in rest]
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
    )
    alive = np.arange(len(state.trackers))
    for now in zip(first, *(followed for _, followed in started), strict=True):
        moves = is_moving(now[alive[0]].lifted_poses)
        state, kept = _weigh_trackers(state, [now[i] for i in alive], moves)
        alive = alive[kept]
    return state


def _side_by_side(state: SideBySide, poses: Poses, detail: Detail) -> tuple[SideBySide, list[Belief]]:
    """All trackers take in poses; one that is dropped meanwhile says nothing any more."""
    leader, *others = state.trackers
    advanced, closed = tracker.accumulate_poses(leader, poses)
    if not others and state.is_decided:
        return _single(state, advanced, closed, detail)
    # frames are averaged once: the ticks that trackers are compared by are the same
    gathered = [tracker.follow_ticks(one, leader, advanced, closed) for one in others]
    gathered.insert(0, (advanced, closed))
    if not closed:
        return state._replace(trackers=tuple(one for one, _ in gathered)), []
    judge = int(state.log_weight.argmax())
    followed = [
        _observe(one, own, detail if i == judge else min(detail, Detail.GEOMETRY), i == judge)
        for i, (one, own) in enumerate(gathered)
    ]
    curved = followed[judge][0].curved  # one judges it for all
    state = state._replace(trackers=tuple(_with_curved(one, curved) for one, _ in followed))
    beliefs, alive = list[Belief](), np.arange(len(followed))
    for now in zip(*(ticks for _, ticks in followed), strict=True):
        moves = is_moving(now[alive[0]].lifted_poses)
        state, kept = _weigh_trackers(state, [now[i] for i in alive], moves)
        alive = alive[kept]
        said = [now[i].belief for i in alive]
        if said[0] is not None:  # they lag alike
            activity = np.array([now[i].evidence.activity for i in alive])
            held_for_motion = 0.0 if moves else REST_NATS * activity
            beliefs.append(mixture([b for b in said if b is not None], state.log_weight - held_for_motion))
    return state, beliefs


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
        evidence, lifted_poses = tick_evidence(state, after), latest_lifted_poses(after.window)
        followed.append(TrackedTick(evidence, lifted_poses, tracker.answer(after, online)))
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
        return state if state.pending is None else state._replace(first=(*state.first, *now)), every
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
