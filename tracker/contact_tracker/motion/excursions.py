"""Filter of excursions: poses that jump away from the motion and back, for example by swapped markers.

A jump is a step much longer than usual, for the time that has passed since the last new pose. The poses
after it are held. If the next step continues it, the velocity has changed, as in an impact, and all are
passed on. If the poses jump back, the held ones were wrong and are dropped. They are back if the jumps add up
to no more than a step, as with swapped markers, or if usual motion leads there from the last pose, as with
another body in the place of this one. If they are not back after half a second, the object has moved, and all
are passed on; after two seconds, if no hand could accelerate an object so.

If they jump to one place and back all the time, two bodies take turns: all are passed on as well, and
``inspection`` reports it.
"""

from collections import Counter, deque
from collections.abc import Collection, Sequence
from itertools import pairwise
from math import hypot
from typing import Final

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.geometry.linalg import between, product, rotation_vectors
from contact_tracker.motion.poses import NEAR_M, NEAR_TURN, STEPS_KEPT, Pose, Step, reach, step_between

JUMP: Final = 3.0
"""A jump is longer than this many usual steps."""
USUAL_QUANTILE: Final = 0.9
KNOWN_STEPS: Final = 10
"""Least number of steps that determine the usual step."""
SHORT_NS: Final = 500_000_000
LONGEST_NS: Final = 2_000_000_000
"""Longest excursion if its first step is no motion. Markers are hidden for up to 1.6 s at a time."""
FAR_M_PER_S2: Final = 50.0
"""Acceleration that no hand gives an object."""
MOST_JUMPS: Final = 3
"""This many jumps in a row are motion, unless they lead back."""
VISITS: Final = 10
VISITS_WITHIN: Final = 40
"""Excursions to one place are those of another body if ``VISITS`` happen within this many poses."""
SAME_PLACE: Final = 0.25
"""Largest movement of that place between two excursions, relative to the jump."""
ARM_M: Final = 0.1
"""Lever arm with which turns count as distances."""
_UNTURNED: Final = np.array([0.0, 0.0, 0.0, 1.0])


