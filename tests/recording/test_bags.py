"""ROS bags: rosbag1, rosbag2 in SQLite, and what stands for them."""

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import zstandard
from test_message_formats import NAME, POSES, assert_read, cdr_pose, humble

from contact_tracker.errors import UnreadableRecording
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import Follow, may_be_recording, open_log, summarise
from contact_tracker.recording.extras import MissingExtra
from mcap_logs import poses_topic, smooth_poses, write_log

rosbags = pytest.importorskip("rosbags")


def write_sqlite(folder: Path, poses: Poses = POSES, part: int = 0) -> Path:
    """As rosbag2 did up to Humble, by Python's own sqlite3."""
    folder.mkdir(exist_ok=True)
    path = folder / f"bag_{part}.db3"
    with sqlite3.connect(path) as file:
        file.execute(
            "create table topics(id integer primary key, name text, type text, serialization_format text, "
            "offered_qos_profiles text)"
        )
        file.execute(
            "create table messages(id integer primary key, topic_id integer, timestamp integer, data blob)"
        )
        file.execute("insert into topics values(1, '/object/pose', ?, 'cdr', '')", (NAME,))
        file.execute("insert into topics values(2, '/rosout', 'rcl_interfaces/msg/Log', 'cdr', '')")
        rows = [(1, pose.stamp_ns, cdr_pose(pose)) for pose in poses]
        file.executemany("insert into messages(topic_id, timestamp, data) values(?, ?, ?)", rows)
    file.close()
    return path


def write_rosbag2(folder: Path) -> Path:
    """As rosbags writes it today, with definitions."""
    from rosbags.rosbag2 import Writer

    with Writer(folder, version=9) as writer:
        connection = writer.add_connection("/object/pose", NAME, typestore=humble())
        for pose in POSES:
            writer.write(connection, pose.stamp_ns, cdr_pose(pose))
    return folder


def write_rosbag1(path: Path) -> Path:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(path) as writer:
        connection = writer.add_connection("/object/pose", NAME, typestore=store)
        for pose in POSES:
            raw = humble().cdr_to_ros1(cdr_pose(pose), NAME)
            writer.write(connection, pose.stamp_ns, bytes(raw))
    return path


def test_db3_of_python(tmp_path: Path) -> None:
    path = write_sqlite(tmp_path / "what? #1%20")
    assert_read(path)
    assert_read(path.parent)
    summary = summarise(str(path))
    assert [source.poses for source in summary.sources] == [len(POSES)]


def test_rosbag2_folder_and_its_metadata(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "bag")
    assert_read(folder)
    assert_read(folder / "metadata.yaml")


def test_metadata_stands_for_a_folder_of_mcap(tmp_path: Path) -> None:
    write_log(tmp_path / "a.mcap", [poses_topic(POSES)])
    (tmp_path / "metadata.yaml").touch()
    assert_read(tmp_path / "metadata.yaml")


def test_parts_in_sqlite_follow_each_other(tmp_path: Path) -> None:
    for part in range(3):
        write_sqlite(tmp_path / "bag", POSES[slice(20 * part, 20 * part + 20)], part)
    assert_read(tmp_path / "bag")


def test_a_part_that_was_converted_to_mcap_is_taken_once(tmp_path: Path) -> None:
    path = write_sqlite(tmp_path / "bag")
    write_log(path.with_suffix(".mcap"), [poses_topic(POSES)])
    assert_read(tmp_path / "bag")


def test_rosbag1(tmp_path: Path) -> None:
    path = write_rosbag1(tmp_path / "a.bag")
    assert_read(path)
    assert [source.poses for source in summarise(str(path)).sources] == [len(POSES)]


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


def test_damaged_bags_are_named(tmp_path: Path) -> None:
    whole = write_rosbag1(tmp_path / "a.bag").read_bytes()
    (tmp_path / "b.bag").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "c.db3").write_bytes(b"SQLite format 3\0" + bytes(100))
    for name in ("b.bag", "c.db3"):
        for read in (open_log, summarise):
            with pytest.raises(UnreadableRecording, match="cannot be opened as a ROS bag"):
                read(str(tmp_path / name))


@pytest.mark.parametrize(
    ("begin", "message"),
    [
        (b"\x1f\x8b\x08\0", "it is compressed: gunzip a.mcap first"),
        (b"\x04\x22\x4d\x18", "it is compressed: lz4 -d a.mcap first"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
    ],
)
def test_what_hides_a_recording_is_named(tmp_path: Path, begin: bytes, message: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(begin)
    with pytest.raises(UnreadableRecording, match=message):
        open_log(str(path))


def test_a_folder_of_packed_parts_says_so(tmp_path: Path) -> None:
    (tmp_path / "rec_0.mcap.lz4").write_bytes(b"\x04\x22\x4d\x18")
    with pytest.raises(UnreadableRecording, match=r"decompress rec_0\.mcap\.lz4 first"):
        open_log(str(tmp_path))


def test_only_mcap_is_followed(tmp_path: Path) -> None:
    with pytest.raises(UnreadableRecording, match="only an MCAP file can be followed"):
        open_log(str(write_sqlite(tmp_path)), follow=Follow())


def test_bags_are_recordings_that_no_result_replaces(tmp_path: Path) -> None:
    assert may_be_recording(str(write_sqlite(tmp_path)))
    assert may_be_recording(str(write_rosbag1(tmp_path / "a.bag")))


def test_without_rosbags_its_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_sqlite(tmp_path)
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag2.storage_sqlite3", None)
    with pytest.raises(MissingExtra, match=r"a \.db3 file needs .* pip install 'contact-tracker\[bags\]'"):
        open_log(str(path))


def test_many_poses_are_read_in_columns(tmp_path: Path) -> None:
    many = smooth_poses(20_000)
    found = Poses.join(list(open_log(str(write_sqlite(tmp_path, many))).batches()))
    np.testing.assert_array_equal(found.stamp_ns, many.stamp_ns)
