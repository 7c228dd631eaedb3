"""Recordings of other programs and of this one: poses, sources, truth, summary."""

import json
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Metadata
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.decoder import DecoderFactory

from contact_tracker.errors import AmbiguousSource, ChoiceError, NoPoses, NoTruth, UnreadableRecording
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording import (
    PoseLog,
    list_sources,
    open_log,
    read_metadata,
    read_truth,
    summarise,
    write_recording,
)
from contact_tracker.recording.items import RawMessage
from contact_tracker.recording.reading import Reading
from contact_tracker.states import Contact
from mcap_logs import (
    START_NS,
    Topic,
    joined,
    pose_stamped,
    poses_topic,
    smooth_poses,
    tf_topic,
    write_log,
)


def assert_same(result: Poses, expected: Poses) -> None:
    np.testing.assert_array_equal(result.stamp_ns, expected.stamp_ns)
    np.testing.assert_allclose(result.position_m, expected.position_m, rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.quat_xyzw, expected.quat_xyzw, rtol=0, atol=1e-12)


def labelled(poses: Poses) -> Truth:
    middle, end = int(poses.stamp_ns[len(poses) // 2]), int(poses.stamp_ns[-1])
    geometry = ContactGeometry(
        Line(np.array([0.6, 0.0, 0.8]), np.array([0.1, 0.2, 0.3])), Plane(np.array([0.0, 0.6, 0.8]), 0.25)
    )
    return Truth(
        (
            TruthInterval(int(poses.stamp_ns[0]), middle - 1, Contact.EF, "rest", True, geometry),
            TruthInterval(middle, end, None),
        )
    )


# --- writing ---------------------------------------------------------------------------------------------


def test_a_written_recording_is_read_back(tmp_path: Path) -> None:
    path, poses = str(tmp_path / "a.mcap"), smooth_poses(2000)
    truth = labelled(poses)
    for name in (path, tmp_path / "again.mcap"):
        write_recording(str(name), poses, truth, {"object": "box", "hand": "left"})
    assert Path(path).read_bytes() == (tmp_path / "again.mcap").read_bytes()
    log = open_log(path)
    assert_same(Poses.collect(log), poses)
    assert (log.counts, log.damage) == ({}, None)
    assert (log.source.topic, log.source.frames) == ("/object/pose", "world")
    assert read_truth(path).to_json() == truth.to_json()
    assert read_metadata(path) == {"recording": {"object": "box", "hand": "left"}}


def test_the_reference_reader_agrees_with_what_we_write(tmp_path: Path) -> None:
    path, poses = tmp_path / "a.mcap", smooth_poses(3000)
    write_recording(str(path), poses, labelled(poses), {})
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert {c.compression for c in summary.chunk_indexes} == {"zstd"}
        assert all(64e3 <= c.uncompressed_size <= 256e3 for c in summary.chunk_indexes[:-1])
        assert all(c.message_index_offsets for c in summary.chunk_indexes)
        rows = list(reader.iter_decoded_messages(["/object/pose"]))
        texts = [m.decoded_message.data for m in reader.iter_decoded_messages(["/contact/truth"])]
    assert texts == ["e-f", "?"]
    for pose, (_, _, message, decoded) in zip(poses, rows, strict=True):
        assert message.log_time == message.publish_time == pose.stamp_ns
        assert decoded.header.frame_id == "world"
        assert decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec == pose.stamp_ns
        p, q = decoded.pose.position, decoded.pose.orientation
        assert (p.x, p.y, p.z) == pose.position_m
        assert (q.x, q.y, q.z, q.w) == pose.quat_xyzw


@given(seed=st.integers(0, 2**32 - 1), chunk=st.sampled_from([0, 1, 3_000, 200_000]))
@settings(max_examples=40, deadline=None)
def test_messages_are_those_of_the_reference_reader_by_log_time(
    tmp_path_factory: Any, seed: int, chunk: int
) -> None:
    """For any sequence of messages of different channels and sizes, in any order or nearly sorted."""
    rng, path, topics = np.random.default_rng(seed), tmp_path_factory.mktemp("log") / "a.mcap", {"/0", "/2"}
    times = rng.permutation(1000) if seed % 2 else np.arange(1000) * 100 + rng.integers(-5000, 5000, 1000)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk, use_chunking=chunk > 0)
        writer.start()
        channels = [writer.register_channel(f"/{i}", "cdr", 0) for i in range(3)]
        writer.add_metadata("about", {"a": "b"})
        for log_time in dict.fromkeys((times + 10_000).tolist()):
            size = rng.choice([0, 7, 92])
            writer.add_message(int(rng.choice(channels)), log_time, rng.bytes(size), int(rng.integers(2**63)))
        writer.finish()
    with path.open("rb") as file:
        expected = [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(file).iter_messages(topics)
        ]
    reading = Reading(str(path), lambda channel: channel.topic in topics)
    items = list(reading)
    messages = [item for item in items if isinstance(item, RawMessage)]
    assert [(item.channel.topic, item.log_time_ns, item.data) for item in messages] == expected
    assert sum(isinstance(item, Metadata) for item in items) == 1
    assert reading.notes.damage is None


@pytest.mark.parametrize("named", [False, True])
def test_a_folder_of_separate_recordings_is_refused(tmp_path: Path, named: bool) -> None:
    for i in range(6):
        write_log(tmp_path / f"take_{i}.mcap", [poses_topic(smooth_poses(50))])
    if named:
        (tmp_path / "metadata.yaml").touch()
        open_log(str(tmp_path))
        return
    with pytest.raises(AmbiguousSource, match=r"take_0.mcap, take_1.mcap, .* and 2 more; name one"):
        open_log(str(tmp_path))
    with pytest.raises(AmbiguousSource, match="name one"):
        summarise(str(tmp_path))
    for i in range(1, 6):
        (tmp_path / f"take_{i}.mcap").rename(tmp_path / f"take_{i}.db3")
    with pytest.raises(AmbiguousSource, match=r"recordings of different formats \(\.db3, \.mcap\): take_0"):
        open_log(str(tmp_path))


def test_a_failed_write_keeps_the_existing_file(tmp_path: Path) -> None:
    path, poses = tmp_path / "a.mcap", smooth_poses()
    write_recording(str(path), poses, None, {})
    before = path.read_bytes()
    with pytest.raises(AttributeError):
        write_recording(str(path), poses, None, {"not text": 1})  # type: ignore[dict-item]
    with pytest.raises(ValueError, match="stamps"):
        write_recording(str(path), smooth_poses(start_ns=-5), None, {})
    assert os.listdir(tmp_path) == ["a.mcap"]
    assert path.read_bytes() == before


# --- files of others -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"use_chunking": False, "index_types": IndexType.NONE, "use_statistics": False},
        {"index_types": IndexType.NONE},
        {"repeat_channels": False, "repeat_schemas": False},
        {"repeat_schemas": False},
        {"chunk_size": 700, "compression": CompressionType.LZ4},
        {"chunk_size": 700, "compression": CompressionType.NONE, "enable_crcs": False},
        {"use_statistics": False, "use_summary_offsets": False},
    ],
    ids=str,
)
def test_every_kind_of_file_reads_the_same(tmp_path: Path, options: dict[str, Any]) -> None:
    poses = smooth_poses(300)
    wrench = Topic("/object/wrench", "geometry_msgs/msg/WrenchStamped", [(START_NS, b"not decoded")])
    path = str(write_log(tmp_path / "a.mcap", [wrench, poses_topic(poses)], **options))
    log = open_log(path)
    assert_same(Poses.collect(log), poses)
    assert (log.counts, log.damage) == ({}, None)


