"""How often ``--up`` is reported as wrong, by its error, on recordings whose faces all have one direction.

    python tests/benchmarks/directions.py
    python tests/benchmarks/directions.py recordings/all_states.mcap --errors 0 3 15

Recordings whose faces differ in direction by more than a degree are left out. An error turns the true
direction about a random axis across it. At 0 and 3 degrees none should be reported: the standard deviation of
``--up`` is 2.
"""

import sys
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.config.loading import load_model
from contact_tracker.geometry.elements import Plane
from contact_tracker.map.file import map_from
from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import need_truth, open_log
from contact_tracker.segmenting import OfflineTracker
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.tables import number
from shared_recordings import SHARED_RECORDINGS

Array = NDArray[np.float64]

ERRORS_DEG: Final = (0.0, 3.0, 15.0, 30.0, 60.0, 90.0)
PARALLEL_DEG: Final = 1.0


def direction_of_faces(path: Path) -> Array | None:
    """The normal (3,) of all faces of the surroundings that are touched; None without one direction."""
    elements = [i.geometry.environment for i in need_truth(str(path)).intervals if i.geometry is not None]
    normals = np.array([element.normal for element in elements if isinstance(element, Plane)])
    if not len(normals):
        return None
    angles_deg = np.degrees(np.arccos(np.clip(normals @ normals[0], -1.0, 1.0)))
    return None if angles_deg.max() > PARALLEL_DEG else np.asarray(normals[0])


def is_reported(poses: Poses, direction: Array) -> bool:
    """Whether ``direction`` is reported as wrong."""
    known_map = map_from({"up": {"direction": [float(part) for part in direction]}})
    tracker = OfflineTracker(load_model(), known_map)
    for _ in tracker.pieces(poses):
        pass
    assert tracker.report is not None
    return any(finding.kind == "knowledge" for finding in tracker.report.findings)


def turned(direction: Array, angle_deg: float, rng: np.random.Generator) -> Array:
    """``direction`` (3,), turned about a random axis across it."""
    axis = np.cross(direction, rng.normal(size=3))
    turn = Rotation.from_rotvec(np.radians(angle_deg) * axis / np.linalg.norm(axis))
    return np.asarray(turn.apply(direction))


def measure(path: Path, errors_deg: list[float]) -> list[bool] | None:
    """Whether each error is reported; None for a recording without one direction."""
    direction = direction_of_faces(path)
    if direction is None:
        return None
    poses, rng = gate(Poses.collect(open_log(str(path)))), np.random.default_rng(0)
    return [is_reported(poses, turned(direction, error_deg, rng)) for error_deg in errors_deg]


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument(
        "recordings", nargs="*", type=Path, help="default: the physics-engine recordings that are shared"
    )
    parser.add_argument("--errors", nargs="+", type=float, default=list(ERRORS_DEG), metavar="DEG")
    args = parser.parse_args()
    paths = args.recordings or sorted(SHARED_RECORDINGS.glob("physics/*/*.mcap"))
    jobs = {path: [(path, args.errors)] for path in paths}
    found = {path.stem: one for path, (one,) in measured(measure, jobs, args.processes) if one is not None}
    if not found:
        parser.error("no recording has faces of one direction only")
    rows = [[name, *("reported" if cell else "-" for cell in cells)] for name, cells in found.items()]
    rows.append(["share", *(number(float(share)) for share in np.mean(list(found.values()), axis=0))])
    columns = ("recording", *(f"{error_deg:g} deg off" for error_deg in args.errors))
    return report(args, directions=Table(columns, rows))


if __name__ == "__main__":
    sys.exit(main())
