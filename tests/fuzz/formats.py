"""Valid recordings of other formats than MCAP of ROS 2: bags, tables, exports, other definitions."""

import json
import sqlite3
import struct
from contextlib import closing
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from pyarrow import parquet
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.typesys import Stores, get_typestore

from mcap_logs import poses_topic, smooth_poses, write_log

POSES = smooth_poses(60)
NAME = "geometry_msgs/msg/PoseStamped"
COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
IDL = """\
module geometry_msgs { module msg { struct PoseStamped {
std_msgs::msg::Header header; geometry_msgs::msg::Pose pose; }; }; };
module std_msgs { module msg { struct Header { builtin_interfaces::msg::Time stamp; string frame_id; }; }; };
module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };
module geometry_msgs { module msg { struct Pose {
geometry_msgs::msg::Point position; geometry_msgs::msg::Quaternion orientation; }; }; };
module geometry_msgs { module msg { struct Point { double x; double y; double z; }; }; };
module geometry_msgs { module msg { struct Quaternion {
@default (value=0.0) double x; double y; double z; double w; }; }; };
"""
_MOTIVE = """\
Format Version,1.23,Take Name,take,Export Frame Rate,200.0,Rotation Type,Quaternion,Length Units,Meters

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body
,Name,cup,cup,cup,cup,cup,cup,cup
,ID,1,2,3,4,5,6,7
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z
"""
_VICON = "Objects\n200\n,,cup:cup,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n"


def _cdr() -> list[tuple[int, bytes]]:
    with TemporaryDirectory() as folder:
        path = write_log(Path(folder) / "a.mcap", [poses_topic(POSES)])
        with path.open("rb") as file:
            return [(message.log_time, message.data) for _, _, message in make_reader(file).iter_messages()]


def _ros1() -> list[tuple[int, bytes]]:
    return [
        (
            pose.stamp_ns,
            struct.pack("<IIII5s", i, *divmod(pose.stamp_ns, 10**9), 5, b"world")
            + struct.pack("<7d", *pose.position_m, *pose.quat_xyzw),
        )
        for i, pose in enumerate(POSES)
    ]


@cache
def definitions() -> tuple[bytes, ...]:
    """Uncompressed MCAP with types defined in IDL, as in ROS 1, or not at all."""
    ros1 = get_typestore(Stores.ROS1_NOETIC).generate_msgdef(NAME, ros_version=1)[0]
    return tuple(
        _mcap(encoding, schema_encoding, text, rows)
        for encoding, schema_encoding, text, rows in (
            ("cdr", "ros2idl", IDL, _cdr()),
            ("ros1", "ros1msg", ros1, _ros1()),
            ("cdr", "", "", _cdr()),
        )
    )


def _mcap(encoding: str, schema_encoding: str, text: str, rows: list[tuple[int, bytes]]) -> bytes:
    out = BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start()
    schema = writer.register_schema(NAME, schema_encoding, text.encode())
    channel = writer.register_channel("/pose", encoding, schema)
    for log_time, data in rows:
        writer.add_message(channel, log_time, data, log_time)
    writer.finish()
    return out.getvalue()


@cache
def bags() -> tuple[bytes, ...]:
    """Bags of ROS 1 in several chunks, each compression, and of rosbag2 in SQLite."""
    made = list[bytes]()
    with TemporaryDirectory() as folder:
        for compression in (None, "BZ2", "LZ4"):
            path = Path(folder) / f"{compression}.bag"
            writer = Rosbag1Writer(path)
            writer.chunk_threshold = 2000
            if compression is not None:
                writer.set_compression(Rosbag1Writer.CompressionFormat[compression])
            with writer:
                connection = writer.add_connection("/pose", NAME, typestore=get_typestore(Stores.ROS1_NOETIC))
                for log_time, data in _ros1():
                    writer.write(connection, log_time, data)
            made.append(path.read_bytes())
        path = Path(folder) / "a.db3"
        with closing(sqlite3.connect(path)) as file:
            file.execute(
                "create table topics(id integer primary key, name text, type text, "
                "serialization_format text, offered_qos_profiles text)"
            )
            file.execute(
                "create table messages(id integer primary key, topic_id integer, timestamp integer, "
                "data blob)"
            )
            file.execute("insert into topics values(1, '/pose', ?, 'cdr', '')", (NAME,))
            file.executemany("insert into messages(topic_id, timestamp, data) values(1, ?, ?)", _cdr())
            file.commit()
        made.append(path.read_bytes())
    return tuple(made)


def _rows() -> np.ndarray:
    return np.column_stack([POSES.stamp_ns / 1e9, POSES.position_m, POSES.quat_xyzw])


@cache
def texts() -> tuple[bytes, ...]:
    """TUM, named columns, exports of Motive and Vicon, and JSON lines."""
    rows = _rows()
    tum = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    named = ",".join(COLUMNS) + "\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    numbers = [",".join(map(repr, row)) for row in np.roll(rows[:, 1:], 4, axis=1).tolist()]
    motive = _MOTIVE + "\n".join(f"{i},{i / 200},{row}" for i, row in enumerate(numbers))
    vicon = _VICON + "\n".join(f"{i},0,{row}" for i, row in enumerate(numbers))
    objects = "\n".join(json.dumps(dict(zip(COLUMNS, row, strict=True))) for row in rows.tolist())
    return tuple(text.encode() for text in (tum, named, motive, vicon, objects))


@cache
def compressed_tables() -> tuple[bytes, ...]:
    made = list[bytes]()
    columns = zip(COLUMNS, zip(*_rows(), strict=True), strict=True)
    plain = {name: list(values) for name, values in columns}
    time, *others = plain
    rows = [
        dict(zip(others, row, strict=True)) for row in zip(*(plain[name] for name in others), strict=True)
    ]
    lists = pyarrow.array([list(row.values()) for row in rows])
    nested = {time: plain[time], "pose": rows, "state": lists}
    for columns, compression in ((plain, "zstd"), (plain, "snappy"), (plain, "none"), (nested, "zstd")):
        out = BytesIO()
        parquet.write_table(pyarrow.table(columns), out, compression=compression, row_group_size=25)
        made.append(out.getvalue())
    return tuple(made)


@cache
def arrays() -> tuple[bytes, ...]:
    """Arrays of NumPy by name, compressed and not."""
    named, made = dict(zip(COLUMNS, _rows().T, strict=True)), list[bytes]()
    for save in (np.savez, np.savez_compressed):
        out = BytesIO()
        save(out, **named)
        made.append(out.getvalue())
    return tuple(made)


@cache
def compressed_recordings() -> tuple[bytes, ...]:
    """Whole files under zstd."""
    packed = zstandard.ZstdCompressor().compress
    return (packed(_mcap("cdr", "", "", _cdr())),)
