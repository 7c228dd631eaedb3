"""What measured wrenches add to motion, on the sets of physics-engine recordings that carry them.

    python tests/benchmarks/wrenches.py
    python tests/benchmarks/wrenches.py --set singular paper --tables docs/benchmarks/wrenches.json

The topic is ``/object/wrench``. ``noise and bias`` adds white noise of 0.1 N and 0.01 N m to each sample, and
a bias of the sensor of 0.5 N and 0.05 N m in each axis (standard deviations), which the tracker has to find.
Figures are means over the time of all recordings of a set, offline; errors of elements are medians.
"""

import sys
from functools import reduce
from itertools import product
from operator import add
from pathlib import Path
from typing import Final

import numpy as np

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import need_truth, open_log, read_wrenches
from contact_tracker.segmenting import segmented, wrench_evidence
from contact_tracker.trajectory import Trajectory
from contact_tracker.wrenches.load import NoLoad
from contact_tracker.wrenches.wrenches import Wrenches
from contact_tracker_lab.benchmark.runner import Table, find_sets, measured, parser_of, report
from contact_tracker_lab.evaluation.evaluate import Evaluation, evaluate
from contact_tracker_lab.evaluation.tables import number
from shared_recordings import SHARED_RECORDINGS

TOPIC: Final = "/object/wrench"
NOISE: Final = (0.1, 0.01)
BIAS: Final = (0.5, 0.05)
WAYS: Final = ("motion alone", "wrenches", "wrenches with noise and bias")
COLUMNS: Final = (
    *("set", "with", "recordings", "accuracy", "sure and wrong", "angle deg", "distance mm", "within 3 sd"),
)


def disturbed(wrenches: Wrenches, seed: int) -> Wrenches:
    """The same with the noise and a bias of a sensor (N, N m)."""
    rng = np.random.default_rng(seed)
    force_n, moment_nm = (
        values + rng.normal(0.0, noise, values.shape) + rng.normal(0.0, bias, 3)
        for values, noise, bias in zip((wrenches.force_n, wrenches.moment_nm), NOISE, BIAS, strict=True)
    )
    return Wrenches(wrenches.stamp_ns, force_n, moment_nm)


def measure(path: Path, way: str, seed: int) -> Evaluation:
    """Segment one recording in one of the WAYS, and judge it."""
    model, log = load_model(), open_log(str(path))
    poses, evidence = Poses.collect(log), None
    if way != WAYS[0]:
        wrenches = read_wrenches(str(path), TOPIC, log.source, poses).wrenches
        try:
            evidence, _ = wrench_evidence(
                poses, disturbed(wrenches, seed) if way == WAYS[2] else wrenches, model
            )
        except NoLoad as reason:
            print(f"{path.stem}: {reason}", file=sys.stderr)
    found = segmented(Trajectory(poses), model, wrenches=evidence)
    return evaluate(poses, need_truth(str(path)), found.segmentation)


def row(name: str, way: str, evaluations: list[Evaluation]) -> list[str]:
    """A row of the table."""
    offline = reduce(add, (one.offline for one in evaluations))
    errors = reduce(add, (one.geometry for one in evaluations))
    off = (float(np.median(values)) for values in (errors.angle_deg, errors.distance_mm))
    figures = (offline.accuracy(), offline.sure_wrong, *off, errors.within_3_sd)
    return [name, way, str(len(evaluations)), *(number(float(figure)) for figure in figures)]


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--set", nargs="+", default=["singular"], metavar="NAME", help="default: singular")
    args = parser.parse_args()
    sets = find_sets(SHARED_RECORDINGS / "physics", args.set)
    jobs = {
        (name, way): [(path, way, seed) for seed, path in enumerate(sets[name])]
        for name, way in product(args.set, WAYS)
    }
    rows = [row(*case, found) for case, found in measured(measure, jobs, args.processes)]
    return report(args, sets=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