def test_the_header_stamp_is_the_time_however_far_the_log_time_is(tmp_path: Path) -> None:
    poses = smooth_poses()
    path = str(write_log(tmp_path / "a.mcap", [poses_topic(poses, offset_ns=515_000 * 10**9)]))
    assert_same(Poses.collect(open_log(path)), poses)
    assert summarise(path).sources[0].log_offset_s == pytest.approx(515_000)


def stamped(path: Path, stamps_ns: Iterable[int], poses: Poses) -> str:
    """Write the poses with these header stamps, logged at their true times."""
    rows = [(p.stamp_ns, pose_stamped(int(ns), *p[1:])) for ns, p in zip(stamps_ns, poses, strict=True)]
    return str(write_log(path, [Topic("/p", "geometry_msgs/msg/PoseStamped", rows)]))


def read_alike(path: str) -> tuple[Poses, dict[str, int]]:
    """The poses of a log, with equal counts one by one, in columns and in its summary."""
    log = open_log(path)
    poses = Poses.collect(log)
    columns, in_batches = in_columns(path)
    (source,) = summarise(path).sources
    assert list(columns) == list(poses)
    assert in_batches.counts == log.counts == source.counts
    assert source.poses == len(poses)
    return poses, dict(log.counts)


@pytest.mark.parametrize(
    ("resolution_ns", "rate_hz", "kept", "counted"),
    [
        *((10**18, rate_hz, 1, "log_time_as_stamp") for rate_hz in (30.0, 1000.0)),
        *((resolution_ns, 200.0, 1, "log_time_as_stamp") for resolution_ns in (10**9, 10**8)),
        (10**7, 200.0, 2, "repeated_stamp"),
    ],
)
def test_coarse_stamps_of_more_than_two_poses_are_not_used(
    tmp_path: Path, resolution_ns: int, rate_hz: float, kept: int, counted: str
) -> None:
    poses = smooth_poses(int(3 * rate_hz), rate_hz)
    stamps = poses.stamp_ns // resolution_ns * resolution_ns
    result, counts = read_alike(stamped(tmp_path / "a.mcap", stamps, poses))
    assert_same(result, poses[::kept])
    assert counts == {counted: len(poses) // kept}


@pytest.mark.parametrize(
    ("zeros", "first_ns", "speed"),
    [
        *((zeros, START_NS, 1.0) for zeros in ([0], range(100), [300], [599], range(600))),
        (range(0, 600, 10), START_NS - 3_000_000, 1.0),
        ([0, 1, 7, 300, 301, 599], START_NS + 515_000 * 10**9, 1.0),
        *(([], 0, speed) for speed in (0.1, 1.0, 3.0)),  # the clock of a simulation starts at zero
    ],
    ids=str,
)
def test_zero_stamps_among_others_follow_from_log_time(
    tmp_path: Path, zeros: Sequence[int], first_ns: int, speed: float
) -> None:
    poses = smooth_poses(600)
    stamps = first_ns + np.rint((poses.stamp_ns - START_NS) * speed).astype(np.int64)
    path = stamped(tmp_path / "a.mcap", np.where(np.isin(np.arange(600), zeros), 0, stamps), poses)
    result, counts = read_alike(path)
    assert_same(result, replace(poses, stamp_ns=stamps))
    assert counts == ({"log_time_as_stamp": len(zeros)} if len(zeros) else {})


@given(kinds=st.lists(st.integers(0, 24), min_size=1, max_size=80), batch=st.sampled_from([1, 3, 16, 500]))
@settings(max_examples=60)
def test_poses_in_columns_and_in_the_summary_are_those_one_by_one(
    tmp_path_factory: Any, kinds: list[int], batch: int
) -> None:
    """For any stamps: zero, leading, late, coarse, of a reset clock; and lost, infinite and held poses."""
    odd = (
        *(lambda ns: 0, lambda ns: ns + 10**10, lambda ns: ns - 10**9, lambda ns: ns // 10**9 * 10**9),
        lambda ns: ns - 10**11,
    )
    lost = {5: 0.0, 6: np.nan}
    poses = smooth_poses(len(kinds), 20.0)
    stamps = [(odd[kind] if kind < 5 else int)(ns) for kind, ns in zip(kinds, poses.stamp_ns, strict=True)]
    position, quat = poses.position_m.copy(), poses.quat_xyzw.copy()
    for i, kind in enumerate(kinds):
        position[i] = lost.get(kind, position[i])
        quat[i] *= -1.0 if kind == 7 else 1.0
        if kind == 8 and i:
            position[i], quat[i] = position[i - 1], quat[i - 1]
    path = stamped(tmp_path_factory.mktemp("log") / "a.mcap", stamps, Poses(poses.stamp_ns, position, quat))
    with patch("contact_tracker.recording.log.BATCH", batch):
        read_alike(path)


def in_columns(path: str, **options: Any) -> tuple[Poses, PoseLog]:
    log = open_log(path, **options)
    return Poses.join([Poses.collect(()), *log.batches()]), log


# --- several sources -------------------------------------------------------------------------------------


@pytest.mark.parametrize("indexed", [True, False])
def test_of_several_topics_one_has_to_be_chosen(tmp_path: Path, indexed: bool) -> None:
    a, b = smooth_poses(seed=1), smooth_poses(seed=2)
    topics = [poses_topic(a, "/a", "map"), poses_topic(b, "/b", "odom")]
    options = {"use_chunking": False, "index_types": IndexType.NONE, "use_statistics": False}
    path = str(write_log(tmp_path / "x.mcap", topics, **({} if indexed else options)))
    with pytest.raises(AmbiguousSource, match=r"--topic.*--frame.*/a map.*/b odom") as caught:
        open_log(path)
    assert "\n" not in str(caught.value)
    assert [(s.topic, s.frames) for s in list_sources(path)] == [("/a", "map"), ("/b", "odom")]
    assert [s.messages for s in list_sources(path)] == ([60, 60] if indexed else [None, None])
    for chosen in (open_log(path, topic="/b"), open_log(path, frame="odom"), open_log(path, "/b", "odom")):
        assert_same(Poses.collect(chosen), b)
        assert chosen.counts == {}


def tf_log(path: Path, first: tuple[Poses, str, str], second: tuple[Poses, str, str]) -> str:
    fixed = tf_topic([Pose(START_NS, (1, 2, 3), (0, 0, 0, 1))], "box", "lid", "/tf_static")
    return str(write_log(path, [fixed, tf_topic(*first, beside=[second])]))


def test_of_several_objects_on_one_topic_one_has_to_be_chosen(tmp_path: Path) -> None:
    a, b = smooth_poses(seed=1), smooth_poses(seed=2)
    path = tf_log(tmp_path / "x.mcap", (a, "world", "box"), (b, "world", "hand"))
    with pytest.raises(AmbiguousSource, match=r"/tf world->box .*; /tf world->hand"):
        open_log(path)
    assert_same(Poses.collect(open_log(path, frame="box")), a)
    assert_same(Poses.collect(open_log(path, frame="world->hand")), b)
    assert open_log(path, topic="/tf_static").source.frames == "box->lid"
    with pytest.raises(ChoiceError, match=r"cup.*/tf world->box"):
        open_log(path, frame="cup")
    path = tf_log(tmp_path / "y.mcap", (a, "camera", "box"), (b, "world", "box"))
    with pytest.raises(AmbiguousSource, match="camera->box"):
        open_log(path, frame="box")
    assert_same(Poses.collect(open_log(path, frame="world->box")), b)


def test_a_body_whose_parent_changes_is_never_lost_silently(tmp_path: Path) -> None:
    early, late = smooth_poses(900), smooth_poses(50, start_ns=START_NS + 4 * 10**9)
    topic = joined(tf_topic(early, "map", "box"), tf_topic(late, "world", "box"))
    path = str(write_log(tmp_path / "x.mcap", [topic]))
    with pytest.raises(AmbiguousSource, match=r"/tf map->box .*; /tf world->box "):
        Poses.collect(open_log(path, frame="box"))
    log = open_log(path, frame="map->box", count_late=True)
    assert_same(Poses.collect(log), early)
    assert log.counts == {"other_source": 50}


@pytest.mark.parametrize("indexed", [True, False])
def test_a_source_that_comes_late_has_to_be_chosen_or_is_counted(tmp_path: Path, indexed: bool) -> None:
    early, late = smooth_poses(900), smooth_poses(50, start_ns=START_NS + 4 * 10**9)
    rows = [*poses_topic(early, frame="a").messages, *poses_topic(late, frame="b").messages]
    topic = Topic("/p", "geometry_msgs/msg/PoseStamped", rows)
    options = {} if indexed else {"index_types": IndexType.NONE, "use_statistics": False}
    path = str(write_log(tmp_path / "x.mcap", [topic], chunk_size=4096, **options))
    for read in (Poses.collect, lambda log: Poses.join(list(log.batches()))):
        with pytest.raises(AmbiguousSource, match=r"/p a .*; /p b "):
            read(open_log(path))
        log = open_log(path, count_late=True)
        assert_same(read(log), early)
        assert log.counts == {"other_source": 50}
        assert [source.frames for source in log.late_sources] == ["b"]
    log = open_log(path, frame="b")
    assert_same(Poses.collect(log), late)
    assert log.counts == {}


def test_sources_of_long_files_are_found_by_the_index(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = smooth_poses(200, start_ns=START_NS + 20 * 10**9)
    topics = [poses_topic(smooth_poses(4000), "/a"), poses_topic(late, "/b")]
    path = str(write_log(tmp_path / "x.mcap", topics, chunk_size=4096))
    read: list[int] = []
    from contact_tracker.recording import bytestream

    original = bytestream.ByteStream.read
    monkeypatch.setattr(bytestream.ByteStream, "read", lambda s, n: (read.append(n), original(s, n))[1])
    with pytest.raises(AmbiguousSource):
        open_log(path)
    assert sum(read) < os.path.getsize(path) / 4


# --- what cannot be used ---------------------------------------------------------------------------------


IN_FRAME, WRONG = "foxglove.PoseInFrame", [(1, b"x")]


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        (Topic("/p", IN_FRAME, WRONG, "flatbuffer", "flatbuffer"), "in flatbuffer with"),
        (Topic("/p", IN_FRAME, [(1, b"{}")], "json", "jsonschema"), "no pose on /p can be read"),
        (Topic("/p", "nav_msgs/msg/Path", WRONG), "nav_msgs/msg/Path, which is no pose; poses are Pose"),
        (Topic("/p", "", WRONG, "cdr", ""), "/p is of no type in cdr with "),
        (Topic("/p", "geometry_msgs/msg/PoseStamped", WRONG), "no pose on /p can be read"),
        (Topic("/s", "std_msgs/msg/String", [(1, {"data": "f-f"})]), "no pose topic among /s"),
    ],
)
def test_poses_that_cannot_be_decoded_are_named(tmp_path: Path, topic: Topic, message: str) -> None:
    path = str(write_log(tmp_path / "a.mcap", [topic]))
    with pytest.raises(NoPoses, match=message) as caught:
        open_log(path)
    assert "\n" not in str(caught.value)
    assert list_sources(path) == []


def test_a_missing_or_unsuitable_topic_is_named(tmp_path: Path) -> None:
    string = Topic("/s", "std_msgs/msg/String", [(START_NS, {"data": "f-f"})])
    path = str(write_log(tmp_path / "a.mcap", [poses_topic(smooth_poses()), string]))
    with pytest.raises(ChoiceError, match=r"no topic /pose; there is /object/pose$"):
        open_log(path, topic="/pose")
    with pytest.raises(ChoiceError, match=r"/s is std_msgs/msg/String, which is no pose"):
        open_log(path, topic="/s")


def test_other_files_are_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("stamp,x,y,z\n" * 100)
    (tmp_path / "folder").mkdir()
    cases = {"empty.mcap": "empty", "text.mcap": "not an MCAP", "folder": "no .mcap", "missing": "no such"}
    for name, reason in cases.items():
        for read in (open_log, list_sources, read_truth, read_metadata, summarise):
            with pytest.raises(UnreadableRecording, match=rf"{name}: .*{reason}") as caught:
                read(str(tmp_path / name))  # type: ignore[operator]
            assert "\n" not in str(caught.value)


# --- truth, metadata, summary ----------------------------------------------------------------------------


def test_without_the_attachment_the_messages_are_the_truth(tmp_path: Path) -> None:
    poses = smooth_poses()
    changes = [
        (START_NS, {"data": "e-f"}),
        (START_NS + 10**8, {"data": "?"}),
        (START_NS + 2 * 10**8, {"data": "free"}),
    ]
    topics = [poses_topic(poses), Topic("/contact/truth", "std_msgs/msg/String", changes)]
    truth = read_truth(str(write_log(tmp_path / "a.mcap", topics)))
    rows = [(i.start_ns - START_NS, i.end_ns - START_NS, i.contact) for i in truth.intervals]
    end = int(poses.stamp_ns[-1]) - START_NS
    assert rows == [(0, 10**8 - 1, Contact.EF), (10**8, 2 * 10**8 - 1, None), (2 * 10**8, end, Contact.FREE)]
    topics[1].messages = [(START_NS, {"data": "sliding"})]
    with pytest.raises(NoTruth, match="sliding"):
        read_truth(str(write_log(tmp_path / "b.mcap", topics)))
    topics[1].messages = [(0, {"data": "f-f"}), (2**64 - 1, {"data": "e-f"})]
    with pytest.raises(NoTruth, match=LATE):
        read_truth(str(write_log(tmp_path / "c.mcap", topics)))
    assert read_truth(str(write_log(tmp_path / "d.mcap", topics[:1]))) is None


def test_truth_is_a_list_or_an_object_with_intervals() -> None:
    """A part of it without any has no changes."""
    rows = [{"start_ns": 0, "end_ns": 5, "contact": "v-f"}]
    truth = Truth.from_json(json.dumps(rows))
    assert truth == Truth.from_json(json.dumps({"intervals": rows}))
    assert (truth.between(10, 20).changes(), truth.changes()) == ([], [(0, Contact.VF)])


def one_row(**changes: Any) -> str:
    return json.dumps([{"start_ns": 0, "end_ns": 1, "contact": "f-f"} | changes])


FACE = {"type": "face", "normal": [0, 0, 1], "offset_m": 0.1}
LATE = "a stamp is more than 146 years from zero"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        *(
            (text, "")
            for text in ("", "7", "[" * 100_000, '{"segments": []}', '[{"start_ns": 0, "end_ns": 5}]')
        ),
        (one_row(end_ns=math.inf), ""),
        (one_row(contact="sliding"), ""),
        (f'{one_row(start_ns=6, end_ns=9)[:-1]}, {{"start_ns": 0, "end_ns": 5, "contact": "e-f"}}]', ""),
        (one_row(start_ns=10**30), LATE),
        (one_row(end_ns=-(10**30)), LATE),
        (one_row(further=[{"start_ns": 0, "end_ns": 10**30, "contact": "f-f"}]), LATE),
        (one_row(object=FACE | {"normal": [1]}, environment=FACE), "not of three numbers"),
        (one_row(object=FACE | {"normal": 3}, environment=FACE), "not of three numbers"),
        (one_row(object=FACE | {"normal": [[0, 0, 1]] * 3}, environment=FACE), "not a list of labelled"),
        (one_row(object=FACE, environment=FACE | {"offset_m": math.nan}), "a number that is nan"),
    ],
)
def test_a_truth_that_cannot_be_is_refused_in_one_line(tmp_path: Path, text: str, why: str) -> None:
    path = write_log(tmp_path / "a.mcap", [], truth=text)
    with pytest.raises(NoTruth, match=rf"^truth\.json.*{why}") as caught:
        read_truth(str(path))
    assert "\n" not in str(caught.value)


