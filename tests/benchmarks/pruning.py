"""Effect of pruning on online posteriors: comparison with wider margins, and with none.

    python tests/benchmarks/pruning.py
    python tests/benchmarks/pruning.py FOLDER/sequence/*.mcap --margins 40

Each recording is tracked with the margin of the model and with others. ``labels`` is the share of ticks with
the same label; ``median`` to ``most`` are quantiles over ticks (median, 90 %, 99 %, maximum) of the largest
difference of a probability; ``rows`` is the number of hypotheses per tick and ``CPU`` the time, both relative
to the model's margin. Without a margin (``none``) old onsets are still thinned.
"""

import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model
from contact_tracker.motion.poses import Poses, batches
from contact_tracker.recording import open_log
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.contact_filter import ContactFilter, forward, ticks_of
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.tables import number
from shared_recordings import ROOT

WARM_UP: Final = 400
"""Poses that are tracked before the measurement."""
COLUMNS: Final = ("recording", "nats", "labels", "median", "90 %", "99 %", "most", "rows", "CPU")


class Run(NamedTuple):
    """``probability`` (T, 7) online, mean number of hypotheses, CPU time (s)."""

    probability: Array
    hypotheses: float
    cpu_s: float


def with_margin(model: Model, margin_nats: float) -> Model:
    return replace(model, search=replace(model.search, margin_nats=margin_nats))


def track(poses: Poses, model: Model) -> Run:
    """Track at least one pose."""
    began_s, probabilities, hypotheses = time.process_time(), [], 0
    for tick in forward(ticks_of(batches(poses), model), ContactFilter.start(model), Detail.SHARED):
        probabilities.append(tick.belief.probability)
        hypotheses += sum(map(len, tick.state.banks))
    cpu_s = time.process_time() - began_s
    return Run(np.array(probabilities), hypotheses / len(probabilities), cpu_s)


def row(name: str, margin_nats: float, own: Run, other: Run) -> list[str]:
    same = own.probability.argmax(axis=1) == other.probability.argmax(axis=1)
    difference = np.abs(own.probability - other.probability).max(axis=1)
    margin = "none" if math.isinf(margin_nats) else number(margin_nats, 0)
    quantiles = [number(float(np.quantile(difference, share)), 4) for share in (0.5, 0.9, 0.99, 1.0)]
    ratios = other.hypotheses / own.hypotheses, other.cpu_s / own.cpu_s
    return [name, margin, number(float(same.mean())), *quantiles, *(number(one, 2) for one in ratios)]


def measure(path: Path, model: Model, margins_nats: list[float]) -> list[list[str]]:
    """Rows of the table for one recording."""
    poses = Poses.collect(open_log(str(path)))
    track(poses[:WARM_UP], model)  # loads the kernels
    own = track(poses, model)
    return [row(path.stem, nats, own, track(poses, with_margin(model, nats))) for nats in margins_nats]


def main() -> int:
    parser = parser_of(__doc__)
    shipped = sorted((ROOT / "recordings").glob("*.mcap"))
    parser.add_argument(
        "logs", nargs="*", type=Path, default=shipped, metavar="MCAP", help="default: recordings/"
    )
    parser.add_argument("--margins", nargs="+", type=float, default=[40.0, math.inf], metavar="NATS")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    args = parser.parse_args()
    model = load_model(args.model)
    jobs = {path: [(path, model, args.margins)] for path in args.logs}
    rows = [one for _, (some,) in measured(measure, jobs, args.processes) for one in some]
    print(f"relative to {model.search.margin_nats:g} nats:")
    return report(args, pruning=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
