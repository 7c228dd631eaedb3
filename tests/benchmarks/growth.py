"""Growth of the time per tick with the landmark memory: a recording's first minute, and a later one.

    python tests/benchmarks/growth.py
    python tests/benchmarks/growth.py --after 3600

A log is played forward and backward repeatedly, and its first minute is compared with the same poses
``--after`` seconds later, when elements have touched before. The two are tracked alternately, tick by tick,
as in the forward pass of ``segment``, several times: so the load of the machine affects both.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from copy import copy
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import TickGrid
from contact_tracker.recording import open_log
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker_lab.evaluation.tables import number, table
from speeds.long_logs import write_long_log

Array = NDArray[np.float64]

ROOT: Final = Path(__file__).resolve().parents[2]
COLUMNS: Final = ("minute", "ms per tick", "x", "hypotheses", "x")


class TickCost(NamedTuple):
    """CPU time of a tick, and the number of hypotheses after it."""

    cpu_s: float
    hypotheses: int


class Growth(NamedTuple):
    """Mean CPU time and number of hypotheses per tick (2,): in the first minute, and ``after_s``."""

    after_s: float
    cpu_s: Array
    hypotheses: Array

    @property
    def cpu_growth(self) -> Array:
        """CPU time relative to the first minute (2,)."""
        return np.asarray(self.cpu_s / self.cpu_s[0])

    @property
    def hypotheses_growth(self) -> Array:
        """Number of hypotheses relative to the first minute (2,)."""
        return np.asarray(self.hypotheses / self.hypotheses[0])


class Stream(NamedTuple):
    """A filter and its ticks."""

    grid: TickGrid
    one: ContactFilter


def track(stream: Stream, poses: Poses) -> Iterator[TickCost]:
    """The cost of each tick that ends within the poses; ticks of a batch share the time of its averaging."""
    for batch in poses.batches():
        began_s = time.process_time()
        closed = stream.grid.add(batch)
        share_s = (time.process_time() - began_s) / max(len(closed), 1)
        for tick in closed:
            began_s = time.process_time()
            stream.one.update(tick, Detail.WEIGHTS)
            many = sum(map(len, stream.one.state.banks))
            yield TickCost(share_s + time.process_time() - began_s, many)


def minutes(log: Path, after_s: float, seconds: float) -> tuple[Poses, Poses, Poses]:
    """The first ``seconds``, the same poses about ``after_s`` later, and all poses before those."""
    short = _read(log)
    tour = 2 * (len(short) - 1)
    rate_hz = 1e9 * (len(short) - 1) / float(short.stamp_ns[-1] - short.stamp_ns[0])
    count = round(seconds * rate_hz)
    first = tour * max(round(after_s * rate_hz / tour), 1)
    with tempfile.TemporaryDirectory() as scratch:
        path = write_long_log(log, (first + count + 1) / rate_hz, Path(scratch) / "long.mcap")
        poses = _read(path)
    return poses[:count], poses[first : first + count], poses[:first]


def _read(log: Path) -> Poses:
    return Poses.join(list(open_log(str(log)).batches()))


def measure(log: Path, model: str, after_s: float, seconds: float, turns: int) -> Growth:
    """The same ``seconds`` with an empty landmark memory and ``after_s`` later, median of each tick."""
    early, late, between = minutes(log, after_s, seconds)
    given = load_model(model)
    known = Stream(TickGrid(given), ContactFilter.start(given))
    for _ in track(known, between):
        pass
    costs = []
    for _ in range(turns):
        new = Stream(TickGrid(given), ContactFilter.start(given))
        again = Stream(copy(known.grid), copy(known.one))
        costs.append(list(zip(track(new, early), track(again, late), strict=False)))
    cost, many = np.median(np.array(costs), axis=0).mean(axis=0).T  # of (turns, ticks, 2, 2)
    return Growth(float(late.stamp_ns[0] - early.stamp_ns[0]) * 1e-9, cost, many)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    log = ROOT / "recordings" / "paper_experiment.mcap"
    parser.add_argument("--log", type=Path, default=log, metavar="MCAP")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    parser.add_argument("--after", type=float, default=600.0, metavar="S")
    parser.add_argument("--seconds", type=float, default=60.0, help="of a minute")
    parser.add_argument("--turns", type=int, default=5)
    args = parser.parse_args(argv)
    growth = measure(args.log, args.model, args.after, args.seconds, args.turns)
    after = f"after {number(growth.after_s, 0)} s"
    figures = zip(growth.cpu_s, growth.cpu_growth, growth.hypotheses, growth.hypotheses_growth, strict=True)
    rows = [
        [name, number(1e3 * cost, 3), number(x, 2), number(many, 0), number(more, 2)]
        for name, (cost, x, many, more) in zip(("first", after), figures, strict=True)
    ]
    print(table(COLUMNS, rows, left=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