def test_a_folder_of_parts_is_one_recording_in_natural_order(tmp_path: Path) -> None:
    poses, folder = smooth_poses(120), tmp_path / "bag"
    folder.mkdir()
    for i in range(12):
        write_log(folder / f"bag_{i}.mcap", [poses_topic(poses[slice(10 * i, 10 * i + 10)])])
    assert_same(Poses.collect(open_log(str(folder))), poses)  # they follow each other in time
    (folder / "metadata.yaml").touch()
    log = open_log(str(folder))
    assert_same(Poses.collect(log), poses)
    assert (log.counts, log.damage) == ({}, None)
    assert list_sources(str(folder))[0].messages == 120
    (folder / "bag_12.mcap").touch()  # as after a crash
    log = open_log(str(folder))
    assert_same(Poses.collect(log), poses)
    assert "bag_12.mcap: it is empty" in log.damage


def test_the_summary_describes_a_recording(tmp_path: Path) -> None:
    poses = smooth_poses(401, rate_hz=100.0)
    gone = poses[np.r_[0:150, 250:401]]
    write_recording(str(tmp_path / "a.mcap"), gone, labelled(gone), {"object": "box"})
    result = summarise(str(tmp_path / "a.mcap"))
    (source,) = result.sources
    assert (source.poses, source.observed, source.counts) == (301, 301, {"gap": 1})
    assert (source.first_ns, source.last_ns) == (START_NS, int(poses.stamp_ns[-1]))
    assert source.duration_s == pytest.approx(4.0)
    assert source.rate_hz == pytest.approx(100.0)
    assert source.jitter_s == pytest.approx(0.0, abs=1e-6)
    steps = np.linalg.norm(np.diff(gone.position_m, axis=0), axis=1)
    assert source.path_m == pytest.approx(steps.sum())
    np.testing.assert_allclose(source.extent_m, np.ptp(gone.position_m, axis=0))
    assert result.topics[("/object/pose", "geometry_msgs/msg/PoseStamped", "cdr")] == 301
    assert result.metadata == {"recording": {"object": "box"}}
    assert (result.attachments, result.undecodable, result.damage) == (("truth.json",), 0, None)


