"""Exact reads from files, pipes, compressed files and growing files, and limits on the work they may cause.

A few compressed bytes can expand to gigabytes or millions of records. Recordings stay below these limits,
even of an object at rest without noise (``tests/recording/test_damaged_recordings.py``).
"""

import os
import stat
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import BufferedReader
from types import SimpleNamespace
from typing import IO, Final, cast

import zstandard

from contact_tracker.errors import UnreadableRecording

RECORD_LIMIT: Final = 256 * 2**20
"""Longest record, and longest decompressed chunk (bytes)."""
_CHUNK_BYTES: Final = 32 * 2**20
_CHUNK_RATIO: Final = 50
"""Largest decompressed size of a chunk (bytes), or its largest ratio to the compressed size."""
_TOTAL_BYTES: Final = 256 * 2**20
_TOTAL_RATIO: Final = 400
"""The same limits for all chunks together."""
BYTES_PER_RECORD: Final = 128
"""Bytes of a message or header that count as the work of one record."""
_MOST_RECORDS: Final = 40_000
_BYTES_OF_RECORD: Final = 12
"""Number of records that are always allowed, and number of bytes read that allow one more."""
SHARE_OF_RECORD: Final = 0.25
"""Work, in records, of a row of a compressed table, of a further pose in a message, or of a record outside of
chunks; uncompressed, each takes over twice ``_BYTES_OF_RECORD``."""
_DAMAGES_SHOWN: Final = 3
_ADVICE: Final = "if it is sound, write it without compression"


class TooMuchWork(ValueError):
    """A file exceeds the limits for its size."""


class WorkBudget:
    """Bytes read of a file, and the work that they have caused so far.

    Attributes
    ----------
    bytes_read : number of bytes read from the disk.
    is_message_left_out : whether a message was not decoded because of the limits.
    """

    def __init__(self, bytes_read: int = 0) -> None:
        self.bytes_read, self.is_message_left_out = bytes_read, False
        self._inflated, self._records = 0, 0.0

    def spend(self, records: float) -> None:
        """Count records, rows, poses, or work that takes as long. Beyond the limit, raises TooMuchWork and
        counts nothing, so that only the large item is left out."""
        if self._records + records > _MOST_RECORDS + self.bytes_read // _BYTES_OF_RECORD:
            raise TooMuchWork(f"more records than {self.bytes_read} bytes explain; {_ADVICE}")
        self._records += records

    def inflate(self, compressed: int, size: int) -> None:
        """Count the expansion of ``compressed`` bytes to ``size``; raises TooMuchWork as ``spend``."""
        self.check_record(compressed, size)
        if self._inflated + size > _TOTAL_BYTES + _TOTAL_RATIO * self.bytes_read:
            raise TooMuchWork(f"{self.bytes_read} bytes are to become {self._inflated + size}; {_ADVICE}")
        self._inflated += size

    def check_record(self, compressed: int, size: int) -> None:
        """Check one record or chunk of ``size`` bytes from ``compressed`` ones; raises TooMuchWork."""
        if size > min(max(_CHUNK_BYTES, _CHUNK_RATIO * compressed), RECORD_LIMIT):
            raise TooMuchWork(f"{compressed} bytes are to become {size}; {_ADVICE}")


