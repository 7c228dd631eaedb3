"""Poses in messages as bytes, and in bags: MCAP of any encoding, rosbag1, rosbag2 in SQLite."""

import sqlite3
import struct
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_typestore

from contact_tracker.motion.poses import Pose, Poses
from mcap_logs import Topic, write_log

POSE_TYPE = "geometry_msgs/msg/PoseStamped"
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1_TEXT = ROS1.generate_msgdef(POSE_TYPE, ros_version=1)[0]


def cdr_pose(pose: Pose) -> bytes:
    """PoseStamped in the frame ``world``, in little-endian CDR."""
    head = struct.pack("<4siII6s6x", b"\0\1\0\0", *divmod(pose.stamp_ns, 10**9), 6, b"world\0")
    return head + struct.pack("<7d", *pose.position_m, *pose.quat_xyzw)


def ros1_pose(number: int, pose: Pose) -> bytes:
    """The same as ROS 1 encodes it."""
    head = struct.pack("<IIII5s", number, *divmod(pose.stamp_ns, 10**9), 5, b"world")
    return head + struct.pack("<7d", *pose.position_m, *pose.quat_xyzw)


def write_raw(
    path: Path,
    kind: str,
    message: str,
    schema_encoding: str,
    schema: bytes,
    rows: Sequence[tuple[int, bytes]],
    **options: Any,
) -> Path:
    """An MCAP file of messages (log time, bytes) of one type in the encoding ``message``."""
    return write_log(path, [Topic("/pose", kind, rows, message, schema_encoding, schema)], **options)


def write_rosbag1(path: Path, poses: Poses, compression: str | None = None, chunk_bytes: int = 2**20) -> Path:
    """A bag as rosbags writes it."""
    from rosbags.rosbag1 import Writer as Rosbag1Writer

    writer = Rosbag1Writer(path)
    writer.chunk_threshold = chunk_bytes
    if compression is not None:
        writer.set_compression(Rosbag1Writer.CompressionFormat[compression])
    with writer:
        connection = writer.add_connection("/object/pose", POSE_TYPE, typestore=ROS1)
        for number, pose in enumerate(poses):
            writer.write(connection, pose.stamp_ns, ros1_pose(number, pose))
    return path


def write_sqlite(path: Path, poses: Poses) -> Path:
    """A bag as rosbag2 wrote it up to Humble, by Python's sqlite3."""
    with closing(sqlite3.connect(path)) as file:
        file.execute(
            "create table topics(id integer primary key, name text, type text, serialization_format text, "
            "offered_qos_profiles text)"
        )
        file.execute(
            "create table messages(id integer primary key, topic_id integer, timestamp integer, data blob)"
        )
        file.execute("insert into topics values(1, '/object/pose', ?, 'cdr', '')", (POSE_TYPE,))
        file.execute("insert into topics values(2, '/rosout', 'rcl_interfaces/msg/Log', 'cdr', '')")
        rows = [(1, pose.stamp_ns, cdr_pose(pose)) for pose in poses]
        file.executemany("insert into messages(topic_id, timestamp, data) values(?, ?, ?)", rows)
        file.commit()
    return path
