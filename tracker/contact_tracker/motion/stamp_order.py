"""The order of stamps: repeated, leading and backward stamps, gaps, and resets of the clock.

A pose at the stamp of the last one is a repetition, unless it is farther from it than the motion allows: then
it is of another body, and is passed on to ``inspection``.

A stamp far ahead of the last one is wrong, or follows a gap. The pose is held until others have followed.
Among the held poses the longest run with increasing stamps is accepted, and of two equally long ones the one
that ends sooner. So one wrong stamp loses only its own pose.
"""

from bisect import bisect_left, insort
from collections import Counter, deque
from collections.abc import Sequence
from itertools import pairwise
from statistics import median
from typing import Final, NamedTuple

from contact_tracker.config.quantities import RANGE_NS
from contact_tracker.motion.poses import Pose, Step, step_between

LONGEST_WAIT_NS: Final = 100_000_000
"""Held poses delay what is said of their time by this much at most."""
GAP_NS: Final = 500_000_000
GAP_PERIODS: Final = 10
LEAD_PERIODS: Final = 5
LEAD_PER_FOLLOWER_NS: Final = 100_000_000
FOLLOWERS: Final = 20
SLOW_RUN_NS: Final = LONGEST_WAIT_NS
SLOW_FOLLOWERS: Final = 2
HELD: Final = 64
"""Most poses that are held; random stamps never form a long run."""
RESET_RUN: Final = 20
PERIODS_KEPT: Final = 25
AWAY_STEPS: Final = 4.0
"""A pose at the same stamp is away if it is farther than this many usual steps between stamps, and than
calibration and noise explain."""
AWAY_M: Final = 0.002
AWAY_TURN: Final = 0.01
LATEST: Final = 6
FEWEST: Final = 3
"""Least number of poses with distinct stamps for the usual step, the median between the latest."""
OTHER_NS: Final = 1
"""Delay with which a pose of another body is passed on, so that stamps increase."""


class Ordered(NamedTuple):
    """A pose with a stamp after all before it; ``continues`` is False at the start, after a gap and a
    reset."""

    pose: Pose
    continues: bool


