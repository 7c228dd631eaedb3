"""Trackers that run only for the evidence of contacts against free motion."""

from typing import NamedTuple

from contact_tracker.motion.poses import Poses
from contact_tracker.tracking import tracker
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.state import TrackerState


class AfterTick(NamedTuple):
    """``log_evidence`` of contacts against free motion (nats), seconds of motion so far, and the belief."""

    log_evidence: float
    moved_s: float
    belief: Belief


class Explained(NamedTuple):
    """A tracker, and the seconds of motion since its start."""

    state: TrackerState
    moved_s: float = 0.0


def follow(
    one: Explained, poses: Poses, detail: Detail = Detail.WEIGHTS
) -> tuple[Explained, list[AfterTick]]:
    """Advance by poses; returns the evidence after each tick that they close, and a belief of this
    ``detail``."""
    state, closed = tracker.accumulate_poses(one.state, poses)
    moved_s, after = one.moved_s, list[AfterTick]()
    for now, count in tracker.update_through_gaps(state, closed, detail):
        state = now
        moved_s += state.model.tick_s * state.window.latest_motion_ratio  # none in a gap
        assert state.belief is not None
        after += [AfterTick(state.log_evidence, moved_s, state.belief)] * count
    return Explained(state, moved_s), after
