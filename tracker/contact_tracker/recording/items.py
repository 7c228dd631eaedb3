"""What single MCAP records hold: payloads in, values out."""

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import Final, NamedTuple

import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

RECORD_LIMIT: Final = 256 * 2**20
RECORD_HEAD: Final = struct.Struct("<BQ")
MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
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


@dataclass(frozen=True)
class Channel:
    """A topic with its message type: schema name, its encoding and its text."""

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


def channel_of(record: records.Channel, schemas: Mapping[int, records.Schema]) -> Channel:
    """A channel record joined with its schema; a channel without schema has an empty type."""
    schema = schemas.get(record.schema_id)
    if schema is None:
        return Channel(record.topic, record.message_encoding, "", "", b"")
    return Channel(record.topic, record.message_encoding, schema.name, schema.encoding, schema.data)


def inflate(chunk: records.Chunk) -> bytes:
    """The records of a chunk; raises one of PARSE_ERRORS if they are not what was written."""
    size = chunk.uncompressed_size
    if size > RECORD_LIMIT:
        raise ValueError(f"a chunk of {size} bytes")
    match chunk.compression:
        case "":
            data = chunk.data
        case "zstd":
            data = inflate_zstd(chunk.data, size)
        case "lz4":
            import lz4.frame  # type: ignore[import-untyped]

            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
        case unknown:
            raise ValueError(f"unknown compression {unknown!r}")
    if len(data) != size:
        raise ValueError(f"{len(data)} bytes where {size} were promised")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its checksum is wrong")
    return data


def inflate_zstd(data: bytes, limit: int) -> bytes:
    """At most ``limit`` bytes, whatever size the compressed data promises."""
    return zstandard.ZstdDecompressor().stream_reader(data).read(limit)


def split(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of the payload of each record in a chunk."""
    first = 0
    while first < len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, first)
        first += RECORD_HEAD.size
        if length > len(data) - first:
            raise ValueError("a record is longer than its chunk")
        yield opcode, first, first + length
        first += length


def attachment_of(payload: bytes) -> Attachment:
    attachment = records.Attachment.read(payload_stream(payload))
    (crc,) = struct.unpack("<I", payload[-4:])
    if crc and crc != zlib.crc32(payload[:-4]):
        raise ValueError("its checksum is wrong")
    return Attachment(attachment.name, attachment.data)


def payload_stream(payload: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(payload))
