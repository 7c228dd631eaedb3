"""Stamps of poses: the time of their header, or the log time where headers have none."""

from collections.abc import Sequence
from statistics import median
from typing import Final

from contact_tracker.motion.poses import Pose

PREFIX_NS: Final = 1_000_000_000
PREFIX_MESSAGES: Final = 2000
SECOND_NS: Final = 1_000_000_000
COARSE: Final = 4
"""Different poses per stamp from which stamps cannot order poses in time."""
COARSE_SECONDS: Final = 2
"""The same for stamps in whole seconds, of which only two occur among the first poses."""

Logged = tuple[Pose, int]
"""A pose with the stamp of its header, and its log time in nanoseconds."""


class Stamping:
    """Assigns stamps to the poses of one source.

    Parameters
    ----------
    prefix : the first poses of the source: one second of log time, and at most 2000.

    Attributes
    ----------
    by_log_time : whether every pose gets its log time: all stamps of the prefix are zero, or most differing
        poses share one.
    """

    def __init__(self, prefix: Sequence[Logged]) -> None:
        self.by_log_time = _are_zero(prefix) or _are_coarse([pose for pose, _ in prefix])
        good = [(pose.stamp_ns, log_time_ns) for pose, log_time_ns in prefix if pose.stamp_ns]
        offsets_ns = [log_time_ns - stamp_ns for stamp_ns, log_time_ns in good]
        self._offset_ns = round(median(offsets_ns)) if good else None
        # A clock may run faster than log time, so stamps of the prefix may reach this far from zero.
        self._near_zero_ns = max(PREFIX_NS, max(good)[0] - min(good)[0]) if good else PREFIX_NS

    @property
    def log_offset_ns(self) -> int:
        """Median delay from a pose's stamp to its log time (ns)."""
        return 0 if self.by_log_time or self._offset_ns is None else self._offset_ns

    @property
    def values(self) -> tuple[bool, int | None, int]:
        """The values derived from the prefix."""
        return self.by_log_time, self._offset_ns, self._near_zero_ns

    @classmethod
    def of(cls, values: tuple[bool, int | None, int]) -> "Stamping":
        """A stamping from its ``values``."""
        stamping = cls(())
        stamping.by_log_time, stamping._offset_ns, stamping._near_zero_ns = values
        return stamping

    def lacks_stamp(self, stamp_ns: int, log_time_ns: int) -> bool:
        """Whether a pose gets its log time instead of its stamp.

        Zero is an unset stamp, unless the other stamps are near zero: clocks of simulations start there.
        """
        if self.by_log_time:
            return True
        if stamp_ns or self._offset_ns is None:
            return False
        return abs(log_time_ns - self._offset_ns) > self._near_zero_ns

    def from_log_time(self, log_time_ns: int) -> int:
        """The stamp of a pose without one; on the clock of the headers, where others have stamps."""
        return log_time_ns if self.by_log_time or self._offset_ns is None else log_time_ns - self._offset_ns


def _are_zero(prefix: Sequence[Logged]) -> bool:
    return len(prefix) > 1 and not any(pose.stamp_ns for pose, _ in prefix)


def _are_coarse(poses: Sequence[Pose]) -> bool:
    """Whether most poses share their stamp with a different pose."""
    stamps = {pose.stamp_ns for pose in poses}
    enough = COARSE_SECONDS if all(stamp_ns % SECOND_NS == 0 for stamp_ns in stamps) else COARSE
    return len({pose[1:] for pose in poses}) >= enough * len(stamps) > 0
