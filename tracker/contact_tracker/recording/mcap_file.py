"""MCAP files: their records, their index, and the record loop.

The loop reads messages, attachments and metadata of a stream in the order of the file. Files may be complete,
truncated, without index, unchunked, growing or piped; one record is in memory at a time. A damaged chunk is
left out; if the framing of records is lost, the loop continues at the next chunk of the index, if there is
one. Chunks in the index are not decompressed.
"""

import bz2
import os
import struct
import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from io import BytesIO
from itertools import pairwise
from typing import IO, Any, Final

import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from contact_tracker.errors import UnreadableRecording, first_line
from contact_tracker.recording.bytestream import (
    BYTES_PER_RECORD,
    RECORD_LIMIT,
    SHARE_OF_RECORD,
    WHAT_IS_READ,
    ByteStream,
    TooMuchWork,
    WorkBudget,
    is_regular,
    is_text,
)
from contact_tracker.recording.items import Channel, Item, RawMessage

IN_CHUNKS: Final = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
_MESSAGE: Final = int(Opcode.MESSAGE)
FIRST_UNKNOWN: Final = max(Opcode) + 1
"""Lowest opcode of later versions of the format or of private records, which are skipped."""
_BZ2_WORK: Final = 4
"""Time to decompress a byte of bz2, relative to zstd or lz4."""
MAGIC: Final = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""
RECORD_HEAD: Final = struct.Struct("<BQ")
MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
PARSE_ERRORS: Final = (
    *(McapError, ValueError, LookupError, struct.error, OverflowError, MemoryError, RuntimeError),
    zstandard.ZstdError,
)


def channel_of(record: records.Channel, schemas: Mapping[int, records.Schema]) -> Channel:
    """A channel record joined with its schema; a channel without schema has an empty type."""
    schema = schemas.get(record.schema_id)
    if schema is None:
        return Channel(record.topic, record.message_encoding, "", "", b"")
    return Channel(record.topic, record.message_encoding, schema.name, schema.encoding, schema.data)


def inflate(chunk: records.Chunk, budget: WorkBudget) -> bytes:
    """The decompressed records of a chunk; raises one of PARSE_ERRORS if they are damaged or too large."""
    data = decompress(chunk.compression, chunk.data, chunk.uncompressed_size, budget)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its checksum is wrong")
    return data


def decompress(compression: str, data: bytes, size: int, budget: WorkBudget) -> bytes:
    """The ``size`` bytes of a chunk of MCAP or of a bag; raises as ``inflate``."""
    budget.check_record(len(data), size)
    work = _BZ2_WORK if compression == "bz2" else 1
    budget.inflate(work * len(data), work * size)
    match compression:
        case "" | "none":
            plain = data
        case "zstd":
            plain = inflate_zstd(data, size)
        case "lz4":
            import lz4.frame  # type: ignore[import-untyped]

            plain = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
        case "bz2":
            try:
                plain = bz2.BZ2Decompressor().decompress(data, size)
            except OSError as error:  # else it would look as if the file could not be read
                raise ValueError(f"its bz2 data is damaged: {error}") from error
        case unknown:
            raise ValueError(f"unknown compression {unknown!r}")
    if len(plain) != size:
        raise ValueError(f"{len(plain)} bytes where {size} were promised")
    return plain


def inflate_zstd(data: bytes, limit: int) -> bytes:
    """Decompress zstd to at most ``limit`` bytes, whatever size the data declares."""
    return zstandard.ZstdDecompressor().stream_reader(data).read(limit)


def _records_in(data: bytes, budget: WorkBudget) -> Iterator[tuple[int, int, int]]:
    """Opcode, begin and end of each record of a chunk; one that is not allowed in a chunk ends it."""
    begin, total, read_head = 0, len(data), RECORD_HEAD.unpack_from
    while begin < total:
        opcode, size = read_head(data, begin)
        begin += RECORD_HEAD.size
        end = begin + size
        if end > total:
            raise ValueError("a record is longer than its chunk")
        if opcode != _MESSAGE and opcode not in IN_CHUNKS and opcode < FIRST_UNKNOWN:
            raise ValueError(f"a record of the kind {opcode} in a chunk")
        budget.spend(1)
        yield opcode, begin, end
        begin = end


def payload_stream(payload: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(payload))


_FOOTER: Final = struct.Struct("<BQQQI")
"""Footer record: opcode, length, start of the index, start of the offsets in it, checksum."""


