"""How far labels depend on where the origin of the body frame is.

    python tests/benchmarks/origins.py [RECORDING ...]

Distance between the tracked points, and share of the ticks whose label changes, if the origin is moved by
some distance: offline, and online while the noise is that of the whole recording. Without arguments, the
three shipped recordings of single contacts.
"""

import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.sensor_noise import independent_point
from contact_tracker.recording import open_log
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.tables import number
from shared_recordings import ROOT

DISTANCES_M: Final = (0.3, 1.0, 10.0)
DIRECTION: Final = np.array([0.6, -0.48, 0.64])
SHIPPED: Final = ("paper_experiment", "robot_1khz", "vision_30hz")
COLUMNS: Final = ("recording", "moved m", "apart mm", "offline", "online")


def rows_of(poses: Poses) -> tuple[NDArray[Any], NDArray[Any]]:
    """Beliefs of all ticks, offline and online."""
    found = Segmentation.join(list(OfflineTracker(load_model()).pieces(poses)))
    return found.beliefs.rows, found.filtered.rows


def changed(before: NDArray[Any], after: NDArray[Any]) -> float:
    """Share of the ticks of both whose labels differ."""
    _, rows, others = np.intersect1d(before["stamp_ns"], after["stamp_ns"], return_indices=True)
    return float((before["contact"][rows] != after["contact"][others]).mean())


def rows_for(path: Path) -> list[list[str]]:
    """Rows of the table for one recording."""
    poses, rows = Poses.collect(open_log(str(path))), list[list[str]]()
    as_recorded = rows_of(poses)
    for away_m in DISTANCES_M:
        aside_m = away_m * DIRECTION
        apart_m = independent_point(poses.of_point(aside_m)) + aside_m - independent_point(poses)
        moved = rows_of(poses.of_point(aside_m))
        shares = (changed(*pair) for pair in zip(as_recorded, moved, strict=True))
        rows.append([path.stem, f"{away_m:g}", f"{1e3 * np.linalg.norm(apart_m):.1f}", *map(number, shares)])
    return rows


def main() -> int:
    parser = parser_of(__doc__)
    shipped = [ROOT / "recordings" / f"{name}.mcap" for name in SHIPPED]
    parser.add_argument("recordings", type=Path, nargs="*", default=shipped)
    args = parser.parse_args()
    jobs = {path: [(path,)] for path in args.recordings}
    rows = [row for _, (some,) in measured(rows_for, jobs, args.processes) for row in some]
    return report(args, origins=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
