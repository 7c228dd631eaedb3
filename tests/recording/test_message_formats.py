"""Messages of other types and encodings than PoseStamped of ROS 2, in files that other libraries wrote."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
import pytest
from mcap_ros1.writer import Writer as Ros1Writer

from contact_tracker.config.table_reading import TableReading
from contact_tracker.errors import AmbiguousSource, ChoiceError, MissingExtra, NoPoses
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording import list_sources, open_log, summarise
from mcap_logs import (
    SCHEMAS,
    START_NS,
    TF,
    Topic,
    header,
    pose_stamped,
    poses_topic,
    smooth_poses,
    transform,
    vector,
    write_log,
)
from pose_files import POSE_TYPE, ROS1_TEXT, cdr_pose, ros1_pose, write_raw

COUNT = 60
POSES = smooth_poses(COUNT)
OTHER = smooth_poses(COUNT, seed=5)
FIRST = next(iter(POSES))


def assert_read(path: Path, expected: Poses = POSES, **which: Any) -> None:
    """The log has these poses, one by one and in columns; positions to the digits of JSON and text."""
    for collect in (Poses.collect, lambda log: Poses.join(list(log.batches()))):
        result = collect(open_log(str(path), **which))
        np.testing.assert_array_equal(result.stamp_ns, expected.stamp_ns)
        np.testing.assert_allclose(result.position_m, expected.position_m, rtol=0, atol=1e-12)
        np.testing.assert_allclose(result.quat_xyzw, expected.quat_xyzw, rtol=0, atol=1e-12)


# --- ROS 2 by rosbags and mcap_ros2 ------------------------------------------------------------------------


def named(pose: Pose) -> dict[str, Any]:
    return {"position": vector(pose.position_m), "orientation": vector(pose.quat_xyzw)}


RULE = "=" * 80 + "\n"
PARTS = SCHEMAS["geometry_msgs/msg/PoseStamped"].partition(RULE)[2]
NAMED_POSE = (
    f"{RULE}MSG: motion_capture_tracking_interfaces/NamedPose\nstring name\ngeometry_msgs/Pose pose\n"
)
BODY = f"{RULE}MSG: mocap4r2_msgs/RigidBody\nstring rigid_body_name\ngeometry_msgs/Pose pose\n"
MARKER = "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n"
HEAD = "std_msgs/Header header\n"


def with_covariance(pose: Pose, **further: str) -> dict[str, Any]:
    return {**pose_stamped(*pose), "pose": {"pose": named(pose), "covariance": [0.5] * 36}, **further}


SINGLE: dict[str, tuple[str, Callable[[Pose], Any]]] = {
    "geometry_msgs/msg/PoseStamped": ("world", lambda p: pose_stamped(*p)),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("world", with_covariance),
    "nav_msgs/msg/Odometry": ("world->box", lambda p: with_covariance(p, child_frame_id="box")),
    "geometry_msgs/msg/TransformStamped": ("world->box", lambda p: transform(*p, "world", "box")),
    TF: ("world->box", lambda p: {"transforms": [transform(*p, "world", "box")]}),
}


@pytest.mark.parametrize("kind", SINGLE)
def test_each_pose_type_is_read(tmp_path: Path, kind: str) -> None:
    frames, message = SINGLE[kind]
    path = write_log(tmp_path / "a.mcap", [Topic("/p", kind, [(p.stamp_ns, message(p)) for p in POSES])])
    (source,) = list_sources(str(path))
    assert (source.type, source.frames) == (kind, frames)
    assert_read(path)


DETECTION = (
    f"{RULE}MSG: vision_msgs/Detection3D\nvision_msgs/ObjectHypothesisWithPose[] results\nstring id\n"
    f"{RULE}MSG: vision_msgs/ObjectHypothesisWithPose\nvision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose\n"
    f"{RULE}MSG: vision_msgs/ObjectHypothesis\nstring class_id\nfloat64 score\n"
    f"{RULE}MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n"
)
ARRAYS: dict[str, tuple[str, Callable[[Pose, Pose], Any], tuple[str, ...]]] = {
    "geometry_msgs/msg/PoseArray": (
        f"{HEAD}geometry_msgs/Pose[] poses\n{RULE}{PARTS}",
        lambda a, b: {"header": header(a.stamp_ns), "poses": [named(a), named(b)]},
        ("0", "1"),
    ),
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": (
        f"{HEAD}NamedPose[] poses\n{NAMED_POSE}{RULE}{PARTS}",
        lambda a, b: {
            "header": header(a.stamp_ns),
            "poses": [{"name": "cup", "pose": named(a)}, {"name": "table", "pose": named(b)}],
        },
        ("cup", "table"),
    ),
    "mocap4r2_msgs/msg/RigidBodies": (
        f"{HEAD}uint32 frame_number\nmocap4r2_msgs/RigidBody[] rigidbodies\n{BODY}{RULE}{PARTS}",
        lambda a, b: {
            "header": header(a.stamp_ns),
            "frame_number": 7,
            "rigidbodies": [
                {"rigid_body_name": "1", "pose": named(a)},
                {"rigid_body_name": "2", "pose": named(b)},
            ],
        },
        ("1", "2"),
    ),
    "vision_msgs/msg/Detection3DArray": (
        f"{HEAD}vision_msgs/Detection3D[] detections\n{DETECTION}{RULE}{PARTS}",
        lambda a, b: {
            "header": header(a.stamp_ns),
            "detections": [
                {"id": "7", "results": [{"hypothesis": {"class_id": "mug"}, "pose": {"pose": named(a)}}]},
                *[{"id": "", "results": [{"hypothesis": {"class_id": "nut"}, "pose": {"pose": named(b)}}]}]
                * 2,
                {"id": "9", "results": []},
            ],
        },
        ("mug/7", "nut", "nut#2"),
    ),
    "visualization_msgs/msg/MarkerArray": (
        f"visualization_msgs/Marker[] markers\n{RULE}MSG: visualization_msgs/Marker\n{MARKER}{RULE}{PARTS}",
        lambda a, b: {
            "markers": [
                {"header": header(a.stamp_ns), "ns": "box", "id": 3, "action": action, "pose": named(pose)}
                for action, pose in ((0, a), (2, b))
            ]
            + [{"header": header(b.stamp_ns), "ns": "box", "id": 4, "pose": named(b)}]
        },
        ("box/3", "box/4"),
    ),
}


def write_ros2(path: Path, topics: list[tuple[str, str, str, list[tuple[int, Any]]]]) -> Path:
    from mcap_ros2.writer import Writer as RosWriter

    with path.open("wb") as file, RosWriter(file) as writer:
        for topic, kind, text, messages in topics:
            schema = writer.register_msgdef(kind, text)
            for log_time, message in messages:
                writer.write_message(topic, schema, message, log_time=log_time)
    return path


@pytest.mark.parametrize("kind", ARRAYS)
def test_each_pose_of_an_array_is_a_source(tmp_path: Path, kind: str) -> None:
    text, message, names = ARRAYS[kind]
    rows = [(a.stamp_ns, message(a, b)) for a, b in zip(POSES, OTHER, strict=True)]
    path = write_ros2(tmp_path / "a.mcap", [("/bodies", kind, text, rows)])
    with pytest.raises(AmbiguousSource, match=f"world->{names[0]}.*world->{names[1]}"):
        open_log(str(path))
    assert_read(path, POSES, frame=names[0])
    assert_read(path, OTHER, frame=f"world->{names[1]}")
    assert [source.source.child_frame_id for source in summarise(str(path)).sources] == list(names)


WRAPPED = (
    f"string ns\nstring name\ngeometry_msgs/PoseStamped pose\n{RULE}MSG: geometry_msgs/PoseStamped\n"
    f"{HEAD}geometry_msgs/Pose pose\n{RULE}{PARTS}"
)


def wrapped(path: Path) -> Path:
    rows = [
        (p.stamp_ns, {"ns": "a", "name": "cup", "pose": {"header": header(p.stamp_ns), "pose": named(p)}})
        for p in POSES
    ]
    return write_ros2(path, [("/object", "lab_msgs/msg/Tracked", WRAPPED, rows)])


@pytest.mark.parametrize("field", ["pose", "pose.pose"])
def test_poses_in_a_field_of_messages_of_another_type(tmp_path: Path, field: str) -> None:
    path = wrapped(tmp_path / "a.mcap")
    reading = TableReading(field=field)
    assert_read(path, POSES, table=reading)
    (source,) = (entry.source for entry in summarise(str(path), reading).sources)
    assert (source.frame_id, source.child_frame_id) == ("world", "cup")
    stamped = write_log(tmp_path / "b.mcap", [poses_topic(POSES)])
    for log, name in (path, field), (stamped, "pose"):
        with pytest.raises(ChoiceError, match="no table"):
            open_log(str(log), table=TableReading(field=name, unit="mm"))


@pytest.mark.parametrize("field", [None, "poze"])
@pytest.mark.parametrize("arguments", [(), ("live", "--json", "x"), ("info", "x", "--topic", "/object")])
def test_the_command_for_a_field_is_named(
    tmp_path: Path, field: str | None, arguments: tuple[str, ...]
) -> None:
    path = wrapped(tmp_path / "a.mcap")
    words = " ".join(arguments or ("segment", str(path)))
    words += "" if "--topic" in arguments else " --topic /object"
    with pytest.raises(NoPoses, match=rf"tracker {re.escape(words)} --field pose\.pose$"):
        open_log(str(path), table=TableReading(field=field, given=arguments))


def test_one_element_of_a_list_in_json(tmp_path: Path) -> None:
    rows = [
        (a.stamp_ns, json.dumps({"seen": [{"at": named(b)}, {"at": named(a)}]}).encode())
        for a, b in zip(POSES, OTHER, strict=True)
    ]
    path = write_raw(tmp_path / "a.mcap", "Seen", "json", "jsonschema", b"{}", rows)
    assert_read(path, POSES, table=TableReading(field="seen[1].at"))
    assert_read(path, OTHER, frame="0", table=TableReading(field="seen.at"))


def test_poses_without_header_markers_and_states_of_gazebo(tmp_path: Path) -> None:
    """Without a header they have their log times."""
    text = f"geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n{RULE}{PARTS}"
    rows = [(pose.stamp_ns, named(pose)) for pose in POSES]
    assert_read(write_ros2(tmp_path / "c.mcap", [("/turtle", "geometry_msgs/msg/Pose", text, rows)]))
    text, kind = f"string[] name\ngeometry_msgs/Pose[] pose\n{RULE}{PARTS}", "gazebo_msgs/msg/ModelStates"
    rows = [(p.stamp_ns, {"name": ["floor", "cup"], "pose": [named(FIRST), named(p)]}) for p in POSES]
    assert_read(write_ros2(tmp_path / "a.mcap", [("/states", kind, text, rows)]), POSES, frame="cup")
    rows = [(p.stamp_ns, {"header": header(p.stamp_ns), "ns": "a", "id": 1, "pose": named(p)}) for p in POSES]
    text, kind = f"{MARKER}{RULE}{PARTS}", "visualization_msgs/msg/Marker"
    assert_read(write_ros2(tmp_path / "b.mcap", [("/m", kind, text, rows)]))


@pytest.mark.parametrize(
    ("kind", "encoding", "text", "why"),
    [
        (POSE_TYPE, "", "", "the file does not define it"),
        (POSE_TYPE, "ros2msg", "", "the file does not define it"),
        (POSE_TYPE, "ros2msg", POSE_TYPE, "its definition in the file cannot be used"),
        (POSE_TYPE, "ros2idl", "module {", "definitions in IDL are not read"),
        (
            POSE_TYPE,
            "ros2msg",
            "std_msgs/Header header\nPose pose\n",
            "its definition in the file lacks parts",
        ),
        ("geometry_msgs/PoseStamped", "ros2msg", SCHEMAS[POSE_TYPE], None),
    ],
)
def test_a_known_type_needs_no_definition(
    tmp_path: Path, kind: str, encoding: str, text: str, why: str | None
) -> None:
    """The use of the known one is counted, and reported in one line."""
    rows = [(pose.stamp_ns, cdr_pose(pose)) for pose in POSES]
    path = write_raw(tmp_path / "a.mcap", kind, "cdr", encoding, text.encode(), rows)
    assert_read(path)
    line = f"{COUNT} poses are read by the known definition of {kind}: {why}" if why else None
    counts = {"known_definition": COUNT} if why else {}
    for collect in (Poses.collect, lambda log: Poses.join(list(log.batches()))):
        log = open_log(str(path))
        collect(log)
        assert (log.counts, log.remarks) == (counts, (line,) if line else ())
    summary = summarise(str(path))
    assert summary.sources[0].poses == COUNT
    assert summary.sources[0].counts == counts
    assert summary.assumptions == ((f"/pose: {line}",) if line else ())


def test_two_types_on_one_topic_are_two_sources(tmp_path: Path) -> None:
    path, name = tmp_path / "a.mcap", "geometry_msgs/msg/PoseWithCovarianceStamped"
    others = [(p.stamp_ns, with_covariance(p)) for p in OTHER]
    write_log(path, [poses_topic(POSES, "/a"), Topic("/a", name, others)])
    with pytest.raises(AmbiguousSource, match=r"msg/PoseStamped\).*/PoseWithCovarianceStamped\)"):
        open_log(str(path), topic="/a")
    for kind in ("PoseStamped", "geometry_msgs/msg/PoseStamped"):
        assert_read(path, topic=f"/a:{kind}")
    assert_read(path, OTHER, topic="/a:PoseWithCovarianceStamped")
    with pytest.raises(ChoiceError, match=r"no topic /a:Path; there is /a$"):
        open_log(str(path), topic="/a:Path")


# --- ROS 1 -------------------------------------------------------------------------------------------------


def test_ros1_messages(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"

    class PoseStamped:
        _type, _full_text = "geometry_msgs/PoseStamped", ROS1_TEXT

        def __init__(self, seq: int, pose: Pose) -> None:
            self._packed = ros1_pose(seq, pose)

        def serialize(self, buffer: Any) -> None:
            buffer.write(self._packed)

    with path.open("wb") as file:
        writer = Ros1Writer(file)
        for seq, pose in enumerate(POSES):
            writer.write_message("/pose", PoseStamped(seq, pose), log_time=pose.stamp_ns)
        writer.finish()
    assert_read(path)
    assert list_sources(str(path))[0].type == "geometry_msgs/PoseStamped"


# --- Foxglove ----------------------------------------------------------------------------------------------


def foxglove_message(kind: str, a: Pose, b: Pose) -> dict[str, Any]:
    """A message of the pose ``a``, and of ``b`` in types with several poses, as in JSON."""
    sec, nsec = divmod(a.stamp_ns, 10**9)
    head = {"timestamp": {"sec": sec, "nsec": nsec}}
    frames = [
        {
            **head,
            "parent_frame_id": "world",
            "child_frame_id": str(i),
            "translation": vector(p.position_m),
            "rotation": vector(p.quat_xyzw),
        }
        for i, p in enumerate((a, b))
    ]
    return {
        "PoseInFrame": {**head, "frame_id": "world", "pose": named(a)},
        "PosesInFrame": {**head, "frame_id": "world", "poses": [named(a), named(b)]},
        "FrameTransform": frames[0],
        "FrameTransforms": {"transforms": frames},
    }[kind]


CLASSES = {
    **{"timestamp": "Timestamp", "pose": "Pose", "poses": "Pose", "transforms": "FrameTransform"},
    **dict.fromkeys(("position", "translation"), "Vector3"),
    **dict.fromkeys(("orientation", "rotation"), "Quaternion"),
}


def of_sdk(schemas: Any, name: str, value: Any) -> Any:
    """The same as objects of Foxglove's SDK."""
    if isinstance(value, list):
        return [of_sdk(schemas, name, element) for element in value]
    if not isinstance(value, dict):
        return value
    return getattr(schemas, name)(
        **{key: of_sdk(schemas, CLASSES.get(key, ""), inner) for key, inner in value.items()}
    )


