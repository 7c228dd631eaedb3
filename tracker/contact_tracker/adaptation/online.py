"""Online: a pose at a time, or several; ticks, noise and doubt are those of the stream."""

from dataclasses import replace
from typing import Final, NamedTuple

from contact_tracker.adaptation import clearance, contradiction, side_by_side
from contact_tracker.adaptation.clearance import Clearance
from contact_tracker.adaptation.contradiction import Contradiction
from contact_tracker.adaptation.conventions import NOTHING_KNOWN, Conventions
from contact_tracker.adaptation.conventions import advance as advance_conventions
from contact_tracker.adaptation.conventions import findings as convention_findings
from contact_tracker.adaptation.mixture import spread_out
from contact_tracker.adaptation.side_by_side import SideBySide
from contact_tracker.config.parameters import Model
from contact_tracker.inspection.stream_checks import (
    LONGEST_TICK_S,
    NOTHING_INSPECTED,
    Finding,
    Inspection,
    findings,
    impacts,
    inspect,
)
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.motion.pose_validation import is_valid, require_valid
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.state import TrackerState

TOGETHER: Final = 50
"""Number of poses that are inspected together."""


class AdaptiveState(NamedTuple):
    """The state of a stream; bounded in size, however long the stream.

    The ``trackers`` side by side; the tests of ``conventions``, of a ``contradiction`` to the prior map and
    of the ``clearance``; the ``inspection`` of the poses. ``uninspected`` are the latest ``many`` poses, of
    which the trackers have the first ``taken_in`` parts; the others wait for the end of the tick. ``last_ns``
    is the stamp of the last pose.
    """

    trackers: SideBySide
    inspection: Inspection
    conventions: Conventions
    contradiction: Contradiction
    clearance: Clearance
    uninspected: tuple[Pose | Poses, ...]
    many: int
    taken_in: int
    last_ns: int | None = None

    @property
    def is_decided(self) -> bool:
        """Whether ticks and noise are chosen for good, and the order of quaternions is known."""
        return self.trackers.is_decided and self.conventions.is_settled

    @property
    def best(self) -> TrackerState | None:
        """The most probable tracker; None before the rate of the stream is known."""
        return self.trackers.best

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What the stream shows of itself."""
        tick_s, fast = self.trackers.model.tick_s, tuple[Finding, ...]()
        if self._impacts_are_possible:
            fast = impacts(self.inspection, tick_s)
        return (
            *findings(self.inspection),
            *fast,
            *convention_findings(self.conventions),
            *(clearance.findings(self.clearance) or (() if fast else self._contradictions)),
        )

    @property
    def _contradictions(self) -> tuple[Finding, ...]:
        """Where nothing else explains why contacts do not fit what is given."""
        return contradiction.findings(self.contradiction, self.trackers.knowledge)

    @property
    def is_in_doubt(self) -> bool:
        """Whether something was found that makes labels wrong."""
        return any(finding.doubts_labels for finding in self.findings)

    @property
    def is_in_doubt_yet(self) -> bool:
        """The same, or it is too early to know: an object that is given may be fast, and what is given may
        not fit."""
        if self.contradiction.is_likely:
            return True
        too_early = self._impacts_are_possible and not self.inspection.blocks
        return self.is_in_doubt or (too_early and self.trackers.model.tick_s > LONGEST_TICK_S)

    @property
    def _impacts_are_possible(self) -> bool:
        """Whether elements of both sides are known: then contacts shorter than a tick can be."""
        knowledge = self.trackers.knowledge
        return bool(knowledge.object) and bool(knowledge.environment)

    @property
    def outliers(self) -> int:
        """Poses left out of their ticks so far."""
        trackers = self.trackers.trackers
        return trackers[0].outliers if trackers else 0  # others may wait


def start(model: Model, lag_s: float = 0.0, knowledge: PriorMap = EMPTY_MAP) -> AdaptiveState:
    """No pose has come yet. With ``lag_s`` answers are of that long ago, and better."""
    return AdaptiveState(
        side_by_side.begin(model, lag_s, knowledge),
        NOTHING_INSPECTED,
        NOTHING_KNOWN,
        Contradiction(),
        Clearance(),
        (),
        0,
        0,
    )


def step(state: AdaptiveState, pose: Pose) -> tuple[AdaptiveState, Belief | None]:
    """Take in one pose; a belief comes out when it closes a tick, from data up to that tick only.

    When the rate becomes known, and after a gap, one pose closes several ticks: the belief is that of the
    last; ``advance`` returns all.

    Raises
    ------
    InvalidPose
        It did not pass the gate.
    """
    state, beliefs = advance(state, pose)
    return state, beliefs[-1] if beliefs else None


def advance(
    state: AdaptiveState, poses: Pose | Poses, detail: Detail = Detail.FORMATION
) -> tuple[AdaptiveState, list[Belief]]:
    """Take in one pose or several, in order; the beliefs of the ticks that they close.

    No label is sure while the poses are in doubt.

    Raises
    ------
    InvalidPose
        They did not pass the gate, or are not after those before.
    """
    if isinstance(poses, Pose):
        if not is_valid(poses, state.last_ns):
            require_valid(Poses.collect([poses]), state.last_ns)
        return _advance(state._replace(last_ns=poses.stamp_ns), poses, 1, detail)
    if len(poses):
        require_valid(poses, state.last_ns)
        state = state._replace(last_ns=int(poses.stamp_ns[-1]))
    beliefs = list[Belief]()
    while len(poses):
        some, poses = poses[: TOGETHER - state.many], poses[TOGETHER - state.many :]
        state, said = _advance(state, some, len(some), detail)
        beliefs += said
    return state, beliefs


def look_at(state: AdaptiveState, poses: Poses) -> AdaptiveState:
    """Inspect poses, whoever tracks them."""
    return state._replace(
        inspection=inspect(state.inspection, poses),
        clearance=clearance.advance(state.clearance, state.trackers.knowledge, poses),
    )


def compare(state: AdaptiveState, poses: Poses) -> AdaptiveState:
    """Advance the test of the prior map by poses, however they are tracked."""
    trackers = state.trackers
    if not trackers.trackers:
        return state
    known = contradiction.advance(state.contradiction, trackers.trackers[0].model, trackers.knowledge, poses)
    return state._replace(contradiction=known)


def finish(state: AdaptiveState) -> tuple[AdaptiveState, list[Belief]]:
    """The stream has ended: beliefs of the last, partial tick and of what the lag still holds back.

    Should it go on after all, it has paused, as after a gap.
    """
    state, beliefs = _take_in(state, Detail.FORMATION)
    if state.uninspected:
        state = look_at(state, Poses.join(state.uninspected))._replace(uninspected=(), many=0, taken_in=0)
    trackers, rest = side_by_side.finish(state.trackers)
    return state._replace(trackers=trackers), [*beliefs, *_as_sure_as_allowed(state, rest)]


def _advance(
    state: AdaptiveState, poses: Pose | Poses, many: int, detail: Detail
) -> tuple[AdaptiveState, list[Belief]]:
    """No more poses than are inspected together, those that wait for it included."""
    state = state._replace(uninspected=(*state.uninspected, poses), many=state.many + many)
    if isinstance(poses, Pose) and _may_wait(state, poses):
        return state, []  # as mostly, where poses come one by one: trackers need them at the end of the tick
    state, beliefs = _take_in(state, detail)
    if state.many == TOGETHER:
        state = look_at(state, Poses.join(state.uninspected))._replace(uninspected=(), many=0, taken_in=0)
    return state, beliefs


def _may_wait(state: AdaptiveState, pose: Pose) -> bool:
    return state.many < TOGETHER and side_by_side.goes_on(state.trackers, pose.stamp_ns)


def _take_in(state: AdaptiveState, detail: Detail) -> tuple[AdaptiveState, list[Belief]]:
    """The trackers take in what waits for the end of a tick."""
    waiting = state.uninspected[state.taken_in :]
    if not waiting:
        return state, []
    poses, conventions = Poses.join(waiting), state.conventions
    trackers, beliefs = side_by_side.advance(state.trackers, poses, detail)
    if trackers.trackers:
        model, rests = trackers.trackers[0].model, trackers.rest.goes_on(state.trackers.rest)
        conventions = advance_conventions(conventions, model, trackers.knowledge, poses, rests)
    state = state._replace(trackers=trackers, conventions=conventions, taken_in=len(state.uninspected))
    state = compare(state, poses)
    return state, _as_sure_as_allowed(state, beliefs)


def _as_sure_as_allowed(state: AdaptiveState, beliefs: list[Belief]) -> list[Belief]:
    if not beliefs or not state.is_in_doubt_yet:
        return beliefs
    return [replace(belief, probability=spread_out(belief.probability)) for belief in beliefs]
