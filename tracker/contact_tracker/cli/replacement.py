"""What a command may replace: nothing that it reads, and a recording only when it is told to."""

import argparse
import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from contact_tracker.errors import UnreadableRecording, UsageError


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """``--overwrite``."""
    parser.add_argument("--overwrite", action="store_true", help="replace FILE even if it is a recording")


def files_read(logs: Iterable[str], model: str, known: str | None) -> list[str]:
    """The files that a command reads: all parts of ``logs``, the model, what is known with its meshes.

    Raises
    ------
    UnreadableRecording, KnowledgeError
        There is no such recording, or the file of what is known cannot be read.
    """
    from contact_tracker.config.loading import model_file
    from contact_tracker.prior_map_files.loading import files_named
    from contact_tracker.recording import parts_of

    parts = [part for log in logs for part in parts_of(log)]
    return [*parts, str(model_file(model)), *map(str, files_named(known) if known is not None else ())]


def check_output(path: Path | None, overwrite: bool, read: Iterable[str] = ()) -> None:
    """Refuse to write onto one of the files ``read``, whatever it is called, or onto a recording.

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
        raise UsageError(f"cannot write {path}: {reason}; --overwrite replaces it")


def _why_kept(path: Path) -> str | None:
    from contact_tracker.recording import may_be_recording

    try:
        return "it is a recording" if may_be_recording(str(path)) else None
    except (OSError, UnreadableRecording) as error:
        return f"it may be a recording, but cannot be read ({getattr(error, 'strerror', None) or error})"