KINDS = ("PoseInFrame", "PosesInFrame", "FrameTransform", "FrameTransforms")


@pytest.mark.parametrize("kind", KINDS)
def test_foxglove_protobuf(tmp_path: Path, kind: str) -> None:
    """As encoded by Foxglove's SDK."""
    path = tmp_path / "a.mcap"
    schemas = __import__("foxglove.messages" if _has_messages() else "foxglove.schemas", fromlist=["Pose"])
    channels = __import__("foxglove.channels", fromlist=["PoseInFrameChannel"])
    context = foxglove.Context()
    with foxglove.open_mcap(str(path), context=context):
        channel = getattr(channels, f"{kind}Channel")("/pose", context=context)
        for a, b in zip(POSES, OTHER, strict=True):
            channel.log(of_sdk(schemas, kind, foxglove_message(kind, a, b)), log_time=a.stamp_ns)
    assert_foxglove(path, kind)


def _has_messages() -> bool:
    from importlib.util import find_spec

    return find_spec("foxglove.messages") is not None


def assert_foxglove(path: Path, kind: str) -> None:
    assert {source.type for source in list_sources(str(path))} == {f"foxglove.{kind}"}
    if kind.endswith("s") or kind == "PosesInFrame":
        assert_read(path, frame="0")
        assert_read(path, OTHER, frame="1")
    else:
        assert_read(path)


