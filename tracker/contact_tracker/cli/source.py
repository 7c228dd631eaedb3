"""The poses of a recording that the arguments select: cut to the interval, counted, paced; and the stream of
``live --state``, which is resumed from a file and saved to it."""

import argparse
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Final

from contact_tracker.cli.terminal import detail, progress, say, warn
from contact_tracker.config.parameters import Model
from contact_tracker.errors import DAMAGED, DONE, StateError, UsageError
from contact_tracker.files import why_not_writable
from contact_tracker.inspection.stream_checks import ORIENTATION, STILL
from contact_tracker.interrupts import SIGNALS, repeat_unless
from contact_tracker.map.map import Map
from contact_tracker.motion.losses import counts_text
from contact_tracker.motion.pose_validation import Arrival
from contact_tracker.motion.poses import Outliers, Poses
from contact_tracker.outputs.adaptation import noise_text, not_given, warnings
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.text import Changes
from contact_tracker.recording import Follow, PoseLog, PoseSource
from contact_tracker.recording.sources import Stamping
from contact_tracker.saved_state import fingerprint, load, save
from contact_tracker.segmenting import segmented
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.filter_bank import Report
from contact_tracker.trajectory import Trajectory

_LONGEST_SLEEP_S: Final = 0.1
"""Longest sleep in seconds between checks whether the stream has to end."""
_SUSPECTED_NS: Final = 3_000_000_000
"""Time in ns after which a suspicion is printed; ``live`` prints none for the seven shipped recordings."""
_POSES_PER_CHECK: Final = 100
"""Number of poses between checks whether most poses of a stream are dropped."""


