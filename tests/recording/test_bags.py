"""ROS bags: rosbag1, rosbag2 in SQLite, and their metadata files."""

import bz2
import shutil
import sqlite3
import struct
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from test_message_formats import POSES, assert_read

from contact_tracker.errors import ChoiceError, NoPoses, UnreadableRecording
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import Follow, may_be_recording, open_log, summarise
from mcap_logs import ROS2, poses_topic, write_log
from pose_files import POSE_TYPE, cdr_pose, write_rosbag1, write_sqlite


def write_rosbag2(folder: Path) -> Path:
    """A bag as rosbags writes it, with definitions."""
    from rosbags.rosbag2 import Writer

    with Writer(folder, version=9) as writer:
        connection = writer.add_connection("/object/pose", POSE_TYPE, typestore=ROS2)
        for pose in POSES:
            writer.write(connection, pose.stamp_ns, cdr_pose(pose))
    return folder


def test_db3_of_python(tmp_path: Path) -> None:
    folder = tmp_path / "what? #1%20"
    folder.mkdir()
    path = write_sqlite(folder / "bag_0.db3", POSES)
    assert_read(path)
    assert_read(path.parent)
    summary = summarise(str(path))
    assert [source.poses for source in summary.sources] == [len(POSES)]


def test_metadata_stand_for_a_folder_of_either_format(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "bag")
    assert_read(folder)
    assert_read(folder / "metadata.yaml")
    write_log(tmp_path / "a.mcap", [poses_topic(POSES)])
    (tmp_path / "metadata.yaml").touch()
    assert_read(tmp_path / "metadata.yaml")


def test_parts_in_sqlite_follow_each_other_and_a_converted_one_is_taken_once(tmp_path: Path) -> None:
    for part in range(3):
        write_sqlite(tmp_path / f"bag_{part}.db3", POSES[slice(20 * part, 20 * part + 20)])
    assert_read(tmp_path)
    for part in range(3):
        write_log(tmp_path / f"bag_{part}.mcap", [poses_topic(POSES[slice(20 * part, 20 * part + 20)])])
    assert_read(tmp_path)


@pytest.mark.parametrize("chunk_bytes", [500, 2**20])
@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_rosbag1(tmp_path: Path, compression: str | None, chunk_bytes: int) -> None:
    path = write_rosbag1(tmp_path / "a.bag", POSES, compression, chunk_bytes)
    assert_read(path)
    assert [source.poses for source in summarise(str(path)).sources] == [len(POSES)]


def test_a_bag_that_was_cut_off_gives_its_whole_chunks(tmp_path: Path) -> None:
    path = write_rosbag1(tmp_path / "a.bag", POSES, "LZ4", 500)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    log = open_log(str(path))
    result = Poses.collect(log)
    np.testing.assert_array_equal(result.stamp_ns, POSES.stamp_ns[: len(result)])
    assert 15 < len(result) < len(POSES)
    assert "it has no index, as when recording was cut off: it is read as it was written" in log.damage


def bag_record(data: bytes, **fields: bytes) -> bytes:
    head = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
        for name, value in fields.items()
    )
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def bag_of(chunks: list[tuple[bytes, bytes, int]]) -> bytes:
    """A bag without index of chunks (compression, data, declared size)."""
    head = bag_record(b" " * 4000, op=b"\x03", index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4))
    records = (
        bag_record(data, op=b"\x05", compression=name, size=struct.pack("<I", size))
        for name, data, size in chunks
    )
    return b"".join((b"#ROSBAG V2.0\n", head, *records))


def connection_record() -> bytes:
    about = {"topic": b"/pose", "type": b"geometry_msgs/PoseStamped", "md5sum": b"0"}
    data = bag_record(b"", **about, message_definition=b"")[4:-4]
    return bag_record(data, op=b"\x07", conn=bytes(4), topic=b"/pose")


@pytest.mark.parametrize("compression", ["none", pytest.param("bz2", marks=pytest.mark.long), "lz4"])
def test_the_decompressed_size_of_bags_is_limited(tmp_path: Path, compression: str) -> None:
    """By numbers of bytes and of records; without limits the records take three times the time allowed."""
    pack = {"none": bytes, "bz2": bz2.compress, "lz4": lz4.frame.compress}[compression]
    name, is_packed = compression.encode(), compression != "none"
    records = connection_record() * 60_000
    zeros = bytes(2**28 if is_packed else 2**16)
    packed = pack(zeros)
    cases = {
        "zeros": ([(name, packed, len(zeros))], f"become {len(zeros)}" if is_packed else "no field op"),
        "lies": ([(name, packed, 100)], "no field op"),
        "records": ([(name, pack(records), len(records))] * (10 if is_packed else 1), "more records than"),
        "unknown": ([(b"xz", b"", 5)], "unknown compression"),
    }
    for case, (chunks, reason) in cases.items():
        path = tmp_path / f"{case}.bag"
        path.write_bytes(bag_of(chunks))
        begin_s = time.process_time()
        with pytest.raises((UnreadableRecording, NoPoses)) as raised:
            open_log(str(path))
        assert time.process_time() - begin_s < 5.0, case
        is_small = case == "records" and not is_packed  # as many records as bytes explain
        assert (reason in str(raised.value)) != is_small


def database(*statements: str) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        with closing(sqlite3.connect(path)) as file:
            for statement in statements:
                file.execute(statement)
            file.commit()

    return write


def changed(write: Callable[[Path], Path], before: bytes, after: bytes) -> Callable[[Path], object]:
    """A bag with other bytes in the place of some."""

    def write_changed(path: Path) -> None:
        content = write(path).read_bytes()
        assert before in content
        path.write_bytes(content.replace(before, after))

    return write_changed


