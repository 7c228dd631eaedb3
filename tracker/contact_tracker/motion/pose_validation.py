"""Validation of poses: all poses pass this gate, in order of time, before anything is computed from them.

Every pose that is dropped or repaired is counted by kind:

=================== ======= ===================================================================
kind                fate    meaning
=================== ======= ===================================================================
``nonfinite``       dropped a NaN or an infinity in the position or the quaternion
``out_of_range``    dropped farther than 1000 km from the origin: its squares drown all others; or a stamp
                            more than 146 years from zero: no column holds much larger ones
``bad_quaternion``  dropped norm more than 5 % away from 1
``renormalised``    kept    norm 0.1 % to 5 % away from 1; smaller deviations are rounding
``repeated_stamp``  dropped the stamp of the last pose again
``simultaneous``    kept    another pose at the stamp of the last one, away from it: of another body. It gets
                            a stamp 1 ns later
``backward_stamp``  dropped a stamp before that of the last pose
``leading_stamp``   dropped a stamp more than 5 median periods after that of the last pose, which those that
                            follow contradict. Such a pose is held until enough follow it: one, and one
                            more for each 0.1 s it leads; or two, and 0.1 s
``clock_reset``     kept    20 backward stamps in a row that run forward among themselves: the
                            clock was set back. From here on stamps are shifted so that time
                            goes on where it stood when the first of those 20 came
``gap``             kept    longer than 0.5 s and than 10 median periods since the last pose
``default_pose``    dropped what trackers report of an object that they do not see, away from the motion: the
                            origin, or any other pose that comes back, bit for bit
``excursion``       dropped poses that jump away from the motion, and back within two seconds, unless they
                            do so again and again: those are of another body
``long_excursion``  -       an excursion of more than half a second
``held``            kept    the last pose once more, bit for bit, with a new stamp
=================== ======= ===================================================================

``q`` and ``-q`` are the same rotation: the one nearer to the last pose is passed on. Quaternions in another
order than that of their fields (wxyz in xyzw, or xyzw in wxyz) are not detected here: reordering the
components keeps all scalar products, hence all angles between poses.
"""

from collections import Counter, deque
from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import isfinite, sqrt
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.config.quantities import RANGE_NS
from contact_tracker.errors import InvalidPose
from contact_tracker.motion.excursions import JUMP, KNOWN_POSES, JumpFilter, is_longer
from contact_tracker.motion.poses import STEPS_KEPT, Pose, Poses, reach, step_between

ROUNDING: Final = 1e-3
NORM_TOLERANCE: Final = 0.05
RANGE_M: Final = 1e6
LONGEST_WAIT_NS: Final = 100_000_000
"""Longest time for which held poses delay the ticks."""
GAP_NS: Final = 500_000_000
GAP_PERIODS: Final = 10
LEAD_PERIODS: Final = 5
MOST_HELD: Final = 64
"""Largest number of poses held for their stamps; random stamps never form a long run."""
RESET_RUN: Final = 20
OTHER_NS: Final = 1
"""Delay with which a pose of another body is passed on, so that stamps increase."""
_ADVICE: Final = "take PoseGate, or gate, of contact_tracker.motion.pose_validation first"


class Ordered(NamedTuple):
    """A pose with a stamp after all before it; ``continues`` is False at the start, after a gap and a
    reset."""

    pose: Pose
    continues: bool


