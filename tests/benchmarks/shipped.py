"""Accuracy on the recordings of this repository.

    python tests/benchmarks/shipped.py
    python tests/benchmarks/shipped.py --tables docs/benchmarks/shipped.json

As ``contact-tracker evaluate recordings/*.mcap``, which gives more details.
"""

import sys
from pathlib import Path
from typing import Final

from contact_tracker import segmenting
from contact_tracker.config.loading import load_model
from contact_tracker.recording import need_truth
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.evaluate import Evaluation, evaluate
from contact_tracker_lab.evaluation.metrics import quantile
from contact_tracker_lab.evaluation.tables import number
from shared_recordings import ROOT
from summaries import read_gated

COLUMNS: Final = (
    *("recording", "accuracy offline", "accuracy online", "log-loss offline", "log-loss online"),
    *("ECE offline", "ECE online", "sure and wrong offline", "sure and wrong online"),
    *("found", "angle, deg", "distance, mm", "within 3 sd"),
)


def measure(path: Path) -> Evaluation:
    """Segment one recording, adapted to its stream, and evaluate it."""
    poses = read_gated(path)
    return evaluate(poses, need_truth(str(path)), segmenting.segment(poses, load_model()))


def row(name: str, evaluation: Evaluation) -> list[str]:
    """A row of the table."""
    tallies, geometry = (evaluation.offline, evaluation.online), evaluation.geometry
    names, figures = ("log_loss", "calibration_error", "sure_wrong"), [one.accuracy() for one in tallies]
    figures += [getattr(tally, name) for name in names for tally in tallies]
    return [
        name,
        *(number(float(figure)) for figure in figures),
        f"{geometry.found_segments} of {geometry.true_segments}",
        number(quantile(geometry.angle_deg, 0.5), 2),
        number(quantile(geometry.distance_mm, 0.5), 2),
        number(geometry.within_3_sd, 2),
    ]


def main() -> int:
    args = parser_of(__doc__).parse_args()
    jobs = {path.stem: [(path,)] for path in sorted((ROOT / "recordings").glob("*.mcap"))}
    rows = [row(name, one) for name, (one,) in measured(measure, jobs, args.processes)]
    return report(args, recordings=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
