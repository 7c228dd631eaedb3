"""Exact reads from files, pipes, compressed files and files that still grow."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BufferedReader
from typing import IO, Final, cast

import zstandard

from contact_tracker.errors import UnreadableRecording

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
_BLOCK: Final = 2**20


@dataclass(frozen=True)
class Follow:
    """Wait at the end of a growing file for more, looking every ``poll_s`` seconds, until ``stop()``.

    ``stop`` may be called from another thread or from a signal handler.
    """

    poll_s: float = 0.02
    _stopped: threading.Event = field(default_factory=threading.Event)

    def stop(self) -> None:
        self._stopped.set()

    @property
    def stopped(self) -> bool:
        return self._stopped.is_set()

    def wait(self) -> bool:
        """Sleep for one poll interval; whether to look again."""
        return not self._stopped.wait(self.poll_s)


class ByteStream:
    """Reads exactly what is asked for, or less at the end; an error while reading is an end, too."""

    def __init__(self, file: IO[bytes], follow: Follow | None = None) -> None:
        self.position = 0
        self.error: str | None = None
        self._file = file
        self._follow = follow

    @property
    def follows(self) -> bool:
        return self._follow is not None

    @property
    def stopped(self) -> bool:
        return self._follow is not None and self._follow.stopped

    def read(self, count: int) -> bytes:
        """The next ``count`` bytes; fewer only where the input ends."""
        data = self._read_some(count)
        while len(data) < count:
            more = self._read_some(count - len(data))
            if more:
                data += more
            elif self.error or self._follow is None or not self._follow.wait():
                break
        self.position += len(data)
        return data

    def skip(self, count: int) -> bool:
        """Pass over ``count`` bytes; whether there were that many."""
        while count and (got := len(self.read(min(count, _BLOCK)))):
            count -= got
        return count == 0

    def seek(self, position: int) -> bool:
        """Go to ``position`` where the input allows it."""
        try:
            self.position = self._file.seek(position)
        except (OSError, ValueError, OverflowError):  # a pipe, or a position from a damaged index
            return False
        return True

    def _read_some(self, count: int) -> bytes:
        try:
            return self._file.read(count)
        except (OSError, zstandard.ZstdError, MemoryError) as error:
            self.error = str(error) or type(error).__name__
            return b""


@contextmanager
def open_stream(path: str, follow: Follow | None = None) -> Iterator[ByteStream]:
    """Open a file, a FIFO or, for ``-``, standard input; whole-file zstd compression is seen through.

    Raises
    ------
    UnreadableRecording
        If it cannot be opened.
    """
    try:
        file = cast(BufferedReader, sys.stdin.buffer) if path == "-" else open(path, "rb")  # noqa: SIM115
    except OSError as error:
        raise UnreadableRecording(error.strerror or str(error)) from error
    try:
        if follow is None and _starts_compressed(file):
            yield ByteStream(zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True))
        else:
            yield ByteStream(file, follow)
    finally:
        if path != "-":
            file.close()


def _starts_compressed(file: BufferedReader) -> bool:
    try:
        return file.peek(len(ZSTD_MAGIC)).startswith(ZSTD_MAGIC)
    except OSError as error:
        raise UnreadableRecording(error.strerror or str(error)) from error


def is_regular(path: str) -> bool:
    """Whether ``path`` can be read more than once and at any place."""
    return path != "-" and os.path.isfile(path)
