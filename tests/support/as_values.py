"""The tracker of a stream as a value: each call returns another one, so that a test can go on from one in
several ways."""

from copy import copy

from contact_tracker.motion.pose_validation import Arrival
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.belief import Belief, Detail

start = Tracker.start


def copied(tracker: Tracker) -> Tracker:
    """A copy; what does not change in place is shared."""
    other = copy(tracker)
    other.filters, other.uninspected = tracker.filters.copied(), [*tracker.uninspected]
    return other


def advance(
    tracker: Tracker, poses: Pose | Poses, detail: Detail = Detail.FORMATION
) -> tuple[Tracker, list[Belief]]:
    """After poses that passed the gate, and the beliefs of the ticks that they close."""
    other = copied(tracker)
    return other, other.add(poses, detail)


def take(
    tracker: Tracker, arrival: Arrival, detail: Detail = Detail.FORMATION
) -> tuple[Tracker, list[Belief]]:
    """After what a pose brings."""
    other = copied(tracker)
    return other, other.update(arrival, detail)


def finish(tracker: Tracker) -> tuple[Tracker, list[Belief]]:
    """At the end of the stream."""
    other = copied(tracker)
    return other, other.finish()
