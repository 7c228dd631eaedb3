"""Bags: ``.bag`` files of ROS 1 (version 2.0), with or without index, and ``.db3`` files of rosbag2.

A record of a ``.bag`` file is a header of named fields, and data. See http://wiki.ros.org/Bags/Format/2.0. A
database can define tables by expressions that run when they are read: an authorizer allows only plain tables
here, and the work is bounded.
"""

import bz2
import os
import sqlite3
import struct
from bisect import bisect
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, suppress
from typing import Any, Final, NamedTuple
from urllib.parse import quote

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.bytestream import (
    BYTES_PER_RECORD,
    RECORD_LIMIT,
    ByteStream,
    TooMuchWork,
    WorkBudget,
    open_stream,
)
from contact_tracker.recording.items import Channel, RawMessage, in_log_order
from contact_tracker.recording.mcap_file import PARSE_ERRORS, inflate_lz4

BAG_MAGIC: Final = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 5, 6, 7
_BZ2_WORK: Final = 4
"""Time to decompress a byte of bz2, relative to zstd or lz4."""
_LENGTH: Final = struct.Struct("<I")
_TIME: Final = struct.Struct("<II")
_SECOND_NS: Final = 1_000_000_000


class _Record(NamedTuple):
    """A record with the ``fields`` of its header by name."""

    fields: dict[bytes, bytes]
    data: bytes

    @property
    def kind(self) -> int:
        return self.fields[b"op"][0]

    def number(self, name: bytes) -> int:
        return int.from_bytes(self.fields[name], "little")

    def time_ns(self, name: bytes) -> int:
        seconds, nanoseconds = _TIME.unpack(self.fields[name])
        return int(seconds * _SECOND_NS + nanoseconds)


def read_rosbag1(
    path: str, wanted: Callable[[Channel], bool], report: Callable[[str], None], budget: WorkBudget
) -> Iterator[RawMessage]:
    """The messages of a ``.bag`` file by log time; without an index in the order of its chunks.

    Parameters
    ----------
    wanted : messages of other channels are skipped unread.
    report : called with one line for each part that cannot be read.

    Raises
    ------
    UnreadableRecording
        It does not begin like a bag, or is encrypted.
    """
    with open_stream(path, budget=budget) as stream:
        bag = _Bag(stream, wanted, report)
        chunks = bag.indexed_chunks()
        if chunks is None:
            yield from bag.messages_as_written()
        else:
            yield from in_log_order((begin_ns, bag.messages_at(place)) for begin_ns, place in chunks)