@pytest.mark.parametrize("kind", KINDS)
def test_foxglove_json(tmp_path: Path, kind: str) -> None:
    pairs = zip(POSES, OTHER, strict=True)
    rows = [(a.stamp_ns, json.dumps(foxglove_message(kind, a, b)).encode()) for a, b in pairs]
    path = write_raw(tmp_path / "a.mcap", f"foxglove.{kind}", "json", "jsonschema", b"{}", rows)
    assert_foxglove(path, kind)


@pytest.mark.parametrize("kind", ["text", "seconds", "microseconds"])
def test_stamps_in_json_may_be_dates(tmp_path: Path, kind: str) -> None:
    """As text, which protobuf's JSON has, or as numbers; others leave the log time."""
    stamps = {
        "text": lambda ns: f"2023-11-14T22:13:{20 + (ns - START_NS) / 1e9:012.9f}Z",
        "seconds": lambda ns: ns / 1e9,
        "microseconds": lambda ns: ns // 1000,
    }
    rows = [
        (
            7,
            json.dumps(
                {"timestamp": stamps[kind](pose.stamp_ns), "frame_id": "w", "pose": named(pose)}
            ).encode(),
        )
        for pose in POSES
    ]
    path = write_raw(tmp_path / "a.mcap", "foxglove.PoseInFrame", "json", "jsonschema", b"{}", rows)
    log = open_log(str(path))
    read = Poses.collect(log).stamp_ns
    np.testing.assert_allclose(read - START_NS, POSES.stamp_ns - START_NS, atol=1000)
    assert not log.counts


