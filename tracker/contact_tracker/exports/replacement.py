"""What may be replaced: nothing that is read, and a recording only when that is asked for."""

import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from contact_tracker.errors import MissingExtra, UnreadableRecording, UsageError


def check_output(
    path: Path | None, overwrite: bool, read: Iterable[str] = (), how: str = "--overwrite"
) -> None:
    """Refuse to write onto one of the files ``read``, whatever it is called, or onto a recording.

    ``how`` to have a recording replaced after all is part of the message.

    Raises
    ------
    UsageError
        Says what to do instead.
    """
    if path is None or not path.exists():
        return
    there = os.stat(path)
    for name in read:
        with suppress(OSError, ValueError):  # who reads it says why it cannot be read
            if os.path.samestat(there, os.fstat(sys.stdin.fileno()) if name == "-" else os.stat(name)):
                shown = "standard input" if name == "-" else name
                raise UsageError(f"cannot write {path}: it is the input {shown}; name another file")
    if not overwrite and (reason := _why_kept(path)):
        raise UsageError(f"cannot write {path}: {reason}; {how} replaces it")


def _why_kept(path: Path) -> str | None:
    from contact_tracker.recording import may_be_recording

    try:
        return "it is a recording" if may_be_recording(str(path)) else None
    except (OSError, UnreadableRecording, MissingExtra) as error:
        return f"it may be a recording, but cannot be read ({getattr(error, 'strerror', None) or error})"
