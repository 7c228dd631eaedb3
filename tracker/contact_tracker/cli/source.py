"""The poses of a recording by the arguments: cut to the interval, counted, paced."""

import argparse
import os
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from contact_tracker.cli.terminal import detail, say, warn
from contact_tracker.errors import ChoiceError, NoPoses
from contact_tracker.exit_codes import DAMAGED, DONE
from contact_tracker.motion.pose_validation import Arrival
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.outputs.adaptation import News, noise_text, warnings
from contact_tracker.recording import PoseLog

if TYPE_CHECKING:
    from contact_tracker.adaptation.report import Report
    from contact_tracker.exports.outcome import Outcome
    from contact_tracker.map.map import Map
    from contact_tracker.segmenting import OfflineTracker
    from contact_tracker.tracking.segmentation import Segmentation

_LONGEST_SLEEP_S: Final = 0.1
"""Longest sleep at a time (s) between looks at whether the stream has to end."""


class Source:
    """The poses of one command; its counts are final after iteration.

    ``name`` is the recording as given by the user, ``args`` has the interval. ``origin_ns`` is the stamp of
    the recording's first pose, from which displayed times count.
    """

    def __init__(self, log: PoseLog, name: str, args: argparse.Namespace) -> None:
        self._log = log
        self._name = name
        detail(f"reading {log.source}")
        self._start_ns = round(args.start * 1e9)
        self._end_ns = None if args.duration is None else self._start_ns + round(args.duration * 1e9)
        self._begin_s = time.monotonic()
        self._is_as_named = not args.table.is_of_table
        if log.note is not None:
            warn(f"{self._name}: {log.note}")
        self.origin_ns = 0
        self.first_ns = 0
        self.last_ns = 0
        self.used = 0
        self.outliers = 0
        self.late = 0
        self._news = News()

    def __iter__(self) -> Iterator[Pose]:
        """The poses of the interval; raises NoPoses or ChoiceError at the end if there were none."""
        return (pose for arrival in self.arrivals() for pose in arrival.poses)

    def arrivals(self) -> Iterator[Arrival]:
        """What each measured pose of the interval brings, instead of the poses."""
        since_ns, late, has_ended = 0 if self.used else None, 0, False
        for arrival in self._log.arrivals():
            poses = list[Pose]()
            for pose in arrival.poses:
                if since_ns is None:
                    self.origin_ns = pose.stamp_ns
                since_ns = pose.stamp_ns - self.origin_ns
                has_ended = self._end_ns is not None and since_ns >= self._end_ns
                if has_ended:
                    break
                if since_ns >= self._start_ns:
                    poses.append(pose)
            if poses:
                if not self.used:
                    self.first_ns = poses[0].stamp_ns
                self.used += len(poses)
                self.last_ns = poses[-1].stamp_ns
            if len(self._log.late_sources) > late:
                late = self._warn_of_late(late)
            if self.used:
                yield Arrival(poses, None, None) if has_ended else arrival._replace(poses=poses)
            if has_ended:
                break
        self._warn_of_late(late)
        self._used_some(since_ns)

    @property
    def name(self) -> str:
        """The recording as given by the user."""
        return self._name

    @property
    def is_stdin(self) -> bool:
        """Whether the input is standard input, which cannot be read again."""
        return self._name == "-"

    def carry_on(self, origin_ns: int, first_ns: int, last_ns: int, used: int) -> None:
        """Continue where another reading has stopped."""
        self.origin_ns, self.first_ns, self.last_ns, self.used = origin_ns, first_ns, last_ns, used

    def _warn_of_late(self, reported: int) -> int:
        """Warn of late sources beyond the first ``reported``; returns their number."""
        for other in self._log.late_sources[reported:]:
            warn(
                f"{self._name}: another source of poses shows up: {other}; going on with {self._log.source}: "
                "choose with --topic or --frame"
            )
        return len(self._log.late_sources)

    def batches(self) -> Iterator[Poses]:
        """The poses in columns, of many at once; with more delay than iteration."""
        last_ns = None
        for poses in self._log.batches():
            if last_ns is None:
                self.origin_ns = int(poses.stamp_ns[0])
            since_ns = poses.stamp_ns - self.origin_ns
            last_ns = int(since_ns[-1])
            ended = self._end_ns is not None and last_ns >= self._end_ns
            first, end = since_ns.searchsorted([self._start_ns, self._end_ns if ended else last_ns + 1])
            if first < end:
                stamps_ns = poses.stamp_ns[first:end].tolist()
                if not self.used:
                    self.first_ns = stamps_ns[0]
                self.last_ns = stamps_ns[-1]
                self.used += len(stamps_ns)
                yield poses[first:end]
            if ended:
                break
        self._used_some(last_ns)

    def _used_some(self, last_ns: int | None) -> None:
        """Raise if no pose was used; the last was read at ``last_ns`` after the first, None without any."""
        if self.used:
            return
        if last_ns is None:
            reason = "" if self._log.loss is None else f": {self._log.loss}"
            raise NoPoses(f"{self._name}: no pose that can be used{reason}{self._noted()}")
        raise ChoiceError(
            f"{self._name}: no pose in the interval that --start and --duration leave; poses were read until "
            f"{last_ns * 1e-9:.2f} s{self._noted()}"
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

    def outcome(
        self,
        poses: Poses,
        found: "Segmentation",
        tracker: "OfflineTracker",
        known_map: "Map",
        notes: Iterable[str],
    ) -> "Outcome":
        """The outcome for outputs of a whole recording; ``notes`` are warnings from before the first pose."""
        from contact_tracker.exports.outcome import Outcome
        from contact_tracker.recording import read_metadata, read_truth
        from contact_tracker.viewer.parts import known_parts
        from contact_tracker.viewer.scene import vertices_from_metadata

        adapted, vertices_m = tracker.report, vertices_from_metadata(read_metadata(self._name))
        is_readable = not self.is_stdin and os.path.exists(self._name) and self._is_as_named
        return Outcome(
            "standard input" if self.is_stdin else Path(self._name).name or self._name,
            poses,
            found,
            self.origin_ns,
            self.counts,
            (*notes, *self._log.warnings, *(() if adapted is None else warnings(adapted))),
            "" if adapted is None else noise_text(adapted),
            self._log.source.frame_id,
            self._log.source.child_frame_id,
            vertices_m,
            known_parts(tracker.map, poses, found.segments, known_map, vertices_m),
            partial(read_truth, self._name),
            self._name if is_readable else None,
            self._log.stamping.log_offset_ns,
        )

    def finish(self, adapted: "Report | None") -> int:
        """Report the poses read and not used, and the tracker's adaptation; returns the exit code."""
        if self._log.damage is not None:
            warn(f"{self._name}: {self._log.damage}")
        motion_s, took_s = (self.last_ns - self.first_ns) * 1e-9, time.monotonic() - self._begin_s
        say(f"{self.used} poses, {motion_s:.2f} s of motion in {took_s:.2f} s{self._noted()}")
        if adapted is not None:
            say(noise_text(adapted))
        if adapted is not None and adapted.map_use:
            say(adapted.map_use)
        self.warn_of_news(adapted)
        for line in self._log.remarks:
            warn(f"{self._name}: {line}")
        return DONE if self._log.damage is None else DAMAGED

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
