"""Accuracy on poses with the distortions of real logs: filtered, slow, interrupted, faulty.

    python tests/benchmarks/field.py recordings
    python tests/benchmarks/field.py FOLDER --set paper sequence robot --only none moving_average_3
    python tests/benchmarks/field.py FOLDER --only volume_distortion --accuracy 0.5mm,0.1deg

Each labelled recording is distorted (``distortions.py``), passes the gate and is tracked as by ``evaluate``,
and for comparison without adaptation. Figures of a distortion are means over the recordings: accuracy, share
of the time with a probability above 0.9 on a wrong state, calibration error of the most probable state, the
accuracy of the worst recording, the share of the elements within 3 standard deviations of the truth, and
their median error in standard deviations, which is 0.67 if these are right and less if they are too large;
the accuracy by arrival, of what ``live`` has given out when a pose comes.
"""

import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from contact_tracker import segmenting
from contact_tracker.config.parameters import Model
from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import need_truth, open_log
from contact_tracker.tracking import offline_smoother
from contact_tracker.trajectory.arguments import model_from
from contact_tracker_lab.benchmark.runner import Table, find_sets, measured, parser_of, report
from contact_tracker_lab.evaluation.evaluate import Evaluation, answers_to, evaluate, gated
from contact_tracker_lab.evaluation.tables import number
from distortions import DISTORTIONS
from shared_recordings import SHARED_RECORDINGS
from summaries import FIGURES, figures

HEADER: Final = ("distortion", *FIGURES, "not adapted offline", "not adapted online", "by arrival")


class Measured(NamedTuple):
    """One recording with one distortion: evaluation of the tracker, and of the one for comparison."""

    adapted: Evaluation
    other: Evaluation


def measure(path: str, distortion: str, model: Model) -> Measured:
    """Distort, gate, track and evaluate one recording; for comparison without adaptation."""
    truth, clean = need_truth(path), Poses.collect(open_log(path))
    random = np.random.default_rng(zlib.crc32(f"{Path(path).stem} {distortion}".encode()))
    distorted = DISTORTIONS[distortion](clean, random)
    poses = gate(distorted)
    found, answers = segmenting.segment(poses, model), answers_to(gated(distorted), model)
    other = offline_smoother.segment(poses, model)
    return Measured(evaluate(poses, truth, found, answers), evaluate(poses, truth, other))


def row(name: str, found: Sequence[Measured]) -> list[str]:
    """The row of the table for one distortion."""
    adapted, other = figures([one.adapted for one in found]), figures([one.other for one in found])
    by_arrival = [one.adapted.arrival.accuracy() for one in found if one.adapted.arrival is not None]
    return [name, *adapted, *other[:2], number(float(np.mean(by_arrival)))]


def main() -> int:
    parser = parser_of(__doc__, has_sets=True, folder=SHARED_RECORDINGS)
    parser.add_argument("--only", nargs="+", default=[*DISTORTIONS], choices=DISTORTIONS, metavar="NAME")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    parser.add_argument("--accuracy", metavar="MM,DEG", help="systematic errors of the poses")
    args = parser.parse_args()
    paths = [str(path) for files in find_sets(args.folder, args.set).values() for path in files]
    model = model_from(args.model, accuracy=args.accuracy)
    jobs = {name: [(path, name, model) for path in paths] for name in args.only}
    rows = [row(*case) for case in measured(measure, jobs, args.processes)]
    return report(args, distortions=Table(HEADER, rows))


if __name__ == "__main__":
    sys.exit(main())
