"""LeRobot data sets of simulated motion, in the layouts of v2.1 and v3."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow
from pyarrow.parquet import write_table
from scipy.spatial.transform import Rotation

from contact_tracker_lab.simulate import Simulated

FPS = 50
POSE = ["x", "y", "z", "qx", "qy", "qz", "qw", "gripper"]


def write_data_set(
    folder: Path, episodes: Sequence[Simulated], version: str, names: object = POSE, euler: str | None = None
) -> Path:
    """Every fourth pose of recordings at 200 Hz as episodes; rotations as angles of an order of scipy."""
    tables = []
    for number, one in enumerate(episodes):
        poses = one.poses[:: 200 // FPS]
        count = len(poses)
        turn = poses.quat_xyzw
        if euler is not None:
            turn = Rotation.from_quat(turn).as_euler(euler)
        state = np.hstack([poses.position_m, turn, np.zeros((count, 1))]).astype(np.float32)
        size = state.shape[1]
        tables.append(
            pyarrow.table(
                {
                    "observation.state": pyarrow.FixedSizeListArray.from_arrays(state.ravel(), size),
                    "action": pyarrow.FixedSizeListArray.from_arrays(state.ravel(), size),
                    "observation.gripper": np.zeros(count, np.float32),
                    "timestamp": (np.arange(count) / FPS).astype(np.float32),
                    "frame_index": np.arange(count),
                    "episode_index": np.full(count, number),
                    "task_index": np.zeros(count, np.int64),
                }
            )
        )
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "videos").mkdir()
    (folder / "videos" / "camera.mp4").write_bytes(b"frames")
    kinds = {"dtype": "float32", "shape": [size], "names": names}
    features = {"observation.state": kinds, "action": kinds, "observation.images.top": {"dtype": "video"}}
    features["observation.gripper"] = {"dtype": "float32", "shape": [1], "names": None}
    info = {"codebase_version": version, "fps": FPS, "total_episodes": len(tables), "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info), encoding="utf-8")
    described = json.dumps({"info": {"features": {name: {} for name in tables[0].column_names}}})
    tables = [table.replace_schema_metadata({"huggingface": described}) for table in tables]
    if version == "v3.0":
        write_table(pyarrow.concat_tables(tables), folder / "data" / "chunk-000" / "file-000.parquet")
        return folder
    for number, table in enumerate(tables):
        write_table(table, folder / "data" / "chunk-000" / f"episode_{number:06d}.parquet")
    return folder