def summary_of(part: str) -> Summary | None:
    """The index of a file; None unless it describes all channels, and the records in it are disjoint."""
    if not is_regular(part):
        return None
    try:
        with open(part, "rb") as file:
            summary = _read(file)
            size = os.fstat(file.fileno()).st_size
    except (*PARSE_ERRORS, OSError):
        return None
    if summary is None or summary.statistics is None:
        return None
    entries: list[Entry] = [*summary.chunk_indexes, *summary.attachment_indexes, *summary.metadata_indexes]
    places = [*sorted(map(_place, entries)), (size, 0)]
    if any(offset + length > following for (offset, length), (following, _) in pairwise(places)):
        return None  # a small file could have the same bytes read over and over
    has_channels = summary.channels.keys() >= summary.statistics.channel_message_counts.keys()
    has_schemas = {channel.schema_id for channel in summary.channels.values()} <= {0, *summary.schemas}
    return summary if has_channels and has_schemas else None


Entry = records.ChunkIndex | records.AttachmentIndex | records.MetadataIndex
"""An entry of an index."""


def _place(index: Entry) -> tuple[int, int]:
    """Offset and size (bytes) of the record that an entry of the index describes, its head included."""
    if isinstance(index, records.ChunkIndex):
        return index.chunk_start_offset, index.chunk_length
    return index.offset, index.length


def _read(file: IO[bytes]) -> Summary | None:
    """The index between the start that the footer gives and the footer; None if it has other records, or is
    too long."""
    if file.read(len(MAGIC)) != MAGIC:
        return None
    end = file.seek(-_FOOTER.size - len(MAGIC), os.SEEK_END)
    opcode, _, start, _, _ = _FOOTER.unpack(file.read(_FOOTER.size))
    if opcode != Opcode.FOOTER or file.read() != MAGIC or not 0 < start <= end <= start + RECORD_LIMIT:
        return None
    file.seek(start)
    summary = Summary()
    add: dict[type, Callable[[Any], object]] = {
        records.Statistics: partial(setattr, summary, "statistics"),
        records.Schema: lambda record: summary.schemas.update({record.id: record}),
        records.Channel: lambda record: summary.channels.update({record.id: record}),
        records.ChunkIndex: summary.chunk_indexes.append,
        records.AttachmentIndex: summary.attachment_indexes.append,
        records.MetadataIndex: summary.metadata_indexes.append,
        **dict.fromkeys((records.SummaryOffset, records.Footer), lambda record: None),
    }
    for record in StreamReader(BytesIO(file.read()), skip_magic=True, emit_chunks=True).records:
        if type(record) not in add:
            return None
        add[type(record)](record)
    return summary


_READ: Final = IN_CHUNKS | {*(Opcode.HEADER, Opcode.FOOTER, Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA)}


