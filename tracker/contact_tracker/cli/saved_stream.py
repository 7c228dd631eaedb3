"""The stream of ``live --state``: resumed from a file, and saved to it."""

import signal
import time
from pathlib import Path
from types import FrameType
from typing import Final

from contact_tracker.adaptation.online import AdaptiveState
from contact_tracker.atomic_file import why_not_replaceable
from contact_tracker.cli.source import Source
from contact_tracker.cli.terminal import say
from contact_tracker.errors import StateError, UsageError
from contact_tracker.interrupts import SIGNALS, repeat_unless
from contact_tracker.outputs.changes import Changes, FormationChanges
from contact_tracker.recording import Follow, PoseLog, PoseSource
from contact_tracker.recording.stamping import Stamping
from contact_tracker.saved_state import Progress, is_same, load, save

EVERY_S: Final = 10.0
_WAIT_S: Final = 0.5
"""Longer than it takes to decode a pose, which must not be interrupted."""


class SavedStream:
    """Saves between poses only: a signal ends the stream after the current pose, a second one at once. On
    standard input, where the next pose may never come, the stream ends while it waits for one.

    Parameters
    ----------
    path : of the file; without one the stream starts from the beginning.
    initial : the state before the first pose.
    log, source, shown : the log, source and reported changes, to be resumed.

    Raises
    ------
    StateError
        The file is not a state.
    UsageError
        It was saved of another source or recording, or with another model, lag or prior map, or has no
        folder.
    """

    def __init__(
        self,
        path: Path,
        initial: AdaptiveState,
        log: PoseLog,
        source: Source,
        shown: tuple[Changes, FormationChanges],
        follow: Follow | None,
    ) -> None:
        self.signal = 0
        self._waits = False
        self.state = initial
        self._path, self._initial, self._log, self._source = path, initial, log, source
        self._shown, self._follow = shown, follow
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

    def keep(self, state: AdaptiveState) -> bool:
        """Save at intervals, after each pose; returns whether to end."""
        now_s = time.monotonic()
        if not self.signal and now_s - self._saved_s >= EVERY_S:
            self.save(state)
            self._saved_s = now_s
        self._waits = not self.signal
        return bool(self.signal)

    def save(self, state: AdaptiveState) -> None:
        """Write the file."""
        self._waits = False
        log, source = self._log, self._source
        changes, formation = self._shown
        progress = Progress(
            self._initial,
            state,
            self._names,
            log.first,
            log.taken,
            log.gate,
            log.stamping.values,
            source.origin_ns,
            source.first_ns,
            source.last_ns,
            source.used,
            changes.label,
            changes.settled,
            changes.open,
            formation.before,
        )
        save(self._path, progress)

    @property
    def _names(self) -> tuple[str, str, str, str]:
        source = self._log.source
        return source.topic, source.type, source.frame_id, source.child_frame_id

    def _carry_on(self, saved: object) -> None:
        if not isinstance(saved, Progress):
            raise StateError(f"{self._path}: it is no state of a stream")
        if not is_same(saved.initial, self._initial):
            raise UsageError(
                f"{self._path} was saved with another model, --lag or known geometry: give the same, or "
                "another file"
            )
        log, name, is_stdin = self._log, self._source.name, self._source.is_stdin
        if saved.source != self._names:
            raise UsageError(
                f"{self._path} is of {PoseSource(*saved.source)}, not of {log.source}: name another file"
            )
        is_same_log = is_same(saved.first, log.first) and not is_stdin
        first_ns = log.first_stamp_ns + saved.gate.shift_ns
        if not is_same_log and not is_stdin and first_ns <= saved.last_ns:
            raise UsageError(
                f"{self._path} is of another recording, which does not end before {name} begins: name "
                "another file"
            )
        stamping = Stamping.of(saved.stamping)
        log.carry_on(saved.gate, stamping, saved.taken, is_same_log)
        self._source.carry_on(saved.origin_ns, saved.first_ns, saved.last_ns, saved.used)
        changes, formation = self._shown
        changes.label, changes.settled, changes.open = saved.label, saved.settled, saved.open
        formation.before = saved.further
        self.state = saved.now

    def _stop(self, number: int, _: FrameType | None) -> None:
        if self.signal:
            raise SystemExit(128 + number)
        self.signal = number
        if self._source.is_stdin:
            self._end_wait(number)
        if self._follow is not None:
            self._follow.stop()

    def _end_wait(self, number: int) -> None:
        """End the wait for the next pose by a second signal, once it has lasted for ``_WAIT_S``."""
        repeat_unless(number, lambda: not self._waits, _WAIT_S)
