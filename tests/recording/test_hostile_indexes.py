"""The index of an MCAP file may say anything: it causes no more work than the bytes of the file explain."""

import struct
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path

import pytest
import zstandard
from mcap import records
from mcap.opcode import Opcode

from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_metadata, summarise
from contact_tracker.recording.bytestream import ByteStream
from contact_tracker.recording.mcap_file import MAGIC, inflate, summary_of
from mcap_logs import SCHEMAS, as_bytes, poses_topic, records_in, smooth_poses, write_log
from traced_memory import memory_below

TYPE = "geometry_msgs/msg/PoseStamped"
POSES = 40
UNKNOWN = 9
"""A channel of another type."""


def message(channel: int, data: bytes = b"") -> bytes:
    return as_bytes(records.Message(channel, 0, data, 0, 0))


def chunk(data: bytes, compression: str = "") -> bytes:
    packed = zstandard.ZstdCompressor().compress(data) if compression else data
    return as_bytes(records.Chunk(compression, packed, 2**60, 0, 0, len(data)))


def channels() -> bytes:
    """The schema of poses, the channel 1 of poses, and an unknown one."""
    return as_bytes(
        records.Schema(data=SCHEMAS[TYPE].encode(), encoding="ros2msg", id=1, name=TYPE),
        *(
            records.Channel(id=number, topic=topic, message_encoding="cdr", metadata={}, schema_id=schema)
            for number, topic, schema in ((1, "/p", 1), (UNKNOWN, "/o", 0))
        ),
    )


def chunk_indexes(places: Sequence[tuple[int, int]], *holds: int) -> bytes:
    """The index of chunks at these offsets, of these sizes, which hold messages of channels."""
    offsets = dict.fromkeys(holds, 0)
    return as_bytes(*(records.ChunkIndex(size, at, "", 0, 2**60, 0, offsets, 0, 0) for at, size in places))


def statistics(counts: Mapping[int, int], chunks: int, metadata: int = 0, messages: int = 0) -> bytes:
    return as_bytes(records.Statistics(0, 1, dict(counts), chunks, messages, 2**60, 0, metadata, 1))


def write(path: Path, data: bytes, index: bytes) -> Path:
    """A file of ``data``, of which the first records are poses, and of this index."""
    body = MAGIC + data
    path.write_bytes(body + index + as_bytes(records.Footer(len(body), 0, 0)) + MAGIC)
    return path


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The records of a sound file, from its header to its last chunk."""
    path = tmp_path_factory.mktemp("sound") / "a.mcap"
    content = write_log(path, [poses_topic(smooth_poses(POSES), "/p")], use_chunking=False).read_bytes()
    data = takewhile(lambda record: record[0] != Opcode.DATA_END, records_in(content))
    return b"".join(content[begin:end] for _, begin, end in data)


def test_chunks_in_the_index_are_not_decompressed(tmp_path: Path, poses: bytes) -> None:
    bomb = chunk(message(UNKNOWN) * 3_000_000, "zstd")
    path = write(tmp_path / "a.mcap", poses, bomb + channels() + statistics({1: POSES}, 0))
    with memory_below(30e6):
        log = open_log(str(path))
        result = Poses.collect(log)
        read_metadata(str(path))
    assert summary_of(str(path)) is None
    assert len(result) == POSES
    assert "write it without compression" in log.damage


def test_an_index_that_begins_in_the_data_is_none(tmp_path: Path, poses: bytes) -> None:
    path = write(tmp_path / "a.mcap", poses, channels() + statistics({1: POSES}, 0))
    content = bytearray(path.read_bytes())
    assert summary_of(str(path)) is not None
    struct.pack_into("<Q", content, len(content) - len(MAGIC) - 20, len(MAGIC))
    path.write_bytes(content)
    assert summary_of(str(path)) is None
    assert len(Poses.collect(open_log(str(path)))) == POSES


def counted_chunks(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the chunks that will be read."""
    sizes = list[int]()

    def counting(record: object, budget: object) -> bytes:
        data = inflate(record, budget)  # type: ignore[arg-type]
        sizes.append(len(data))
        return data

    monkeypatch.setattr("contact_tracker.recording.mcap_file.inflate", counting)
    return sizes


