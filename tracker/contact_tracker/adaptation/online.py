"""Online: adaptation to a stream that comes pose by pose or in batches."""

from dataclasses import replace
from typing import Final, NamedTuple

from contact_tracker.adaptation import clearance, contradiction, impacts, side_by_side
from contact_tracker.adaptation.clearance import Clearance
from contact_tracker.adaptation.contradiction import Contradiction
from contact_tracker.adaptation.conventions import NOTHING_KNOWN, Conventions
from contact_tracker.adaptation.conventions import advance as advance_conventions
from contact_tracker.adaptation.conventions import findings as convention_findings
from contact_tracker.adaptation.impacts import Impacts
from contact_tracker.adaptation.mixture import mixed_with_uniform
from contact_tracker.adaptation.side_by_side import SideBySide
from contact_tracker.config.parameters import Model
from contact_tracker.inspection.stream_checks import (
    NOTHING_INSPECTED,
    Finding,
    Inspection,
    findings,
    inspect,
)
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.motion.pose_validation import Arrival, is_valid, require_valid
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.state import TrackerState

BATCH_POSES: Final = 50
"""Number of poses that are inspected together."""


class AdaptiveState(NamedTuple):
    """The state of a stream; bounded in size, however long the stream.

    The ``trackers`` side by side; the tests of ``conventions``, of a ``contradiction`` to the prior map, of
    the ``clearance`` and of ``impacts``; the ``inspection`` of the poses. ``uninspected`` are the latest
    ``many`` poses; the trackers have the first ``taken_in`` parts of these and get the others at the end of
    the tick. ``last_ns`` is the stamp of the last pose; ``late`` is the number of those left out, see
    ``take``.
    """

    trackers: SideBySide
    inspection: Inspection
    conventions: Conventions
    contradiction: Contradiction
    clearance: Clearance
    impacts: Impacts
    uninspected: tuple[Pose | Poses, ...]
    many: int
    taken_in: int
    last_ns: int | None = None
    late: int = 0

    @property
    def is_decided(self) -> bool:
        """Whether the choice of ticks and noise is final."""
        return self.trackers.is_decided

    @property
    def best(self) -> TrackerState | None:
        """The most probable tracker; None before the rate of the stream is known."""
        return self.trackers.best

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the stream."""
        in_stream = findings(self.inspection, self.conventions.fitting_units)
        fast = impacts.findings(self.impacts, self.trackers.model.tick_s)
        mixed_up = convention_findings(self.conventions)
        if self.inspection.bodies or self.inspection.units:
            fast = mixed_up = ()
        return (
            *in_stream,
            *fast,
            *mixed_up,
            *(clearance.findings(self.clearance) or (() if fast else self._contradictions)),
        )

    @property
    def _contradictions(self) -> tuple[Finding, ...]:
        """A contradiction to the prior map, reported if no other finding explains it."""
        return contradiction.findings(self.contradiction, self.trackers.knowledge)

    @property
    def is_in_doubt(self) -> bool:
        """Whether a finding makes labels unreliable."""
        return any(finding.doubts_labels for finding in self.findings)

    @property
    def may_be_in_doubt(self) -> bool:
        """The same, or it is not known yet: impacts may be shorter than a tick, and the prior map or the
        conventions of the poses may be wrong."""
        if self.contradiction.is_likely or self.conventions.is_likely:
            return True
        knowledge = self.trackers.knowledge
        too_early = bool(knowledge.object and knowledge.environment) and not self.inspection.blocks
        may_be_short = self.trackers.model.tick_s > impacts.LONGEST_TICK_S and (
            too_early or self.impacts.is_near
        )
        return self.is_in_doubt or may_be_short

    @property
    def outliers(self) -> int:
        """Poses left out of their ticks so far."""
        trackers = self.trackers.trackers
        return self.trackers.outliers + (trackers[0].outliers if trackers else 0)  # others may wait


def start(
    model: Model, lag_s: float = 0.0, knowledge: PriorMap = EMPTY_MAP, frame_moves: bool = False
) -> AdaptiveState:
    """State before the first pose.

    Parameters
    ----------
    lag_s : with a fixed lag beliefs are later and more accurate.
    frame_moves : whether poses are in the frame of a body that moves, as the user asked.
    """
    return AdaptiveState(
        side_by_side.begin(model, lag_s, knowledge),
        NOTHING_INSPECTED._replace(frame_moves=frame_moves),
        NOTHING_KNOWN,
        Contradiction(),
        Clearance(),
        Impacts(),
        (),
        0,
        0,
    )


def step(state: AdaptiveState, pose: Pose) -> tuple[AdaptiveState, Belief | None]:
    """Update by one pose; returns a belief if the pose closes a tick, from data up to that tick only.

    When the rate becomes known, and after a gap, one pose closes several ticks: the belief is that of the
    last; ``advance`` returns all.

    Raises
    ------
    InvalidPose
        The pose did not pass the gate.
    """
    state, beliefs = advance(state, pose)
    return state, beliefs[-1] if beliefs else None


def advance(
    state: AdaptiveState, poses: Pose | Poses, detail: Detail = Detail.FORMATION
) -> tuple[AdaptiveState, list[Belief]]:
    """Update by one pose or several, in order; returns the beliefs of the ticks that they close.

    While the poses may be in doubt, probabilities are mixed with uniform ones.

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
        some, poses = poses[: BATCH_POSES - state.many], poses[BATCH_POSES - state.many :]
        state, new = _advance(state, some, len(some), detail)
        beliefs += new
    return state, beliefs


