"""How right the tracker is on what real logs do to poses: filtered, slow, interrupted, faulty.

    python tests/benchmarks/field.py recordings
    python tests/benchmarks/field.py FOLDER --set paper sequence robot --only none moving_average_3

Each labelled recording is distorted (``distortions.py``), passes the gate and is tracked as ``evaluate``
does, and beside it with the model as it is, adapted to nothing. Figures of a distortion are means over the
recordings: accuracy, share of the time with a probability above 0.9 on a wrong state, calibration error of
the most probable state, the accuracy of the worst recording, and the share of the elements within 3
standard deviations of the truth.
"""

import argparse
import os
import sys
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import reduce
from itertools import product
from multiprocessing import get_context
from operator import add
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from tqdm import tqdm

import kept_tables
from contact_tracker import adaptation
from contact_tracker.config.loading import load_model
from contact_tracker.evaluation.evaluate import Evaluation, evaluate
from contact_tracker.evaluation.tables import number, table
from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.tracking import offline_smoother
from distortions import DISTORTIONS
from identification import ROOT, command_of, find_sets
from kept_tables import Table

HEADER: Final = (
    *("distortion", "offline", "online", "sure and wrong offline", "online", "calibration offline", "online"),
    *("worst offline", "online", "within 3 sd", "not adapted offline", "online"),
)


class Measured(NamedTuple):
    """One recording under one distortion: by the tracker, and by the model as it is."""

    adapted: Evaluation
    alone: Evaluation


def measure(path: str, distortion: str, model_name: str) -> Measured:
    """Distort, pass the gate, track and judge one recording."""
    truth, clean = read_truth(path), Poses.collect(open_log(path))
    if truth is None:
        raise SystemExit(f"{path}: no truth")
    random = np.random.default_rng(zlib.crc32(f"{Path(path).stem} {distortion}".encode()))
    poses, model = gate(DISTORTIONS[distortion](clean, random)), load_model(model_name)
    found = adaptation.segment(poses, model), offline_smoother.segment(poses, model)
    return Measured(*(evaluate(poses, truth, one) for one in found))


def row(name: str, measured: Sequence[Measured]) -> list[str]:
    """A line of the table."""
    both = [(one.adapted.offline, one.adapted.online) for one in measured]
    alone = [(one.alone.offline, one.alone.online) for one in measured]
    accuracy = np.array([[tally.accuracy() for tally in pair] for pair in both])
    geometry = reduce(add, [one.adapted.geometry for one in measured])
    columns = (
        accuracy.mean(axis=0),
        np.mean([[tally.sure_wrong for tally in pair] for pair in both], axis=0),
        np.mean([[tally.calibration_error for tally in pair] for pair in both], axis=0),
        accuracy.min(axis=0),
        [geometry.within_3_sd],
        np.mean([[tally.accuracy() for tally in pair] for pair in alone], axis=0),
    )
    return [name, *(number(float(value)) for column in columns for value in column)]


def measure_all(
    paths: Sequence[str], names: Sequence[str], model: str, processes: int
) -> Iterator[list[str]]:
    """The lines of the table, one after the other."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"  # spawned, so that the workers' numpy sees it
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(measure, path, name, model) for name, path in product(names, paths)]
        for first, name in enumerate(tqdm(names, file=sys.stderr, disable=None)):
            mine = jobs[first * len(paths) : (first + 1) * len(paths)]
            yield row(name, [job.result() for job in mine])


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    default = os.environ.get("CONTACT_TRACKER_RECORDINGS", str(ROOT.parent / "shared" / "recordings"))
    parser.add_argument("folder", nargs="?", type=Path, default=Path(default), help="default: %(default)s")
    parser.add_argument("--set", nargs="+", default=[], metavar="NAME", help="only these sets")
    parser.add_argument("--only", nargs="+", default=[*DISTORTIONS], choices=DISTORTIONS, metavar="NAME")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    parser.add_argument("--tables", type=Path, metavar="JSON", help="keep the table in this file")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args(argv)
    paths = [str(path) for some in find_sets(args.folder, args.set).values() for path in some]
    rows = list(measure_all(paths, args.only, args.model, args.processes))
    print(table(HEADER, rows))
    if args.tables:
        command = command_of("field", args.set, args.model)
        kept_tables.keep(args.tables, command, {"distortions": Table(HEADER, rows)})
    return 0


if __name__ == "__main__":
    sys.exit(main())