class StampOrder:
    """Passes on poses with increasing stamps.

    A pose at the stamp of the last one is a repetition, unless it is farther from it than the motion allows:
    then it is of another body, and is passed on to ``inspection``. A stamp far ahead is wrong,
    or follows a gap: its pose is held until others have followed. Among the held poses the longest run with
    increasing stamps is accepted, and of two equally long ones the one that ends sooner. So one wrong stamp
    loses only its own pose.

    Parameters
    ----------
    counts : dropped poses and events are counted here by kind.

    Attributes
    ----------
    last_ns : stamp of the last pose in order; None before the first.
    period_ns : the usual time between poses, the median of the latest; zero while it is unknown.
    shift_ns : shift that is added to stamps since the last reset of the clock.
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self.last_ns: int | None = None
        self.period_ns = 0
        self.shift_ns = 0
        self._periods: deque[int] = deque(maxlen=STEPS_KEPT)
        self._latest: deque[Pose] = deque(maxlen=KNOWN_POSES)
        self._held: list[Pose] = []
        self._backward: list[int] = []
        self._follows_other = False

    def admit(self, pose: Pose) -> Sequence[Ordered]:
        """The poses to pass on now: this one, none, or several that were held."""
        stamp_ns = pose.stamp_ns + self.shift_ns
        if abs(pose.stamp_ns) > RANGE_NS or abs(stamp_ns) > RANGE_NS:
            self._counts["out_of_range"] += 1
            return ()
        if self.shift_ns:
            pose = pose._replace(stamp_ns=stamp_ns)
        if self.last_ns is not None:
            step_ns = stamp_ns - self.last_ns
            if step_ns == 0 or (self._follows_other and step_ns == -OTHER_NS):
                return self._consider_other(pose, self.last_ns)
            if step_ns < 0:
                return self._consider_reset(stamp_ns, pose)
            if not self._held and step_ns <= LEAD_PERIODS * self.period_ns:
                return (self._accept(pose),)
        self._held.append(pose)
        return self._release(ended=False)

    def finish(self) -> Sequence[Ordered]:
        """At the end of the stream, the held poses that later ones have confirmed; all if there are none."""
        return self._release(ended=True)

    def _release(self, ended: bool) -> Sequence[Ordered]:
        """Pass on the held poses that have been confirmed, and drop those that contradict them."""
        released = list[Ordered]()
        while self._held:
            stamps_ns = [pose.stamp_ns for pose in self._held]
            run = longest_run(stamps_ns, self.last_ns)
            if len(self._held) < MOST_HELD and not self._is_confirmed([stamps_ns[i] for i in run]):
                if not ended:
                    break
                # one stamp contradicts all before it; at the start there is nothing to contradict
                if len(run) == 1 and self.period_ns:
                    self._counts["leading_stamp"] += len(self._held)
                    self._held = []
                    break
            first, accepted_ns = run[0], stamps_ns[run[0]]
            if first:  # poses before it that are not in the run lead it
                self._counts["leading_stamp"] += first
            released.append(self._accept(self._held[first]))
            for stamp_ns in stamps_ns[first + 1 :]:
                if stamp_ns == accepted_ns:
                    self._counts["repeated_stamp"] += 1
                elif stamp_ns < accepted_ns:
                    self._counts["backward_stamp"] += 1
            self._held = [pose for pose in self._held[first + 1 :] if pose.stamp_ns > accepted_ns]
        return released

    def _is_confirmed(self, run_ns: Sequence[int]) -> bool:
        """Whether enough stamps have followed the first of a run for it to be right."""
        followers = len(run_ns) - 1
        if self.last_ns is None:
            return followers > 0
        lead_ns = run_ns[0] - self.last_ns
        if lead_ns <= LEAD_PERIODS * self.period_ns or followers > lead_ns // LONGEST_WAIT_NS:
            return True
        return followers > 1 and run_ns[-1] - run_ns[0] >= LONGEST_WAIT_NS

    def _consider_other(self, pose: Pose, last_ns: int) -> Sequence[Ordered]:
        """Drop a pose at the stamp of the last one, unless it is of another body: then one is enough."""
        steps = [step_between(a, b) for a, b in pairwise(self._latest)]
        # the median, as some of them lead from one body to the other
        is_away = is_longer(step_between(self._latest[-1], pose), reach(steps, JUMP, 0.5))
        if self._held or self._follows_other or not is_away:
            self._counts["repeated_stamp"] += 1
            return ()
        self._counts["simultaneous"] += 1
        self.last_ns, self._follows_other = last_ns + OTHER_NS, True
        return (Ordered(pose._replace(stamp_ns=self.last_ns), True),)

    def _consider_reset(self, stamp_ns: int, pose: Pose) -> Sequence[Ordered]:
        """Drop a pose with an earlier stamp, or detect a reset of the clock by ``RESET_RUN`` in order."""
        if self._backward and stamp_ns <= self._backward[-1]:
            self._backward = []
        self._backward.append(stamp_ns)
        if len(self._backward) <= RESET_RUN:
            self._counts["backward_stamp"] += 1
            return ()
        first_ns, released = self._backward[0], self.finish()
        assert self.last_ns is not None
        shift_ns = self.last_ns + max(self.period_ns, 1) - first_ns
        self.shift_ns += shift_ns
        self._counts["clock_reset"] += 1
        accepted = self._accept(pose._replace(stamp_ns=stamp_ns + shift_ns))
        return (*released, accepted._replace(continues=False))

    def _accept(self, pose: Pose) -> Ordered:
        continues = self.last_ns is not None
        if self.last_ns is not None:
            step_ns = pose.stamp_ns - self.last_ns
            if step_ns > GAP_NS and step_ns > GAP_PERIODS * self.period_ns > 0:
                self._counts["gap"] += 1
                continues = False
            else:
                self._periods.append(step_ns)
                self.period_ns = sorted(self._periods)[len(self._periods) // 2]
        self._backward = []
        self._latest.append(pose)
        self.last_ns, self._follows_other = pose.stamp_ns, False
        return Ordered(pose, continues)


def longest_run(stamps: Sequence[int], after: int | None) -> list[int]:
    """Indices of the longest run of increasing stamps; of equally long ones the one that ends soonest
    ``after`` a stamp, or after its own first."""
    if all(a < b for a, b in pairwise(stamps)):
        return list(range(len(stamps)))
    runs = list[list[int]]()  # the longest one that ends with each
    for i, stamp in enumerate(stamps):
        runs.append([*max((run for run in runs if stamps[run[-1]] < stamp), key=len, default=[]), i])
    return max(runs, key=lambda r: (len(r), (stamps[r[0]] if after is None else after) - stamps[r[-1]]))


class Arrival(NamedTuple):
    """The effect of a measured pose: the ``poses`` to pass on now, possibly none, or poses held until then.

    ``time_ns`` is the latest stamp of the stream, None before the first pose in order. No pose before
    ``next_ns`` is awaited any more: ticks that end by then are complete. It is later than ``time_ns`` by the
    usual period if no pose is held, and otherwise earlier by ``LONGEST_WAIT_NS`` at most.
    """

    poses: Sequence[Pose]
    time_ns: int | None
    next_ns: int | None


class PoseGate:
    """Validates a stream of poses one by one.

    Parameters
    ----------
    counts : dropped and repaired poses are counted here by kind; kinds that do not occur stay absent.

    Attributes
    ----------
    counts : counts by kind so far; callers may add to them.
    refused_xyzw : the first quaternion of a wrong norm.
    """

    def __init__(self, counts: Counter[str] | None = None) -> None:
        self.counts: Counter[str] = Counter() if counts is None else counts
        self._order = StampOrder(self.counts)
        self._jumps = JumpFilter(self.counts)
        self._last: Pose | None = None
        self.refused_xyzw: tuple[float, float, float, float] | None = None

    @property
    def shift_ns(self) -> int:
        """Shift (ns) that is added to stamps since the last reset of the clock."""
        return self._order.shift_ns

    def admit(self, pose: Pose) -> Sequence[Pose]:
        """The poses to pass on now: this one, none, or several that were held until it came.

        Parameters
        ----------
        pose : as measured; any floats, any integer stamp.

        Returns
        -------
        Poses with unit quaternions continuous in sign, and stamps after that of the last one returned.
        """
        quat_xyzw = self._unit_quaternion(pose)
        if quat_xyzw is None:
            return ()
        return self._pass_on(self._order.admit(Pose(pose.stamp_ns, pose.position_m, quat_xyzw)))

    def arrive(self, pose: Pose) -> Arrival:
        """``admit`` online, where time goes on while poses are held or dropped."""
        poses, time_ns = self.admit(pose), self._order.last_ns
        if time_ns is None:
            return Arrival(poses, None, None)
        if poses and poses[-1].stamp_ns == time_ns:
            return Arrival(poses, time_ns, time_ns + self._order.period_ns)
        held_ns = self._jumps.held_since_ns
        next_ns = time_ns if held_ns is None else max(held_ns, time_ns - LONGEST_WAIT_NS)
        return Arrival(poses, time_ns, next_ns)

    def end(self) -> Arrival:
        """``finish`` online."""
        time_ns = self._order.last_ns
        return Arrival(self.finish(), time_ns, time_ns)

    def finish(self) -> Sequence[Pose]:
        """The poses still held, at the end of the stream."""
        passed = self._pass_on(self._order.finish())
        return (*passed, *map(self._continuous, self._jumps.finish()))

    def admit_all(self, poses: Iterable[Pose]) -> Poses:
        """``admit`` for several, in columns."""
        return Poses.collect([kept for pose in poses for kept in self.admit(pose)])

    def _unit_quaternion(self, pose: Pose) -> tuple[float, float, float, float] | None:
        """The unit quaternion of a pose with valid numbers; None otherwise."""
        (px, py, pz), (x, y, z, w) = pose.position_m, pose.quat_xyzw
        # A sum is finite only if its terms are; it may overflow, which is out of range anyway.
        if not isfinite(px + py + pz + x + y + z + w) and not all(map(isfinite, (px, py, pz, x, y, z, w))):
            self.counts["nonfinite"] += 1
            return None
        if max(abs(px), abs(py), abs(pz)) > RANGE_M:
            self.counts["out_of_range"] += 1
            return None
        norm = sqrt(x * x + y * y + z * z + w * w)
        deviation = abs(norm - 1.0)
        if deviation > NORM_TOLERANCE:
            self.counts["bad_quaternion"] += 1
            self.refused_xyzw = self.refused_xyzw or pose.quat_xyzw
            return None
        if deviation > ROUNDING:
            self.counts["renormalised"] += 1
        return (x / norm, y / norm, z / norm, w / norm)

    def _pass_on(self, ordered: Iterable[Ordered]) -> Sequence[Pose]:
        passed = list[Pose]()
        for arrived, continues in ordered:
            kept = self._jumps.admit(arrived, continues, self._order.period_ns)
            passed += map(self._continuous, kept)
        return passed

    def _continuous(self, pose: Pose) -> Pose:
        """The pose with the sign of its quaternion that is nearer to the last."""
        last = self._last
        if last is not None:
            a, b = pose.quat_xyzw, last.quat_xyzw
            if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0.0:
                pose = pose._replace(quat_xyzw=(-a[0], -a[1], -a[2], -a[3]))
            if pose[1:] == last[1:]:
                self.counts["held"] += 1
        self._last = pose
        return pose


def gate(poses: Iterable[Pose], counts: Counter[str] | None = None) -> Poses:
    """The poses of a whole recording that pass the gate; ``counts`` counts those dropped or repaired."""
    passed = PoseGate(counts)
    parts = [passed.admit_all(batch) for batch in (poses.batches() if isinstance(poses, Poses) else [poses])]
    return Poses.join([*parts, Poses.collect(passed.finish())])


def require_valid(poses: Poses, after_ns: int | None) -> None:
    """Refuse columns of poses that did not pass the gate.

    Parameters
    ----------
    after_ns : the stamp of the pose before them, if there is one.

    Raises
    ------
    InvalidPose
        A number that is not finite or out of range, a quaternion that is no unit quaternion, or stamps that
        are no integers or do not increase.
    """
    stamp_ns, count = np.asarray(poses.stamp_ns), len(poses)
    if stamp_ns.dtype.kind not in "iu":
        raise InvalidPose(
            f"stamps are integers in nanoseconds, not {stamp_ns.dtype}: multiply seconds by 1e9"
        )
    if poses.position_m.shape != (count, 3) or poses.quat_xyzw.shape != (count, 4):
        raise InvalidPose("a pose has three coordinates and a quaternion xyzw")
    steps_ns = np.diff(stamp_ns, prepend=stamp_ns[:1] - 1 if after_ns is None else after_ns)
    with np.errstate(all="ignore"):
        norm = np.sqrt(np.square(poses.quat_xyzw).sum(axis=1))
        faults = {
            "a position that is not finite or out of range": ~(np.abs(poses.position_m) <= RANGE_M).all(
                axis=1
            ),
            "a quaternion that is not of length 1": ~(np.abs(norm - 1.0) <= ROUNDING),
            "a stamp that is not after the one before": steps_ns <= 0,
            "a stamp more than 146 years from zero": np.abs(stamp_ns) > RANGE_NS,
        }
    for text, wrong in faults.items():
        if wrong.any():
            first = int(wrong.argmax())
            raise InvalidPose(f"pose {first} of {count} has {text} (stamp {stamp_ns[first]} ns): {_ADVICE}")
