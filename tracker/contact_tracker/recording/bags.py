"""Bags: ``.bag`` files of ROS 1 (version 2.0), with or without index, and ``.db3`` files of rosbag2.

A record of a ``.bag`` file is a header of named fields, and data. See http://wiki.ros.org/Bags/Format/2.0.
Its chunks are found from record to record, so that each is read once, whatever the index says; the index
orders them by time. A database can define tables by expressions that run when they are read: an authorizer
allows only plain columns, and the work is bounded.
"""

import os
import sqlite3
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from itertools import count
from typing import Final
from urllib.parse import quote

from contact_tracker.errors import UnreadableRecording, first_line
from contact_tracker.recording.bytestream import (
    BYTES_PER_RECORD,
    RECORD_LIMIT,
    ByteStream,
    Notes,
    TooMuchWork,
    WorkBudget,
    open_stream,
)
from contact_tracker.recording.items import Channel, Item, RawMessage, in_log_order
from contact_tracker.recording.mcap_file import PARSE_ERRORS, decompress

BAG_MAGIC: Final = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 5, 6, 7
_LENGTH: Final = struct.Struct("<I")
_TIME: Final = struct.Struct("<II")


class _Header(dict[bytes, bytes]):
    """The fields of a record by name; raises ValueError if a field is missing or cannot be read."""

    def __init__(self, data: bytes) -> None:
        at = 0
        while at < len(data):
            size = int.from_bytes(data[at : at + _LENGTH.size], "little")
            at += _LENGTH.size + size
            name, equals, value = data[at - size : at].partition(b"=")
            if not equals or at > len(data):
                raise ValueError("a field of a header cannot be read")
            self[name] = value

    def __missing__(self, name: bytes) -> bytes:
        raise ValueError(f"a header has no field {name.decode()}")

    def number(self, name: bytes) -> int:
        return int.from_bytes(self[name], "little")

    def time_ns(self, name: bytes) -> int:
        seconds, nanoseconds = _TIME.unpack(self[name])
        return int(seconds * 1_000_000_000 + nanoseconds)


_Chunk = tuple[_Header, int, int]
"""Header of a chunk, and offset and size (bytes) of its data."""


def read_bag(path: str, is_wanted: Callable[[Channel], bool], notes: Notes) -> Iterator[Item]:
    """The messages of a ``.bag`` or a ``.db3`` file by log time; of a ``.bag`` file without an index in the
    order of its chunks. Messages of channels that ``is_wanted`` does not accept are skipped unread.

    Raises UnreadableRecording if it does not begin like a bag, is encrypted, or is no database of rosbag2.
    """
    with open_stream(path, budget=notes.budget) as stream:
        if (begin := stream.read(len(BAG_MAGIC))).startswith(b"SQLite"):
            yield from _read_sqlite(path, is_wanted, notes)
            return
        if begin != BAG_MAGIC:
            raise UnreadableRecording("it is not a bag of version 2.0: convert it with rosbag fix")
        bag = _Bag(stream, is_wanted, notes.report)
        chunks, begins_ns = bag.find_chunks()
        if all(chunk in begins_ns for chunk in chunks):
            ordered = sorted((begins_ns[place], place) for place in chunks)
            yield from in_log_order((begin_ns, bag.messages_in(chunks[place])) for begin_ns, place in ordered)
            return
        notes.report("it has no index, as when recording was cut off: it is read as it was written")
        for chunk in chunks.values():
            yield from bag.messages_in(chunk)


