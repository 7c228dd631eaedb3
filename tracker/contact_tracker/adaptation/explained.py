"""Trackers that are followed for what contacts explain of the motion, and for nothing else."""

from typing import NamedTuple

from contact_tracker.motion.poses import Poses
from contact_tracker.tracking import tracker
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.state import TrackerState


class AfterTick(NamedTuple):
    """``log_evidence`` of contacts against free motion (nats), and for how long the object has moved (s)."""

    log_evidence: float
    moved_s: float


class Explained(NamedTuple):
    """A tracker, and for how long the object has moved (s) since it began."""

    state: TrackerState
    moved_s: float = 0.0


def follow(one: Explained, poses: Poses) -> tuple[Explained, list[AfterTick]]:
    """Take in poses; what is explained after each tick that they close."""
    state, closed = tracker.accumulate_poses(one.state, poses)
    moved_s, after = one.moved_s, list[AfterTick]()
    for tick in closed:
        state, _ = tracker.update(state, tick, Detail.WEIGHTS)
        moved_s += state.model.tick_s * state.window.latest_motion_ratio
        after.append(AfterTick(state.log_evidence, moved_s))
    return Explained(state, moved_s), after
