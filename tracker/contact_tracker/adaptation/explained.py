"""Trackers that run only for the evidence of contacts against free motion."""

from typing import NamedTuple

from contact_tracker.motion.poses import Poses
from contact_tracker.tracking import tracker
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.state import TrackerState


class AfterTick(NamedTuple):
    """``log_evidence`` of contacts against free motion (nats), and the seconds of motion so far."""

    log_evidence: float
    moved_s: float


class Explained(NamedTuple):
    """A tracker, and the seconds of motion since its start."""

    state: TrackerState
    moved_s: float = 0.0


def follow(one: Explained, poses: Poses) -> tuple[Explained, list[AfterTick]]:
    """Advance by poses; returns the evidence after each tick that they close."""
    state, closed = tracker.accumulate_poses(one.state, poses)
    moved_s, after = one.moved_s, list[AfterTick]()
    for now, count in tracker.update_through_gaps(state, closed, Detail.WEIGHTS):
        state = now
        moved_s += state.model.tick_s * state.window.latest_motion_ratio  # none in a gap
        after += [AfterTick(state.log_evidence, moved_s)] * count
    return Explained(state, moved_s), after