class _Bag:
    def __init__(
        self, stream: ByteStream, is_wanted: Callable[[Channel], bool], report: Callable[[str], None]
    ) -> None:
        self._stream, self._wanted, self._report = stream, is_wanted, report
        self._channels: dict[int, Channel | None] = {}
        try:
            head, size = self._next_head()
            is_head = head.number(b"op") == _BAG and stream.take(size, False) is not None
        except (*PARSE_ERRORS, EOFError):
            is_head = False
        if not is_head:
            raise UnreadableRecording("it is damaged: its first record cannot be read")
        if head.get(b"encryptor"):
            raise UnreadableRecording("its messages are encrypted: decrypt it with rosbag decrypt")

    def find_chunks(self) -> tuple[dict[int, _Chunk], dict[int, int]]:
        """The chunks by their offsets, and the first log times (ns) of chunks in the index; also notes
        connections."""
        stream, chunks, begins_ns = self._stream, dict[int, _Chunk](), dict[int, int]()
        while True:
            place = stream.position
            try:
                header, size = self._next_head()
                end = stream.position + size
                if size >= RECORD_LIMIT or not stream.may_have(size):
                    raise EOFError("it is cut off")
                op = header.number(b"op")
                if op == _CHUNK:
                    chunks[place] = header, stream.position, size
                elif op == _CHUNK_INFO:
                    begins_ns[header.number(b"chunk_pos")] = header.time_ns(b"start_time")
                elif op == _CONNECTION:
                    self._note_connection(header, stream.read(size))
                stream.seek(end)
            except (EOFError, *PARSE_ERRORS) as error:
                if not isinstance(error, EOFError):
                    fault = f"it is damaged at byte {place} ({first_line(error)})"
                    self._report(f"{fault}: rosbag reindex may find more")
                elif str(error):
                    self._report(f"{error} at byte {place}")
                return chunks, begins_ns

    def messages_in(self, chunk: _Chunk) -> list[RawMessage]:
        """The messages of a chunk by log time, up to any damage."""
        messages = list[RawMessage]()
        try:
            header, offset, stored = chunk
            data, at = self._stream.read(stored) if self._stream.seek(offset) else b"", 0
            compression = header[b"compression"].decode(errors="replace")
            size = len(data) if compression == "none" else header.number(b"size")
            data = decompress(compression, data, size, self._stream.budget)
            while at < len(data):
                begin, end = _part(data, at)
                header = _Header(data[begin:end])
                begin, at = _part(data, end)
                self._stream.budget.spend(1)
                if header.number(b"op") == _CONNECTION:
                    self._note_connection(header, data[begin:at])
                elif header.number(b"op") == _MESSAGE:
                    channel = self._channels.get(header.number(b"conn"))
                    if channel is not None:
                        messages.append(RawMessage(channel, header.time_ns(b"time"), data[begin:at]))
        except PARSE_ERRORS as error:
            self._report(f"unreadable chunk at byte {chunk[1]} ({first_line(error)})")
        return sorted(messages, key=lambda message: message.log_time_ns)

    def _note_connection(self, header: _Header, data: bytes) -> None:
        number, about = header.number(b"conn"), _Header(data)
        if number not in self._channels:
            topic, kind = (text.decode(errors="replace") for text in (header[b"topic"], about[b"type"]))
            channel = Channel(topic, "ros1", kind, "ros1msg", about.get(b"message_definition", b""))
            self._channels[number] = channel if self._wanted(channel) else None

    def _next_head(self) -> tuple[_Header, int]:
        """The header of the next record and the size of its data; raises EOFError at the end of the file,
        with a message if it is truncated."""
        header_length = self._stream.read(_LENGTH.size)
        if not header_length:
            raise EOFError
        size = _LENGTH.unpack(header_length)[0] if len(header_length) == _LENGTH.size else RECORD_LIMIT
        header = self._stream.read(size) if size < RECORD_LIMIT else b""
        data_length = self._stream.read(_LENGTH.size)
        if len(header) != size or len(data_length) != _LENGTH.size:
            raise EOFError("it is cut off")
        self._stream.budget.spend(1 + size // BYTES_PER_RECORD)
        return _Header(header), _LENGTH.unpack(data_length)[0]


def _part(data: bytes, at: int) -> tuple[int, int]:
    """Begin and end of the header or data of a record in a chunk, whose length is at the offset ``at``."""
    (size,) = _LENGTH.unpack_from(data, at)
    if size > len(data) - at - _LENGTH.size:
        raise ValueError("a record is longer than its chunk")
    return at + _LENGTH.size, at + _LENGTH.size + size


_TABLES: Final = frozenset({"messages", "topics", "message_definitions", "sqlite_master"})
_HIDDEN: Final = 6
"""Index in ``table_xinfo`` of whether a column is hidden or generated."""
_STEPS: Final = 10_000
"""Steps of the virtual machine between checks of their number."""
_LEAST_STEPS: Final = 50_000_000
_STEPS_PER_BYTE: Final = 20
_MOST_NAMED: Final = 500
"""Largest number of topics in a query; with more, all messages are read and filtered afterwards."""


def _read_sqlite(path: str, is_wanted: Callable[[Channel], bool], notes: Notes) -> Iterator[RawMessage]:
    """The messages of a ``.db3`` file, as by ``read_bag``."""
    size = os.path.getsize(path)
    notes.budget.bytes_read += size
    if os.path.exists(f"{path}-wal") and os.path.getsize(f"{path}-wal"):
        notes.report("its last messages are in a write-ahead log that is not read: open it once with sqlite3")
    chosen: dict[int, Channel] | None = None
    try:
        with closing(_opened(path, size)) as file:
            topics = _channels(file, notes.report)
            chosen = {number: channel for number, channel in topics.items() if is_wanted(channel)}
            yield from _messages(file, chosen, notes.budget, size)
    except (sqlite3.Error, TooMuchWork, UnicodeDecodeError) as error:
        # A message of SQLite may quote bytes that are no text.
        fault = "its tables are malformed" if isinstance(error, UnicodeDecodeError) else error
        if chosen is None:
            raise UnreadableRecording(f"it cannot be opened as a rosbag2 database: {fault}") from error
        notes.report(f"it is damaged: {fault}")


def _opened(path: str, size: int) -> sqlite3.Connection:
    """A connection that reads only plain columns of the tables, in a number of steps that the file size
    bounds; raises UnreadableRecording if other columns are in them."""
    uri = f"file:{quote(os.path.abspath(path))}?mode=ro&immutable=1"
    file = sqlite3.connect(uri, uri=True, isolation_level=None)
    file.text_factory = lambda data: data.decode(errors="replace")
    file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, RECORD_LIMIT)
    for pragma in ("trusted_schema = off", "cell_size_check = on", "mmap_size = 0"):
        file.execute(f"pragma {pragma}")
    checks = count((_LEAST_STEPS + _STEPS_PER_BYTE * size) // _STEPS, -1)
    file.set_progress_handler(lambda: next(checks) <= 0, _STEPS)

    kinds = dict(file.execute("select name, type from sqlite_master").fetchall())
    for name in _TABLES & kinds.keys():
        columns = file.execute(f"pragma table_xinfo({name})").fetchall()
        if kinds[name] != "table" or any(column[_HIDDEN] for column in columns):
            file.close()
            raise UnreadableRecording(f"it is no database of rosbag2: {name} is no plain table")

    def allowed(action: int, table: str | None, *_: str | None) -> int:
        is_read = action == sqlite3.SQLITE_READ and table in _TABLES
        return sqlite3.SQLITE_OK if is_read or action == sqlite3.SQLITE_SELECT else sqlite3.SQLITE_DENY

    file.set_authorizer(allowed)
    return file


def _channels(file: sqlite3.Connection, report: Callable[[str], None]) -> Mapping[int, Channel]:
    definitions = dict[str, tuple[str, str]]()
    if file.execute("select name from sqlite_master where name = 'message_definitions'").fetchone():
        columns = "topic_type, encoding, encoded_message_definition"
        for kind, *definition in file.execute(f"select {columns} from message_definitions"):
            definitions[str(kind)] = str(definition[0]), str(definition[1])
    channels, unreadable = dict[int, Channel](), 0
    for number, *about in file.execute("select id, name, type, serialization_format from topics"):
        if not all(isinstance(value, str) for value in about):
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
    """The messages by log time, as long as their total length is within the ``size`` of the file (bytes):
    pages that refer to themselves or to one another make any number of long messages. Sorting is by row, and
    data are fetched one by one, so that they are not all in memory.
    """
    which = f"where topic_id in ({', '.join('?' * len(channels))})" if len(channels) <= _MOST_NAMED else ""
    rows = file.execute(
        f"select topic_id, timestamp, rowid from messages {which} order by timestamp",
        [*channels] if which else [],
    )
    fetch = file.cursor()
    for number, log_time_ns, row in rows:
        budget.spend(1)
        channel = channels.get(number)
        if channel is None or not isinstance(log_time_ns, int):
            continue
        record = fetch.execute("select data from messages where rowid = ?", [row]).fetchone()
        if record is not None and isinstance(record[0], bytes):
            size -= len(record[0])
            if size < 0:
                raise TooMuchWork("its messages are longer than the file")
            yield RawMessage(channel, max(log_time_ns, 0), record[0])
