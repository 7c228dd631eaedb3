"""What Rust prints when a library of it panics, which no exception handler can take back."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Final

_STDERR: Final = 2


class _Silence:
    """How many callers want it quiet at the moment, and where stderr goes otherwise."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._callers = 0
        self._kept: int | None = None

    def begin(self) -> None:
        with self._lock:
            self._callers += 1
            if self._callers == 1:
                self._kept = _closed_stderr()

    def end(self) -> None:
        with self._lock:
            self._callers -= 1
            if not self._callers and self._kept is not None:
                os.dup2(self._kept, _STDERR)
                os.close(self._kept)


_SILENCE: Final = _Silence()


@contextmanager
def without_panics() -> Iterator[None]:
    """Send what is printed to the file descriptor of stderr nowhere, meanwhile; the error is raised as well.

    The threads of polars print it: a message, and a backtrace where ``RUST_BACKTRACE`` asks for one.
    """
    if sys.stderr is not None:
        sys.stderr.flush()
    _SILENCE.begin()
    try:
        yield
    finally:
        _SILENCE.end()


def _closed_stderr() -> int | None:
    """A copy of the descriptor, which itself leads nowhere now; None where there is none."""
    try:
        kept = os.dup(_STDERR)
    except OSError:
        return None
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, _STDERR)
    os.close(nowhere)
    return kept
