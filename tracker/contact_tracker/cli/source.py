"""The poses of a recording by the arguments: cut to the interval, counted, paced."""

import argparse
import os
import time
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.cli.terminal import detail, say, warn
from contact_tracker.errors import DAMAGED, DONE, ChoiceError, NoPoses
from contact_tracker.motion.pose_validation import Arrival
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.outputs.adaptation import News, noise_text, warnings
from contact_tracker.recording import PoseLog
from contact_tracker.trajectory import Trajectory

if TYPE_CHECKING:
    from contact_tracker.adaptation.report import Report
    from contact_tracker.tracking.segmentation import Segmentation

_LONGEST_SLEEP_S: Final = 0.1
"""Longest sleep at a time (s) between looks at whether the stream has to end."""
_POSES_PER_LOOK: Final = 100
"""A stream is looked at each time that so many poses have come, whether most are dropped."""


class Source:
    """The poses of one command; its counts are final after iteration.

    ``name`` is the recording as given by the user, ``args`` has the interval. ``origin_ns`` is the stamp of
    the recording's first pose, from which displayed times count.
    """

    def __init__(self, log: PoseLog, name: str, args: argparse.Namespace) -> None:
        self._log = log
        self.name = name
        detail(f"reading {log.source}")
        self._start_ns = round(args.start * 1e9)
        self._end_ns = None if args.duration is None else self._start_ns + round(args.duration * 1e9)
        self._begin_s = time.monotonic()
        self._is_as_named = not args.table.is_of_table
        if log.note is not None:
            warn(f"{self.name}: {log.note}")
        self.origin_ns = 0
        self.first_ns = 0
        self.last_ns = 0
        self.used = 0
        self.outliers = 0
        self.late = 0
        self._read_ns: int | None = None  # until when, after the first pose
        self._news = News()

    def __iter__(self) -> Iterator[Pose]:
        return (pose for poses in self.batches() for pose in poses)

    def batches(self) -> Iterator[Poses]:
        """The poses of the interval in columns, many at once.

        Raises
        ------
        NoPoses, ChoiceError
            At the end, if there were none.
        """
        for poses in self._log.batches():
            rows, has_ended = self._cut(poses.stamp_ns)
            if rows.start < rows.stop:
                yield poses[rows]
            if has_ended:
                break
        self._require_some()

    def arrivals(self) -> Iterator[Arrival]:
        """What each measured pose of the interval brings, with less delay; raises as ``batches``."""
        late = 0
        for count, arrival in enumerate(self._log.arrivals(), 1):
            if count % _POSES_PER_LOOK == 0:
                self._warn_of(self._log.loss)
            rows, has_ended = self._cut([pose.stamp_ns for pose in arrival.poses])
            late = self._warn_of_late(late)
            if self.used:
                poses = arrival.poses[rows]
                yield Arrival(poses, None, None) if has_ended else arrival._replace(poses=poses)
            if has_ended:
                break
        self._warn_of_late(late)
        self._require_some()

    def _cut(self, stamp_ns: Sequence[int] | NDArray[np.int64]) -> tuple[slice, bool]:
        """The rows of the next poses that are in the interval, which are counted, and whether it is over."""
        count = len(stamp_ns)
        if not count:
            return slice(0, 0), False
        if self._read_ns is None and not self.used:
            self.origin_ns = int(stamp_ns[0])
        self._read_ns = int(stamp_ns[-1]) - self.origin_ns
        first = bisect_left(stamp_ns, self.origin_ns + self._start_ns)
        end = count if self._end_ns is None else bisect_left(stamp_ns, self.origin_ns + self._end_ns)
        if first < end:
            if not self.used:
                self.first_ns = int(stamp_ns[first])
            self.used += end - first
            self.last_ns = int(stamp_ns[end - 1])
        return slice(first, end), end < count

    @property
    def is_stdin(self) -> bool:
        """Whether the input is standard input, which cannot be read again."""
        return self.name == "-"

    def carry_on(self, origin_ns: int, first_ns: int, last_ns: int, used: int) -> None:
        """Continue where another reading has stopped."""
        self.origin_ns, self.first_ns, self.last_ns, self.used = origin_ns, first_ns, last_ns, used

    def _warn_of_late(self, reported: int) -> int:
        """Warn of late sources beyond the first ``reported``; returns their number."""
        for other in self._log.late_sources[reported:]:
            warn(
                f"{self.name}: another source of poses shows up: {other}; going on with {self._log.source}: "
                "choose with --topic or --frame"
            )
        return len(self._log.late_sources)

    def _require_some(self) -> None:
        """Raise if no pose was used."""
        if self.used:
            return
        if self._read_ns is None:
            reason = "" if self._log.loss is None else f": {self._log.loss}"
            raise NoPoses(f"{self.name}: no pose that can be used{reason}{self._noted()}")
        raise ChoiceError(
            f"{self.name}: no pose in the interval that --start and --duration leave; poses were read until "
            f"{self._read_ns * 1e-9:.2f} s{self._noted()}"
        )

    def counted(self, found: "Iterable[Segmentation]") -> "Iterator[Segmentation]":
        """The pieces of ``found``, while outliers are counted."""
        for piece in found:
            self.outliers += piece.outliers
            yield piece

    @property
    def expected(self) -> int | None:
        """Approximate number of poses, if the recording's index has it."""
        is_shared = self._log.source.type.endswith("TFMessage")  # of several frames
        is_cut = self._start_ns > 0 or self._end_ns is not None
        return None if is_shared or is_cut else self._log.source.messages

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of dropped or repaired poses, by kind."""
        kinds = {**self._log.counts, "late": self.late, "outlier": self.outliers}
        return {kind: count for kind, count in kinds.items() if count}

    def trajectory(self) -> Trajectory:
        """All poses of the interval, in memory."""
        poses = Poses.join(list(self.batches()))
        is_rereadable = not self.is_stdin and os.path.exists(self.name) and self._is_as_named
        return Trajectory.from_log(self._log, self.name, poses, is_rereadable, self.origin_ns)

    def finish(self, adapted: "Report | None") -> int:
        """Report the poses read and not used, and the tracker's adaptation; returns the exit code."""
        self.warn_of_damage()
        motion_s, took_s = (self.last_ns - self.first_ns) * 1e-9, time.monotonic() - self._begin_s
        say(f"{self.used} poses, {motion_s:.2f} s of motion in {took_s:.2f} s{self._noted()}")
        if adapted is not None:
            say(noise_text(adapted))
        if adapted is not None and adapted.map_use:
            say(adapted.map_use)
        self.warn_of_news(adapted)
        for line in self._log.remarks:
            warn(f"{self.name}: {line}")
        return DONE if self._log.damage is None else DAMAGED

    def warn_of_damage(self) -> None:
        """Warn, if that is not done yet, that most poses were dropped, or that the recording is damaged: it
        comes before the results."""
        self._warn_of(self._log.damage)

    def _warn_of(self, damage: str | None) -> None:
        for line in self._news.of(filter(None, [damage])):
            warn(f"{self.name}: {line}")

    def warn_of_news(self, adapted: "Report | None") -> None:
        """Warn of the problems of the stream of which it was not warned before."""
        for line in self._news.of(() if adapted is None else warnings(adapted)):
            warn(line)

    def _noted(self) -> str:
        counts = ", ".join(f"{kind} {count}" for kind, count in self.counts.items())
        return f"; noted: {counts}" if counts else ""


def paced(
    arrivals: Iterable[Arrival], rate: float, has_to_end: Callable[[], bool] = lambda: False
) -> Iterator[Arrival]:
    """``arrivals`` in real time, ``rate`` times as fast.

    Once the stream ``has_to_end``, the pose that has been read comes at once, so that it is not lost.
    """
    first_ns: int | None = None
    begin_s = time.monotonic()
    for arrival in arrivals:
        if first_ns is None and arrival.poses:
            first_ns, begin_s = arrival.poses[0].stamp_ns, time.monotonic()
        if first_ns is not None and arrival.time_ns is not None:
            due_s = begin_s + (arrival.time_ns - first_ns) * 1e-9 / rate
            while (wait_s := due_s - time.monotonic()) > 0 and not has_to_end():
                time.sleep(min(wait_s, _LONGEST_SLEEP_S))  # a signal that raises nothing does not end it
        yield arrival
