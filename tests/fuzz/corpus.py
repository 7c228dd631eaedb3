"""Valid inputs of every kind, from which the mutations are made."""

import json
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow
import trimesh
import zstandard
from mcap.writer import CompressionType
from pyarrow import parquet

import as_values
from contact_tracker.config import preset_names, shipped
from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.saved_state import save
from mcap_logs import Topic, poses_topic, smooth_poses, tf_topic, write_log
from motive_export import write_motive
from pose_files import POSE_TYPE, ROS1_TEXT, cdr_pose, ros1_pose, write_raw, write_rosbag1, write_sqlite

ROOT = Path(__file__).resolve().parents[2]
POSES = smooth_poses(60)
COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
_VICON = "Objects\n200\n,,cup:cup,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n"


@cache
def recordings() -> tuple[bytes, ...]:
    """Small MCAP files: chunked and not, compressed and not, with one source and with several."""
    poses = Poses.collect(open_log(str(ROOT / "recordings" / "vision_30hz.mcap")))[:90]
    moving = smooth_poses(40)
    tf = tf_topic(moving, "world", "a", beside=[(moving, "world", child) for child in "bc"])
    truth = [(int(poses.stamp_ns[0]), {"data": "v-f"}), (int(poses.stamp_ns[50]), {"data": "free"})]
    topics = [poses_topic(poses), Topic("/contact/truth", "std_msgs/msg/String", truth)]
    made = list[bytes]()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        for options in (
            {"chunk_size": 1500, "compression": CompressionType.ZSTD},
            {"chunk_size": 1500, "compression": CompressionType.LZ4},
            {"chunk_size": 10**6, "compression": CompressionType.NONE},
            {"use_chunking": False},
        ):
            made.append(write_log(path, topics, **options).read_bytes())
        made.append(write_log(path, [tf]).read_bytes())
    return tuple(made)


@cache
def models() -> tuple[bytes, ...]:
    return tuple((shipped() / f"{name}.toml").read_bytes() for name in preset_names())


@cache
def known_files() -> tuple[bytes, ...]:
    """The file of docs/map.md, and one with a box for an object."""
    page = (ROOT / "docs" / "map.md").read_text(encoding="utf-8")
    mesh, _, _ = page.partition("```toml\n")[2].partition("```")
    box = mesh.partition("[object.mesh]")[0] + "[object.box]\nsize_m = [0.1, 0.1, 0.1]\n"
    return mesh.encode(), box.encode()


@cache
def meshes() -> tuple[bytes, ...]:
    """A box, as binary STL, as text STL and as OBJ."""
    made = (
        trimesh.creation.box((1.0, 1.0, 1.0)).export(file_type=one) for one in ("stl", "stl_ascii", "obj")
    )
    return tuple(one if isinstance(one, bytes) else one.encode() for one in made)


@cache
def states() -> tuple[bytes, ...]:
    state, _ = as_values.advance(as_values.start(load_model()), smooth_poses(120))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "s"
        save(path, state)
        return (path.read_bytes(),)


@cache
def streams() -> tuple[Poses, ...]:
    return (smooth_poses(150), Poses.collect(open_log(str(ROOT / "recordings" / "vision_30hz.mcap")))[:120])


@cache
def definitions() -> tuple[bytes, ...]:
    """Uncompressed MCAP with types defined in IDL, as in ROS 1, or not at all."""
    cdr = [(pose.stamp_ns, cdr_pose(pose)) for pose in POSES]
    ros1 = [(pose.stamp_ns, ros1_pose(i, pose)) for i, pose in enumerate(POSES)]
    made = list[bytes]()
    with TemporaryDirectory() as folder:
        for encoding, schema_encoding, text, rows in (
            ("cdr", "ros2idl", "module geometry_msgs { };", cdr),
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
    for write in (np.savez, np.savez_compressed):
        out = BytesIO()
        write(out, **named)
        made.append(out.getvalue())
    return tuple(made)


@cache
def compressed_recordings() -> tuple[bytes, ...]:
    """Whole files under zstd."""
    packed = zstandard.ZstdCompressor().compress
    return (packed(definitions()[-1]),)
