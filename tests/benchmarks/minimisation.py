"""Time of minimising the paper's objectives on fixed windows, against SLSQP from three random starts.

cold: from the relaxed problems with a coarse tolerance, then from the best one until a step gains less than a
billionth; warm: from the minimum of the window before, with the same tolerance; all: as ``minimise_windows``,
which is cold with the minima of neighbouring windows as further starts. x: time of SLSQP over this time.
lower: share of the compared windows on which SLSQP's best minimum is lower by more than a ten-thousandth. The
sums over windows are not included.

python tests/benchmarks/minimisation.py recordings/paper_experiment.mcap
"""

import sys
import time
from collections.abc import Callable
from statistics import median
from typing import TypeVar

import numpy as np

from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.motion.poses import Poses
from contact_tracker.paper import matrix, minimise_slsqp, motion
from contact_tracker.paper.batched import Batch, minimise_batched
from contact_tracker.paper.window_curves import FINE, curves, from_relaxed, minimise_windows, window_sums
from contact_tracker.recording import open_log
from contact_tracker_lab.benchmark.runner import Table, parser_of, report

FRAMES, STEP, STARTS, RUNS = 500, 10, 3, 5
Found = TypeVar("Found")


def timed(work: Callable[[], Found], runs: int = RUNS) -> tuple[float, Found]:
    """Median CPU time (s), and the result."""
    spent = []
    for _ in range(runs):
        begin = time.process_time()
        found = work()
        spent.append(time.process_time() - begin)
    return median(spent), found


def cold(model: ContactModel, k: np.ndarray, moments: np.ndarray) -> Batch:
    """The best minima from the relaxed problems."""
    best = from_relaxed(model, k, moments)
    return minimise_batched(model.contact, k, best.x, best.y, *FINE)


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("log")
    parser.add_argument("--windows", type=int, default=40, help="windows on which SLSQP is run")
    args = parser.parse_args()
    poses = Poses.collect(open_log(args.log))
    count = (len(poses) - FRAMES) // STEP + 1
    poses = poses[: (count - 1) * STEP + FRAMES]
    sample = np.linspace(min(1, count - 1), count - 1, args.windows).astype(int)
    columns = (
        *("contact", "SLSQP (ms)", "cold (us)", "cold speed-up", "cold: SLSQP lower"),
        *("warm (us)", "warm speed-up", "warm: SLSQP lower"),
        *("all (us)", "all speed-up", "all: SLSQP lower"),
    )
    spent, _ = timed(lambda: curves(poses, FRAMES, STEP))
    print(f"per window and contact; {count} windows, SLSQP on {args.windows}")
    print(f"all six curves of {len(poses)} poses, including sums over windows: {spent:.2f} s")
    return report(args, minima=Table(columns, [row_of(model, poses, sample) for model in CONTACT_MODELS]))


def row_of(model: ContactModel, poses: Poses, sample: np.ndarray) -> list[str]:
    """A row of the table."""
    position_m, rng = poses.position_m - poses.position_m.mean(axis=0), np.random.default_rng(0)
    pair = motion(poses.rotation, position_m)
    frames = [slice(STEP * w, STEP * w + FRAMES) for w in sample]
    matrices = [matrix(model.contact, pair[0][f], pair[1][f]) for f in frames]
    begin = time.process_time()
    slsqp = np.array([minimise_slsqp(model.contact, k, rng, STARTS).value for k in matrices])
    spent = (time.process_time() - begin) / len(sample)
    k, moments = window_sums(model, poses.rotation, position_m, FRAMES, STEP)
    runs = [timed(lambda: cold(model, k, moments))]
    whole, best = timed(lambda: minimise_windows(model, poses.rotation, position_m, FRAMES, STEP))
    before = np.maximum(np.arange(len(k)) - 1, 0)
    runs.append(timed(lambda: minimise_batched(model.contact, k, best.x[before], best.y[before], *FINE)))
    runs.append((whole, best))
    cells = []
    for time_s, found in runs:
        each = time_s / len(k)
        lower = np.mean(slsqp < found.value[sample] * (1.0 - 1e-4))
        cells += [f"{1e6 * each:.0f}", f"{spent / each:.0f}", f"{100 * lower:.0f} %"]
    return [model.contact.value, f"{1e3 * spent:.1f}", *cells]


if __name__ == "__main__":
    sys.exit(main())
