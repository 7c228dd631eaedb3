"""Parsing of single MCAP records: payloads to values."""

import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from heapq import heappop, heappush
from io import BytesIO
from itertools import count
from typing import Final, NamedTuple, cast

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from contact_tracker.recording.limits import WorkBudget

IN_CHUNKS: Final = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
FIRST_UNKNOWN: Final = max(Opcode) + 1
"""Opcodes from here on are of later versions of the format, or private, and skipped."""
_MOST: Final = 128
"""Messages handled at a time."""
MAGIC: Final = b"\x89MCAP0\r\n"
"""First and last bytes of a file."""
RECORD_HEAD: Final = struct.Struct("<BQ")
MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
_ALIKE: Final = RECORD_HEAD.size + 2
"""Bytes that hold opcode, length and channel of a message."""
_LOG_TIME_AT: Final = 6
PARSE_ERRORS: Final = (
    McapError,
    ValueError,
    LookupError,
    struct.error,
    OverflowError,
    MemoryError,
    RuntimeError,
    zstandard.ZstdError,
)


POSE_ROW: Final = "contact_tracker/pose_row"
"""The encoding of rows of poses: ``<q7d``, stamp, position, quaternion; the schema is their frames."""


@dataclass(frozen=True)
class Channel:
    """A topic with its message type: name, encoding and text of the schema."""

    topic: str
    encoding: str
    type: str
    schema_encoding: str
    schema: bytes


class RawMessage(NamedTuple):
    """An undecoded message."""

    channel: Channel
    log_time_ns: int
    data: bytes


class Attachment(NamedTuple):
    name: str
    data: bytes


class Metadata(NamedTuple):
    name: str
    values: dict[str, str]


Item = RawMessage | Attachment | Metadata
BUFFER_BYTES: Final = 2**23
"""Size from which messages are no longer collected, but handled."""


def some_messages(items: Iterator[Item], most: int) -> list[RawMessage]:
    """The next messages, up to ``most``, or up to ``BUFFER_BYTES`` of them."""
    messages, size = list[RawMessage](), 0
    for item in items:
        if isinstance(item, RawMessage):
            messages.append(item)
            size += len(item.data)
            if len(messages) >= most or size >= BUFFER_BYTES:
                break
    return messages


def channel_of(record: records.Channel, schemas: Mapping[int, records.Schema]) -> Channel:
    """A channel record joined with its schema; a channel without schema has an empty type."""
    schema = schemas.get(record.schema_id)
    if schema is None:
        return Channel(record.topic, record.message_encoding, "", "", b"")
    return Channel(record.topic, record.message_encoding, schema.name, schema.encoding, schema.data)


def inflate(chunk: records.Chunk, budget: WorkBudget) -> bytes:
    """The decompressed records of a chunk; raises one of PARSE_ERRORS if they are damaged or too large."""
    size = chunk.uncompressed_size
    budget.inflate(len(chunk.data), size)
    match chunk.compression:
        case "":
            data = chunk.data
        case "zstd":
            data = inflate_zstd(chunk.data, size)
        case "lz4":
            data = inflate_lz4(chunk.data, size)
        case unknown:
            raise ValueError(f"unknown compression {unknown!r}")
    if len(data) != size:
        raise ValueError(f"{len(data)} bytes where {size} were promised")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its checksum is wrong")
    return data


def inflate_zstd(data: bytes, limit: int) -> bytes:
    """Decompress zstd to at most ``limit`` bytes, whatever size the data declares."""
    return zstandard.ZstdDecompressor().stream_reader(data).read(limit)


def inflate_lz4(data: bytes, limit: int) -> bytes:
    """Decompress lz4 to at most ``limit`` bytes."""
    import lz4.frame  # type: ignore[import-untyped]

    return cast(bytes, lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit))


class Run(NamedTuple):
    """``many`` consecutive records of one ``opcode`` from byte ``at``, with payloads of ``size`` bytes each;
    messages are of one channel."""

    opcode: int
    at: int
    size: int
    many: int

    @property
    def end(self) -> int:
        """Offset of the next record."""
        return self.at - RECORD_HEAD.size + self.many * (RECORD_HEAD.size + self.size)

    def log_times_ns(self, data: bytes) -> list[int]:
        """Log times of messages (ns)."""
        step, at = RECORD_HEAD.size + self.size, self.at + _LOG_TIME_AT
        times = np.ndarray(self.many, "<u8", data, at, step)
        return cast(list[int], times.tolist())

    def payloads(self, data: bytes) -> list[bytes]:
        """Payloads of messages, without their headers."""
        step = RECORD_HEAD.size + self.size
        ends = range(self.at + self.size, self.end + 1, step)
        return [data[end - self.size + MESSAGE_HEAD.size : end] for end in ends]


