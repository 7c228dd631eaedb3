"""What dropping hopeless hypotheses changes in what is said online: beside wider margins, and without one.

    python tests/benchmarks/pruning.py
    python tests/benchmarks/pruning.py FOLDER/sequence/*.mcap --margins 40

Each recording is followed with the model's own margin and with others. ``labels`` is the share of ticks with
the same label, ``median`` to ``most`` how far apart the probabilities are (of the state that differs most, in
the median tick, the 90th and 99th percentile and the worst), ``rows`` the hypotheses per tick and ``CPU`` the
time, both as a multiple. Without a margin (``none``) old onsets still get sparser.
"""

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model
from contact_tracker.evaluation.tables import number, table
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.forward_pass import forward

ROOT: Final = Path(__file__).resolve().parents[2]
WARM_UP: Final = 400
"""Poses that are followed before time is taken."""
COLUMNS: Final = ("recording", "nats", "labels", "median", "90 %", "99 %", "most", "rows", "CPU")


class Run(NamedTuple):
    """``probability`` (T, 7) online, mean number of hypotheses, CPU time (s)."""

    probability: NDArray[np.float64]
    hypotheses: float
    cpu_s: float


def with_margin(model: Model, margin_nats: float) -> Model:
    return replace(model, search=replace(model.search, margin_nats=margin_nats))


def follow(poses: Poses, model: Model) -> Run:
    """Of at least one pose."""
    began_s, said, living = time.process_time(), [], 0
    for seen in forward(poses, model, detail=Detail.SHARED):
        said.append(seen.belief.probability)
        living += sum(map(len, seen.state.banks))
    return Run(np.array(said), living / len(said), time.process_time() - began_s)


def row(name: str, margin_nats: float, own: Run, other: Run) -> list[str]:
    same = own.probability.argmax(axis=1) == other.probability.argmax(axis=1)
    apart = np.abs(own.probability - other.probability).max(axis=1)
    told = "none" if math.isinf(margin_nats) else number(margin_nats, 0)
    by_share = [number(float(np.quantile(apart, share)), 4) for share in (0.5, 0.9, 0.99, 1.0)]
    times = other.hypotheses / own.hypotheses, other.cpu_s / own.cpu_s
    return [name, told, number(float(same.mean())), *by_share, *(number(t, 2) for t in times)]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    shipped = sorted((ROOT / "recordings").glob("*.mcap"))
    parser.add_argument(
        "logs", nargs="*", type=Path, default=shipped, metavar="MCAP", help="default: recordings/"
    )
    parser.add_argument("--margins", nargs="+", type=float, default=[40.0, math.inf], metavar="NATS")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    args = parser.parse_args(argv)
    model = load_model(args.model)
    rows = []
    for path in tqdm(args.logs, unit="recording"):
        poses = Poses.collect(open_log(str(path)))
        follow(poses[:WARM_UP], model)  # kernels are loaded
        own = follow(poses, model)
        rows += [row(path.stem, m, own, follow(poses, with_margin(model, m))) for m in args.margins]
    print(f"beside {model.search.margin_nats:g} nats:\n{table(COLUMNS, rows, left=2)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
