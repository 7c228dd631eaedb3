"""Filter of jumps: drops poses away from the motion, where the object is hidden or its markers are swapped.

A jump is a step much longer than usual, for the time since the last new pose. The poses after it, an
excursion, are held. If the next step goes on in the same way, as in an impact, or if the poses are not back
after half a second, the object has moved, and all are passed on; after two seconds, if no hand could
accelerate an object so. If they jump back, the held ones were wrong and are dropped. They are back if the two
jumps cancel, as with swapped markers, or if usual motion leads there from the last pose, as with another body
in the place of this one.

The origin, and any pose that comes by a jump again, bit for bit, are what trackers report of an object that
they do not see: they are dropped at once. Where a stream starts at the origin, also after a gap, it waits
until the motion is known.

If poses jump to one place and back all the time, two bodies take turns: all are passed on, and ``inspection``
reports it.
"""

from collections import Counter, deque
from collections.abc import Collection, Sequence
from itertools import pairwise
from math import hypot, inf
from typing import Final

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.geometry.linalg import between, product
from contact_tracker.motion.poses import (
    ARM_M,
    NEAR_M,
    NEAR_TURN,
    STEPS_KEPT,
    Pose,
    Step,
    reach,
    step_between,
)

JUMP: Final = 3.0
"""A jump is longer than this many usual steps."""
USUAL_QUANTILE: Final = 0.9
KNOWN_POSES: Final = 10
"""Least number of poses that determine the usual step. With 5 and 20, 355 and 361 poses of 5,221 that were
shifted, alone or in bursts, pass instead of 359."""
SHORT_NS: Final = 500_000_000
LONGEST_NS: Final = 2_000_000_000
"""Longest excursion if its first step is no motion. Markers are hidden for up to 1.6 s at a time."""
FAR_M_PER_S2: Final = 50.0
"""Acceleration that no hand gives an object."""
VISIT_PERIODS: Final = 4
"""``KNOWN_POSES`` excursions in a row to one place, at most so many periods apart, are those of another body.
Half and double drop the same poses of 231 streams with faults; with half, one in three poses is dropped."""
MOST_WAITING: Final = 2000
"""Largest number of poses that are held, and of those that wait for motion away from the origin. With 1,000,
2,476 of 20,962 poses of another body pass instead of 1,038, as at 1 kHz these are less than ``LONGEST_NS``;
with 4,000 as many."""
_ORIGIN: Final = (0.0, 0.0, 0.0)

Numbers = tuple[tuple[float, float, float], tuple[float, float, float, float]]


def longest_of(steps: Collection[Step]) -> Step:
    """The longest step that is no jump, given usual ones."""
    return reach(steps, JUMP, USUAL_QUANTILE)


def is_longer(step: Step, longest: Step, times: float = 1.0) -> bool:
    """Whether a step is longer than ``times`` the longest one, in position or turn."""
    return step.distance_m > times * longest.distance_m or step.turn > times * longest.turn