class Source:
    """The poses of a command; their counts are final after iteration.

    Parameters
    ----------
    name : path of the recording.
    args : have the interval and the reading of tables.
    """

    def __init__(self, log: PoseLog, name: str, args: argparse.Namespace) -> None:
        self.log = log
        self.name = name
        detail(f"reading {log.source}")
        log.select(args.start, args.duration)
        self._is_cut = args.start > 0.0 or args.duration is not None
        self._begin_s = time.monotonic()
        self._is_as_named = not args.table.is_of_table
        if log.note is not None:
            warn(f"{self.name}: {log.note}")
        self._warned = set[str]()
        self._suspected_since_ns: int | None = None
        self._late = 0

    def batches(self) -> Iterator[Poses]:
        """The poses of the interval in batches of columns.

        Raises
        ------
        NoPoses, ChoiceError
            At the end: there were no poses.
        """
        yield from self.log.batches()
        if not self.log.valid:
            raise self.log.no_poses(self.name)

    def arrivals(self) -> Iterator[Arrival]:
        """The arrivals of measured poses in the interval, with less delay; raises as ``batches``."""
        for count, arrival in enumerate(self.log.arrivals(), 1):
            if count % _POSES_PER_CHECK == 0:
                self._warn_once(self.log.loss)
            self._warn_of_late_sources()
            if self.log.valid:
                yield arrival
        self._warn_of_late_sources()
        if not self.log.valid:
            raise self.log.no_poses(self.name)

    @property
    def is_stdin(self) -> bool:
        """Whether the input is standard input, which cannot be read again."""
        return self.name == "-"

    def _warn_of_late_sources(self) -> None:
        """Warn of sources that show up late, each once."""
        for source in self.log.late_sources[self._late :]:
            self._late += 1
            warn(
                f"{self.name}: another source of poses shows up: {source}; going on with {self.log.source}: "
                "choose with --topic or --frame"
            )

    @property
    def expected(self) -> int | None:
        """Approximate number of poses, if the recording's index has it."""
        is_shared = self.log.source.type.endswith("TFMessage")  # of several frames
        return None if is_shared or self._is_cut else self.log.source.messages

    def trajectory(self) -> Trajectory:
        """All poses of the interval, in memory."""
        poses = Poses.join(list(self.batches()))
        is_rereadable = not self.is_stdin and os.path.exists(self.name) and self._is_as_named
        return Trajectory.from_log(self.log, self.name, poses, is_rereadable)

    def segment(
        self, trajectory: Trajectory, model: Model, known_map: Map, label: str = "segment"
    ) -> Outcome:
        """The segmentation of all poses, with a bar of progress."""
        with progress(label, "poses", len(trajectory)) as set_done:
            return segmented(trajectory, model, known_map, progress=set_done)

    def finish(self, adapted: Report | None, outliers: Outliers, late: int = 0) -> int:
        """Print the numbers of read and unused poses and the tracker's adaptation; returns the exit code."""
        self.warn_of_damage()
        log, took_s = self.log, time.monotonic() - self._begin_s
        kinds = {**log.counts, "late": late, "outlier": outliers.total}
        counts = counts_text(kinds, outliers, log.origin_ns)
        noted, motion_s = f"; noted: {counts}" if counts else "", (log.last_ns - log.first_ns) * 1e-9
        say(f"{log.valid} poses, {motion_s:.2f} s of motion in {took_s:.2f} s{noted}")
        if adapted is not None:
            say(noise_text(adapted))
        if adapted is not None and adapted.map_use:
            say(adapted.map_use)
        self.warn_of_problems(adapted)
        for line in self.log.remarks:
            warn(f"{self.name}: {line}")
        return DONE if self.log.damage is None else DAMAGED

    def warn_of_damage(self) -> None:
        """Warn once that most poses were dropped or the recording is damaged, before the results."""
        self._warn_once(self.log.damage)

    def _warn_once(self, damage: str | None) -> None:
        for line in not_given(filter(None, [damage]), self._warned):
            warn(f"{self.name}: {line}")

    def warn_of_problems(self, adapted: Report | None, stamp_ns: int | None = None) -> None:
        """Warn of the problems of the stream, each once. In a stream that goes on at ``stamp_ns``, poses that
        have not changed so far are warned of once that has lasted for ``_SUSPECTED_NS``: an object may rest
        at first."""
        if adapted is not None and stamp_ns is not None and stamp_ns - self.log.first_ns < _SUSPECTED_NS:
            lasting = tuple(f for f in adapted.findings if f.kind not in (STILL, ORIENTATION))
            adapted = adapted._replace(findings=lasting)
        for line in not_given(warnings(adapted), self._warned):
            warn(line)

    def report_suspicion(self, stamp_ns: int, suspicions: Sequence[str]) -> None:
        """Print once why no label is certain, and since when, if that has lasted for ``_SUSPECTED_NS``."""
        if not suspicions:
            self._suspected_since_ns = None
        elif self._suspected_since_ns is None:
            self._suspected_since_ns = stamp_ns
        elif stamp_ns - self._suspected_since_ns >= _SUSPECTED_NS:
            since_s = (self._suspected_since_ns - self.log.origin_ns) * 1e-9
            suspected = "; or ".join(suspicions)
            text = f"no label is certain since {since_s:.1f} s: {suspected}; more motion decides"
            for line in not_given([text], self._warned):
                say(line)


def paced(
    arrivals: Iterable[Arrival], rate: float, has_to_end: Callable[[], bool] = lambda: False
) -> Iterator[Arrival]:
    """``arrivals`` in real time, ``rate`` times as fast.

    If the stream ``has_to_end``, the pose that has been read follows at once, so that it is not lost.
    """
    first_ns: int | None = None
    begin_s = time.monotonic()
    for arrival in arrivals:
        if first_ns is None and arrival.poses:
            first_ns, begin_s = arrival.poses[0].stamp_ns, time.monotonic()
        if first_ns is not None and arrival.time_ns is not None:
            due_s = begin_s + (arrival.time_ns - first_ns) * 1e-9 / rate
            while (wait_s := due_s - time.monotonic()) > 0 and not has_to_end():
                time.sleep(min(wait_s, _LONGEST_SLEEP_S))  # signals without an exception do not end a sleep
        yield arrival


EVERY_S: Final = 10.0
"""Time in seconds between two saved states."""
_SAVED: Final = ("initial", "state", "source", "first", "taken", "gate", "stamping", "span", "changes")
"""Keys of a saved state: a hash of the initial state, which model, lag and prior map determine; the tracker;
topic, type and frames of the poses; the first pose of the log with its log time (ns); the number of poses
read; the gate; the stamping (``sources.Stamping``); the stamps of the first pose and of the first and last
used pose, and the number of used poses; the printed changes (``Changes``)."""
_WAIT_S: Final = 0.5
"""Time in seconds until a signal is repeated: longer than the decoding of a pose, which it must not break."""


