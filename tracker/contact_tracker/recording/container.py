"""The record loop: reads messages, attachments and metadata of an MCAP stream in the order of the file.

It serves files that are complete, truncated, without index, unchunked, growing or piped, and holds one
record at a time. A damaged chunk is left out; where the framing of records is lost, the loop continues at
the next chunk of the index, if there is one.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from enum import StrEnum
from itertools import chain, pairwise, repeat
from typing import Final

from mcap import records
from mcap.opcode import Opcode
from mcap.summary import Summary

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.bytestream import ByteStream
from contact_tracker.recording.file_index import Place
from contact_tracker.recording.items import (
    MAGIC,
    MESSAGE_HEAD,
    PARSE_ERRORS,
    RECORD_HEAD,
    Channel,
    DamageReport,
    Item,
    Metadata,
    RawMessage,
    Run,
    attachment_of,
    channel_of,
    inflate,
    payload_stream,
    runs,
)
from contact_tracker.recording.limits import BYTES_PER_RECORD, RECORD_LIMIT, TooMuchWork
from contact_tracker.recording.tables import is_text

_READ: Final = frozenset(
    {
        Opcode.HEADER,
        Opcode.FOOTER,
        Opcode.SCHEMA,
        Opcode.CHANNEL,
        Opcode.MESSAGE,
        Opcode.CHUNK,
        Opcode.ATTACHMENT,
        Opcode.METADATA,
    }
)


class End(StrEnum):
    """How the input ended: properly, between records, inside a record, in invalid data, or by the caller."""

    FOOTER = "footer"
    EOF = "eof"
    TRUNCATED = "truncated"
    DAMAGED = "damaged"
    STOPPED = "stopped"


class RecordLoop:
    """Iterate once for the items of one MCAP stream; afterwards ``end`` and ``damage`` are set.

    Parameters
    ----------
    stream : positioned at the start of the file.
    wanted : messages of other channels are skipped unread.
    summary : of the same file, where known: replaces damaged channel records and gives chunk offsets.

    Attributes
    ----------
    messages : number of messages so far, of all channels.

    Raises
    ------
    UnreadableRecording
        While iterating, if the input does not start as MCAP.
    """

    def __init__(
        self,
        stream: ByteStream,
        wanted: Callable[[Channel], bool],
        summary: Summary | None = None,
    ) -> None:
        self.end: End | None = None
        self.damage = DamageReport()
        self.messages = 0
        self._stream = stream
        self._wanted = wanted
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, Channel | None] = {}
        self._chunk_starts: list[int] = []
        self._orphans = 0
        if summary is not None:
            self._schemas.update(summary.schemas)
            self._chunk_starts = sorted(c.chunk_start_offset for c in summary.chunk_indexes)
            for channel in summary.channels.values():
                self._add_channel(channel)

    def __iter__(self) -> Iterator[Item]:
        return chain.from_iterable(self.groups())

    def groups(self) -> Iterator[list[Item]]:
        """The items of one record after the other; the messages of a chunk in the order of log time."""
        if (magic := self._stream.read(len(MAGIC))) != MAGIC:
            hint = "; if it is a table, name it .csv" if is_text(magic) else ""
            reason = self._stream.error or (f"it is not an MCAP file{hint}" if magic else "it is empty")
            raise UnreadableRecording(reason)
        for opcode, payload, start in self._frames():
            if group := self._group(opcode, payload, start):
                yield group
        self.report_orphans()

    def opcode_at(self, place: Place) -> int | None:
        """Opcode of the record at a place; None if there is none of this size."""
        head = self._stream.read(RECORD_HEAD.size) if self._stream.seek(place.offset) else b""
        opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (-1, 0)
        return opcode if opcode in _READ and len(head) + length == place.size else None

    def items_at(self, place: Place) -> list[Item]:
        """The items of one record, as in ``groups``; channels are those of ``summary``."""
        opcode, length = self.opcode_at(place), place.size - RECORD_HEAD.size
        if opcode == Opcode.ATTACHMENT and length > RECORD_LIMIT:
            return []
        payload = self._stream.read(length) if opcode is not None and length <= RECORD_LIMIT else b""
        if opcode is None or len(payload) != length:
            self.damage.add(f"no MCAP record at byte {place.offset}")
            return []
        return self._group(opcode, payload, place.offset)

    def report_orphans(self) -> None:
        """Add messages without channel to the damage, once nothing more is read."""
        if self._orphans:
            self.damage.add(f"{self._orphans} messages of channels whose description is missing")
            self._orphans = 0

    def _group(self, opcode: int, payload: bytes, start: int) -> list[Item]:
        """The items of one record, up to any damage, by log time."""
        group = list[Item]()
        try:
            if opcode == Opcode.CHUNK:
                budget = self._stream.budget
                data = inflate(records.Chunk.read(payload_stream(payload)), budget)
                for run in runs(data, budget):
                    group += self._items(data, run)
            else:
                group += self._items(payload, Run(opcode, 0, len(payload), 1))
        except PARSE_ERRORS as error:
            self.damage.add(f"unreadable {_name(opcode)} at byte {start} ({_line(error)})")
        return _in_log_order(group)

    def _frames(self) -> Iterator[tuple[int, bytes, int]]:
        """Opcode, payload and offset of every relevant record, until the input ends."""
        while True:
            start = self._stream.position
            head = self._stream.read(RECORD_HEAD.size)
            if not head:
                self._finish(End.EOF, "it ends without a footer: the recording was not finished")
                return
            opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (-1, 0)
            try:
                self._stream.budget.count_framed()
            except TooMuchWork as error:
                self._finish(End.DAMAGED, str(error))
                return
            look = opcode in _READ and not (opcode == Opcode.ATTACHMENT and length > RECORD_LIMIT)
            payload = b""
            if opcode == 0 or (look and length > RECORD_LIMIT):
                complete, end, text = False, End.DAMAGED, f"no MCAP record at byte {start}"
            else:
                complete = opcode > 0 and self._stream.may_have(length)
                if complete and look:
                    payload = self._stream.read(length)
                    complete = len(payload) == length
                elif complete:
                    complete = self._stream.skip(length)
                end, text = End.TRUNCATED, f"it is cut off inside a record at byte {start}"
            if complete and look:
                yield opcode, payload, start
            if complete and opcode == Opcode.FOOTER:
                self._finish(End.FOOTER, None)
                return
            if not complete and not self._resume(start, text):
                self._finish(end, text)
                return

    def _resume(self, start: int, text: str) -> bool:
        """Go to the next chunk after an invalid record; returns whether there is one."""
        following = bisect_right(self._chunk_starts, start)
        if following == len(self._chunk_starts) or not self._stream.seek(self._chunk_starts[following]):
            return False
        self.damage.add(text)
        return True

    def _finish(self, end: End, damage: str | None) -> None:
        stream = self._stream
        self.end = End.STOPPED if stream.stopped and end is not End.FOOTER else end
        if self.end is End.FOOTER:
            if stream.read(len(MAGIC)) != MAGIC:
                self.damage.add("its last bytes are missing")
            elif not stream.follows and stream.read(1):
                self.damage.add("what follows its end is ignored")
        elif self.end is not End.STOPPED and damage:
            self.damage.add(f"{damage} ({stream.error})" if stream.error else damage)

    def _items(self, data: bytes, run: Run) -> Iterable[Item]:
        if run.opcode == Opcode.MESSAGE:
            channel_id, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(data, run.at)
            self.messages += run.many
            try:
                channel = self._channels[channel_id]
            except KeyError:
                self._orphans += run.many
                return ()
            if channel is None:
                return ()
            if run.many == 1:
                message = data[run.at + MESSAGE_HEAD.size : run.at + run.size]
                return (RawMessage(channel, log_time_ns, message),)
            return map(RawMessage, repeat(channel), run.log_times_ns(data), run.payloads(data))
        payload = data[run.at : run.at + run.size]
        if run.opcode == Opcode.ATTACHMENT:
            return (attachment_of(payload),)
        if run.opcode == Opcode.METADATA:
            self._stream.budget.count_records(len(payload) // BYTES_PER_RECORD)
            metadata = records.Metadata.read(payload_stream(payload))
            return (Metadata(metadata.name, metadata.metadata),)
        if run.opcode == Opcode.SCHEMA:
            schema = records.Schema.read(payload_stream(payload))
            self._schemas[schema.id] = schema
        elif run.opcode == Opcode.CHANNEL:
            self._add_channel(records.Channel.read(payload_stream(payload)))
        return ()

    def _add_channel(self, record: records.Channel) -> None:
        channel = channel_of(record, self._schemas)
        self._channels[record.id] = channel if self._wanted(channel) else None


def _in_log_order(items: list[Item]) -> list[Item]:
    """Messages by log time; other items keep their place."""
    times_ns = [item.log_time_ns for item in items if isinstance(item, RawMessage)]
    if all(before <= after for before, after in pairwise(times_ns)):
        return items
    return sorted(items, key=lambda item: item.log_time_ns if isinstance(item, RawMessage) else 0)


def _name(opcode: int) -> str:
    return Opcode(opcode).name.lower()


def _line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