class JumpFilter:
    """Drops default poses and excursions from a stream of poses whose quaternions have norm 1.

    Parameters
    ----------
    counts : dropped poses are counted here as ``default_pose`` or ``excursion``, and those excursions of more
        than half a second as ``long_excursion``.
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._last: Pose | None = None
        self._newest: Pose | None = None  # passed on or held, and not a repetition
        self._steps: deque[Step] = deque(maxlen=STEPS_KEPT)
        self._waiting: list[Pose] = []
        self._held: list[Pose] = []
        self._until_ns = 0
        self._arrivals: deque[Numbers] = deque(maxlen=STEPS_KEPT)
        self._visited: Pose | None = None
        self._visits = 0

    @property
    def held_since_ns(self) -> int | None:
        """Stamp of the first pose that is held; None if there is none."""
        held = self._waiting or self._held
        return held[0].stamp_ns if held else None

    def admit(self, pose: Pose, continues: bool, period_ns: int) -> Sequence[Pose]:
        """The poses to pass on now: this one, none, or several that were held.

        Parameters
        ----------
        continues : whether it follows closely on the pose before.
        period_ns : the usual time between poses.
        """
        released: Sequence[Pose] = ()
        if not continues and not self._waiting:  # those that wait do so on either side of a gap
            released, self._last = self.finish(), None
            self._steps.clear()
        if self._waiting or (pose.position_m == _ORIGIN and self._last is None):
            return (*released, *self._wait(pose))
        return (*released, *self._judge(pose, period_ns))

    def finish(self) -> Sequence[Pose]:
        """The poses still held: nothing has shown that they are wrong."""
        released = (*self._waiting, *self._held)
        self._waiting, self._held = [], []
        for pose in released:
            self._pass_on(pose)
        return released

    def _pass_on(self, pose: Pose, step: Step | None = None) -> Sequence[Pose]:
        if self._last is not None and pose[1:] != self._last[1:]:
            self._steps.append(step or step_between(self._last, pose))
        self._last = pose
        self._note(pose)
        return (pose,)

    def _note(self, pose: Pose) -> None:
        if self._newest is None or pose[1:] != self._newest[1:]:
            self._newest = pose

    def _wait(self, pose: Pose) -> Sequence[Pose]:
        """Hold poses from the first at the origin on, until motion shows whether the object was there."""
        self._waiting.append(pose)
        if len(self._waiting) == MOST_WAITING:
            return self.finish()
        motion = [] if pose.position_m == _ORIGIN else [p for p in self._waiting if p.position_m != _ORIGIN]
        if len(motion) < KNOWN_POSES:
            return ()
        longest = longest_of([step_between(a, b) for a, b in pairwise(motion)])
        if all(hypot(*there.position_m) > longest.distance_m for there in motion):
            self._counts["default_pose"] += len(self._waiting) - len(motion)
            self._waiting = motion
        return self.finish()

    def _judge(self, pose: Pose, period_ns: int) -> Sequence[Pose]:
        """Pass on, drop or hold a pose by the step to it."""
        last, newest = self._last, self._newest
        if last is None or newest is None:
            return self._pass_on(pose)
        step = step_between(newest, pose)
        if step.distance_m <= NEAR_M and step.turn <= NEAR_TURN and not self._held:  # as usual: no jump
            return self._pass_on(pose, step)
        longest = self._longest()
        if self._is_default(pose, step, longest):
            self._arrivals.append(pose[1:])
            self._counts["default_pose"] += 1
            return ()
        elapsed_ns = pose.stamp_ns - newest.stamp_ns
        is_jump = is_longer(step, longest, max(elapsed_ns / max(period_ns, 1), 1.0))
        if not self._held:
            if not is_jump:
                return self._pass_on(pose, step)
            self._arrivals.append(pose[1:])
            is_motion = _apart_m(last, pose) <= max(NEAR_M, FAR_M_PER_S2 * (1e-9 * elapsed_ns) ** 2)
            self._until_ns = last.stamp_ns + (SHORT_NS if is_motion else LONGEST_NS)
        elif self._has_returned(last, pose, longest, is_jump):
            return self._come_back(last, pose, longest, period_ns)
        self._held.append(pose)
        self._note(pose)
        is_motion = len(self._held) == 2 and _goes_on(last, newest, pose, longest)
        is_motion |= pose.stamp_ns > self._until_ns or len(self._held) == MOST_WAITING
        return self.finish() if is_motion else ()

    def _longest(self) -> Step:
        """The longest step that is no jump."""
        if len(self._steps) < KNOWN_POSES:
            return Step(inf, inf)
        usual, last = longest_of(self._steps), self._steps[-1]
        return Step(max(usual.distance_m, JUMP * last.distance_m), max(usual.turn, JUMP * last.turn))

    def _is_default(self, pose: Pose, step: Step, longest: Step) -> bool:
        """Whether a pose is a default pose away from the motion; an object may turn at the origin."""
        if pose.position_m == _ORIGIN:
            return step.distance_m > longest_of(self._steps).distance_m
        return pose[1:] in self._arrivals and is_longer(step, longest)

    def _has_returned(self, last: Pose, pose: Pose, longest: Step, is_jump: bool) -> bool:
        """Whether the jumps away and back cancel, or usual motion leads to this pose from the last one, to
        which it is nearer than to the pose before it, relative to the jump."""
        first, before = self._held[0], self._held[-1]
        if is_jump:
            shift_m = np.add(_shift_m(last, first), _shift_m(before, pose))
            turn = 2.0 * np.linalg.norm(product(_turn(last, first), _turn(before, pose))[:3])
            if not is_longer(Step(float(np.linalg.norm(shift_m)), float(turn)), longest):
                return True
        jump, step, back = step_between(last, first), step_between(last, pose), step_between(before, pose)
        parts = zip(step, back, jump, longest, strict=True)
        is_nearer = sum((a**2 - b**2) / away**2 for a, b, away, most in parts if away > most) < 0.0
        return is_nearer and not is_longer(step, longest, (1 + len(self._held)) / JUMP)

    def _come_back(self, last: Pose, pose: Pose, longest: Step, period_ns: int) -> Sequence[Pose]:
        """Pass on the pose that continues the motion, and the held ones only if they are of another body.
        Turns in place are not: such flips are frequent errors of vision."""
        first, visited, self._visited = self._held[0], self._visited, self._held[-1]
        is_again = (
            visited is not None
            and first.stamp_ns - visited.stamp_ns <= VISIT_PERIODS * period_ns
            and step_between(last, first).distance_m > NEAR_M
            and not is_longer(step_between(visited, first), longest)
        )
        self._visits = self._visits + 1 if is_again else 1
        if self._visits >= KNOWN_POSES:
            self._held.append(pose)
            return self.finish()
        self._counts["excursion"] += len(self._held)
        if pose.stamp_ns - last.stamp_ns > SHORT_NS:
            self._counts["long_excursion"] += 1
        self._held, self._last = [], pose  # this step is not usual
        self._note(pose)
        return (pose,)


def _goes_on(last: Pose, jumped: Pose, pose: Pose, longest: Step) -> bool:
    """Whether the step after a jump leads on, in position or turn as the jump itself."""
    jump, both = step_between(last, jumped), step_between(last, pose)
    return all(b >= (1 + 1 / JUMP) * a for a, b, most in zip(jump, both, longest, strict=True) if a > most)


def _shift_m(a: Pose, b: Pose) -> Array:
    return np.subtract(b.position_m, a.position_m)


def _turn(a: Pose, b: Pose) -> Array:
    return between(np.array(a.quat_xyzw), np.array(b.quat_xyzw))


def _apart_m(a: Pose, b: Pose) -> float:
    step = step_between(a, b)
    return hypot(step.distance_m, ARM_M * step.turn)
