"""Truncated, damaged, compressed, piped and growing recordings: the readable part is read."""

import os
import shutil
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
import zstandard
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from pyarrow import feather
from scipy.io import savemat

from contact_tracker.errors import AmbiguousSource, ContactTrackerError, NoPoses, NoTruth, UnreadableRecording
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import (
    Follow,
    list_sources,
    open_log,
    read_metadata,
    read_truth,
    summarise,
    write_recording,
)
from contact_tracker.recording.bytestream import TooMuchWork, WorkBudget
from contact_tracker.recording.mcap_file import MAGIC
from contact_tracker.states import Contact
from mcap_logs import START_NS, Topic, poses_topic, records_in, smooth_poses, write_log
from traced_memory import memory_below

SMALL = {"chunk_size": 700, "compression": CompressionType.ZSTD}
INDEX_LESS = {"index_types": IndexType.NONE, "use_statistics": False, "repeat_channels": False}


def read(path: Path | str) -> tuple[Poses, str | None]:
    """All poses and the damage; no poses after a one-line error that nothing can be used, or that a source
    has to be chosen, which may show up late."""
    try:
        log = open_log(str(path))
    except ContactTrackerError as error:
        return Poses.collect([]), one_line(error)
    try:
        poses = Poses.collect(log)
    except AmbiguousSource as error:
        return Poses.collect([]), one_line(error)
    return poses, log.damage


def one_line(error: Exception) -> str:
    assert "\n" not in str(error)
    return str(error)


def chunk_offsets(path: Path) -> list[tuple[int, int]]:
    """Offset and length of the chunk records of a file."""
    records = records_in(path.read_bytes())
    return [(begin, end - begin) for opcode, begin, end in records if opcode == Opcode.CHUNK]


# --- cut off ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options", [SMALL, {"use_chunking": False}, SMALL | INDEX_LESS], ids=["chunks", "unchunked", "index-less"]
)
def test_a_recording_cut_anywhere_gives_what_precedes(tmp_path: Path, options: dict[str, Any]) -> None:
    poses = smooth_poses(30)
    content = write_log(tmp_path / "whole.mcap", [poses_topic(poses)], **options).read_bytes()
    cut = tmp_path / "cut.mcap"
    counts: list[int] = []
    for length in [*range(0, len(content), 97), len(content) - 1]:
        cut.write_bytes(content[:length])
        result, damage = read(cut)
        counts.append(len(result))
        assert damage is not None
        np.testing.assert_array_equal(result.stamp_ns, poses.stamp_ns[: len(result)])
        np.testing.assert_array_equal(result.position_m, poses.position_m[: len(result)])
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] == len(poses)
    assert len(set(counts)) > 5


def test_truth_and_metadata_of_a_cut_recording(tmp_path: Path) -> None:
    poses, path = smooth_poses(4000), tmp_path / "a.mcap"
    truth = Truth((TruthInterval(START_NS, int(poses.stamp_ns[-1]), Contact.FF),))
    write_recording(str(path), poses, truth, {"object": "box"})
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    result, damage = read(path)
    assert 1000 < len(result) < 3000
    assert "cut off" in damage
    assert read_truth(str(path)) == truth
    assert read_metadata(str(path)) == {"recording": {"object": "box"}}


# --- damaged ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("at", "value", "text"), [(-20, None, "unreadable chunk at byte {}"), (25, 2**50, f"to become {2**50}")]
)
@pytest.mark.parametrize(
    ("options", "which"),
    [(SMALL, 0), (SMALL, 4), (SMALL | INDEX_LESS, 4)],
    ids=["first", "indexed", "index-less"],
)
def test_on_both_sides_of_a_damaged_chunk_all_is_read(
    tmp_path: Path, options: dict[str, Any], which: int, at: int, value: int | None, text: str
) -> None:
    """Of a chunk whose data are damaged, or whose declared size is too large."""
    poses = smooth_poses(100)
    path = write_log(tmp_path / "a.mcap", [poses_topic(poses)], **options)
    start, length = chunk_offsets(path)[which]
    data = bytearray(path.read_bytes())
    if value is None:
        data[start + length + at] ^= 0xFF
    else:
        struct.pack_into("<Q", data, start + at, value)
    path.write_bytes(data)
    result, damage = read(path)
    assert 0 < len(poses) - len(result) < 15
    assert (result.stamp_ns[0] == poses.stamp_ns[0]) == (which > 0)
    assert result.stamp_ns[-1] == poses.stamp_ns[-1]
    assert np.isin(result.stamp_ns, poses.stamp_ns).all()
    assert text.format(start) in damage
    assert summarise(str(path)).damage == damage


