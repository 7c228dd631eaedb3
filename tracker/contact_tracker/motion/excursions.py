"""Filter of excursions: poses that jump away from the motion and back, for example by swapped markers.

A jump is a step much longer than usual. The poses after it are held. If the jumps since add up to no more
than a step, the held poses were wrong and are dropped. If that has not happened for half a second, or the
steps stay long, the object has moved, and all are passed on.

If they jump to one place and back all the time, two bodies take turns: all are passed on as well, for
``inspection`` to see.
"""

from collections import Counter, deque
from collections.abc import Sequence
from math import hypot
from typing import Final

import numpy as np

from contact_tracker.geometry.rotation import between, product
from contact_tracker.motion.pose_steps import NEAR_M, STEPS_KEPT, Step, Steps, reach, step_between
from contact_tracker.motion.poses import Array, Pose

JUMP: Final = 3.0
"""A jump is longer than this many usual steps."""
USUAL_QUANTILE: Final = 0.9
KNOWN_STEPS: Final = 10
"""Fewer steps do not show yet what is usual."""
LONGEST_NS: Final = 500_000_000
MOST_JUMPS: Final = 3
"""This many jumps in a row are motion, unless they lead back."""
VISITS: Final = 10
VISITS_WITHIN: Final = 40
"""Excursions to one place are those of another body if there are ``VISITS`` within so many poses."""
SAME_PLACE: Final = 0.25
"""Largest movement of that place between two excursions, relative to the jump."""
ARM_M: Final = 0.1
"""Lever arm with which turns count as distances."""
_UNTURNED: Final = np.array([0.0, 0.0, 0.0, 1.0])


class ExcursionFilter:
    """Drops excursions from a stream of poses whose quaternions have norm 1.

    Parameters
    ----------
    counts : dropped poses are counted here as ``excursion``.
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._last: Pose | None = None
        self._steps: deque[Step] = deque(maxlen=STEPS_KEPT)
        self._held: list[Pose] = []
        self._shift_m: Array = np.zeros(3)
        self._turn: Array = _UNTURNED
        self._in_a_row = 0
        self._poses = 0
        self._visits: deque[int] = deque(maxlen=VISITS)
        self._last_excursion: Pose | None = None

    def admit(self, pose: Pose, continues: bool) -> Sequence[Pose]:
        """The poses to go on with now: this one, none, or several that were held.

        Parameters
        ----------
        continues : whether it follows closely on the pose before.
        """
        self._poses += 1
        if not continues:
            released = self.finish()
            self._steps.clear()
            self._last = pose
            return (*released, pose)
        before = self._held[-1] if self._held else self._last
        if before is None:
            self._last = pose
            return (pose,)
        step = step_between(before, pose)
        if step.is_near and not self._held:  # the usual case; no jump, whatever is usual
            return self._pass_on(pose, step)
        furthest = self._furthest()
        is_jump = step.distance_m > furthest.distance_m or step.turn > furthest.turn
        if not self._held:
            if not is_jump:
                return self._pass_on(pose, step)
            self._shift_m, self._turn, self._in_a_row = np.zeros(3), _UNTURNED, 0
        if is_jump:
            self._add_jump(before, pose)
            if self._has_returned(furthest):
                return self._come_back(pose)
        self._in_a_row = self._in_a_row + 1 if is_jump else 0
        self._held.append(pose)
        assert self._last is not None
        too_long = pose.stamp_ns - self._last.stamp_ns > LONGEST_NS
        return self.finish() if too_long or self._in_a_row == MOST_JUMPS else ()

    def _come_back(self, pose: Pose) -> Sequence[Pose]:
        """The pose with which the motion goes on, and the held ones only where they are of another body."""
        self._note_visit()
        if len(self._visits) == VISITS and self._poses - self._visits[0] < VISITS_WITHIN:
            self._held.append(pose)
            return self.finish()
        self._counts["excursion"] += len(self._held)
        self._held = []
        self._last = pose
        return (pose,)

    def _note_visit(self) -> None:
        """Count the excursion, if it is to where the one before was. Turns in place are no other body: such
        flips are frequent errors of vision."""
        assert self._last is not None
        if step_between(self._last, self._held[0]).distance_m <= NEAR_M:
            self._visits.clear()
            return
        same_m, before = SAME_PLACE * _apart_m(self._last, self._held[0]), self._last_excursion
        if before is None or _apart_m(before, self._held[0]) > same_m:
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

    def passes_all(self, steps: Steps) -> bool:
        """Whether poses that continue from the last one by these steps pass without further checks."""
        return not self._held and self._last is not None and steps.are_near

    def pass_all(self, last: Pose, steps: Steps) -> None:
        """Pass on poses that need no further checks, up to ``last``."""
        newest = slice(-STEPS_KEPT, None)
        self._poses += len(steps.distance_m)
        self._steps.extend(map(Step, steps.distance_m[newest].tolist(), steps.turn[newest].tolist()))
        self._last = last

    def _pass_on(self, pose: Pose, step: Step) -> Sequence[Pose]:
        self._steps.append(step)
        self._last = pose
        return (pose,)

    def _furthest(self) -> Step:
        """The longest step that is no jump."""
        if len(self._steps) < KNOWN_STEPS:
            return Step(np.inf, np.inf)
        return reach(self._steps, JUMP, USUAL_QUANTILE)

    def _add_jump(self, before: Pose, pose: Pose) -> None:
        self._shift_m = self._shift_m + np.subtract(pose.position_m, before.position_m)
        turn = between(np.array([before.quat_xyzw]), np.array([pose.quat_xyzw]))[0]
        self._turn = product(self._turn, turn)

    def _has_returned(self, furthest: Step) -> bool:
        """Whether the jumps so far add up to no more than a step."""
        if not self._held:
            return False
        turn = 2.0 * float(np.linalg.norm(self._turn[:3]))
        return float(np.linalg.norm(self._shift_m)) <= furthest.distance_m and turn <= furthest.turn


def _apart_m(a: Pose, b: Pose) -> float:
    step = step_between(a, b)
    return hypot(step.distance_m, ARM_M * step.turn)