class Notes:
    """What is noted of a recording while it is read, and the budget of this work.

    Attributes
    ----------
    part : name of the part of a folder that is read; empty for a file.
    assumption : one line on what was assumed about a table, or None.
    """

    def __init__(self) -> None:
        self.budget, self.part = WorkBudget(), ""
        self.assumption: str | None = None
        self._damages, self._more_damages = list[str](), 0

    def report(self, damage: str) -> None:
        """Note one line on what cannot be read."""
        if len(self._damages) < _DAMAGES_SHOWN:
            self._damages.append(f"{self.part}: {damage}" if self.part else damage)
        else:
            self._more_damages += 1

    def assume(self, text: str) -> None:
        """Note one line on an assumption."""
        self.assumption = text if self.assumption is None else f"{self.assumption}; {text}"

    @property
    def damage(self) -> str | None:
        """One line, or None without damage."""
        lines = list(self._damages)
        if self._more_damages:
            lines.append(f"and {self._more_damages} more")
        if self.budget.is_message_left_out:
            explained = f"{self.budget.bytes_read} bytes explain"
            lines.append(f"messages that take longer to decode than {explained} are left out; {_ADVICE}")
        return "; ".join(lines) or None


ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
TABLE_ENDINGS: Final = (
    *(".csv", ".tsv", ".txt", ".tum", ".dat", ".jsonl", ".json", ".parquet", ".pq", ".feather", ".arrow"),
    *(".npy", ".npz", ".mat", ".h5", ".hdf5", ".c3d"),
)
"""Usual suffixes of tables; text files with other suffixes may be tables as well."""
WHAT_IS_READ: Final = (
    "MCAP files, ROS bags (.db3, .bag), tables (CSV, TUM, JSON, Parquet, Feather, NumPy, MATLAB, HDF5), C3D "
    "with bodies, and exports of Motive, Vicon and Qualisys"
)
FROM_ARRAYS: Final = "contact_tracker.Trajectory.from_arrays(t, p, q) takes times, positions and rotations"
"""How poses are read that are in no such file."""
_UTF_16: Final = (b"\xff\xfe", b"\xfe\xff")
_CONTROLS: Final = bytes(set(range(32)) - set(b"\t\n\r\f") | {127})
_BLOCK: Final = 2**20
_TAIL: Final = 64
"""Number of the last bytes read of a followed file, which are compared once it has been written to."""


