"""The gate: what poses have to pass before anything is computed from them.

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
``backward_stamp``  dropped a stamp before that of the last pose
``clock_reset``     kept    20 backward stamps in a row that run forward among themselves: the
                            clock was set back. From here on stamps are shifted so that time
                            goes on where it stood when the first of those 20 came
``gap``             kept    longer than 0.5 s and than 10 median periods since the last pose
``held``            kept    the last pose once more, bit for bit, with a new stamp
=================== ======= ===================================================================

``q`` and ``-q`` are one rotation: of the two, the one nearer to the last pose is passed on. Quaternions
written as wxyz into an xyzw field cannot be told from motion: reordering the components keeps all
scalar products, hence all angles between poses.
"""

from collections import Counter, deque
from collections.abc import Mapping
from math import isfinite, sqrt
from statistics import median
from types import MappingProxyType
from typing import Final

import numpy as np

from contact_tracker.poses import Pose, Poses

ROUNDING: Final = 1e-3
NORM_TOLERANCE: Final = 0.05
RANGE_M: Final = 1e6
RANGE_NS: Final = 2**62
GAP_NS: Final = 500_000_000
GAP_PERIODS: Final = 10
RESET_RUN: Final = 20
_PERIODS_KEPT: Final = 25


class PoseGate:
    """Validates a stream of poses one by one.

    Parameters
    ----------
    counts : what is dropped or repaired is added here by kind; kinds that do not occur stay absent.
    """

    def __init__(self, counts: Counter[str] | None = None) -> None:
        self._counts: Counter[str] = Counter() if counts is None else counts
        self._raw: Pose | None = None
        self._last: Pose | None = None
        self._offset_ns = 0
        self._run: tuple[int, int, int] | None = None
        self._periods_ns: deque[int] = deque(maxlen=_PERIODS_KEPT)

    @property
    def counts(self) -> Mapping[str, int]:
        """Counts by kind so far; a live view."""
        return MappingProxyType(self._counts)

    def admit(self, pose: Pose) -> Pose | None:
        """The pose to go on with, or None if it is dropped.

        Parameters
        ----------
        pose : as measured; any floats, any integer stamp.

        Returns
        -------
        Pose with a unit quaternion continuous in sign and a stamp after that of the last one returned.
        """
        quat_xyzw = self._unit(pose)
        if quat_xyzw is None:
            return None
        stamp_ns = self._forward(pose.stamp_ns)
        if stamp_ns is None:
            return None
        last, raw = self._last, self._raw
        if last is not None and raw is not None:
            if pose[1:] == raw[1:]:
                self._counts["held"] += 1
            a, b = quat_xyzw, last.quat_xyzw
            if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0.0:
                quat_xyzw = (-a[0], -a[1], -a[2], -a[3])
        self._raw = pose
        self._last = Pose(stamp_ns, pose.position_m, quat_xyzw)
        return self._last

    def admit_all(self, poses: Poses) -> Poses | None:
        """The same of poses that need no closer look; None, and nothing has happened, if one of them does."""
        last, raw = self._last, self._raw
        if last is None or raw is None or self._offset_ns:
            return None
        position_m, quat, steps_ns = (
            poses.position_m,
            poses.quat_xyzw,
            np.diff(poses.stamp_ns, prepend=last[0]),
        )
        with np.errstate(all="ignore"):
            x, y, z, w = quat.T
            norm = np.sqrt(x * x + y * y + z * z + w * w)
            sound = (np.abs(position_m) <= RANGE_M).all() and (np.abs(norm - 1.0) <= ROUNDING).all()
        if not sound or steps_ns.min() <= 0 or steps_ns.max() > GAP_NS or poses.stamp_ns[-1] > RANGE_NS:
            return None
        unit = quat / norm[:, None]
        cosine = (unit * np.concatenate([[last.quat_xyzw], unit[:-1]])).sum(axis=1)
        if (np.abs(cosine) < ROUNDING).any():  # half a turn: the sign depends on how the sum is rounded
            return None
        sign = np.where(cosine < 0.0, -1.0, 1.0).cumprod()
        before = Poses.join([Poses.collect((raw,)), poses])
        if held := len(before) - len(before.fresh):
            self._counts["held"] += held
        self._run = None
        self._periods_ns.extend(steps_ns[-_PERIODS_KEPT:].tolist())
        admitted = Poses(poses.stamp_ns, position_m, unit * sign[:, None])
        (self._raw,), (self._last,) = poses[-1:], admitted[-1:]
        return admitted

    def _unit(self, pose: Pose) -> tuple[float, float, float, float] | None:
        """The unit quaternion of a pose whose numbers are sound."""
        (px, py, pz), (x, y, z, w) = pose.position_m, pose.quat_xyzw
        # A sum is finite only if its terms are; it may overflow, which is out of range anyway.
        if not isfinite(px + py + pz + x + y + z + w) and not all(map(isfinite, (px, py, pz, x, y, z, w))):
            self._counts["nonfinite"] += 1
            return None
        if max(abs(px), abs(py), abs(pz)) > RANGE_M:
            self._counts["out_of_range"] += 1
            return None
        norm = sqrt(x * x + y * y + z * z + w * w)
        deviation = abs(norm - 1.0)
        if deviation > NORM_TOLERANCE:
            self._counts["bad_quaternion"] += 1
            return None
        if deviation > ROUNDING:
            self._counts["renormalised"] += 1
        return (x / norm, y / norm, z / norm, w / norm)

    def _forward(self, raw_stamp_ns: int) -> int | None:
        """The stamp on a clock that only runs forward."""
        stamp_ns = raw_stamp_ns + self._offset_ns
        if max(abs(raw_stamp_ns), abs(stamp_ns)) > RANGE_NS:
            self._counts["out_of_range"] += 1
            return None
        if self._last is None:
            return stamp_ns
        step_ns = stamp_ns - self._last.stamp_ns
        if step_ns == 0:
            self._counts["repeated_stamp"] += 1
            return None
        if step_ns < 0:
            return self._backward(stamp_ns)
        self._run = None
        self._note_step(step_ns)
        return stamp_ns

    def _backward(self, stamp_ns: int) -> int | None:
        """Drop a pose from the past, unless so many came in order that the clock must have been reset."""
        first_ns, last_ns, length = self._run or (stamp_ns, stamp_ns - 1, 0)
        if stamp_ns <= last_ns:
            first_ns, length = stamp_ns, 0
        if length < RESET_RUN:
            self._run = (first_ns, stamp_ns, length + 1)
            self._counts["backward_stamp"] += 1
            return None
        assert self._last is not None
        period_ns = round(median(self._periods_ns)) if self._periods_ns else 1
        shift_ns = self._last.stamp_ns + period_ns - first_ns
        self._offset_ns += shift_ns
        self._run = None
        self._counts["clock_reset"] += 1
        self._note_step(stamp_ns + shift_ns - self._last.stamp_ns)
        return stamp_ns + shift_ns

    def _note_step(self, step_ns: int) -> None:
        if step_ns > GAP_NS and self._periods_ns and step_ns > GAP_PERIODS * median(self._periods_ns):
            self._counts["gap"] += 1
        else:
            self._periods_ns.append(step_ns)