class RecordLoop:
    """Iterate once for the items of one MCAP stream.

    Parameters
    ----------
    stream : positioned at the start of the file.
    report : called with one line for each damage.
    is_wanted : accepts channels; messages of other channels are skipped unread. None skips all messages, with
        their chunks.
    summary : index of the same file, if known: replaces damaged channel records and gives chunk offsets.

    Attributes
    ----------
    messages : number of messages of all channels so far.
    is_sound : whether no damage was found so far.

    Iteration raises UnreadableRecording if the input does not start as MCAP.
    """

    def __init__(
        self,
        stream: ByteStream,
        report: Callable[[str], None],
        is_wanted: Callable[[Channel], bool] | None,
        summary: Summary | None = None,
    ) -> None:
        self._opcodes = _READ if is_wanted is not None else _READ - {Opcode.CHUNK, Opcode.MESSAGE}
        self._report, self._stream, self._wanted = report, stream, is_wanted
        self.is_sound, self.messages = True, 0
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, Channel | None] = {}
        self._chunk_starts, self._orphans = list[int](), 0
        if summary is not None:
            self._schemas.update(summary.schemas)
            self._chunk_starts = sorted(c.chunk_start_offset for c in summary.chunk_indexes)
            for channel in summary.channels.values():
                self._add_channel(channel)

    def __iter__(self) -> Iterator[Item]:
        """The items record by record; the messages of a chunk by log time."""
        if (magic := self._stream.read(len(MAGIC))) != MAGIC:
            hint = f". What is read: {WHAT_IS_READ}"
            if is_text(magic):
                hint = f"; if it is a table, {self._stream.way_to_table}"
            reason = self._stream.error or (f"it is not an MCAP file{hint}" if magic else "it is empty")
            raise UnreadableRecording(reason)
        for opcode, payload, start in self._frames():
            yield from self._group(opcode, payload, start)

    def opcode_of(self, index: Entry) -> int | None:
        """Opcode of the record that an entry of the index describes; None if there is none of this size."""
        offset, size = _place(index)
        head = self._stream.read(RECORD_HEAD.size) if self._stream.seek(offset) else b""
        opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (-1, 0)
        return opcode if opcode in _READ and len(head) + length == size else None

    def items_of(self, index: Entry) -> list[Item]:
        """The items of one record, as in iteration; channels are from ``summary``."""
        offset, size = _place(index)
        opcode, length = self.opcode_of(index), size - RECORD_HEAD.size
        if opcode == Opcode.ATTACHMENT and length > RECORD_LIMIT:
            return []
        payload = self._stream.read(length) if opcode is not None and length <= RECORD_LIMIT else b""
        if opcode is None or len(payload) != length:
            self._damage(f"no MCAP record at byte {offset}")
            return []
        return self._group(opcode, payload, offset)

    def report_orphans(self) -> None:
        """Report messages without channel as damage, at the end of reading."""
        if self._orphans:
            self._damage(f"{self._orphans} messages of channels whose description is missing")
            self._orphans = 0

    def _group(self, opcode: int, payload: bytes, start: int) -> list[Item]:
        """The items of one record, up to any damage, by log time."""
        group, channels, head_size = list[Item](), self._channels, MESSAGE_HEAD.size
        try:
            parts: Iterable[tuple[int, int, int]] = ((opcode, 0, len(payload)),)
            if opcode == Opcode.CHUNK:
                payload = inflate(records.Chunk.read(payload_stream(payload)), self._stream.budget)
                parts = _records_in(payload, self._stream.budget)
            for inner, begin, end in parts:
                if inner != _MESSAGE:
                    self._add(group, inner, payload[begin:end])
                    continue
                channel_id, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(payload, begin)
                self.messages += 1
                if channel_id not in channels:
                    self._orphans += 1
                elif (channel := channels[channel_id]) is not None:
                    group.append(RawMessage(channel, log_time_ns, payload[begin + head_size : end]))
        except PARSE_ERRORS as error:
            self._damage(f"unreadable {Opcode(opcode).name.lower()} at byte {start} ({first_line(error)})")
        times_ns = [item.log_time_ns for item in group if isinstance(item, RawMessage)]
        if any(before > after for before, after in pairwise(times_ns)):
            group.sort(key=lambda item: item.log_time_ns if isinstance(item, RawMessage) else 0)
        return group

    def _frames(self) -> Iterator[tuple[int, bytes, int]]:
        """Opcode, payload and offset of every relevant record, until the input ends."""
        stream = self._stream
        while True:
            start = stream.position
            head = stream.read(RECORD_HEAD.size)
            if not head:
                self._note_end("it ends without a footer: the recording was not finished")
                return
            opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (-1, 0)
            try:
                stream.budget.spend(SHARE_OF_RECORD)
            except TooMuchWork as error:
                self._note_end(str(error))
                return
            is_read = opcode in self._opcodes and not (opcode == Opcode.ATTACHMENT and length > RECORD_LIMIT)
            if opcode == 0 or (is_read and length > RECORD_LIMIT):
                payload, fault = None, f"no MCAP record at byte {start}"
            else:
                payload = stream.take(length, is_read) if opcode > 0 else None
                fault = f"it is cut off inside a record at byte {start}"
            if payload is None:  # continue at the next chunk of the index
                following = bisect_right(self._chunk_starts, start)
                if not any(map(stream.seek, self._chunk_starts[following : following + 1])):
                    self._note_end(fault)
                    return
                self._damage(fault)
                continue
            if is_read:
                yield opcode, payload, start
            if opcode == Opcode.FOOTER:
                if stream.read(len(MAGIC)) != MAGIC:
                    self._damage("its last bytes are missing")
                elif stream.follow is None and stream.read(1):
                    self._damage("what follows its end is ignored")
                return

    def _note_end(self, damage: str) -> None:
        """Report why the input ends as damage, unless the caller has stopped it."""
        if self._stream.follow is None or not self._stream.follow.stopped:
            self._damage(f"{damage} ({self._stream.error})" if self._stream.error else damage)

    def _add(self, group: list[Item], opcode: int, payload: bytes) -> None:
        """Add the content of a record that is no message."""
        if opcode == Opcode.ATTACHMENT:
            crc = int.from_bytes(payload[-4:], "little")
            if crc and crc != zlib.crc32(payload[:-4]):
                raise ValueError("its checksum is wrong")
            group.append(records.Attachment.read(payload_stream(payload)))
        elif opcode == Opcode.METADATA:
            self._stream.budget.spend(len(payload) // BYTES_PER_RECORD)
            group.append(records.Metadata.read(payload_stream(payload)))
        elif opcode == Opcode.SCHEMA:
            schema = records.Schema.read(payload_stream(payload))
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            self._add_channel(records.Channel.read(payload_stream(payload)))

    def _damage(self, text: str) -> None:
        self.is_sound = False
        self._report(text)

    def _add_channel(self, record: records.Channel) -> None:
        channel = channel_of(record, self._schemas)
        self._channels[record.id] = channel if self._wanted is not None and self._wanted(channel) else None
