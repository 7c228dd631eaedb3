"""How right the labels of a robot's log are: docs/theory.md, section 11.

    python tests/benchmarks/robot_logs.py
    python tests/benchmarks/robot_logs.py --seeds 4

A robot slides and tilts a part on a table and carries it, along straight lines and with exact poses, rounded
to 1 um. In the rows ``carry`` it only carries it; with ``turns`` the part turns on the way, about its centre.
``noise`` has 0.1 mm and 0.03 deg. Shares of the time, offline and online: ``right`` labels, those that are
``sure and wrong`` (0.9 and more, and open to no other), and of the poses that are left out as ``outliers``.
"""

import sys
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.segmenting import segmented
from contact_tracker.tracking.segmentation import Beliefs
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.evaluate import answers_to
from contact_tracker_lab.evaluation.scoring import tick_containing, tick_in_force
from contact_tracker_lab.evaluation.tables import number
from robot_moves import logged, pick_and_place

SURE: Final = 0.9
COLUMNS: Final = (
    *("motion", "rate, Hz", "logs", "right", "sure and wrong", "right, live", "sure and wrong, live"),
    "outliers",
)


class Case(NamedTuple):
    rate_hz: float
    slides: bool
    turn_rad: float
    noise: tuple[float, float]

    @property
    def name(self) -> str:
        words = ["slide, tilt and carry" if self.slides else "carry"]
        words += ["turns"] if self.turn_rad else []
        words += ["noise"] if any(self.noise) else []
        return ", ".join(words)


EXACT, NOISY = (0.0, 0.0), (1e-4, 5e-4)
CASES: Final = [
    *(Case(rate_hz, True, 0.0, EXACT) for rate_hz in (30.0, 125.0, 500.0)),
    Case(125.0, False, 0.0, EXACT),
    Case(125.0, True, 0.4, EXACT),
    Case(125.0, False, 0.4, EXACT),
    Case(125.0, True, 0.4, NOISY),
]


def measure(case: Case, seed: int) -> tuple[float, ...]:
    """Shares right, sure and wrong, both also online, and outliers."""
    model = load_model()
    trajectory, columns = logged(
        pick_and_place(case.rate_hz, seed, case.turn_rad, case.slides), seed, case.noise
    )
    poses, outcome = Poses.collect(trajectory), segmented(trajectory, model).segmentation
    online = answers_to(poses, model)
    shares: list[float] = []
    for tick, beliefs in (
        (tick_containing(poses.stamp_ns, outcome.stamp_ns), outcome.beliefs),
        (tick_in_force(poses.stamp_ns, online.arrival_ns), online.beliefs),
    ):
        shares += _shares(beliefs, tick, columns)
    return (*shares, outcome.outliers.total / len(poses))


def _shares(beliefs: Beliefs, tick: np.ndarray, columns: np.ndarray) -> tuple[float, float]:
    has_answer = tick >= 0
    rows, columns = beliefs.rows[tick[has_answer]], columns[has_answer]
    is_right = rows["contact"] == columns
    is_sure = (rows["probability"].max(axis=1) >= SURE) & ~rows["inseparable"].any(axis=1)
    return float(is_right.mean()), float((is_sure & ~is_right).mean())


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="logs of each row (default: 3)")
    args = parser.parse_args()
    jobs = {case: [(case, seed) for seed in range(args.seeds)] for case in CASES}
    rows = []
    for case, found in measured(measure, jobs, args.processes):
        shares = [number(float(share), 3) for share in np.mean(found, axis=0)]
        rows.append([case.name, f"{case.rate_hz:.0f}", str(args.seeds), *shares])
    return report(args, logs=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
