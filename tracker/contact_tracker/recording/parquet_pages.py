"""Checks the declared sizes of a Parquet file's pages before a library decompresses them.

A few bytes can expand to billions of rows or to gigabytes. Footer and page headers are in Thrift's compact
protocol: https://parquet.apache.org/docs/file-format/
"""

import os
import struct
from collections.abc import Iterator, Mapping, Set
from typing import IO, Any, Final

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.bytestream import TooMuchWork, WorkBudget

PARQUET_MAGIC: Final = b"PAR1"
_END: Final = struct.Struct("<I4s")
_PAGE_HEADER: Final = 2**16
"""Longest page header (bytes); it may contain statistics of long texts."""
_DEEPEST: Final = 16
_TEXTS: Final = (6, 7)
"""Physical types of columns of texts."""
_WHOLE: Final = (0, 6)
"""Encodings in which each text is there in full; in others many values may share a long one."""
_MOST_SHARED: Final = 2**28
"""Most bytes that texts in other encodings may become."""
_VALUES_PER_ROW: Final = 7
"""Values of lists that count as a row: a pose has as many."""
_BOOLEANS, _NUMBERS, _DOUBLE, _BINARY, _LISTS, _STRUCT = (1, 2), (3, 4, 5, 6), 7, 8, (9, 10), 12
_Struct = Mapping[int, Any]
"""The fields of a Thrift struct by number."""


def check_pages(path: str, names: Set[str], bodies: int, budget: WorkBudget) -> None:
    """Check the columns of these names in a file with ``bodies`` bodies.

    Raises
    ------
    UnreadableRecording
        Columns or rows exceed the limits for the file's size, or page headers cannot be parsed.
    """
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        try:
            for group in _footer(file, size).get(4, ()):
                budget.count_rows(group[3] * bodies)
                chosen = [column for column in group[1] if _name(column) in names]
                pages = list[tuple[int, int]]()
                for column in chosen:
                    if len(column[3][3]) > 1:  # lists have more values than there are rows
                        budget.count_rows(column[3][5] // _VALUES_PER_ROW)
                    for page in _pages(file, column[3], group[3], size):
                        budget.count_records(1)  # several columns may name the same pages
                        pages.append(page)
                if pages:
                    budget.inflate(sum(packed for packed, _ in pages), sum(plain for _, plain in pages))
        except TooMuchWork as error:
            raise UnreadableRecording(f"it is too much for its size: {error}") from error
        except (ValueError, LookupError, TypeError, struct.error, AttributeError, RecursionError) as error:
            raise UnreadableRecording(
                f"it is damaged: where its pages begin cannot be read ({error})"
            ) from error


def _footer(file: IO[bytes], size: int) -> _Struct:
    file.seek(max(size - _END.size, 0))
    length, magic = _END.unpack(file.read(_END.size))
    if magic != PARQUET_MAGIC or length > size - _END.size:
        raise ValueError("it has no footer")
    file.seek(size - _END.size - length)
    return _Thrift(file.read(length)).struct()


def _name(column: _Struct) -> str:
    if column.get(1):
        raise ValueError("its columns are in other files")
    return str(column[3][3][0].decode(errors="replace"))


def _pages(file: IO[bytes], column: _Struct, rows: int, size: int) -> Iterator[tuple[int, int]]:
    """Stored and decompressed bytes of each page of a column."""
    at = min(column[9], column.get(11) or column[9])
    end = at + column[7]
    if not 0 < at <= end <= size or (column[5] > rows and len(column[3]) == 1):
        raise ValueError("a column is elsewhere, or has more values than there are rows")
    values = longest = shared = 0
    while at < end:
        file.seek(at)
        header = _Thrift(file.read(min(_PAGE_HEADER, end - at)))
        page = header.struct()
        plain, packed = page[2], page[3]
        of_data = page.get(5) or page.get(8)
        values += of_data[1] if of_data else 0
        if plain < 0 or packed < 0 or (of_data or page.get(7) or {1: 0})[1] < 0 or values > column[5]:
            raise ValueError("a page has more values than its column")
        at += header.at + packed
        longest = max(longest, plain)
        if column[1] in _TEXTS and of_data and of_data[2 if page.get(5) else 4] not in _WHOLE:
            shared += of_data[1] * longest
        if shared > _MOST_SHARED:
            raise UnreadableRecording(
                f"its column {column[3][0].decode(errors='replace')} is text: write numbers"
            )
        yield header.at + packed, plain
    if at != end:
        raise ValueError("a page is longer than its column")


class _Thrift:
    """Parser of the compact protocol; raises LookupError or ValueError for truncated or invalid data."""

    def __init__(self, data: bytes) -> None:
        self.at = 0
        self._data = data
        self._depth = 0

    def struct(self) -> _Struct:
        fields, number = dict[int, Any](), 0
        self._depth += 1
        if self._depth > _DEEPEST:
            raise ValueError("too deep")
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._signed()
            fields[number] = self._value(head & 15)
        self._depth -= 1
        return fields

    def _value(self, kind: int) -> Any:
        if kind in _BOOLEANS:
            return kind == _BOOLEANS[0]
        if kind == _NUMBERS[0]:
            return self._byte()
        if kind in _NUMBERS:
            return self._signed()
        if kind == _DOUBLE:
            return self._take(8)
        if kind == _BINARY:
            return self._take(self._unsigned())
        if kind in _LISTS:
            return self._list()
        if kind == _STRUCT:
            return self.struct()
        raise ValueError(f"a field of the kind {kind}")

    def _list(self) -> list[Any]:
        head = self._byte()
        count, kind = head >> 4, head & 15
        count = self._unsigned() if count == 15 else count
        if count > len(self._data) - self.at:
            raise ValueError("a list is longer than what is left")
        if kind in _BOOLEANS:
            return list(self._take(count))
        return [self._value(kind) for _ in range(count)]

    def _byte(self) -> int:
        byte = self._data[self.at]
        self.at += 1
        return byte

    def _take(self, count: int) -> bytes:
        if count > len(self._data) - self.at:
            raise ValueError("it is cut off")
        self.at += count
        return self._data[self.at - count : self.at]

    def _unsigned(self) -> int:
        number = shift = 0
        while True:
            byte = self._byte()
            number |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return number
            if shift > 63:
                raise ValueError("a number is too long")

    def _signed(self) -> int:
        number = self._unsigned()
        return (number >> 1) ^ -(number & 1)
