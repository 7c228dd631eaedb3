"""Accuracy of identification on sets of labelled recordings: of the tracker, and of alternatives.

    python tests/benchmarks/identification.py --set paper sequence --json figures.json
    python tests/benchmarks/identification.py FOLDER --tables docs/benchmarks/identification.json

A set is a folder with .mcap files; its figures are computed from the sum over its recordings. The tracker
makes one pass over each recording; the alternatives are described in ``fixed_windows`` and ``segment_bic``.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path

from tqdm import tqdm

import fixed_windows
import identification_json
import identification_tables
import kept_tables
import segment_bic
import tracking
from contact_tracker.config.loading import load_model
from contact_tracker.errors import ContactTrackerError, NoPoses, NoTruth
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker_lab.evaluation.geometry_errors import GeometryErrors, geometry_errors
from contact_tracker_lab.evaluation.scoring import scoring
from contact_tracker_lab.evaluation.tables import number
from fixed_windows import Recorded, Windows
from scores import Score, Scores
from shared_recordings import add_folder
from worker_pool import worker_pool


@dataclass(frozen=True, eq=False)
class Measured:
    """Results on one recording.

    ``scores`` by method; ``geometry`` of the tracker's segments, without singular motion; ``cpu_s`` of the
    tracker's pass; ``recorded`` is the input of the method that is calibrated on the whole set.
    """

    path: Path
    scores: Scores
    geometry: GeometryErrors
    recorded: Recorded
    cpu_s: float
    duration_s: float


def measure(path: Path, model_name: str) -> Measured:
    """Track and evaluate one recording; raises ContactTrackerError if it cannot be used."""
    model = load_model(model_name)
    truth = read_truth(str(path))
    if truth is None:
        raise NoTruth(f"{path}: no truth")
    poses = Poses.collect(open_log(str(path)))
    if not len(poses):
        raise NoPoses(f"{path}: no pose that can be used")
    begin_s = time.process_time()
    tracked = tracking.track(poses, model)
    cpu_s = time.process_time() - begin_s
    scored, windows = scoring(poses.stamp_ns, truth), Windows.of(poses)
    answers = {
        **tracking.answers(poses, tracked),
        **fixed_windows.smallest_answers(windows, poses.stamp_ns),
        **segment_bic.answers(poses, scored, tracked, model),
    }
    return Measured(
        path,
        {method: Score.of(answer, scored) for method, answer in answers.items()},
        geometry_errors(poses, identifiable(truth), tracked.segmentation.segments),
        Recorded(windows, scored),
        cpu_s,
        float(poses.stamp_ns[-1] - poses.stamp_ns[0]) * 1e-9,
    )


def identifiable(truth: Truth) -> Truth:
    """The truth without the elements of singular intervals, whose motion does not determine them."""
    return Truth(tuple(replace(i, geometry=None) if i.singular else i for i in truth.intervals))


def measure_sets(sets: dict[str, list[Path]], model_name: str, processes: int) -> dict[str, list[Measured]]:
    """Results on the recordings that can be used, by set; the others are reported on stderr."""
    with worker_pool(processes) as pool:
        done = measure_all([path for paths in sets.values() for path in paths], model_name, pool)
        by_set = {name: [done[path] for path in paths if path in done] for name, paths in sets.items()}
        by_set = {name: measured for name, measured in by_set.items() if measured}
        jobs = [
            pool.submit(fixed_windows.hmm_scores, [m.recorded for m in measured], load_model(model_name))
            for measured in by_set.values()
        ]
        return {
            name: [replace(m, scores=m.scores | more) for m, more in zip(measured, job.result(), strict=True)]
            for (name, measured), job in zip(by_set.items(), jobs, strict=True)
        }


def measure_all(paths: Sequence[Path], model_name: str, pool: Executor) -> dict[Path, Measured]:
    done: dict[Path, Measured] = {}
    jobs = {pool.submit(measure, path, model_name): path for path in paths}
    for future in tqdm(as_completed(jobs), total=len(jobs), unit="recording"):
        path = jobs[future]
        try:
            done[path] = future.result()
        except ContactTrackerError as error:
            tqdm.write(f"{path.name}: {error}", file=sys.stderr)
            continue
        accuracies = (
            f"{number(score.main.accuracy())} {method.when}"
            for method, score in done[path].scores.items()
            if method.name == tracking.NAME
        )
        tqdm.write(f"{path.name}: {', '.join(accuracies)}", file=sys.stderr)
    return done


def find_sets(folder: Path, wanted: Sequence[str]) -> dict[str, list[Path]]:
    """Recordings by the name of their folder; only the ``wanted`` sets, if any are named.

    ``folder`` may also be one recording.
    """
    sets: dict[str, list[Path]] = {}
    for path in [folder] if folder.is_file() else sorted(folder.rglob("*.mcap")):
        sets.setdefault(path.parent.name, []).append(path)
    unknown = set(wanted) - set(sets)
    if unknown or not sets:
        raise SystemExit(
            f"{folder}: no set {' '.join(sorted(unknown))}; there are: {' '.join(sets) or 'none'}"
        )
    return {name: paths for name, paths in sets.items() if not wanted or name in wanted}


def main(
    argv: Sequence[str] | None = None,
    measure_them: Callable[[dict[str, list[Path]], str, int], dict[str, list[Measured]]] = measure_sets,
) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_folder(parser)
    parser.add_argument("--set", nargs="+", default=[], metavar="NAME", help="only these sets")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write all figures to this file")
    parser.add_argument("--tables", type=Path, metavar="JSON", help="keep the summary in this file")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args(argv)

    sets = find_sets(args.folder, args.set)
    measured = measure_them(sets, args.model, args.processes)
    if measured:
        blocks = identification_tables.blocks(measured)
        print(identification_tables.to_text(blocks))
        if args.tables:
            command = command_of("identification", args.set, args.model)
            kept_tables.keep(args.tables, command, identification_tables.summary(measured))
        if args.json:
            args.json.write_text(identification_json.to_json(measured), encoding="utf-8")
    return 0 if sum(map(len, measured.values())) == sum(map(len, sets.values())) else 1


def command_of(benchmark: str, sets: Sequence[str], model_name: str) -> str:
    """The command that reproduces the figures."""
    chosen = [*(["--set", *sets] if sets else [])]
    chosen += ["--model", Path(model_name).name] if model_name != "default" else []
    return " ".join([f"python tests/benchmarks/{benchmark}.py FOLDER", *chosen])


if __name__ == "__main__":
    sys.exit(main())
