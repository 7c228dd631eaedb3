"""MCAP files for tests, written with the reference libraries: any type, any chunking, any topic."""

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import McapRecord
from mcap.writer import Writer
from mcap_ros2.writer import Writer as RosWriter
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from contact_tracker.motion.poses import Pose, Poses

START_NS = 1_700_000_000_000_000_000

ROS2 = get_typestore(Stores.ROS2_HUMBLE)
SCHEMAS = {
    kind: ROS2.generate_msgdef(kind, ros_version=2)[0]
    for kind in (
        *(
            f"geometry_msgs/msg/{name}Stamped"
            for name in ("Pose", "PoseWithCovariance", "Transform", "Wrench")
        ),
        *("nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "std_msgs/msg/String"),
    )
}


@dataclass
class Topic:
    """Messages of one topic: (log time, dict to be encoded by the type's schema, or bytes as they are), with
    the usual ``schema`` of the type or another one."""

    name: str
    type: str
    messages: Sequence[tuple[int, Any]]
    encoding: str = "cdr"
    schema_encoding: str = "ros2msg"
    schema: bytes | None = None


def write_log(path: Path, topics: Sequence[Topic], truth: str | None = None, **options: Any) -> Path:
    """Write the messages of all topics in the order of log time, and a truth attachment."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2", library="test")
        rows: list[tuple[int, int, bytes]] = []
        for topic in topics:
            text = SCHEMAS.get(topic.type, "").encode() if topic.schema is None else topic.schema
            schema = writer.register_schema(topic.type, topic.schema_encoding, text)
            channel = writer.register_channel(topic.name, topic.encoding, schema)
            times = [log_time for log_time, _ in topic.messages]
            rows += [(t, channel, data) for t, data in zip(times, _encode(topic), strict=True)]
        for log_time, channel, data in sorted(rows, key=lambda row: row[0]):
            writer.add_message(channel, log_time, data, log_time)
        if truth is not None:
            writer.add_attachment(0, 0, "truth.json", "application/json", truth.encode())
        writer.finish()
    return path


def header(stamp_ns: int, frame: str = "world") -> dict[str, Any]:
    return {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}, "frame_id": frame}


def vector(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyzw", map(float, values), strict=False))


def pose_stamped(
    stamp_ns: int, position: Sequence[float], quat: Sequence[float], frame: str = "world"
) -> Any:
    return {
        "header": header(stamp_ns, frame),
        "pose": {"position": vector(position), "orientation": vector(quat)},
    }


def transform(stamp_ns: int, position: Sequence[float], quat: Sequence[float], frame: str, child: str) -> Any:
    return {
        "header": header(stamp_ns, frame),
        "child_frame_id": child,
        "transform": {"translation": vector(position), "rotation": vector(quat)},
    }


def wrench_stamped(stamp_ns: int, values: Any, frame: str = "object") -> dict[str, Any]:
    return {
        "header": header(stamp_ns, frame),
        "wrench": {"force": vector(values[:3]), "torque": vector(values[3:])},
    }


def poses_topic(poses: Poses, name: str = "/object/pose", frame: str = "world", offset_ns: int = 0) -> Topic:
    """The poses as PoseStamped, logged ``offset_ns`` after their header stamps."""
    messages = [(p.stamp_ns + offset_ns, pose_stamped(*p, frame=frame)) for p in poses]
    return Topic(name, "geometry_msgs/msg/PoseStamped", messages)


TF = "tf2_msgs/msg/TFMessage"


def tf_topic(
    poses: Iterable[Pose],
    parent: str,
    child: str,
    name: str = "/tf",
    beside: Iterable[tuple[Iterable[Pose], str, str]] = (),
) -> Topic:
    """Transforms from ``child`` to ``parent``; those of chains ``beside`` are in the same messages."""
    chains = [[transform(*p, *pair) for p in chain] for chain, *pair in ((poses, parent, child), *beside)]
    rows = zip(poses, zip(*chains, strict=True), strict=True)
    return Topic(name, TF, [(pose.stamp_ns, {"transforms": list(parts)}) for pose, parts in rows])


def joined(*topics: Topic) -> Topic:
    """The messages of all topics on the first one."""
    return replace(topics[0], messages=[message for topic in topics for message in topic.messages])


def smooth_poses(count: int = 60, rate_hz: float = 200.0, seed: int = 0, start_ns: int = START_NS) -> Poses:
    """A smooth motion with generic numbers in every field, signs of quaternions continuous."""
    phase = np.random.default_rng(seed).uniform(0, 6, (2, 3))
    t = np.arange(count) / rate_hz
    quat = Rotation.from_rotvec(0.8 * np.sin(t[:, None] + phase[0])).as_quat(canonical=True)
    stamps = start_ns + np.round(t * 1e9).astype(np.int64)
    return Poses(stamps, 0.3 * np.cos(1.3 * t[:, None] + phase[1]), quat)


def as_bytes(*records: McapRecord) -> bytes:
    """Records as in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)  # type: ignore[attr-defined]
    return builder.end()


def records_in(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, begin and end of each record of an MCAP file."""
    at = 8
    while at < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, at)
        yield opcode, at, at + 9 + length
        at += 9 + length


def _encode(topic: Topic) -> list[bytes]:
    if topic.type not in SCHEMAS or all(isinstance(body, bytes) for _, body in topic.messages):
        return [body for _, body in topic.messages]
    buffer = BytesIO()
    with RosWriter(buffer) as writer:
        schema = writer.register_msgdef(topic.type, SCHEMAS[topic.type])
        for sequence, (_, body) in enumerate(topic.messages):
            writer.write_message(topic.name, schema, body, log_time=sequence)
    buffer.seek(0)
    return [message.data for _, _, message in make_reader(buffer).iter_messages()]