class SavedStream:
    """Saves the state of a stream between poses: a signal ends the stream after the current pose, a second
    signal at once. On standard input, where the next pose may never come, a signal ends the wait for it.

    Parameters
    ----------
    path : of the file; if it does not exist, the stream starts from the beginning.
    initial : the tracker before the first pose.
    source, changes : the poses and the printed changes, which are resumed.

    Raises
    ------
    StateError
        The file is not a state.
    UsageError
        The state is of another source or recording, or has another model, lag or map, or the folder of the
        file does not exist.
    """

    def __init__(
        self,
        path: Path,
        initial: Tracker,
        source: Source,
        changes: Changes,
        follow: Follow | None,
    ) -> None:
        self.signal = 0
        self._waits = False
        self.tracker = initial
        read_as = source.log.source.read_as  # without the path: the next part has another one
        read_as = read_as._replace(path="", table=replace(read_as.table, given=()))
        inspection = initial.inspection._replace(read_as=read_as)
        self._initial = fingerprint(replace(initial, inspection=inspection))
        self._path, self._log, self._source = path, source.log, source
        self._changes, self._follow = changes, follow
        self._saved_s = time.monotonic()
        if path.exists():
            self._resume(load(path))
            say(f"resumed from {path}, after {self._log.valid} poses")
        elif (refusal := why_not_writable(path)) is not None:
            raise UsageError(f"{path}: the state cannot be saved there: {refusal}")
        for number in (getattr(signal, name) for name in SIGNALS if hasattr(signal, name)):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._stop)

    def begin_pose(self) -> None:
        """Mark the arrival of a pose, which is processed until ``end_pose``."""
        self._waits = False

    def end_pose(self) -> bool:
        """Save if ``EVERY_S`` has passed; returns whether the stream has to end."""
        now_s = time.monotonic()
        if not self.signal and now_s - self._saved_s >= EVERY_S:
            self.save()
            self._saved_s = now_s
        self._waits = not self.signal
        return bool(self.signal)

    def save(self) -> None:
        """Write the state to the file."""
        self._waits = False
        log = self._log
        values = (
            *(self._initial, self.tracker, self._names, log.first, log.taken, log.gate, tuple(log.stamping)),
            (log.origin_ns, log.first_ns, log.last_ns, log.valid),
            vars(self._changes),
        )
        save(self._path, dict(zip(_SAVED, values, strict=True)))

    @property
    def _names(self) -> tuple[str, str, str, str]:
        source = self._log.source
        return source.topic, source.type, source.frame_id, source.child_frame_id

    def _resume(self, saved: object) -> None:
        """Resume the stream from the loaded state ``saved``."""
        if not isinstance(saved, dict) or tuple(saved) != _SAVED:
            raise StateError(f"{self._path}: it is no state of a stream")
        initial, self.tracker, names, first, taken, gate, stamping, span, changes = saved.values()
        if initial != self._initial:
            raise UsageError(
                f"{self._path} was saved with another model, --lag, --states or known geometry: give the "
                "same, or another file"
            )
        log, name, is_stdin = self._log, self._source.name, self._source.is_stdin
        if names != self._names:
            raise UsageError(
                f"{self._path} is of {PoseSource(*names)}, not of {log.source}: name another file"
            )
        is_same_log = fingerprint(first) == fingerprint(log.first) and not is_stdin
        first_ns = log.first_stamp_ns + gate.shift_ns
        if not is_same_log and not is_stdin and first_ns <= span[2]:
            raise UsageError(
                f"{self._path} is of another recording, which does not end before {name} begins: name "
                "another file"
            )
        self.tracker.inspection = self.tracker.inspection._replace(read_as=log.source.read_as)
        log.carry_on(gate, Stamping(*stamping), taken, is_same_log, span)
        vars(self._changes).update(changes)

    def _stop(self, number: int, _: FrameType | None) -> None:
        if self.signal:
            raise SystemExit(128 + number)
        self.signal = number
        if self._source.is_stdin:  # a repeated signal ends a long wait for the next pose
            repeat_unless(number, lambda: not self._waits, _WAIT_S)
        if self._follow is not None:
            self._follow.stop()