MAGIC, SQLITE = b"#ROSBAG V2.0\n", b"SQLite format 3\0"
ENCRYPTED = bag_record(b" ", op=b"\x03", index_pos=bytes(8), encryptor=b"rosbag/AesCbcEncryptor")
MESSAGES = "create table messages(id integer primary key, topic_id integer, timestamp integer, data blob"
TOPICS = "create table topics(id integer, name text, type text, serialization_format text)"
ENDLESS = (
    "create view messages as with recursive n(i) as (select 1 union all select i + 1 from n) "
    "select i as id, 1 as topic_id, i as timestamp, x'00' as data from n"
)
GENERATED = f"{MESSAGES} generated always as (zeroblob(900000000)) virtual)"
LONG_NAMES = "create view topics as select 1 as id, hex(zeroblob(400000000)) as name"
REFUSED: dict[str, tuple[Callable[[Path], object], str]] = {
    "encrypted.bag": (
        lambda path: path.write_bytes(MAGIC + ENCRYPTED),
        "its messages are encrypted: decrypt it with rosbag decrypt",
    ),
    "old.bag": (
        lambda path: path.write_bytes(b"#ROSBAG V1.2\n" + ENCRYPTED),
        "it is not a bag of version 2.0: convert it with rosbag fix",
    ),
    "zeros.bag": (
        lambda path: path.write_bytes(MAGIC + bytes(200)),
        "it is damaged: its first record cannot be read",
    ),
    "bz2.bag": (
        changed(lambda path: write_rosbag1(path, POSES, "BZ2", 500), b"BZh91AY&SY", b"BZh91AY&SZ"),
        "its bz2 data is damaged",
    ),
    "fields.bag": (
        changed(
            lambda path: write_rosbag1(path, POSES, None, 500), b"\x04\0\0\0op=\x02", b"\x04\0\0\0oq=\x02"
        ),
        "no field op",
    ),
    "endless view.db3": (database(ENDLESS, TOPICS), "messages is no plain table"),
    "generated column.db3": (database(GENERATED, TOPICS), "messages is no plain table"),
    "endless names.db3": (database(f"{MESSAGES})", LONG_NAMES), "topics is no plain table"),
    "zeros.db3": (
        lambda path: path.write_bytes(SQLITE + bytes(100)),
        "cannot be opened as a rosbag2 database",
    ),
    "other.db3": (database("create table topics(id)"), "as a rosbag2 database: no such column: name"),
    # SQLite quotes a schema that is no text in its error, which Python then cannot decode
    "malformed.db3": (
        changed(lambda path: write_sqlite(path, POSES), b"CREATE TABLE topics", b"CREA\xcaE TABLE topics"),
        "as a rosbag2 database: its tables are malformed",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bags_that_are_not_read_are_refused(tmp_path: Path, name: str) -> None:
    write, message = REFUSED[name]
    write(tmp_path / name)
    with pytest.raises(UnreadableRecording, match=message):
        open_log(str(tmp_path / name))
    if name.endswith("db3"):
        with pytest.raises(UnreadableRecording, match=message):
            summarise(str(tmp_path / name))


def test_expressions_of_an_index_are_not_run(tmp_path: Path) -> None:
    path = write_sqlite(tmp_path / "bag_0.db3", POSES)
    database("create index timestamps on messages (abs(timestamp))")(path)
    assert_read(path)


def test_a_write_ahead_log_is_named(tmp_path: Path) -> None:
    path = write_sqlite(tmp_path / "bag_0.db3", POSES)
    Path(f"{path}-wal").write_bytes(b"x")
    log = open_log(str(path))
    assert len(Poses.collect(log)) == len(POSES)
    assert "its last messages are in a write-ahead log that is not read" in log.damage


@pytest.mark.parametrize("ending", [".mcap.zst", ".mcap.zstd"])
def test_compressed_parts(tmp_path: Path, ending: str) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    plain = write_log(tmp_path / "a.mcap", [poses_topic(POSES)])
    (folder / f"a_0{ending}").write_bytes(zstandard.ZstdCompressor().compress(plain.read_bytes()))
    assert_read(folder)
    assert_read(folder / f"a_0{ending}")
    shutil.copy(plain, folder / "a_0.mcap")
    assert_read(folder)


def test_a_folder_of_compressed_parts_is_reported(tmp_path: Path) -> None:
    (tmp_path / "rec_0.mcap.lz4").write_bytes(b"\x04\x22\x4d\x18")
    with pytest.raises(UnreadableRecording, match=r"decompress rec_0\.mcap\.lz4 first"):
        open_log(str(tmp_path))


def test_only_mcap_is_followed(tmp_path: Path) -> None:
    with pytest.raises(ChoiceError, match="only an MCAP file can be followed"):
        open_log(str(write_sqlite(tmp_path / "a.db3", POSES)), follow=Follow())


def test_bags_are_recordings_that_no_result_replaces(tmp_path: Path) -> None:
    assert may_be_recording(str(write_sqlite(tmp_path / "a.db3", POSES)))
    assert may_be_recording(str(write_rosbag1(tmp_path / "a.bag", POSES)))


def test_messages_of_a_database_are_no_longer_than_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where pages that refer to themselves make long messages of few bytes."""
    path, size = write_sqlite(tmp_path / "a.db3", POSES), 20 * len(cdr_pose(next(iter(POSES)))) + 1
    monkeypatch.setattr("contact_tracker.recording.bags.os.path.getsize", lambda path: size)
    log = open_log(str(path))
    assert len(Poses.collect(log)) == 20
    assert log.damage == "it is damaged: its messages are longer than the file"