class StampOrder:
    """Passes on poses with increasing stamps.

    Parameters
    ----------
    counts : dropped poses and events are counted here by kind.

    Attributes
    ----------
    last_ns : stamp of the last pose in order; None before the first.
    period_ns : the usual time between poses, the median of the latest; zero while it is unknown.
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self.last_ns: int | None = None
        self.period_ns = 0
        self._offset_ns = 0
        self._backward: tuple[int, int, int] | None = None
        self._held: list[Pose] = []
        self._latest: deque[Pose] = deque(maxlen=LATEST)
        self._follows_other = False
        self._periods: deque[int] = deque(maxlen=PERIODS_KEPT)
        self._in_order: list[int] = []

    @property
    def shift_ns(self) -> int:
        """What is added to stamps since the last reset of the clock."""
        return self._offset_ns

    def admit(self, pose: Pose) -> Sequence[Ordered]:
        """The poses to go on with now: this one, none, or several that were held."""
        stamp_ns = pose.stamp_ns + self._offset_ns
        if abs(pose.stamp_ns) > RANGE_NS or abs(stamp_ns) > RANGE_NS:
            self._counts["out_of_range"] += 1
            return ()
        if self._offset_ns:
            pose = pose._replace(stamp_ns=stamp_ns)
        if self.last_ns is not None:
            step_ns = stamp_ns - self.last_ns
            if step_ns == 0 or (self._follows_other and step_ns == -OTHER_NS):
                return self._consider_other(pose)
            if step_ns < 0:
                return self._consider_reset(pose)
            if not self._held and step_ns <= LEAD_PERIODS * self.period_ns:
                return (self._accept(pose),)
        self._held.append(pose)
        return self._release(ended=False)

    def finish(self) -> Sequence[Ordered]:
        """The held poses that others have followed, or all if there are no others, at the end of the
        stream."""
        return self._release(ended=True)

    def _release(self, ended: bool) -> Sequence[Ordered]:
        """Pass on the held poses that have been confirmed, and drop those that contradict them."""
        released = list[Ordered]()
        while self._held:
            stamps_ns = [pose.stamp_ns for pose in self._held]
            run = longest_run(stamps_ns, self.last_ns)
            if len(self._held) < HELD and not self._is_confirmed([stamps_ns[i] for i in run]):
                if not ended:
                    break
                # one stamp contradicts all before it; at the start there is nothing to contradict
                if len(run) == 1 and self.last_ns is not None and self._periods:
                    self._counts["leading_stamp"] += len(self._held)
                    self._held = []
                    break
            first = run[0]
            accepted_ns = stamps_ns[first]
            released.append(self._accept(self._held[first]))
            # poses before it that are not in the run lead it
            if first:
                self._counts["leading_stamp"] += first
            self._held = self._held[first + 1 :]
            for pose in self._held:
                if pose.stamp_ns == accepted_ns:
                    self._counts["repeated_stamp"] += 1
                elif pose.stamp_ns < accepted_ns:
                    self._counts["backward_stamp"] += 1
            self._held = [pose for pose in self._held if pose.stamp_ns > accepted_ns]
        return released

    def _is_confirmed(self, run_ns: Sequence[int]) -> bool:
        """Whether enough stamps have followed the first of a run for it to be right."""
        followers = len(run_ns) - 1
        if self.last_ns is None:
            return followers > 0
        lead_ns = run_ns[0] - self.last_ns
        if lead_ns <= LEAD_PERIODS * self.period_ns:
            return True
        slow = followers >= SLOW_FOLLOWERS and run_ns[-1] - run_ns[0] >= SLOW_RUN_NS
        return slow or followers >= min(1 + lead_ns // LEAD_PER_FOLLOWER_NS, FOLLOWERS)

    def _consider_other(self, pose: Pose) -> Sequence[Ordered]:
        """Drop a pose at the stamp of the last one, unless it is of another body: then one is enough."""
        assert self.last_ns is not None
        if self._held or self._follows_other or not self._is_away(pose):
            self._counts["repeated_stamp"] += 1
            return ()
        self._counts["simultaneous"] += 1
        self.last_ns, self._follows_other = self.last_ns + OTHER_NS, True
        return (Ordered(pose._replace(stamp_ns=self.last_ns), True),)

    def _is_away(self, pose: Pose) -> bool:
        """Whether this pose is farther from the last one than calibration, noise and usual steps explain."""
        if len(self._latest) < FEWEST:
            return False
        steps = [step_between(a, b) for a, b in pairwise(self._latest)]
        usual = Step(median(step.distance_m for step in steps), median(step.turn for step in steps))
        step = step_between(self._latest[-1], pose)
        return step.distance_m > max(AWAY_M, AWAY_STEPS * usual.distance_m) or step.turn > max(
            AWAY_TURN, AWAY_STEPS * usual.turn
        )

    def _consider_reset(self, pose: Pose) -> Sequence[Ordered]:
        """Drop a pose with an earlier stamp, or detect a reset of the clock by ``RESET_RUN`` in order."""
        stamp_ns = pose.stamp_ns
        first_ns, last_ns, length = self._backward or (stamp_ns, stamp_ns - 1, 0)
        if stamp_ns <= last_ns:
            first_ns, length = stamp_ns, 0
        if length < RESET_RUN:
            self._backward = (first_ns, stamp_ns, length + 1)
            self._counts["backward_stamp"] += 1
            return ()
        released = self.finish()
        assert self.last_ns is not None
        shift_ns = self.last_ns + max(self.period_ns, 1) - first_ns
        self._offset_ns += shift_ns
        self._counts["clock_reset"] += 1
        return (
            *released,
            self._accept(pose._replace(stamp_ns=stamp_ns + shift_ns))._replace(continues=False),
        )

    def _accept(self, pose: Pose) -> Ordered:
        continues = self.last_ns is not None
        if self.last_ns is not None:
            step_ns = pose.stamp_ns - self.last_ns
            if step_ns > GAP_NS and self._periods and step_ns > GAP_PERIODS * self.period_ns:
                self._counts["gap"] += 1
                continues = False
            else:
                if len(self._periods) == PERIODS_KEPT:
                    del self._in_order[bisect_left(self._in_order, self._periods[0])]
                self._periods.append(step_ns)
                insort(self._in_order, step_ns)
                self.period_ns = self._in_order[len(self._in_order) // 2]
        self._backward = None
        self._latest.append(pose)
        self.last_ns, self._follows_other = pose.stamp_ns, False
        return Ordered(pose, continues)


def longest_run(stamps: Sequence[int], after: int | None) -> list[int]:
    """Indices of the longest run of increasing stamps; of equally long ones the shortest in time.

    Parameters
    ----------
    after : the stamp that a run has to follow; None if there is none.
    """
    if all(a < b for a, b in pairwise(stamps)):
        return list(range(len(stamps)))
    runs = list[tuple[int, int, int]]()  # best run ending with each: length, first stamp, predecessor
    for i, stamp in enumerate(stamps):
        before = [j for j in range(i) if stamps[j] < stamp]
        j = max(before, key=lambda j: runs[j][:2], default=-1)
        runs.append((runs[j][0] + 1, runs[j][1], j) if before else (1, stamp, -1))
    last = max(
        range(len(stamps)),
        key=lambda i: (runs[i][0], (runs[i][1] if after is None else after) - stamps[i]),
    )
    indices = [last]
    while (last := runs[last][2]) >= 0:
        indices.append(last)
    return indices[::-1]