class ExcursionFilter:
    """Drops excursions from a stream of poses whose quaternions have norm 1.

    Parameters
    ----------
    counts : dropped poses are counted here as ``excursion``, and those excursions of more than half a second
        as ``long_excursion``.
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._last: Pose | None = None
        self._new_ns = 0
        self._steps: deque[Step] = deque(maxlen=STEPS_KEPT)
        self._held: list[Pose] = []
        self._shift_m: Array = np.zeros(3)
        self._turn: Array = _UNTURNED
        self._in_a_row = 0
        self._until_ns = 0
        self._poses = 0
        self._visits: deque[int] = deque(maxlen=VISITS)
        self._last_excursion: Pose | None = None

    def admit(self, pose: Pose, continues: bool, period_ns: int) -> Sequence[Pose]:
        """The poses to pass on now: this one, none, or several that were held.

        Parameters
        ----------
        continues : whether it follows closely on the pose before.
        period_ns : the usual time between poses.
        """
        self._poses += 1
        previous = self._held[-1] if self._held else self._last
        elapsed_ns = pose.stamp_ns - self._new_ns
        if previous is None or pose[1:] != previous[1:]:
            self._new_ns = pose.stamp_ns
        if not continues:
            released = self.finish()
            self._steps.clear()
            self._last = pose
            return (*released, pose)
        if previous is None:
            self._last = pose
            return (pose,)
        step = step_between(previous, pose)
        if step.distance_m <= NEAR_M and step.turn <= NEAR_TURN and not self._held:  # as usual: no jump
            return self._pass_on(pose, step)
        furthest, periods = self._furthest(), max(elapsed_ns / max(period_ns, 1), 1.0)
        is_jump = step.distance_m > periods * furthest.distance_m or step.turn > periods * furthest.turn
        if not self._held:
            if not is_jump:
                return self._pass_on(pose, step)
            self._shift_m, self._turn, self._in_a_row = np.zeros(3), _UNTURNED, 0
            is_motion = _apart_m(previous, pose) <= max(NEAR_M, FAR_M_PER_S2 * (1e-9 * elapsed_ns) ** 2)
            self._until_ns = previous.stamp_ns + (SHORT_NS if is_motion else LONGEST_NS)
        if is_jump:
            self._add_jump(previous, pose)
            if self._has_returned(pose, furthest):
                return self._come_back(pose)
        is_motion = self._continues_jump(pose, furthest)
        self._in_a_row = self._in_a_row + 1 if is_jump else 0
        self._held.append(pose)
        is_motion |= pose.stamp_ns > self._until_ns or self._in_a_row == MOST_JUMPS
        return self.finish() if is_motion else ()

    @property
    def held_since_ns(self) -> int | None:
        """Stamp of the first pose that is held; None if there is none."""
        return self._held[0].stamp_ns if self._held else None

    def _come_back(self, pose: Pose) -> Sequence[Pose]:
        """Pass on the pose that continues the motion, and the held ones only if they are of another body."""
        self._note_visit()
        if len(self._visits) == VISITS and self._poses - self._visits[0] < VISITS_WITHIN:
            self._held.append(pose)
            return self.finish()
        self._counts["excursion"] += len(self._held)
        assert self._last is not None
        if pose.stamp_ns - self._last.stamp_ns > SHORT_NS:
            self._counts["long_excursion"] += 1
        self._held = []
        self._last = pose
        return (pose,)

    def _note_visit(self) -> None:
        """Count the excursion, if it leads to the place of the one before. Turns in place are no other body:
        such flips are frequent errors of vision."""
        assert self._last is not None
        if step_between(self._last, self._held[0]).distance_m <= NEAR_M:
            self._visits.clear()
            return
        same_m, previous = SAME_PLACE * _apart_m(self._last, self._held[0]), self._last_excursion
        if previous is None or _apart_m(previous, self._held[0]) > same_m:
            self._visits.clear()
        self._visits.append(self._poses)
        self._last_excursion = self._held[-1]

    def finish(self) -> Sequence[Pose]:
        """The poses still held: they have not come back."""
        released, self._held = self._held, []
        for pose in released:
            assert self._last is not None
            self._pass_on(pose, step_between(self._last, pose))
        return released

    def _pass_on(self, pose: Pose, step: Step) -> Sequence[Pose]:
        self._steps.append(step)
        self._last = pose
        return (pose,)

    def _furthest(self) -> Step:
        """The longest step that is no jump."""
        if len(self._steps) < KNOWN_STEPS:
            return Step(np.inf, np.inf)
        usual, last = reach(self._steps, JUMP, USUAL_QUANTILE), self._steps[-1]
        return Step(max(usual.distance_m, JUMP * last.distance_m), max(usual.turn, JUMP * last.turn))

    def _add_jump(self, before: Pose, pose: Pose) -> None:
        self._shift_m = self._shift_m + np.subtract(pose.position_m, before.position_m)
        turn = between(np.array([before.quat_xyzw]), np.array([pose.quat_xyzw]))[0]
        self._turn = product(self._turn, turn)

    def _has_returned(self, pose: Pose, furthest: Step) -> bool:
        """Whether the jumps so far add up to no more than a step, or usual motion leads to this pose from the
        last one, to which it is nearer than to the pose before it."""
        if not self._held or self._last is None:
            return False
        turn = 2.0 * float(np.linalg.norm(self._turn[:3]))
        if float(np.linalg.norm(self._shift_m)) <= furthest.distance_m and turn <= furthest.turn:
            return True
        steps, step = (1 + len(self._held)) / JUMP, step_between(self._last, pose)
        is_usual = step.distance_m <= steps * furthest.distance_m and step.turn <= steps * furthest.turn
        return is_usual and _apart_m(self._last, pose) < _apart_m(self._held[-1], pose)

    def _continues_jump(self, pose: Pose, furthest: Step) -> bool:
        """Whether the step to this pose continues the jump to the only held one, so that it was motion."""
        if len(self._held) != 1 or self._last is None:
            return False
        first, second = _displacement(self._last, self._held[0]), _displacement(self._held[0], pose)
        length, following = np.linalg.norm(first, axis=1), np.linalg.norm(second, axis=1)
        is_forward = (first * second).sum(axis=1) > 0.0
        return bool((is_forward & (JUMP * following >= length))[length > furthest].all())


def _displacement(a: Pose, b: Pose) -> Array:
    """(2, 3) the path from ``a`` to ``b``, and the turn as a rotation vector."""
    turn = rotation_vectors(between(np.array(a.quat_xyzw), np.array(b.quat_xyzw)))
    return np.array([np.subtract(b.position_m, a.position_m), turn])


def _apart_m(a: Pose, b: Pose) -> float:
    step = step_between(a, b)
    return hypot(step.distance_m, ARM_M * step.turn)


STEPS: Final = 10.0
"""A pose is away from the motion if it is farther than this many usual steps, and not near."""
QUANTILE: Final = 0.95
NEIGHBOURS: Final = 5
MOST_HELD: Final = 2000
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
        """The poses to pass on now: this one, none, or several that were held.

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
        return self.finish() if len(self._held) == MOST_HELD else ()

    @property
    def held_since_ns(self) -> int | None:
        """Stamp of the first pose that is held; None if there is none."""
        return self._held[0][0].stamp_ns if self._held else None

    def finish(self) -> Sequence[Pose]:
        """The poses still held: no later motion has shown that they are default poses."""
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
            if (step.distance_m > NEAR_M or step.turn > NEAR_TURN) and self._is_default(pose):
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
        is_repeated = pose[1:] in self._arrivals
        self._arrivals.pop(pose[1:], None)
        self._arrivals[pose[1:]] = None  # as the latest
        if len(self._arrivals) > _ARRIVALS_KEPT:
            del self._arrivals[next(iter(self._arrivals))]
        return is_repeated or _is_origin(pose, is_away, in_position)

    def _is_suspect(self, pose: Pose) -> bool:
        """Whether a pose may be a default pose, while the motion is not known yet."""
        if pose.position_m != _ORIGIN:
            return False
        previous = self._held[-1][0] if self._held else self._kept[-1] if self._kept else pose
        turns_there = previous.position_m == _ORIGIN and previous.quat_xyzw != pose.quat_xyzw
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
    between = [step_between(near, pose) for near in motion]
    return (
        all(step.distance_m > reach_m or step.turn > reach_turn for step in between),
        all(step.distance_m > reach_m for step in between),
    )


def _is_origin(pose: Pose, is_away: bool, in_position: bool) -> bool:
    """Whether a pose is the origin, away from the motion; an object that only turns is always there."""
    return pose.position_m == _ORIGIN and (in_position or (is_away and _is_unturned(pose)))


def _is_unturned(pose: Pose) -> bool:
    return pose.quat_xyzw[:3] == _ORIGIN