class _Bag:
    def __init__(
        self, stream: ByteStream, wanted: Callable[[Channel], bool], report: Callable[[str], None]
    ) -> None:
        self._stream = stream
        self._wanted = wanted
        self._report = report
        self._channels: dict[int, Channel | None] = {}
        if stream.read(len(BAG_MAGIC)) != BAG_MAGIC:
            raise UnreadableRecording("it is not a bag of version 2.0: convert it with rosbag fix")
        try:
            self._head = self._record()
            is_head = self._head.kind == _BAG
        except (*PARSE_ERRORS, EOFError):
            is_head = False
        if not is_head:
            raise UnreadableRecording("it is damaged: its first record cannot be read")
        if self._head.fields.get(b"encryptor"):
            raise UnreadableRecording("its messages are encrypted: decrypt it with rosbag decrypt")
        self._begin = stream.position
        self._chunks: list[tuple[int, int]] = []
        self._overlaps = False

    def indexed_chunks(self) -> list[tuple[int, int]] | None:
        """First log time and offset of each chunk, by log time; None without an index."""
        chunks = dict[int, int]()
        with suppress(*PARSE_ERRORS, EOFError):
            place = self._head.number(b"index_pos")
            if place and self._stream.seek(place):
                for _ in range(self._head.number(b"conn_count")):
                    self._note_connection(self._record())
                for _ in range(self._head.number(b"chunk_count")):
                    info = self._record()
                    if info.kind == _CHUNK_INFO:
                        chunks[info.number(b"chunk_pos")] = info.time_ns(b"start_time")
                return sorted((begin_ns, place) for place, begin_ns in chunks.items())
        self._report("it has no index, as when recording was cut off: it is read as it was written")
        self._stream.seek(self._begin)
        return None

    def messages_at(self, place: int) -> list[RawMessage]:
        """The messages of the chunk at an offset, by log time."""
        try:
            if self._overlaps:
                return []
            if self._stream.seek(place):
                record = self._record()
                if self._is_read_before(place, self._stream.position):
                    self._overlaps = True
                    self._report(f"the chunk at byte {place} is part of another one: no more are read")
                    return []
                return self._messages(record, place)
            self._report(f"no chunk is at byte {place}")
        except (*PARSE_ERRORS, EOFError) as error:
            self._report(f"unreadable chunk at byte {place} ({_line(error)})")
        return []

    def _is_read_before(self, begin: int, end: int) -> bool:
        """Whether a chunk overlaps one that was read; if not, it is marked as read."""
        at = bisect(self._chunks, (begin, end))
        before, after = self._chunks[at - 1 : at], self._chunks[at : at + 1]
        if any(begin < other_end and other < end for other, other_end in (*before, *after)):
            return True
        self._chunks.insert(at, (begin, end))
        return False

    def messages_as_written(self) -> Iterator[RawMessage]:
        """The messages of one chunk after the other, each by log time."""
        while True:
            place = self._stream.position
            try:
                record = self._record()
            except EOFError as error:
                if str(error):
                    self._report(f"{error} at byte {place}")
                return
            except PARSE_ERRORS as error:
                self._report(f"it is damaged at byte {place} ({_line(error)})")
                return
            yield from self._messages(record, place)

    def _messages(self, record: _Record, place: int) -> list[RawMessage]:
        """The messages of a chunk, up to any damage."""
        found = list[RawMessage]()
        try:
            found.extend(self._messages_of(record))
        except PARSE_ERRORS as error:
            self._report(f"unreadable record at byte {place} ({_line(error)})")
        return sorted(found, key=lambda message: message.log_time_ns)

    def _messages_of(self, record: _Record) -> Iterator[RawMessage]:
        """The messages of a chunk one by one; raises one of PARSE_ERRORS at damage."""
        if record.kind == _CONNECTION:
            self._note_connection(record)
        elif record.kind == _MESSAGE:
            yield from self._message(record)
        elif record.kind == _CHUNK:
            budget, data, at = self._stream.budget, self._inflated(record), 0
            while at < len(data):
                part, at = _record_at(data, at)
                budget.count_records(1)
                if part.kind == _CONNECTION:
                    self._note_connection(part)
                elif part.kind == _MESSAGE:
                    yield from self._message(part)

    def _message(self, record: _Record) -> Iterator[RawMessage]:
        channel = self._channels.get(record.number(b"conn"))
        if channel is not None:
            yield RawMessage(channel, record.time_ns(b"time"), record.data)

    def _note_connection(self, record: _Record) -> None:
        number = record.number(b"conn")
        if number in self._channels:
            return
        about = _fields(record.data)
        text = about.get(b"message_definition", b"")
        topic = record.fields[b"topic"].decode(errors="replace")
        channel = Channel(topic, "ros1", about[b"type"].decode(errors="replace"), "ros1msg", text)
        self._channels[number] = channel if self._wanted(channel) else None

    def _inflated(self, chunk: _Record) -> bytes:
        budget, data, size = self._stream.budget, chunk.data, chunk.number(b"size")
        match chunk.fields[b"compression"]:
            case b"none":
                return data
            case b"lz4":
                budget.inflate(len(data), size)
                found = inflate_lz4(data, size)
            case b"bz2":
                budget.check_record(len(data), size)
                budget.inflate(_BZ2_WORK * len(data), _BZ2_WORK * size)
                found = _inflate_bz2(data, size)
            case unknown:
                raise ValueError(f"unknown compression {unknown!r}")
        if len(found) != size:
            raise ValueError(f"{len(found)} bytes where {size} were promised")
        return found

    def _record(self) -> _Record:
        """The next record of the file; raises EOFError at its end, with a message if it is truncated."""
        parts = list[bytes]()
        for _ in range(2):
            head = self._stream.read(_LENGTH.size)
            if not head and not parts:
                raise EOFError
            size = _LENGTH.unpack(head)[0] if len(head) == _LENGTH.size else RECORD_LIMIT
            part = self._stream.read(size) if size < RECORD_LIMIT else b""
            if len(part) != size:
                raise EOFError("it is cut off")
            parts.append(part)
        self._stream.budget.count_records(1 + len(parts[0]) // BYTES_PER_RECORD)
        return _Record(_fields(parts[0]), parts[1])


def _inflate_bz2(data: bytes, limit: int) -> bytes:
    """At most ``limit`` bytes; raises ValueError where the data is damaged."""
    try:
        return bz2.BZ2Decompressor().decompress(data, limit)
    except OSError as error:  # else it would look as if the file could not be read
        raise ValueError(f"its bz2 data is damaged: {error}") from error


def _record_at(data: bytes, at: int) -> tuple[_Record, int]:
    """The record of a chunk at an offset, and the offset of the next one."""
    parts = list[bytes]()
    for _ in range(2):
        (size,) = _LENGTH.unpack_from(data, at)
        at += _LENGTH.size
        if size > len(data) - at:
            raise ValueError("a record is longer than its chunk")
        parts.append(data[at : at + size])
        at += size
    return _Record(_fields(parts[0]), parts[1]), at


def _fields(header: bytes) -> dict[bytes, bytes]:
    fields, at = dict[bytes, bytes](), 0
    while at < len(header):
        (size,) = _LENGTH.unpack_from(header, at)
        at += _LENGTH.size
        name, equals, value = header[at : at + size].partition(b"=")
        if not equals or size > len(header) - at:
            raise ValueError("a field of a header cannot be read")
        fields[name] = value
        at += size
    return fields


def _line(error: BaseException) -> str:
    if isinstance(error, KeyError):
        return f"a header has no field {error.args[0].decode(errors='replace')}"
    return (str(error) or type(error).__name__).splitlines()[0]


_TABLES: Final = frozenset({"messages", "topics", "message_definitions"})
_HIDDEN: Final = 6
"""Index in ``table_xinfo`` of whether a column is hidden or generated."""
_STEPS: Final = 10_000
"""Steps of the virtual machine between checks of their number."""
_LEAST_STEPS: Final = 50_000_000
_STEPS_PER_BYTE: Final = 20
_ERRORS: Final = (sqlite3.Error, UnicodeDecodeError)
"""Of SQLite; the second where its message would quote bytes that are no text."""
_MOST_NAMED: Final = 500
"""With more topics all messages are read and filtered afterwards."""


def read_sqlite(
    path: str, wanted: Callable[[Channel], bool], report: Callable[[str], None], budget: WorkBudget
) -> Iterator[RawMessage]:
    """The messages of a ``.db3`` file by log time; parameters as of ``read_rosbag1``.

    Raises
    ------
    UnreadableRecording
        It is not a database of rosbag2.
    """
    size = os.path.getsize(path)
    budget.count_read(size)
    if os.path.exists(f"{path}-wal") and os.path.getsize(f"{path}-wal"):
        report("its last messages are in a write-ahead log that is not read: open it once with sqlite3")
    try:
        with closing(_opened(path, size)) as file:
            _check_tables(file)
            topics = _channels(file, report)
            chosen = {number: channel for number, channel in topics.items() if wanted(channel)}
            try:
                yield from _messages(file, chosen, budget, size)
            except (*_ERRORS, TooMuchWork) as error:
                report(f"it is damaged: {_words(error)}")
    except _ERRORS as error:
        raise UnreadableRecording(f"it cannot be opened as a rosbag2 database: {_words(error)}") from error


def _words(error: Exception) -> str:
    return "its tables are malformed" if isinstance(error, UnicodeDecodeError) else str(error)


def _opened(path: str, size: int) -> sqlite3.Connection:
    uri = f"file:{quote(os.path.abspath(path))}?mode=ro&immutable=1"
    file = sqlite3.connect(uri, uri=True, isolation_level=None)
    file.text_factory = lambda data: data.decode(errors="replace")
    file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, RECORD_LIMIT)
    for pragma in ("trusted_schema = off", "cell_size_check = on", "mmap_size = 0"):
        file.execute(f"pragma {pragma}")
    left = (_LEAST_STEPS + _STEPS_PER_BYTE * size) // _STEPS

    def count_steps() -> int:
        nonlocal left
        left -= 1
        return left < 0

    file.set_progress_handler(count_steps, _STEPS)
    return file


