"""Logs as a robot and a motion-capture system write them, made of recordings/paper_experiment.mcap to try the
pages of the documentation with:

    python docs/examples/sample_logs.py robot.mcap take.csv

``robot.mcap`` has an arm on /tf and /tf_static, ``take.csv`` two rigid bodies as Motive exports them. The
file name says which; files that exist are replaced.
"""

import argparse
import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap_ros2.writer import Writer
from scipy.spatial.transform import Rotation

import contact_tracker

RECORDINGS: Final = Path(__file__).resolve().parents[2] / "recordings"
REST: Final = 1000
"""Poses at the start of the recording, in which nothing moves."""
RATE_HZ: Final = 200
MOUNT: Final = (Rotation.from_euler("xyz", [0.3, -0.5, 0.7]), np.array([0.0, 0.0, 0.08]))
"""Rotation and position (m) of the object on the flange."""
UP: Final = np.array([0.566, 0.556, 0.609])
"""Which way the desk of the recording looks."""
TABLE_M: Final = (0.4, 0.7, 0.1)
TF_SCHEMA: Final = """\
geometry_msgs/TransformStamped[] transforms
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""


def moving_poses(seconds: float) -> tuple[Any, Rotation, Any]:
    """Stamps (ns), rotations and positions (m) of the recording after its rest."""
    poses = contact_tracker.read(RECORDINGS / "paper_experiment.mcap")
    rows = slice(REST, REST + round(RATE_HZ * seconds))
    return poses.stamp_ns[rows], Rotation.from_quat(poses.quat_xyzw[rows]), poses.position_m[rows]


def write_robot(path: Path) -> None:
    """``base`` to ``flange`` moves on /tf; on /tf_static is the mount of the object on the flange."""
    stamp_ns, turns, places = moving_poses(12.0)
    turns = turns * MOUNT[0].inv()
    places = places - turns.apply(MOUNT[1])
    with path.open("wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef("tf2_msgs/msg/TFMessage", TF_SCHEMA)

        def write(topic: str, stamp: int, frames: tuple[str, str], turn: Rotation, place: Any) -> None:
            message = {"transforms": [_transform(stamp, frames, turn, place)]}
            writer.write_message(topic, schema, message, log_time=stamp, publish_time=stamp)

        write("/tf_static", int(stamp_ns[0]), ("flange", "object"), *MOUNT)
        for stamp, turn, place in zip(stamp_ns.tolist(), turns, places, strict=True):
            write("/tf", stamp, ("base", "flange"), turn, place)


def _transform(stamp_ns: int, frames: tuple[str, str], turn: Rotation, place: Any) -> dict[str, Any]:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frames[0]},
        "child_frame_id": frames[1],
        "transform": {
            "translation": dict(zip("xyz", place.tolist(), strict=True)),
            "rotation": dict(zip("xyzw", turn.as_quat().tolist(), strict=True)),
        },
    }


def write_take(path: Path) -> None:
    """A cup on a table, in millimetres and with y up, as Motive has it."""
    _, turns, places = moving_poses(15.0)
    upwards = Rotation.align_vectors([0.0, 1.0, 0.0], UP)[0]
    rng = np.random.default_rng(0)
    count = len(places)
    shaken = Rotation.from_rotvec(rng.normal(0.0, 1e-3, (count, 3)))
    cup = _columns(upwards * turns, upwards.apply(places))
    table = _columns(shaken, np.tile(TABLE_M, (count, 1)) + rng.normal(0.0, 3e-4, (count, 3)))
    values = ["Rotation"] * 4 + ["Position"] * 3
    with path.open("w", newline="", encoding="utf-8-sig") as file:
        out = csv.writer(file)
        about = {"Format Version": "1.23", "Take Name": "take", "Capture Frame Rate": f"{RATE_HZ}.0"}
        about |= {"Rotation Type": "Quaternion", "Length Units": "Millimeters", "Coordinate Space": "Global"}
        out.writerow([cell for pair in about.items() for cell in pair])
        out.writerow([])
        out.writerow(["", "Type", *["Rigid Body"] * 14])
        out.writerow(["", "Name", *["cup"] * 7, *["table"] * 7])
        out.writerow(["", "ID", *range(14)])
        out.writerow(["", "", *values, *values])
        out.writerow(["Frame", "Time (Seconds)", *"XYZWXYZ", *"XYZWXYZ"])
        for frame, row in enumerate(np.hstack([cup, table]).round(6).tolist()):
            out.writerow([frame, f"{frame / RATE_HZ:.6f}", *row])


def _columns(turns: Rotation, places_m: Any) -> Any:
    """(N, 7) quaternions and positions in mm."""
    return np.hstack([turns.as_quat(), 1000.0 * places_m])


SAMPLES: Final[dict[str, Callable[[Path], None]]] = {"robot.mcap": write_robot, "take.csv": write_take}


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help=f"{' or '.join(SAMPLES)}")
    for path in parser.parse_args(argv).files:
        if path.name not in SAMPLES:
            parser.error(f"{path.name} is none of {', '.join(SAMPLES)}")
        SAMPLES[path.name](path)


if __name__ == "__main__":
    main()
