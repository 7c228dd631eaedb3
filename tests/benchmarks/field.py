"""Accuracy on poses with the distortions of real logs: filtered, slow, interrupted, faulty.

    python tests/benchmarks/field.py recordings
    python tests/benchmarks/field.py FOLDER --set paper sequence robot --only none moving_average_3
    python tests/benchmarks/field.py FOLDER --set paper sequence robot --only slow_wander --oracle
    python tests/benchmarks/field.py FOLDER --only volume_distortion --accuracy 0.5mm,0.1deg

Each labelled recording is distorted (``distortions.py``), passes the gate and is tracked as by ``evaluate``,
and for comparison without adaptation. Figures of a distortion are means over the recordings: accuracy, share
of the time with a probability above 0.9 on a wrong state, calibration error of the most probable state, the
accuracy of the worst recording, the share of the elements within 3 standard deviations of the truth, and
their median error in standard deviations, which is 0.67 if these are right and less if they are too large;
the accuracy by arrival, of what ``live`` has given out when a pose comes.
"""

import argparse
import sys
import zlib
from collections.abc import Iterator, Sequence
from functools import reduce
from itertools import product
from operator import add
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from tqdm import tqdm

import kept_tables
from contact_tracker import segmenting
from contact_tracker.config.parameters import Model
from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.tracking import offline_smoother
from contact_tracker.trajectory.arguments import model_from
from contact_tracker_lab.evaluation.evaluate import Evaluation, answers_to, evaluate
from contact_tracker_lab.evaluation.tables import number, table
from distortions import DISTORTIONS
from identification import command_of, find_sets
from kept_tables import Table
from shared_recordings import add_folder
from true_errors import KNOWN, measured_poses, true_model
from worker_pool import worker_pool

FIGURES: Final = (
    *("accuracy offline", "accuracy online", "sure and wrong offline", "sure and wrong online"),
    *("ECE offline", "ECE online", "worst accuracy offline", "worst accuracy online"),
    *("within 3 sd", "median sd"),
)

HEADER: Final = ("distortion", *FIGURES, "not adapted offline", "not adapted online", "by arrival")
ORACLE_HEADER: Final = ("distortion", "errors", *FIGURES)


class Measured(NamedTuple):
    """One recording with one distortion: evaluation of the tracker, and of the one for comparison."""

    adapted: Evaluation
    other: Evaluation


def measure(path: str, distortion: str, model: Model, oracle: bool) -> Measured:
    """Distort, gate, track and evaluate one recording; for comparison without adaptation, or with the true
    errors given."""
    truth, clean = read_truth(path), Poses.collect(open_log(path))
    if truth is None:
        raise SystemExit(f"{path}: no truth")
    random = np.random.default_rng(zlib.crc32(f"{Path(path).stem} {distortion}".encode()))
    distorted = DISTORTIONS[distortion](clean, random)
    poses = gate(distorted)
    found, answers = segmenting.segment(poses, model), answers_to(distorted, model)
    if oracle:
        good = gate(measured_poses(distortion, clean, distorted))
        other = offline_smoother.segment(good, true_model(distortion, path, good, model))
    else:
        other = offline_smoother.segment(poses, model)
    return Measured(evaluate(poses, truth, found, answers), evaluate(poses, truth, other))


def figures(measured: Sequence[Evaluation]) -> list[str]:
    """Figures of one distortion and one tracker, over the recordings."""
    both = [(one.offline, one.online) for one in measured]
    accuracy = np.array([[tally.accuracy() for tally in pair] for pair in both])
    geometry = reduce(add, [one.geometry for one in measured])
    columns = (
        accuracy.mean(axis=0),
        np.mean([[tally.sure_wrong for tally in pair] for pair in both], axis=0),
        np.mean([[tally.calibration_error for tally in pair] for pair in both], axis=0),
        accuracy.min(axis=0),
        [geometry.within_3_sd, geometry.median_sd],
    )
    return [number(float(value)) for column in columns for value in column]


def rows_of(name: str, measured: Sequence[Measured], oracle: bool) -> list[list[str]]:
    """Rows of the table for one distortion."""
    adapted, other = figures([one.adapted for one in measured]), figures([one.other for one in measured])
    if oracle:
        return [[name, "inferred", *adapted], [name, "given", *other]]
    by_arrival = [one.adapted.arrival.accuracy() for one in measured if one.adapted.arrival is not None]
    return [[name, *adapted, *other[:2], number(float(np.mean(by_arrival)))]]


def with_others(rows: list[list[str]], kept: list[list[str]]) -> list[list[str]]:
    """The rows of these distortions and the ``kept`` ones of others, in the order of ``DISTORTIONS``."""
    lines = {line[0]: line for line in [*kept, *rows]}
    return [lines[name] for name in DISTORTIONS if name in lines]


def measure_all(
    paths: Sequence[str], names: Sequence[str], model: Model, processes: int, oracle: bool
) -> Iterator[list[str]]:
    """Rows of the table, one distortion after the other."""
    with worker_pool(processes) as pool:
        jobs = [pool.submit(measure, path, name, model, oracle) for name, path in product(names, paths)]
        for first, name in enumerate(tqdm(names, file=sys.stderr, disable=None)):
            of_distortion = jobs[first * len(paths) : (first + 1) * len(paths)]
            yield from rows_of(name, [job.result() for job in of_distortion], oracle)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_folder(parser)
    parser.add_argument("--set", nargs="+", default=[], metavar="NAME", help="only these sets")
    parser.add_argument("--only", nargs="+", default=[], choices=DISTORTIONS, metavar="NAME")
    parser.add_argument("--oracle", action="store_true", help="compare with the true errors given")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    parser.add_argument("--accuracy", metavar="MM,DEG", help="systematic errors of the poses")
    parser.add_argument(
        "--tables",
        type=Path,
        metavar="JSON",
        help="keep the table in this file, with its rows of others",
    )
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args(argv)
    names = args.only or [name for name in DISTORTIONS if name in KNOWN or not args.oracle]
    if args.oracle and (unknown := [name for name in names if name not in KNOWN]):
        parser.error(f"no true errors to give of {' '.join(unknown)}; there are: {' '.join(KNOWN)}")
    paths = [str(path) for some in find_sets(args.folder, args.set).values() for path in some]
    model = model_from(args.model, accuracy=args.accuracy)
    rows = list(measure_all(paths, names, model, args.processes, args.oracle))
    header = ORACLE_HEADER if args.oracle else HEADER
    print(table(header, rows))
    if args.tables:
        if args.accuracy:
            parser.error("--tables keeps figures without --accuracy")
        command = command_of("field", args.set, args.model)
        if args.oracle:
            command += f" --only {' '.join(names)} --oracle"
        elif args.tables.exists():
            kept = kept_tables.read(args.tables)
            if kept.command != command:
                parser.error(f"{args.tables} is of another command: {kept.command}")
            rows = with_others(rows, kept.tables["distortions"].rows)
        kept_tables.keep(args.tables, command, {"distortions": Table(header, rows)})
    return 0


if __name__ == "__main__":
    sys.exit(main())