@pytest.mark.parametrize(
    "message",
    [
        b"{",
        b"[1, 2]",
        b"[" * 100_000,
        b'{"timestamp": {"sec": "x", "nsec": 0}}',
        json.dumps({"timestamp": {"sec": 1, "nsec": 0}, "frame_id": 7, "pose": named(FIRST)}).encode(),
        json.dumps({"timestamp": {"sec": 1}, "frame_id": "w", "pose": named(FIRST)}).encode(),
        json.dumps(
            {"timestamp": {"sec": 1, "nsec": 1}, "frame_id": "w", "pose": {"position": None}}
        ).encode(),
        b'{"timestamp": {"sec": Infinity, "nsec": 0}, "frame_id": "w", "pose": {}}',
    ],
)
def test_json_that_is_no_pose_is_counted(tmp_path: Path, message: bytes) -> None:
    good = {"timestamp": {"sec": 1, "nsec": 5}, "frame_id": "w", "pose": named(FIRST)}
    far = {**good, "timestamp": {"sec": 10**30, "nsec": 5}}
    rows = [(5, json.dumps(good).encode()), (6, message), (7, json.dumps(far).encode())]
    path = write_raw(tmp_path / "a.mcap", "foxglove.PoseInFrame", "json", "jsonschema", b"{}", rows)
    log = open_log(str(path))
    assert len(Poses.collect(log)) == 1
    assert log.counts == {"undecodable": 1, "out_of_range": 1}
    assert summarise(str(path)).undecodable == 1


def test_a_missing_library_is_named_with_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mcap_protobuf.decoder", None)
    rows = [(START_NS, b"x")]
    path = write_raw(tmp_path / "a.mcap", "foxglove.PoseInFrame", "protobuf", "protobuf", b"", rows)
    for read in (open_log, summarise):
        with pytest.raises(MissingExtra, match=r"pip install 'contact-tracker\[foxglove\]'"):
            read(str(path))