@dataclass(frozen=True)
class Follow:
    """Policy for growing files: poll every ``poll_s`` seconds at their end, until ``stop()``.

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
        """Sleep for one poll interval; returns whether to read again."""
        return not self._stopped.wait(self.poll_s)


class ByteStream:
    """Reads exactly the requested bytes, or fewer at the end; a read error counts as the end.

    Parameters
    ----------
    file : source of the bytes.
    budget : counts the bytes read, and bounds the decompressed size.
    follow : wait for more at the end of the file at ``path``.
    """

    def __init__(
        self,
        file: IO[bytes],
        budget: WorkBudget | None = None,
        follow: Follow | None = None,
        path: str = "",
        compressed: bool = False,
    ) -> None:
        self.position = 0
        self.error: str | None = None
        self.budget = budget or WorkBudget()
        self.follow = follow
        self._plain, self._path = file, path
        self._tail, self._written_ns = b"", 0
        self._inflated: IO[bytes] | None = None
        self._size: int | None = None
        with suppress(OSError):  # not every stream has a descriptor
            status = os.fstat(file.fileno())
            if stat.S_ISREG(status.st_mode) and follow is None and not compressed:
                self._size = status.st_size
        if compressed:
            counted = cast(IO[bytes], SimpleNamespace(read=self._read_plain))
            self._inflated = zstandard.ZstdDecompressor().stream_reader(counted, read_across_frames=True)

    @property
    def way_to_table(self) -> str:
        """Advice on how text in this stream can be read as a table."""
        if self._inflated is not None:
            return "decompress it: zstd -d"
        return (
            "name it .csv" if self._plain.seekable() else "save it to a file: tables are not read from a pipe"
        )

    def may_have(self, count: int) -> bool:
        """Whether ``count`` bytes may follow; known without reading if the file does not grow."""
        return self._size is None or self.position + count <= self._size

    def read(self, count: int) -> bytes:
        """The next ``count`` bytes; fewer only at the end of the input."""
        parts, missing = list[bytes](), count
        while missing:
            part = self._read_some(missing)
            missing -= len(part)
            if part:
                parts.append(part)
            elif self.error or self.follow is None or self._has_changed(True) or not self.follow.wait():
                break
        data = parts[0] if len(parts) == 1 else b"".join(parts)
        self.position += len(data)
        return data

    def take(self, count: int, is_read: bool) -> bytes | None:
        """The next ``count`` bytes, empty if they are skipped unread; None if there are fewer."""
        if not self.may_have(count):
            return None
        if is_read:
            data = self.read(count)
            return data if len(data) == count else None
        if self._size is not None and self.seek(self.position + count):
            self.budget.bytes_read += count
            return b""
        while count and (got := len(self.read(min(count, _BLOCK)))):
            count -= got
        return None if count else b""

    def seek(self, position: int) -> bool:
        """Go to ``position``; returns False if the input does not allow it."""
        try:
            self.position = (self._inflated or self._plain).seek(position)
            self._tail = b""
        except (OSError, ValueError, OverflowError):  # a pipe, or a position from a damaged index
            return False
        return True

    def _read_some(self, count: int) -> bytes:
        try:
            if self._inflated is None:
                if self._has_changed(False):
                    return b""
                data = self._read_plain(count)
                self._tail = (self._tail + data)[-_TAIL:] if self._path else b""
                return data
            self.budget.check_record(self.budget.bytes_read, count)
            part = self._inflated.read(min(count, _BLOCK))
            self.budget.inflate(self.budget.bytes_read, len(part))
            return part
        except (OSError, TooMuchWork, zstandard.ZstdError, MemoryError) as error:
            self.error = str(error) or type(error).__name__
            return b""

    def _read_plain(self, count: int) -> bytes:
        data = self._plain.read(count)
        self.budget.bytes_read += len(data)
        return data

    def _has_changed(self, is_at_end: bool) -> bool:
        """Whether the followed file was rewritten in place, so that the bytes read last differ, or, at its
        end, was replaced, removed or shortened."""
        if not self._path:
            return False
        opened = os.fstat(self._plain.fileno())
        try:
            current = os.stat(self._path)
            if is_at_end and not os.path.samestat(current, opened):
                self.error = "it was replaced by another file while it was followed"
            elif is_at_end and stat.S_ISREG(current.st_mode) and current.st_size < self._plain.tell():
                self.error = "it became shorter while it was followed"
            elif stat.S_ISREG(opened.st_mode) and opened.st_mtime_ns != self._written_ns:
                self._written_ns = opened.st_mtime_ns
                with open(self._path, "rb") as again:
                    again.seek(self._plain.tell() - len(self._tail))
                    tail = again.read(len(self._tail))
                if len(tail) == len(self._tail) and tail != self._tail:
                    self.error = "it was written anew while it was followed"
        except OSError:
            self.error = "it was removed while it was followed" if is_at_end else None
        return self.error is not None


@contextmanager
def open_stream(
    path: str, follow: Follow | None = None, budget: WorkBudget | None = None
) -> Iterator[ByteStream]:
    """Open a file, a FIFO or, for ``-``, standard input; a file that is compressed with zstd is decompressed.

    Streams of one recording share the ``budget``. Raises UnreadableRecording if the file cannot be opened.
    """
    try:
        file = cast(BufferedReader, sys.stdin.buffer) if path == "-" else open(path, "rb")  # noqa: SIM115
        is_compressed = follow is None and file.peek(len(ZSTD_MAGIC)).startswith(ZSTD_MAGIC)
    except OSError as error:
        raise UnreadableRecording(error.strerror or str(error)) from error
    try:
        followed = path if follow is not None and path != "-" else ""
        yield ByteStream(file, budget, follow, followed, is_compressed)
    finally:
        if path != "-":
            file.close()


def is_regular(path: str) -> bool:
    """Whether ``path`` can be read repeatedly and at any position."""
    return path not in ("", "-") and os.path.isfile(path)


def first_bytes(path: str, count: int = 4096) -> bytes:
    """The first bytes of a file, which identify its format; empty if it can be read only once, or not."""
    with suppress(OSError):
        if is_regular(path):
            with open(path, "rb") as file:
                return file.read(count)
    return b""


def encoding_of(begin: bytes) -> str:
    """The encoding of text with these first bytes."""
    if begin.startswith(_UTF_16):
        return "utf-16"
    try:
        begin[:-4].decode()
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def is_text(begin: bytes, path: str = "") -> bool:
    """Whether a file with these first bytes is text; in other encodings than UTF-8 and UTF-16, only if its
    name has the suffix of a table."""
    encoding = encoding_of(begin)
    if encoding == "utf-16":
        return True
    has_controls = len(begin.translate(None, _CONTROLS)) < len(begin)
    is_known = encoding != "latin-1" or path.lower().endswith(TABLE_ENDINGS)
    return bool(begin) and not has_controls and is_known
