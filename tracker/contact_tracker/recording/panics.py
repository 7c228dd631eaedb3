"""Suppresses output of panics in Rust libraries, which print to the descriptor of stderr even if caught."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Final

_STDERR: Final = 2


class _Silence:
    """The number of active callers, and a copy of stderr's descriptor."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._callers = 0
        self._kept: int | None = None

    def begin(self) -> None:
        with self._lock:
            if not self._callers:
                self._kept = _closed_stderr()
            self._callers += 1

    def end(self) -> None:
        with self._lock:
            self._callers -= 1
            if not self._callers and self._kept is not None:
                os.dup2(self._kept, _STDERR)
                os.close(self._kept)


_SILENCE: Final = _Silence()


@contextmanager
def without_panics() -> Iterator[None]:
    """Discard output to the file descriptor of stderr within the context; errors are still raised.

    The threads of polars print a message, and with ``RUST_BACKTRACE`` a backtrace.
    """
    if sys.stderr is not None:
        sys.stderr.flush()
    _SILENCE.begin()
    try:
        yield
    finally:
        _SILENCE.end()


def _closed_stderr() -> int | None:
    """Redirect the descriptor to the null device; returns a copy of it, or None if that fails."""
    try:
        kept = os.dup(_STDERR)
    except OSError:
        return None
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
    except OSError:  # no free descriptors
        os.close(kept)
        return None
    os.dup2(nowhere, _STDERR)
    os.close(nowhere)
    return kept
