"""Limits on the work that a file may cause, in proportion to the bytes read.

Compressed, a few bytes can expand to gigabytes or millions of records. Poses stay below these limits even of
an object at rest that is recorded without noise (``tests/recording/test_damaged_recordings.py``).
"""

from typing import Final

RECORD_LIMIT: Final = 256 * 2**20
"""Longest record, and longest decompressed chunk (bytes)."""
_CHUNK_BYTES: Final = 32 * 2**20
_CHUNK_RATIO: Final = 50
"""A chunk may expand to this size (bytes), or by this factor."""
_TOTAL_BYTES: Final = 256 * 2**20
_TOTAL_RATIO: Final = 400
"""The same for all chunks together."""
_RECORDS: Final = 40_000
_BYTES_PER_RECORD: Final = 12
"""Records in chunks that are always allowed, and bytes read for each further one."""
BYTES_PER_RECORD: Final = 128
"""Bytes of a message or header that count as the work of one record."""
_RECORDS_PER_DEFINITION: Final = 64
"""Records whose work a definition takes, whatever its length."""
_DEFINITION_BYTES_PER_RECORD: Final = 8
"""Bytes of a definition that count as the work of one record more."""
_BYTES_PER_FRAME: Final = 4
"""Bytes read for each further record outside of chunks: uncompressed, each takes over twice as many bytes."""
_ROWS: Final = 100_000
_BYTES_PER_ROW: Final = 4
"""The same for rows of compressed tables, which are read in columns."""
_ADVICE: Final = "if it is sound, decompress the file first"


class TooMuchWork(ValueError):
    """A file exceeds the limits for its size."""


class WorkBudget:
    """Bytes read of a file, and the work that they have caused so far."""

    def __init__(self) -> None:
        self._read = 0
        self._inflated = 0
        self._records = 0
        self._rows = 0
        self._framed = 0
        self._defined = 0
        self._is_message_left_out = False

    def count_read(self, count: int) -> None:
        """Count bytes read from the disk."""
        self._read += count

    def inflate(self, compressed: int, size: int) -> None:
        """Count the expansion of ``compressed`` bytes to ``size``; raises TooMuchWork, then nothing is
        counted."""
        self.check_record(compressed, size)
        if self._inflated + size > _TOTAL_BYTES + _TOTAL_RATIO * self._read:
            raise TooMuchWork(f"{self._read} bytes are to become {self._inflated + size}; {_ADVICE}")
        self._inflated += size

    def check_record(self, compressed: int, size: int) -> None:
        """Check one record or chunk of ``size`` bytes from ``compressed`` ones; raises TooMuchWork."""
        if size > min(max(_CHUNK_BYTES, _CHUNK_RATIO * compressed), RECORD_LIMIT):
            raise TooMuchWork(f"{compressed} bytes are to become {size}; {_ADVICE}")

    @property
    def bytes_read(self) -> int:
        """Bytes read from the disk."""
        return self._read

    @property
    def _explained_records(self) -> int:
        return _RECORDS + self._read // _BYTES_PER_RECORD

    def count_records(self, many: int) -> None:
        """Count records, or poses in them; raises TooMuchWork, then nothing is counted: only what takes too
        long is left out."""
        if self._records + many > self._explained_records:
            raise TooMuchWork(f"more records than {self._read} bytes explain; {_ADVICE}")
        self._records += many

    def count_definition(self, size: int) -> None:
        """Count a message definition of ``size`` bytes, apart from messages, which may be read before; raises
        TooMuchWork, then nothing is counted."""
        work = _RECORDS_PER_DEFINITION + size // _DEFINITION_BYTES_PER_RECORD
        if self._defined + work > self._explained_records:
            raise TooMuchWork(f"longer definitions than {self._read} bytes explain; {_ADVICE}")
        self._defined += work

    def leave_out_message(self) -> None:
        """Note that a message is not decoded, as that would exceed the limits."""
        self._is_message_left_out = True

    @property
    def damage(self) -> str | None:
        """One line if messages were left out."""
        if not self._is_message_left_out:
            return None
        return f"messages that take longer to decode than {self._read} bytes explain are left out; {_ADVICE}"

    def count_framed(self) -> None:
        """Count a record outside of chunks, as the whole file may be compressed; raises TooMuchWork."""
        self._framed += 1
        if self._framed > _RECORDS + self._read // _BYTES_PER_FRAME:
            raise TooMuchWork(f"more records than {self._read} bytes explain; {_ADVICE}")

    def count_rows(self, many: int) -> None:
        """Count rows of a compressed table, once for each body in it; raises TooMuchWork."""
        self._rows += many
        if self._rows > _ROWS + self._read // _BYTES_PER_ROW:
            raise TooMuchWork(f"more rows than {self._read} bytes explain; if it is sound, write it as CSV")
