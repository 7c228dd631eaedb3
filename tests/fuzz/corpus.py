"""Valid inputs of every kind, from which the mutations are made."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import trimesh
from mcap.writer import CompressionType

import as_values
from contact_tracker.config import preset_names, shipped
from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.saved_state import save
from mcap_logs import Topic, poses_topic, smooth_poses, tf_topic, write_log

ROOT = Path(__file__).resolve().parents[2]


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
