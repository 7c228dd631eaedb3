"""Valid recordings of other formats than MCAP of ROS 2: bags, tables, exports, other definitions."""

import json
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow
import zstandard
from mcap.writer import CompressionType
from pyarrow import parquet

from mcap_logs import smooth_poses
from motive_export import write_motive
from pose_files import POSE_TYPE, ROS1_TEXT, cdr_pose, ros1_pose, write_raw, write_rosbag1, write_sqlite

POSES = smooth_poses(60)
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
_VICON = "Objects\n200\n,,cup:cup,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n"


@cache
def definitions() -> tuple[bytes, ...]:
    """Uncompressed MCAP with types defined in IDL, as in ROS 1, or not at all."""
    cdr = [(pose.stamp_ns, cdr_pose(pose)) for pose in POSES]
    ros1 = [(pose.stamp_ns, ros1_pose(i, pose)) for i, pose in enumerate(POSES)]
    made = list[bytes]()
    with TemporaryDirectory() as folder:
        for encoding, schema_encoding, text, rows in (
            ("cdr", "ros2idl", IDL, cdr),
            ("ros1", "ros1msg", ROS1_TEXT, ros1),
            ("cdr", "", "", cdr),
        ):
            about = POSE_TYPE, encoding, schema_encoding, text.encode(), rows
            path = write_raw(Path(folder) / "a.mcap", *about, compression=CompressionType.NONE)
            made.append(path.read_bytes())
    return tuple(made)


@cache
def bags() -> tuple[bytes, ...]:
    """Bags of ROS 1 in several chunks, each compression, and of rosbag2 in SQLite."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        made = [write_rosbag1(folder / f"{one}.bag", POSES, one, 2000) for one in (None, "BZ2", "LZ4")]
        return tuple(path.read_bytes() for path in [*made, write_sqlite(folder / "a.db3", POSES)])


def _rows() -> np.ndarray:
    return np.column_stack([POSES.stamp_ns / 1e9, POSES.position_m, POSES.quat_xyzw])


@cache
def texts() -> tuple[bytes, ...]:
    """TUM, named columns, exports of Motive and Vicon, and JSON lines."""
    rows = _rows()
    tum = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    named = ",".join(COLUMNS) + "\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    numbers = [",".join(map(repr, row)) for row in np.roll(rows[:, 1:], 4, axis=1).tolist()]
    with TemporaryDirectory() as folder:
        motive = write_motive(Path(folder) / "take.csv", POSES, POSES).read_text(encoding="utf-8")
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
    return (packed(definitions()[-1]),)
