"""Valid inputs of every kind, from which the mutations are made."""

import struct
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mcap.writer import CompressionType

import as_values
from contact_tracker.config import preset_names, shipped
from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.saved_state import save
from mcap_logs import Topic, poses_topic, smooth_poses, transform, write_log

ROOT = Path(__file__).resolve().parents[2]
KNOWN = """\
[up]
direction = [0, 0, 1]
spread_deg = 2

[environment]
complete = false

[[environment.plane]]
name = "table"
normal = [0, 0, 1]
offset_m = 0.71

[[environment.line]]
direction = [0, 1, 0]
point_m = [0.4, 0, 0.71]

[[environment.box]]
name = "block"
size_m = [0.1, 0.1, 0.3]
position_m = [0.2, 0, 0.86]
quat_xyzw = [0, 0, 0, 1]

[object.box]
size_m = [0.1, 0.1, 0.1]
"""


@cache
def recordings() -> tuple[bytes, ...]:
    """Small MCAP files: chunked and not, compressed and not, with one source and with several."""
    poses = Poses.collect(open_log(str(ROOT / "recordings" / "vision_30hz.mcap")))[:90]
    tf = [
        (pose.stamp_ns, {"transforms": [transform(*pose, "world", name) for name in ("a", "b", "c")]})
        for pose in smooth_poses(40)
    ]
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
        made.append(write_log(path, [Topic("/tf", "tf2_msgs/msg/TFMessage", tf)]).read_bytes())
    return tuple(made)


@cache
def models() -> tuple[bytes, ...]:
    return tuple((shipped() / f"{name}.toml").read_bytes() for name in preset_names())


@cache
def known_files() -> tuple[bytes, ...]:
    mesh = KNOWN.replace("[object.box]\nsize_m = [0.1, 0.1, 0.1]", '[object.mesh]\npath = "part.stl"')
    return KNOWN.encode(), mesh.encode()


@cache
def meshes() -> tuple[bytes, ...]:
    """A tetrahedron and a box, as binary STL, as text STL and as OBJ."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = [(a, b, c) for a, b, c, d in quads] + [(a, c, d) for a, b, c, d in quads]
    binary = BytesIO(bytes(80))
    binary.seek(80)
    binary.write(struct.pack("<I", len(triangles)))
    text, rows = ["solid box"], [f"v {x} {y} {z}" for x, y, z in corners]
    for triangle in triangles:
        points = corners[list(triangle)]
        binary.write(struct.pack("<12fH", 0, 0, 0, *points.ravel(), 0))
        loop = "".join(f"vertex {x} {y} {z}\n" for x, y, z in points)
        text.append(f"facet normal 0 0 0\nouter loop\n{loop}endloop\nendfacet")
        rows.append(f"f {' '.join(str(i + 1) for i in triangle)}")
    return binary.getvalue(), "\n".join([*text, "endsolid"]).encode(), "\n".join(rows).encode()


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
