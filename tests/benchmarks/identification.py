"""How well contacts are identified: all sets of a folder of labelled recordings, offline and online.

    python tests/benchmarks/identification.py --set paper sequence --json figures.json

A set is a folder with .mcap files. Figures of a set derive from the sum over its recordings.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import reduce
from multiprocessing import get_context
from operator import add
from pathlib import Path

from contact_tracker.errors import ContactTrackerError, NoTruth
from contact_tracker.evaluation.evaluate import Evaluation, evaluate
from contact_tracker.evaluation.metrics import quantile
from contact_tracker.evaluation.report import Report
from contact_tracker.evaluation.scoring import Subset
from contact_tracker.evaluation.tables import number, table
from contact_tracker.model import load_model
from contact_tracker.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.segmenter import segment

ROOT = Path(__file__).resolve().parents[2]
HEADER = (
    "set", "n", "scored s", "all", "ident.", "clear", "F1", "online", "moved", "bound. s", "delay s",
    "ECE filt.", "smooth.", "sure&wrong", "deg", "mm", "in 3 sd", "CPU s", "x real",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Measured:
    """One recording judged; ``cpu_s`` of segmenting it, online and offline."""

    path: Path
    evaluation: Evaluation
    cpu_s: float
    duration_s: float


def measure(path: Path, model_name: str) -> Measured:
    """Segment and judge one recording; raises ContactTrackerError where it cannot be used."""
    model = load_model(model_name)
    truth = read_truth(str(path))
    if truth is None:
        raise NoTruth(f"{path}: no truth")
    poses = Poses.collect(open_log(str(path)))
    begin_s = time.process_time()
    found = segment(poses, model)
    cpu_s = time.process_time() - begin_s
    duration_s = float(poses.stamp_ns[-1] - poses.stamp_ns[0]) * 1e-9
    return Measured(path, evaluate(poses, truth, found), cpu_s, duration_s)


def find_sets(folder: Path, wanted: Sequence[str]) -> dict[str, list[Path]]:
    """Recordings by the name of the folder they lie in; only the ``wanted`` ones where some are named."""
    sets: dict[str, list[Path]] = {}
    for path in sorted(folder.rglob("*.mcap")):
        sets.setdefault(path.parent.name, []).append(path)
    unknown = set(wanted) - set(sets)
    if unknown or not sets:
        raise SystemExit(
            f"{folder}: no set {' '.join(sorted(unknown))}; there are: {' '.join(sets) or 'none'}"
        )
    return {name: paths for name, paths in sets.items() if not wanted or name in wanted}


def measure_all(paths: Iterable[Path], model_name: str, processes: int) -> dict[Path, Measured]:
    """All that could be measured; what could not is said on stderr, one line each."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"  # spawned, so that the workers' numpy sees it
    done: dict[Path, Measured] = {}
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(measure, path, model_name): path for path in paths}
        for future in as_completed(waiting):
            path = waiting[future]
            try:
                done[path] = future.result()
            except ContactTrackerError as error:
                print(f"{path.name}: {error}", file=sys.stderr)
                continue
            offline, online = done[path].evaluation.offline, done[path].evaluation.online
            accuracies = f"{number(offline.accuracy())} offline, {number(online.accuracy())} online"
            print(f"{len(done)}/{len(waiting)} {path.name}: {accuracies}", file=sys.stderr)
    return done


def row(name: str, measured: Sequence[Measured]) -> list[str]:
    """The line of one set."""
    total = reduce(add, (m.evaluation for m in measured))
    cpu_s, duration_s = sum(m.cpu_s for m in measured), sum(m.duration_s for m in measured)
    off, on, geometry = total.offline, total.online, total.geometry
    return [
        name,
        str(len(measured)),
        number(off.seconds(), 1),
        *(number(off.accuracy(s)) for s in (Subset.ALL, Subset.IDENTIFIABLE, Subset.CLEAR)),
        number(off.macro_f1),
        number(on.accuracy()),
        number(on.accuracy(Subset.MOVED)),
        number(quantile(off.boundary_s, 0.5), 2),
        number(quantile(on.delay_s, 0.5), 2),
        number(on.calibration_error),
        number(off.calibration_error),
        number(on.sure_wrong),
        number(quantile(geometry.angle_deg, 0.5), 2),
        number(quantile(geometry.distance_mm, 0.5), 2),
        number(geometry.within_3_sd, 2),
        number(cpu_s, 1),
        number(cpu_s / duration_s if duration_s else float("nan"), 2),
    ]


def summary(sets: dict[str, list[Measured]]) -> str:
    """The table: a line per set, and one over all where there are several."""
    rows = [row(name, measured) for name, measured in sets.items()]
    if len(sets) > 1:
        rows.append(row("total", [m for measured in sets.values() for m in measured]))
    return table(HEADER, rows)


def to_json(sets: dict[str, list[Measured]]) -> str:
    """Per set the report of its recordings, as ``evaluate --json`` gives it, with the CPU seconds."""
    reports = {
        name: {
            "cpu_s": {m.path.name: m.cpu_s for m in measured},
            **json.loads(Report({m.path.name: m.evaluation for m in measured}).to_json()),
        }
        for name, measured in sets.items()
    }
    return json.dumps(reports, indent=1)


def main(
    argv: Sequence[str] | None = None,
    measure_them: Callable[[Iterable[Path], str, int], dict[Path, Measured]] = measure_all,
) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    default = os.environ.get("CONTACT_TRACKER_RECORDINGS", str(ROOT.parent / "shared" / "recordings"))
    parser.add_argument("folder", nargs="?", type=Path, default=Path(default), help="default: %(default)s")
    parser.add_argument("--set", nargs="+", default=[], metavar="NAME", help="only these sets")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write all figures to this file")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args(argv)

    sets = find_sets(args.folder, args.set)
    done = measure_them([path for paths in sets.values() for path in paths], args.model, args.processes)
    measured = {name: [done[path] for path in paths if path in done] for name, paths in sets.items()}
    measured = {name: some for name, some in measured.items() if some}
    if measured:
        print(summary(measured))
    if args.json and measured:
        args.json.write_text(to_json(measured), encoding="utf-8")
    return 0 if len(done) == sum(map(len, sets.values())) else 1


if __name__ == "__main__":
    sys.exit(main())
