"""The index at the end of an MCAP file: its channels, their numbers of messages, and places of records.

It is not read by the reader of the mcap library, which also decompresses chunks in it, whatever their size.
"""

import os
import struct
from collections.abc import Iterator
from itertools import pairwise
from typing import IO, Final, NamedTuple

from mcap import records
from mcap.opcode import Opcode
from mcap.summary import Summary

from contact_tracker.recording.bytestream import is_regular
from contact_tracker.recording.items import FIRST_UNKNOWN, MAGIC, PARSE_ERRORS, RECORD_HEAD, payload_stream
from contact_tracker.recording.limits import RECORD_LIMIT

_FOOTER: Final = struct.Struct("<BQQQI")
"""Footer record: opcode, length, start of the index, start of the offsets in it, checksum."""
_SKIPPED: Final = frozenset({Opcode.SUMMARY_OFFSET})


class Place(NamedTuple):
    """Offset and size (bytes) of a record, its head included."""

    offset: int
    size: int

    @property
    def end(self) -> int:
        return self.offset + self.size


def summary_of(part: str) -> Summary | None:
    """The index of a file; None unless it describes all channels, and its records are disjoint."""
    if not is_regular(part):
        return None
    try:
        with open(part, "rb") as file:
            summary = _read(file)
            size = os.fstat(file.fileno()).st_size
    except (*PARSE_ERRORS, OSError):
        return None
    if summary is None or summary.statistics is None or not _are_disjoint(summary, size):
        return None
    has_channels = summary.channels.keys() >= summary.statistics.channel_message_counts.keys()
    has_schemas = {channel.schema_id for channel in summary.channels.values()} <= {0, *summary.schemas}
    return summary if has_channels and has_schemas else None


def place_of(index: records.ChunkIndex | records.AttachmentIndex | records.MetadataIndex) -> Place:
    """The place of the record that an entry of the index describes."""
    if isinstance(index, records.ChunkIndex):
        return Place(index.chunk_start_offset, index.chunk_length)
    return Place(index.offset, index.length)


def _are_disjoint(summary: Summary, size: int) -> bool:
    """Whether the records of an index are disjoint and inside the file: else a small one could have the same
    bytes read over and over."""
    places = [place_of(chunk) for chunk in summary.chunk_indexes]
    places += [place_of(attachment) for attachment in summary.attachment_indexes]
    places += [place_of(metadata) for metadata in summary.metadata_indexes]
    places.sort()
    return all(a.end <= b.offset for a, b in pairwise(places)) and (not places or places[-1].end <= size)


def _read(file: IO[bytes]) -> Summary | None:
    """The records between the start that the footer gives and the footer; None if there are others than those
    of an index."""
    if file.read(len(MAGIC)) != MAGIC:
        return None
    end = file.seek(-_FOOTER.size - len(MAGIC), os.SEEK_END)
    opcode, _, start, _, _ = _FOOTER.unpack(file.read(_FOOTER.size))
    if opcode != Opcode.FOOTER or file.read() != MAGIC or not 0 < start <= end:
        return None
    file.seek(start)
    summary = Summary()
    for opcode, payload in _records(file, end):
        stream = payload_stream(payload)
        match opcode:
            case Opcode.STATISTICS:
                summary.statistics = records.Statistics.read(stream)
            case Opcode.SCHEMA:
                schema = records.Schema.read(stream)
                summary.schemas[schema.id] = schema
            case Opcode.CHANNEL:
                channel = records.Channel.read(stream)
                summary.channels[channel.id] = channel
            case Opcode.CHUNK_INDEX:
                summary.chunk_indexes.append(records.ChunkIndex.read(stream))
            case Opcode.ATTACHMENT_INDEX:
                summary.attachment_indexes.append(records.AttachmentIndex.read(stream))
            case Opcode.METADATA_INDEX:
                summary.metadata_indexes.append(records.MetadataIndex.read(stream))
            case _:
                return None
    return summary


def _records(file: IO[bytes], end: int) -> Iterator[tuple[int, bytes]]:
    """Opcode and payload of each record up to ``end``; raises ValueError where one does not fit."""
    at = file.tell()
    while at < end:
        opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
        at += RECORD_HEAD.size + length
        if at > end or length > RECORD_LIMIT:
            raise ValueError("a record is longer than its file")
        payload = file.read(length)
        if opcode not in _SKIPPED and opcode < FIRST_UNKNOWN:
            yield opcode, payload
