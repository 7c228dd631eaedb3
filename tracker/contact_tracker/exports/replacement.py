"""Protection of input files and recordings against being overwritten."""

import os
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path

from contact_tracker.errors import MissingExtra, UnreadableRecording, UsageError


def check_output(
    path: Path | None, overwrite: bool, read: Iterable[str] = (), how: str = "--overwrite"
) -> Callable[[], None]:
    """Refuse to overwrite one of the files ``read``, under any name, or a recording.

    The message contains ``how`` to overwrite a recording after all.

    Returns
    -------
    The same check for ``whole_file``, as files may be renamed and linked in the meantime.

    Raises
    ------
    UsageError
        The message says what to do instead.
    """
    names = tuple(read)
    check = partial(_check, path, overwrite, how, names, tuple(map(_status, names)))
    check()
    return check


def _check(
    path: Path | None,
    overwrite: bool,
    how: str,
    names: tuple[str, ...],
    before: tuple[os.stat_result | None, ...],
) -> None:
    """Check again; ``before`` are the files of ``names`` at the first check."""
    if path is None or not path.exists():
        return
    there = os.stat(path)
    for name, first in zip(names, before, strict=True):
        if any(one is not None and os.path.samestat(there, one) for one in (first, _status(name))):
            shown = "standard input" if name == "-" else name
            raise UsageError(f"cannot write {path}: it is the input {shown}; name another file")
    if not overwrite and (reason := _why_kept(path)):
        raise UsageError(f"cannot write {path}: {reason}; {how} replaces it")


def _status(name: str) -> os.stat_result | None:
    """The status of a file, None on errors, which reading it reports."""
    with suppress(OSError, ValueError):
        return os.fstat(sys.stdin.fileno()) if name == "-" else os.stat(name)
    return None


def _why_kept(path: Path) -> str | None:
    from contact_tracker.recording import may_be_recording

    try:
        return "it is a recording" if may_be_recording(str(path)) else None
    except (OSError, UnreadableRecording, MissingExtra) as error:
        return f"it may be a recording, but cannot be read ({getattr(error, 'strerror', None) or error})"
