"""Filter of default poses, which trackers report while they do not see the object.

A default pose is the identity, the origin with some orientation, or another pose that is always exactly the
same. Such poses are dropped if they are away from the motion: farther from the last poses than a step of the
motion can be. The origin is dropped at once, any other pose when it repeats bit for bit. An object that rests
at the origin, or starts or passes there, comes from nearby and loses nothing.

At the start and after a gap it is not known where the motion is. Candidates are then held until other poses
have come.
"""

from collections import Counter, deque
from collections.abc import Collection, Sequence
from itertools import pairwise
from typing import Final

from contact_tracker.motion.poses import STEPS_KEPT, Pose, Step, reach, step_between

STEPS: Final = 10.0
"""A pose is away from the motion if it is farther than this many usual steps, and not near."""
QUANTILE: Final = 0.95
NEIGHBOURS: Final = 5
HELD: Final = 2000
_ARRIVALS_KEPT: Final = 256
_ORIGIN: Final = (0.0, 0.0, 0.0)

Numbers = tuple[tuple[float, float, float], tuple[float, float, float, float]]


class DefaultPoseFilter:
    """Drops the default poses from a stream of poses whose quaternions have norm 1.

    Parameters
    ----------
    counts : dropped poses are counted here as ``default_pose``.
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._kept: deque[Pose] = deque(maxlen=NEIGHBOURS)
        self._steps: deque[Step] = deque(maxlen=STEPS_KEPT)
        self._held: list[tuple[Pose, bool]] = []
        self._motion = 0
        self._dropped = 0
        self._arrivals: dict[Numbers, None] = {}

    def admit(self, pose: Pose, continues: bool) -> Sequence[Pose]:
        """The poses to go on with now: this one, none, or several that were held.

        Parameters
        ----------
        continues : whether it follows closely on the pose before.
        """
        if not continues and not self._held:  # held poses wait for motion on either side of a gap
            self._kept.clear()
            self._steps.clear()
            self._dropped = 0
        if len(self._kept) == NEIGHBOURS:
            return (pose,) if self._passes(pose) else ()
        suspect = self._is_suspect(pose)
        if not self._held and not suspect:
            self._keep(pose)
            return (pose,)
        self._held.append((pose, suspect))
        self._motion += not suspect
        if len(self._kept) + self._motion == NEIGHBOURS:
            self._judge_held()
            return self.finish()
        return self.finish() if len(self._held) == HELD else ()

    @property
    def held_since_ns(self) -> int | None:
        """Stamp of the first pose that is held; None if there is none."""
        return self._held[0][0].stamp_ns if self._held else None

    def finish(self) -> Sequence[Pose]:
        """The poses still held: no motion has come that would show them to be default poses."""
        waiting = [pose for pose, _ in self._held]
        self._held, self._motion = [], 0
        for pose in waiting:
            self._keep(pose)
        return waiting

    def _keep(self, pose: Pose) -> None:
        if self._kept and self._kept[-1][1:] != pose[1:]:
            self._note_step(self._kept[-1], pose, step_between(self._kept[-1], pose))
        self._kept.append(pose)

    def _passes(self, pose: Pose) -> bool:
        """Judge a pose by the motion before it."""
        last = self._kept[-1]
        if last[1:] != pose[1:]:
            step = step_between(last, pose)
            if not step.is_near and self._is_default(pose):
                self._counts["default_pose"] += 1
                self._dropped += 1
                return False
            self._note_step(last, pose, step)
        self._dropped = 0
        self._kept.append(pose)
        return True

    def _note_step(self, before: Pose, pose: Pose, step: Step) -> None:
        """Add a step to the usual steps of the motion; steps from or to the origin do not count."""
        if (pose.position_m == _ORIGIN) == (before.position_m == _ORIGIN):
            frames = 1 + self._dropped
            self._steps.append(step if frames == 1 else Step(step.distance_m / frames, step.turn / frames))

    def _is_default(self, pose: Pose) -> bool:
        """Whether a pose away from the motion is a default pose; it is remembered."""
        # a pose that itself came by a jump does not count as motion near this one
        motion = [kept for kept in self._kept if kept[1:] != pose[1:] or kept[1:] not in self._arrivals]
        is_away, in_position = _is_away(pose, motion, self._steps)
        if not is_away:
            return False
        known = pose[1:] in self._arrivals
        self._arrivals.pop(pose[1:], None)
        self._arrivals[pose[1:]] = None  # as the latest
        if len(self._arrivals) > _ARRIVALS_KEPT:
            del self._arrivals[next(iter(self._arrivals))]
        return known or _is_origin(pose, is_away, in_position)

    def _is_suspect(self, pose: Pose) -> bool:
        """Whether it may be a default pose, while the motion is not known yet."""
        if pose.position_m != _ORIGIN:
            return False
        before = self._held[-1][0] if self._held else self._kept[-1] if self._kept else pose
        turns_there = before.position_m == _ORIGIN and before.quat_xyzw != pose.quat_xyzw
        return _is_unturned(pose) or not turns_there

    def _judge_held(self) -> None:
        """Drop the default poses among those held, given the motion before and after them."""
        motion = [*self._kept, *(pose for pose, suspect in self._held if not suspect)]
        steps = [step_between(a, b) for a, b in pairwise(motion) if a[1:] != b[1:]]
        waiting = [
            (pose, suspect)
            for pose, suspect in self._held
            if not suspect or not _is_origin(pose, *_is_away(pose, motion, steps))
        ]
        if dropped := len(self._held) - len(waiting):
            self._counts["default_pose"] += dropped
        self._held = waiting


def _is_away(pose: Pose, motion: Sequence[Pose], steps: Collection[Step]) -> tuple[bool, bool]:
    """Whether a pose is away from all poses of the motion: at all, and by its position alone."""
    reach_m, reach_turn = reach(steps, STEPS, QUANTILE)
    between = [step_between(other, pose) for other in motion]
    return (
        all(step.distance_m > reach_m or step.turn > reach_turn for step in between),
        all(step.distance_m > reach_m for step in between),
    )


def _is_origin(pose: Pose, is_away: bool, in_position: bool) -> bool:
    """Whether a pose is the origin, away from the motion; an object that only turns is always there."""
    return pose.position_m == _ORIGIN and (in_position or (is_away and _is_unturned(pose)))


def _is_unturned(pose: Pose) -> bool:
    return pose.quat_xyzw[:3] == _ORIGIN