@pytest.mark.parametrize("byte", [0, 1, 3, 8], ids=["opcode", "length", "length, high", "length, highest"])
def test_after_lost_framing_reading_continues_by_the_index(tmp_path: Path, byte: int) -> None:
    poses = smooth_poses(100)
    path = write_log(tmp_path / "a.mcap", [poses_topic(poses)], **SMALL)
    chunks = chunk_offsets(path)
    data = bytearray(path.read_bytes())
    data[chunks[4][0] + byte] = 0x00 if byte == 0 else 0xF5
    path.write_bytes(data)
    result, damage = read(path)
    assert damage is not None
    assert len(result) >= len(poses) - 2 * len(poses) // len(chunks) - 2
    assert result.stamp_ns[-1] == poses.stamp_ns[-1]


def _claiming(path: Path, opcode: int, size: int, records: bytes) -> Path:
    """A valid recording with a chunk of ``size`` bytes of repeated ``records``."""
    poses, raw = smooth_poses(100), records * (size // len(records))
    content = write_log(path, [poses_topic(poses)], **SMALL).read_bytes()
    packed = zstandard.ZstdCompressor().compress(raw)
    head = struct.pack("<QQQII", 0, 0, len(raw), 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
    at = chunk_offsets(path)[2][0]
    chunk = struct.pack("<BQ", opcode, len(head) + len(packed)) + head + packed
    path.write_bytes(content[:at] + chunk + content[at:])
    return path


EMPTY = struct.pack("<BQ", 0, 0)
PRIVATE = struct.pack("<BQ", 0x80, 0)
NAMELESS = struct.pack("<BQHI", Opcode.SCHEMA, 6, 1, 0)


@pytest.mark.parametrize(
    ("records", "size"), [*((records, 2**25) for records in (EMPTY, PRIVATE, NAMELESS)), (PRIVATE, 2**28)]
)
def test_work_is_bounded_by_the_bytes_read(
    tmp_path: Path, records: bytes, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = list[int]()
    monkeypatch.setattr(WorkBudget, "spend", _counting(counted))
    path = _claiming(tmp_path / "a.mcap", Opcode.CHUNK, size, records)
    with memory_below(100e6):
        result, damage = read(path)
        summary = summarise(str(path))
    assert len(result) == 100, "what was readable is kept"
    assert summary.sources[0].poses == 100
    assert "unreadable chunk" in damage
    assert sum(counted) < 4 * 50_000, "each pass looks at no more records than the bytes explain"


def _counting(counted: list[float]) -> Callable[[WorkBudget, float], None]:
    original = WorkBudget.spend

    def spend(budget: WorkBudget, records: float) -> None:
        counted.append(records)
        original(budget, records)

    return spend


def test_a_long_rest_without_noise_is_read_whole(tmp_path: Path) -> None:
    """No real recording has a higher compression ratio."""
    count, path = 60_000, tmp_path / "rest.mcap"
    stamps = START_NS + 5_000_000 * np.arange(count)
    rest = Poses(stamps, np.tile([0.1, 0.2, 0.3], (count, 1)), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))
    write_recording(str(path), rest, None, {})
    log = open_log(str(path))
    assert sum(map(len, log.batches())) == count
    assert log.damage is None


def test_a_compressed_file_of_gigabytes_is_read_up_to_the_limit(tmp_path: Path) -> None:
    content = write_log(tmp_path / "a.mcap", [poses_topic(smooth_poses(100))], **SMALL).read_bytes()
    head = struct.pack("<BQ", Opcode.MESSAGE, 200 * 2**20)
    compressor = zstandard.ZstdCompressor()
    zeros = b"".join(compressor.compress(bytes(2**25)) for _ in range(40))
    at = chunk_offsets(tmp_path / "a.mcap")[5][0]
    path = tmp_path / "b.mcap.zst"
    path.write_bytes(compressor.compress(content[:at] + head) + zeros)
    with memory_below(100e6):
        result, damage = read(path)
    assert len(result) > 20
    assert "write it without compression" in damage


def test_any_number_of_damages_makes_one_line(tmp_path: Path) -> None:
    poses = smooth_poses(100)
    path = write_log(tmp_path / "a.mcap", [poses_topic(poses)], **SMALL)
    data = bytearray(path.read_bytes())
    chunks = chunk_offsets(path)
    for start, length in chunks[1:]:
        data[start + length - 20] ^= 0xFF
    path.write_bytes(data)
    _, damage = read(path)
    assert damage.count("unreadable chunk") == 3
    assert damage.endswith(f"; and {len(chunks) - 4} more")


def test_a_damaged_truth_is_not_used_and_reported(tmp_path: Path) -> None:
    truth = '[{"start_ns": 0, "end_ns": 5, "contact": "v-f"}]'
    path = write_log(tmp_path / "a.mcap", [poses_topic(smooth_poses(60))], truth)
    path.write_bytes(path.read_bytes().replace(b'"v-f"', b'"e-f"'))
    assert read_truth(str(path)) is None
    assert "unreadable attachment at byte 33 (its checksum is wrong)" in str(summarise(str(path)).damage)


def test_what_follows_the_end_is_reported(tmp_path: Path) -> None:
    poses = smooth_poses(30)
    path = write_log(tmp_path / "a.mcap", [poses_topic(poses)])
    path.write_bytes(path.read_bytes() * 2)
    result, damage = read(path)
    assert len(result) == len(poses)
    assert damage == "what follows its end is ignored"


POSES = smooth_poses(40)
CHANGES = Topic("/contact/truth", "std_msgs/msg/String", [(START_NS, {"data": "v-f"})])
TRUTH = Truth((TruthInterval(START_NS, int(POSES.stamp_ns[-1]), Contact.EE),))
COLUMNS = {"t": np.arange(40) / 200, **dict(zip(("x", "y", "z"), POSES.position_m.T, strict=True))}
COLUMNS |= dict(zip(("qx", "qy", "qz", "qw"), POSES.quat_xyzw.T, strict=True))
VICTIMS: dict[str, Callable[[Path], object]] = {
    "ours.mcap": lambda path: write_recording(str(path), POSES, TRUTH, {"object": "box"}),
    "chunks.mcap": lambda path: write_log(path, [CHANGES, poses_topic(POSES)], **SMALL),
    "unchunked.mcap": lambda path: write_log(path, [CHANGES, poses_topic(POSES)], use_chunking=False),
    "v7.mat": lambda path: savemat(path, COLUMNS, do_compression=True),
    "v6.mat": lambda path: savemat(path, COLUMNS),
    "v4.mat": lambda path: savemat(path, COLUMNS, format="4"),
    "a.feather": lambda path: feather.write_feather(
        pyarrow.table(COLUMNS | {"l": [[1.0]] * 40}), str(path), compression="lz4"
    ),
    "two_bodies.c3d": lambda path: shutil.copy(Path(__file__).with_name("two_bodies.c3d"), path),
}


@pytest.fixture(scope="module", params=VICTIMS)
def victim(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    VICTIMS[request.param](path := tmp_path_factory.mktemp("victim") / request.param)
    return path


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    changes=st.lists(st.tuples(st.floats(0, 1), st.binary(min_size=1, max_size=12)), min_size=1, max_size=4),
    kept=st.just(1.0) | st.floats(0, 1),
)
@example(changes=[(0.56640625, bytes(4)), (0.5291777660773443, b"\x18" + bytes(4))], kept=1.0)
def test_any_damage_raises_only_expected_errors(
    victim: Path, changes: list[tuple[float, bytes]], kept: float
) -> None:
    content = victim.read_bytes()
    data = bytearray(content[: 12 + int(kept * (len(content) - 12))])
    for place, replacement in changes:
        start = int(place * (len(data) - len(replacement)))
        data[start : start + len(replacement)] = replacement
    path = victim.with_stem("damaged")
    path.write_bytes(data)
    result, _ = read(path)
    assert len(result) <= 40 or victim.suffix != ".mcap"
    for function in (list_sources, read_truth, read_metadata, summarise):
        try:
            function(str(path))  # type: ignore[operator]
        except (UnreadableRecording, NoTruth) as error:
            one_line(error)


# --- compressed ------------------------------------------------------------------------------------------


def test_a_compressed_file_that_is_cut_off_is_damaged(tmp_path: Path) -> None:
    plain = write_log(tmp_path / "a.mcap", [poses_topic(smooth_poses(300))]).read_bytes()
    (packed := tmp_path / "a.mcap.zstd").write_bytes(zstandard.compress(plain)[:-500])
    result, damage = read(packed)
    assert len(result) <= 300
    assert damage is not None


def test_compressed_messages_are_inflated(tmp_path: Path) -> None:
    poses = smooth_poses(50)
    plain = write_log(tmp_path / "a.mcap", [poses_topic(poses)])
    with plain.open("rb") as file:
        messages = [(m.log_time, zstandard.compress(m.data)) for _, _, m in make_reader(file).iter_messages()]
    packed = write_log(tmp_path / "b.mcap", [Topic("/p", "geometry_msgs/msg/PoseStamped", messages)])
    result, damage = read(packed)
    np.testing.assert_array_equal(result.position_m, poses.position_m)
    assert damage is None


# --- piped and growing -----------------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_gives_poses_while_it_is_being_filled(tmp_path: Path) -> None:
    poses = smooth_poses(800)
    data = write_log(tmp_path / "a.mcap", [poses_topic(poses)], **SMALL).read_bytes()
    fifo = tmp_path / "pipe"
    os.mkfifo(fifo)
    half_read = threading.Event()

    def fill() -> None:
        with fifo.open("wb", buffering=0) as pipe:
            pipe.write(data[: len(data) // 2])
            assert half_read.wait(10)
            pipe.write(data[len(data) // 2 :])

    thread = threading.Thread(target=fill)
    thread.start()
    log = open_log(str(fifo))
    stamps = []
    for pose in log:
        stamps.append(pose.stamp_ns)
        if len(stamps) == 300:
            half_read.set()
    thread.join()
    assert stamps == poses.stamp_ns.tolist()
    assert log.damage is None


def test_following_stops_when_the_caller_says_so(tmp_path: Path) -> None:
    poses = smooth_poses(600)
    path = write_log(tmp_path / "a.mcap", [poses_topic(poses)], use_chunking=False)
    path.write_bytes(path.read_bytes()[:-20_000])
    follow = Follow(poll_s=0.002)
    log = open_log(str(path), follow=follow)

    stamps: list[int] = []
    for pose in log:
        stamps.append(pose.stamp_ns)
        if len(stamps) == 300:
            threading.Timer(0.05, follow.stop).start()
    assert 300 < len(stamps) < 600
    assert log.damage is None


def test_a_growing_folder_is_followed_from_part_to_part(tmp_path: Path) -> None:
    poses, folder = smooth_poses(600), tmp_path / "bag"
    folder.mkdir()
    write_log(folder / "bag_0.mcap", [poses_topic(poses[:400])])

    def grow() -> None:
        time.sleep(0.03)
        write_log(tmp_path / "next.mcap", [poses_topic(poses[400:])]).rename(folder / "bag_1.mcap")
        time.sleep(0.03)
        (folder / "metadata.yaml").touch()

    thread = threading.Thread(target=grow)
    thread.start()
    result = Poses.collect(open_log(str(folder), follow=Follow(poll_s=0.002)))
    thread.join()
    np.testing.assert_array_equal(result.stamp_ns, poses.stamp_ns)


def test_a_long_stream_takes_no_more_memory_than_a_chunk_and_the_prefix(tmp_path: Path) -> None:
    path = write_log(
        tmp_path / "a.mcap", [poses_topic(smooth_poses(12_000))], chunk_size=16_384, **INDEX_LESS
    )
    next(iter(open_log(str(path))))  # caches of the libraries are filled
    assert path.stat().st_size > 600_000
    with memory_below(600_000):
        assert sum(1 for _ in open_log(str(path))) == 12_000


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("replaced", "replaced by another"),
        ("shorter", "became shorter"),
        ("gone", "removed"),
        ("anew", "written anew"),
    ],
)
def test_a_followed_file_that_changes_ends_the_stream(tmp_path: Path, change: str, text: str) -> None:
    poses, path = smooth_poses(400), tmp_path / "a.mcap"
    content = write_log(path, [poses_topic(poses)], **SMALL).read_bytes()
    path.write_bytes(content[: len(content) // 2])
    log = open_log(str(path), follow=Follow(poll_s=0.005))
    first = [next(iter(log)) for _ in range(20)]
    assert len(first) == 20
    if change == "replaced":
        second_path = tmp_path / "b.mcap"
        second_path.write_bytes(content)
        second_path.replace(path)
    elif change == "shorter":
        os.truncate(path, 3000)
    elif change == "anew":  # as by a recorder that is started again
        path.write_bytes(
            write_log(tmp_path / "b.mcap", [poses_topic(smooth_poses(400, seed=1))], **SMALL).read_bytes()
        )
    else:
        path.unlink()
    rest = list(log)
    assert 20 < len(first) + len(rest) < 300
    assert text in log.damage


def test_endless_unknown_records_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap.zst"
    plain = write_log(tmp_path / "a.mcap", [poses_topic(smooth_poses(20))]).read_bytes()
    records = struct.pack("<BQ", 0x80, 0) * 3_000_000
    path.write_bytes(zstandard.ZstdCompressor().compress(plain[:8] + records + plain[8:]))
    with pytest.raises(UnreadableRecording, match=r"more records than \d+ bytes explain"):
        open_log(str(path))


def test_the_size_of_a_chunk_is_limited_by_memory() -> None:
    """docs/conventions.md: 256 MB in any case, also where 50 times its size is more."""
    large = 100 * 2**20
    WorkBudget().check_record(large, 256 * 2**20)
    with pytest.raises(TooMuchWork, match="are to become"):
        WorkBudget().check_record(large, 256 * 2**20 + 1)


def test_a_record_beyond_all_memory_is_not_read(tmp_path: Path) -> None:
    """In a sparse file: a declared record of more than 256 MB is not read."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        file.write(MAGIC + struct.pack("<BQ", 6, 300 * 2**20))
        file.truncate(301 * 2**20)
    refused = pytest.raises((UnreadableRecording, NoPoses), match="no MCAP record at byte 8")
    with memory_below(50 * 2**20), refused:
        list(open_log(str(path)))


def test_messages_of_a_channel_that_nothing_describes_are_counted(tmp_path: Path) -> None:
    poses, late = smooth_poses(30), smooth_poses(40, start_ns=START_NS + 10**10)
    topics = [poses_topic(poses), poses_topic(late, name="/other")]
    path = write_log(
        tmp_path / "a.mcap", topics, compression=CompressionType.NONE, enable_crcs=False, **INDEX_LESS
    )
    data = bytearray(path.read_bytes())
    struct.pack_into("<H", data, data.index(b"/other") - 8, 77)  # the number of another channel
    path.write_bytes(data)
    result, damage = read(path)
    np.testing.assert_array_equal(result.stamp_ns, poses.stamp_ns)
    assert "40 messages of channels whose description is missing" in damage
