"""How much work a file may cause: bounded by the bytes that were read of it.

Compression lets a few bytes claim gigabytes, or millions of records. Poses stay below these bounds even where
an object rests and is written without noise (``tests/recording/test_damaged_recordings.py``).
"""

from typing import Final

RECORD_LIMIT: Final = 256 * 2**20
"""No record, and no chunk when it is decompressed, is longer."""
_CHUNK_BYTES: Final = 32 * 2**20
_CHUNK_RATIO: Final = 50
"""A chunk may become that long, or so many times as long as it is."""
_TOTAL_BYTES: Final = 256 * 2**20
_TOTAL_RATIO: Final = 400
"""The same of all chunks together."""
_RECORDS: Final = 40_000
_BYTES_PER_RECORD: Final = 12
"""So many records are in chunks, and one more for so many bytes that were read."""
BYTES_PER_RECORD: Final = 128
"""So many bytes of a message, or of a header, are as much work as a record."""
_BYTES_PER_FRAME: Final = 4
"""The same of records outside of chunks: without compression each takes more than twice as many."""
_ROWS: Final = 100_000
_BYTES_PER_ROW: Final = 4
"""The same of rows of tables that are compressed: they are read in columns."""
_ADVICE: Final = "if it is sound, decompress the file first"


class TooMuchWork(ValueError):
    """A chunk holds more than its size explains."""


class WorkBudget:
    """What was read of a file, and what it has become so far."""

    def __init__(self) -> None:
        self._read = 0
        self._inflated = 0
        self._records = 0
        self._rows = 0
        self._framed = 0

    def count_read(self, count: int) -> None:
        """So many bytes more were read from the file, as they lie on the disk."""
        self._read += count

    def inflate(self, compressed: int, size: int) -> None:
        """``compressed`` bytes are to become ``size``; raises TooMuchWork, and nothing is counted."""
        self.check_record(compressed, size)
        if self._inflated + size > _TOTAL_BYTES + _TOTAL_RATIO * self._read:
            raise TooMuchWork(f"{self._read} bytes are to become {self._inflated + size}; {_ADVICE}")
        self._inflated += size

    def check_record(self, compressed: int, size: int) -> None:
        """One record, or chunk, of ``size`` bytes comes out of so many; raises TooMuchWork."""
        if size > min(max(_CHUNK_BYTES, _CHUNK_RATIO * compressed), RECORD_LIMIT):
            raise TooMuchWork(f"{compressed} bytes are to become {size}; {_ADVICE}")

    @property
    def bytes_read(self) -> int:
        """As they lie on the disk."""
        return self._read

    def count_records(self, many: int) -> None:
        """So many records, or poses in them, are to be looked at; raises TooMuchWork."""
        self._records += many
        if self._records > _RECORDS + self._read // _BYTES_PER_RECORD:
            raise TooMuchWork(f"more records than {self._read} bytes explain; {_ADVICE}")

    def count_framed(self) -> None:
        """One record more lies outside of chunks: the whole file may be compressed; raises TooMuchWork."""
        self._framed += 1
        if self._framed > _RECORDS + self._read // _BYTES_PER_FRAME:
            raise TooMuchWork(f"more records than {self._read} bytes explain; {_ADVICE}")

    def count_rows(self, many: int) -> None:
        """So many rows of a compressed table, for each body in it, are to be read; raises TooMuchWork."""
        self._rows += many
        if self._rows > _ROWS + self._read // _BYTES_PER_ROW:
            raise TooMuchWork(f"more rows than {self._read} bytes explain; if it is sound, write it as CSV")