def _check_tables(file: sqlite3.Connection) -> None:
    """Raise UnreadableRecording unless all tables of rosbag2 exist and are plain."""
    found = dict(file.execute("select name, type from sqlite_master").fetchall())
    missing = {"messages", "topics"} - found.keys()
    if missing:
        raise UnreadableRecording(f"it is no database of rosbag2: it has no table {min(missing)}")
    for name in _TABLES & found.keys():
        columns = file.execute(f"pragma table_xinfo({name})").fetchall()
        if found[name] != "table" or any(column[_HIDDEN] for column in columns):
            raise UnreadableRecording(f"it is no database of rosbag2: {name} is no plain table")
    file.set_authorizer(_allowed)


def _allowed(action: int, table: str | None, column: str | None, *_: Any) -> int:
    is_select = action == sqlite3.SQLITE_SELECT
    is_read = action == sqlite3.SQLITE_READ and table in _TABLES | {"sqlite_master"}
    return sqlite3.SQLITE_OK if is_select or is_read else sqlite3.SQLITE_DENY


def _channels(file: sqlite3.Connection, report: Callable[[str], None]) -> Mapping[int, Channel]:
    definitions = dict[str, tuple[str, str]]()
    is_defined = "select name from sqlite_master where name = 'message_definitions'"
    if file.execute(is_defined).fetchone():
        columns = "topic_type, encoding, encoded_message_definition"
        for kind, *definition in file.execute(f"select {columns} from message_definitions"):
            definitions[str(kind)] = str(definition[0]), str(definition[1])
    channels, unreadable = dict[int, Channel](), 0
    for number, *about in file.execute("select id, name, type, serialization_format from topics"):
        if not all(isinstance(one, str) for one in about):
            unreadable += 1
            continue
        topic, kind, encoding = about
        schema_encoding, text = definitions.get(kind, ("", ""))
        channels[number] = Channel(topic, encoding, kind, schema_encoding, text.encode())
    if unreadable:
        report(f"it is damaged: {unreadable} of its topics cannot be read")
    return channels


def _messages(
    file: sqlite3.Connection, channels: Mapping[int, Channel], budget: WorkBudget, size: int
) -> Iterator[RawMessage]:
    """The messages by log time, while they are together no longer than the file of ``size`` bytes: pages that
    refer to themselves, or to one another, make any number of long ones.

    They are fetched one by one after sorting, which would keep them all.
    """
    which = f"where topic_id in ({', '.join('?' * len(channels))})" if len(channels) <= _MOST_NAMED else ""
    rows = file.execute(
        f"select topic_id, timestamp, rowid from messages {which} order by timestamp",
        [*channels] if which else [],
    )
    fetch = file.cursor()
    for number, log_time_ns, row in rows:
        budget.count_records(1)
        channel = channels.get(number)
        if channel is None or not isinstance(log_time_ns, int):
            continue
        found = fetch.execute("select data from messages where rowid = ?", [row]).fetchone()
        if found is not None and isinstance(found[0], bytes):
            size -= len(found[0])
            if size < 0:
                raise TooMuchWork("its messages are longer than the file")
            yield RawMessage(channel, max(log_time_ns, 0), found[0])
