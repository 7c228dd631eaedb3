"""The stream of ``live --state``: resumed from a file, and saved to it."""

import signal
import time
from pathlib import Path
from types import FrameType
from typing import Final

from contact_tracker.cli.source import Source
from contact_tracker.cli.terminal import say
from contact_tracker.errors import StateError, UsageError
from contact_tracker.files import why_not_replaceable
from contact_tracker.interrupts import SIGNALS, repeat_unless
from contact_tracker.outputs.text import Changes
from contact_tracker.recording import Follow, PoseLog, PoseSource
from contact_tracker.recording.sources import Stamping
from contact_tracker.saved_state import fingerprint, is_same, load, save
from contact_tracker.tracker import Tracker

EVERY_S: Final = 10.0
_SAVED: Final = ("initial", "state", "source", "first", "taken", "gate", "stamping", "span", "reported")
"""What is saved, between the arrivals of two poses: a hash of the initial state, which model, lag and prior
map determine, and the tracker; topic, type and frames of the poses; the first pose of the log with its log
time (ns), and how many were read, with the gate and the stamping (``sources.Stamping``); the stamps of the
first pose, of the first and last that were used, and their number; what was reported (``Changes``)."""
_WAIT_S: Final = 0.5
"""Longer than it takes to decode a pose, which must not be interrupted."""


class SavedStream:
    """Saves between poses only: a signal ends the stream after the current pose, a second one at once. On
    standard input, where the next pose may never come, the stream ends while it waits for one.

    Parameters
    ----------
    path : of the file; without one the stream starts from the beginning.
    initial : the tracker before the first pose.
    log, source, changes : the log, its source and what was reported, to be resumed.

    Raises
    ------
    StateError
        The file is not a state.
    UsageError
        It was saved of another source or recording, or with another model, lag or map, or has no
        folder.
    """

    def __init__(
        self,
        path: Path,
        initial: Tracker,
        log: PoseLog,
        source: Source,
        changes: Changes,
        follow: Follow | None,
    ) -> None:
        self.signal = 0
        self._waits = False
        self.tracker = initial
        self._path, self._initial, self._log, self._source = path, fingerprint(initial), log, source
        self._changes, self._follow = changes, follow
        self._saved_s = time.monotonic()
        if path.exists():
            self._carry_on(load(path))
            say(f"resumed from {path}, after {source.used} poses")
        elif not path.parent.is_dir():
            raise UsageError(f"{path}: there is no folder {path.parent} to save it in")
        elif (refusal := why_not_replaceable(path)) is not None:
            raise UsageError(f"{path}: the state cannot be saved there: {refusal}")
        for number in (getattr(signal, name) for name in SIGNALS if hasattr(signal, name)):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._stop)

    def take(self) -> None:
        """A pose has come, and is processed until ``keep``."""
        self._waits = False

    def keep(self) -> bool:
        """Save at intervals, after each pose; returns whether to end."""
        now_s = time.monotonic()
        if not self.signal and now_s - self._saved_s >= EVERY_S:
            self.save()
            self._saved_s = now_s
        self._waits = not self.signal
        return bool(self.signal)

    def save(self) -> None:
        """Write the file."""
        self._waits = False
        log, source, changes = self._log, self._source, self._changes
        values = (
            *(self._initial, self.tracker, self._names, log.first, log.taken, log.gate, tuple(log.stamping)),
            (source.origin_ns, source.first_ns, source.last_ns, source.used),
            (changes.label, changes.settled, changes.open, changes.further),
        )
        save(self._path, dict(zip(_SAVED, values, strict=True)))

    @property
    def _names(self) -> tuple[str, str, str, str]:
        source = self._log.source
        return source.topic, source.type, source.frame_id, source.child_frame_id

    def _carry_on(self, saved: object) -> None:
        if not isinstance(saved, dict) or tuple(saved) != _SAVED:
            raise StateError(f"{self._path}: it is no state of a stream")
        initial, self.tracker, names, first, taken, gate, stamping, span, reported = saved.values()
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
        is_same_log = is_same(first, log.first) and not is_stdin
        first_ns = log.first_stamp_ns + gate.shift_ns
        if not is_same_log and not is_stdin and first_ns <= span[2]:
            raise UsageError(
                f"{self._path} is of another recording, which does not end before {name} begins: name "
                "another file"
            )
        log.carry_on(gate, Stamping(*stamping), taken, is_same_log)
        self._source.carry_on(*span)
        changes = self._changes
        changes.label, changes.settled, changes.open, changes.further = reported

    def _stop(self, number: int, _: FrameType | None) -> None:
        if self.signal:
            raise SystemExit(128 + number)
        self.signal = number
        if self._source.is_stdin:  # a second signal ends the wait for the next pose, once it has lasted
            repeat_unless(number, lambda: not self._waits, _WAIT_S)
        if self._follow is not None:
            self._follow.stop()