def take(
    state: AdaptiveState, arrival: Arrival, detail: Detail = Detail.FORMATION
) -> tuple[AdaptiveState, list[Belief]]:
    """``advance`` online, where a tick does not wait for poses that are held or late: it is complete once
    none is waited for.

    Poses that come more than a tick after theirs was closed are left out and counted.
    """
    beliefs = list[Belief]()
    for pose in arrival.poses:
        if side_by_side.is_late(state.trackers, pose.stamp_ns):
            state = state._replace(late=state.late + 1)
        else:
            state, new = advance(state, pose, detail)
            beliefs += new
    if arrival.next_ns is None or side_by_side.goes_on(state.trackers, arrival.next_ns):
        return state, beliefs
    state, new = _update_trackers(state, detail)
    beliefs += new
    trackers, new = side_by_side.pass_time(state.trackers, arrival.next_ns, detail)
    state = state._replace(trackers=trackers)
    return state, [*beliefs, *_with_doubt(state, new)]


def inspect_poses(state: AdaptiveState, poses: Poses) -> AdaptiveState:
    """Update the inspection and the tests of clearance and impacts by poses, which are tracked elsewhere."""
    knowledge, away, hits = state.trackers.knowledge, state.clearance, state.impacts
    for first in range(0, len(poses) if knowledge else 0, BATCH_POSES):
        some = poses[first : first + BATCH_POSES]
        away, hits = clearance.advance(away, knowledge, some), impacts.advance(hits, knowledge, some)
    return state._replace(inspection=inspect(state.inspection, poses), clearance=away, impacts=hits)


def check_conventions(state: AdaptiveState, poses: Poses) -> AdaptiveState:
    """Update the test of conventions by poses, which may be tracked elsewhere."""
    trackers = state.trackers.trackers
    if not trackers or trackers[0].averaging is None:
        return state
    noise = trackers[0].averaging.stream.noise
    sigma = noise.sigma_position_m, noise.sigma_rotation_rad
    known = advance_conventions(
        state.conventions, trackers[0].model, sigma, poses, has_odd_unit=state.inspection.units
    )
    return state._replace(conventions=known)


def check_prior_map(state: AdaptiveState, poses: Poses) -> AdaptiveState:
    """Update the test of a contradiction to the prior map by poses, which are tracked elsewhere."""
    trackers, best = state.trackers, state.best
    if best is None:
        return state
    known = contradiction.advance(
        state.contradiction,
        best.model,
        trackers.knowledge,
        poses,
        trackers.is_decided,
        trackers.rest.ticks_at_rest > 0,
        state.inspection.filtered,
    )
    return state._replace(contradiction=known)


def finish(state: AdaptiveState) -> tuple[AdaptiveState, list[Belief]]:
    """End of the stream: the beliefs of the last, partial tick and of the ticks within the lag.

    The state can be advanced further, as after a gap.
    """
    state, beliefs = _update_trackers(state, Detail.FORMATION)
    if state.uninspected:
        state = _inspect_batch(state)
    trackers, rest = side_by_side.finish(state.trackers)
    state = state._replace(trackers=trackers, contradiction=contradiction.finish(state.contradiction))
    return state, [*beliefs, *_with_doubt(state, rest)]


def _advance(
    state: AdaptiveState, poses: Pose | Poses, many: int, detail: Detail
) -> tuple[AdaptiveState, list[Belief]]:
    """Advance by at most ``BATCH_POSES`` uninspected poses, those from before included."""
    state = state._replace(uninspected=(*state.uninspected, poses), many=state.many + many)
    if isinstance(poses, Pose) and _is_within_tick(state, poses):
        return state, []  # most single poses: the trackers need them at the end of the tick only
    state, beliefs = _update_trackers(state, detail)
    if state.many == BATCH_POSES:
        state = _inspect_batch(state)
    return state, beliefs


def _inspect_batch(state: AdaptiveState) -> AdaptiveState:
    state = inspect_poses(state, Poses.join(state.uninspected))
    return state._replace(uninspected=(), many=0, taken_in=0)


def _is_within_tick(state: AdaptiveState, pose: Pose) -> bool:
    """Whether a pose closes neither a tick nor a batch."""
    return state.many < BATCH_POSES and side_by_side.goes_on(state.trackers, pose.stamp_ns)


def _update_trackers(state: AdaptiveState, detail: Detail) -> tuple[AdaptiveState, list[Belief]]:
    """Update the trackers by the poses that they do not have yet."""
    pending = state.uninspected[state.taken_in :]
    if not pending:
        return state, []
    poses = Poses.join(pending)
    trackers, beliefs = side_by_side.advance(state.trackers, poses, detail)
    state = state._replace(trackers=trackers, taken_in=len(state.uninspected))
    state = check_prior_map(check_conventions(state, poses), poses)
    return state, _with_doubt(state, beliefs)


def _with_doubt(state: AdaptiveState, beliefs: list[Belief]) -> list[Belief]:
    """The beliefs, mixed with uniform ones while the stream may be in doubt."""
    if not beliefs or not state.may_be_in_doubt:
        return beliefs
    possible = state.trackers.knowledge.allowed
    return [replace(one, probability=mixed_with_uniform(one.probability, possible)) for one in beliefs]