def test_the_summary_of_irregular_poses_has_their_jitter(tmp_path: Path) -> None:
    poses = smooth_poses(3000)
    noise = np.random.default_rng(0).normal(0, 2e5, 3000).astype(np.int64)
    shaken = Poses(poses.stamp_ns + noise, poses.position_m, poses.quat_xyzw)
    (source,) = summarise(str(write_log(tmp_path / "a.mcap", [poses_topic(shaken)]))).sources
    assert source.rate_hz == pytest.approx(200.0, rel=0.01)
    assert source.jitter_s == pytest.approx(np.sqrt(2) * 2e-4, rel=0.1)


def test_the_rate_is_not_that_of_a_rounded_period(tmp_path: Path) -> None:
    """60 Hz with stamps to 0.1 ms and some frames dropped: most periods are 16.7 ms."""
    poses = smooth_poses(600, rate_hz=60.0)
    stamps = START_NS + np.round(np.arange(600) / 60.0, 4) * 1e9
    kept = np.random.default_rng(0).random(600) > 0.05
    rounded = Poses(stamps.astype(np.int64), poses.position_m, poses.quat_xyzw)[kept]
    (source,) = summarise(str(write_log(tmp_path / "a.mcap", [poses_topic(rounded)]))).sources
    assert f"{source.rate_hz:.1f}" == "60.0"


def test_an_invalid_log_time_is_noted(tmp_path: Path) -> None:
    """In a file log times are unsigned 64-bit integers, stamps are signed."""
    rows = [(2**63 + p.stamp_ns, pose_stamped(0, *p[1:])) for p in smooth_poses()]
    path = str(write_log(tmp_path / "a.mcap", [Topic("/p", "geometry_msgs/msg/PoseStamped", rows)]))
    for result, log in (in_columns(path), (Poses.collect(log_again := open_log(path)), log_again)):
        assert not len(result)
        assert log.counts["out_of_range"] == len(rows)