def runs(data: bytes, budget: WorkBudget) -> Iterator[Run]:
    """The records of a chunk; consecutive messages of one channel and size are grouped.

    A record that is not allowed in a chunk ends it.
    """
    first = 0
    while first < len(data):
        opcode, size = RECORD_HEAD.unpack_from(data, first)
        at = first + RECORD_HEAD.size
        if size > len(data) - at:
            raise ValueError("a record is longer than its chunk")
        if opcode not in IN_CHUNKS and opcode < FIRST_UNKNOWN:
            raise ValueError(f"a record of the kind {opcode} in a chunk")
        is_message = opcode == Opcode.MESSAGE and size >= MESSAGE_HEAD.size
        run = Run(opcode, at, size, _alike(data, first, RECORD_HEAD.size + size) if is_message else 1)
        budget.count_records(run.many)
        yield run
        first = run.end


def _alike(data: bytes, first: int, step: int) -> int:
    """Number of messages from byte ``first`` on with the same length and channel."""
    head = data[first : first + _ALIKE]
    if data[first + step : first + step + _ALIKE] != head:
        return 1
    many = min((len(data) - first) // step, _MOST)
    heads = np.frombuffer(data, np.uint8, many * step, first).reshape(many, step)[:, :_ALIKE]
    same = (heads == heads[0]).all(axis=1)
    return many if same.all() else int(same.argmin())


def attachment_of(payload: bytes) -> Attachment:
    attachment = records.Attachment.read(payload_stream(payload))
    (crc,) = struct.unpack("<I", payload[-4:])
    if crc and crc != zlib.crc32(payload[:-4]):
        raise ValueError("its checksum is wrong")
    return Attachment(attachment.name, attachment.data)


def payload_stream(payload: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(payload))


_SHOWN: Final = 3


class DamageReport:
    """The first damages as text, further ones counted."""

    def __init__(self) -> None:
        self._shown: list[str] = []
        self._more = 0

    def add(self, text: str) -> None:
        if len(self._shown) < _SHOWN:
            self._shown.append(text)
        else:
            self._more += 1

    def add_all(self, other: "DamageReport", prefix: str = "") -> None:
        """Add another report, with ``prefix`` before each text."""
        for text in other._shown:
            self.add(prefix + text)
        self._more += other._more

    @property
    def text(self) -> str | None:
        """The line, or None without damage."""
        return "; ".join(self._shown) + (f"; and {self._more} more" if self._more else "") or None


_PENDING_BYTES: Final = 8 * BUFFER_BYTES


def in_log_order(chunks: Iterable[tuple[int, Iterable[Item]]]) -> Iterator[RawMessage]:
    """The messages of all chunks by log time.

    Each chunk comes with a lower bound of its log times (ns), in the order of these bounds. Messages are
    buffered as long as later chunks may have earlier ones, up to 64 MB.
    """
    pending, pending_bytes, number = list[tuple[int, int, RawMessage]](), 0, count()
    for begin_ns, items in chunks:
        while pending and (pending[0][0] < begin_ns or pending_bytes > _PENDING_BYTES):
            _, _, earliest = heappop(pending)
            pending_bytes -= len(earliest.data)
            yield earliest
        for item in items:
            if isinstance(item, RawMessage):
                heappush(pending, (item.log_time_ns, next(number), item))
                pending_bytes += len(item.data)
    while pending:
        yield heappop(pending)[2]


BELIEF_TOPIC: Final = "/contact/belief"
FRAMES_TOPIC: Final = "/contact/frames"
SCENE_TOPIC: Final = "/contact/scene"
MAP_TOPIC: Final = "/contact/map"
RESULT_TOPICS: Final = frozenset({BELIEF_TOPIC, FRAMES_TOPIC, SCENE_TOPIC, MAP_TOPIC})