def test_overlapping_chunks_are_read_once(
    tmp_path: Path, poses: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each chunk lies in a message of the one before, and reaches to its end."""
    deep, tail = 100, message(UNKNOWN) * 100
    for _ in range(deep):
        content = chunk(tail)
        tail = message(UNKNOWN, content[: len(content) - len(tail)]) + tail
    outer, head = chunk(tail), len(message(UNKNOWN))
    begin = len(MAGIC) + len(poses)
    end, at = begin + len(outer), begin + len(outer) - len(tail) + head
    places = [(begin, len(outer))]
    for _ in range(deep):
        places.append((at, end - at))
        at += len(chunk(b"")) + head
    index = channels() + chunk_indexes(places, 1)
    path = write(tmp_path / "a.mcap", poses + outer, index + statistics({1: POSES, 9: 1}, len(places)))
    read = counted_chunks(monkeypatch)
    assert len(Poses.collect(open_log(str(path)))) == POSES
    assert summarise(str(path)).sources[0].poses == POSES
    assert sum(read) < 3 * len(outer)


def test_metadata_named_over_and_over_is_read_once(tmp_path: Path, poses: bytes) -> None:
    metadata = as_bytes(records.Metadata("m", {str(i): "" for i in range(2000)}))
    entry = as_bytes(records.MetadataIndex(len(MAGIC) + len(poses), len(metadata), "m"))
    index = channels() + entry * 3000 + statistics({1: POSES}, 0, metadata=3000)
    path = write(tmp_path / "a.mcap", poses + metadata, index)
    assert summary_of(str(path)) is None
    assert len(read_metadata(str(path))["m"]) == 2000


def test_cut_records_are_not_read_to_the_end(
    tmp_path: Path, poses: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After lost framing, reading continues at the next chunk of the index, here over and over."""
    many, cut = 500, struct.pack("<BQ", Opcode.CHUNK, 2**27)
    begin = len(MAGIC) + len(poses)
    index = channels() + chunk_indexes([(begin + i * len(cut), len(cut)) for i in range(many)])
    path = write(tmp_path / "a.mcap", poses + many * cut, index + statistics({1: POSES}, 0))
    read, original = list[int](), ByteStream.read

    def counting(stream: ByteStream, count: int) -> bytes:
        data = original(stream, count)
        read.append(len(data))
        return data

    monkeypatch.setattr(ByteStream, "read", counting)
    assert summarise(str(path)).sources[0].poses == POSES
    assert sum(read) < 2 * path.stat().st_size


def test_metadata_that_expands_is_left_out(tmp_path: Path, poses: bytes) -> None:
    """A compressed file whose metadata has a million keys; a hundred thousand letters are no such case."""
    many, long = {str(i): "" for i in range(1_000_000)}, {"urdf": "<robot/>" * 12_500}
    metadata = as_bytes(records.Metadata("many", many), records.Metadata("long", long))
    path = write(tmp_path / "a.mcap", poses + metadata, b"")
    path = path.rename(tmp_path / "a.mcap.zst")
    path.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()))
    summary = summarise(str(path))
    assert summary.sources[0].poses == POSES
    assert summary.metadata == {"long": long}
    assert "unreadable metadata" in summary.damage


def two_chunks(poses: bytes) -> tuple[bytes, bytes, bytes]:
    """The records before the messages, and their two halves as chunks."""
    messages, preamble = list[bytes](), b""
    for opcode, begin, end in records_in(MAGIC + poses + MAGIC):
        record = poses[begin - len(MAGIC) : end - len(MAGIC)]
        if opcode == Opcode.MESSAGE:
            messages.append(record)
        else:
            preamble += record
    half = len(messages) // 2
    return preamble, chunk(b"".join(messages[:half])), chunk(b"".join(messages[half:]))


@pytest.mark.parametrize("error", [0, -9])
def test_chunks_of_wrong_size_in_the_index_are_read_in_order(
    tmp_path: Path, poses: bytes, error: int
) -> None:
    """Chunks that overlap in log time, as the index says, are read by the index if it is right."""
    preamble, first, second = two_chunks(poses)
    begin = len(MAGIC) + len(preamble)
    places = [(begin, len(first) + error), (begin + len(first), len(second) + error)]
    index = channels() + chunk_indexes(places, 1)
    path = write(tmp_path / "a.mcap", preamble + first + second, index + statistics({1: POSES}, 2))
    log = open_log(str(path))
    assert len(Poses.collect(log)) == POSES
    assert log.damage is None


def test_messages_outside_of_chunks_that_are_sorted_are_reported(tmp_path: Path, poses: bytes) -> None:
    record = chunk(message(UNKNOWN) * 10)
    begin = len(MAGIC) + len(poses)
    index = channels() + chunk_indexes([(begin + i * len(record), len(record)) for i in range(2)], UNKNOWN)
    counts = statistics({1: POSES, UNKNOWN: 20}, 2, messages=POSES + 20)
    path = write(tmp_path / "a.mcap", poses + 2 * record, index + counts)
    assert summarise(str(path)).damage == (
        f"{POSES} messages outside of chunks, which overlap in log time, are left out"
    )
