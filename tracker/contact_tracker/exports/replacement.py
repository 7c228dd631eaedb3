"""Protection of input files, of other outputs and of recordings against being overwritten."""

import os
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path

from contact_tracker.errors import MissingExtra, UnreadableRecording, UsageError


def check_output(
    path: Path | None,
    overwrite: bool,
    read: Iterable[str] = (),
    how: str = "--overwrite",
    written: Iterable[Path | None] = (),
) -> Callable[[], None]:
    """Refuse an output that is one of the files ``read`` or of the other outputs ``written``, under any name,
    or that would replace a recording.

    The message contains ``how`` to overwrite a recording after all.

    Returns
    -------
    The same check for ``whole_file``, as files may be renamed and linked in the meantime.

    Raises
    ------
    UsageError
        The message says what to do instead.
    """
    names = {
        **{str(one): "another output," for one in written if one is not None},
        **dict.fromkeys(read, "the input"),
    }
    before = {name: _status(name) for name in names}
    check = partial(_check, path, overwrite, how, names, before)
    check()
    return check


def _check(
    path: Path | None,
    overwrite: bool,
    how: str,
    names: Mapping[str, str],
    before: Mapping[str, os.stat_result | None],
) -> None:
    """Check again; ``names`` say what each file is, and ``before`` are these files at the first check."""
    if path is None:
        return
    there, real = _status(str(path)), os.path.realpath(path)
    for name, what in names.items():
        states = before[name], _status(name)
        is_same = name != "-" and os.path.realpath(name) == real  # which need not exist yet
        if is_same or any(there and one and os.path.samestat(there, one) for one in states):
            shown = "standard input" if name == "-" else name
            raise UsageError(f"cannot write {path}: it is {what} {shown}; name another file")
    if there and not overwrite and (reason := _why_kept(path)):
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
