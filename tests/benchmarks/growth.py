"""What a tick takes in a recording's first minute, and in one much later: how it grows with what is known.

    python tests/benchmarks/growth.py
    python tests/benchmarks/growth.py --after 3600

A log is played forth and back, and its first minute is compared with the same poses ``--after`` so many
seconds, when elements have been met before. The two are followed tick by tick in turns, as the online pass
of ``segment`` does, several times: a machine that is faster now than a second ago is so for both.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from speeds.long_logs import write_long_log

from contact_tracker import tracker
from contact_tracker.belief import Detail
from contact_tracker.evaluation.tables import number, table
from contact_tracker.poses import Poses
from contact_tracker.presets import load_model
from contact_tracker.recording import open_log
from contact_tracker.state import TrackerState

ROOT: Final = Path(__file__).resolve().parents[2]
COLUMNS: Final = ("minute", "ms per tick", "x", "hypotheses", "x")


class Taken(NamedTuple):
    """CPU time of a tick, and the hypotheses that are left."""

    cpu_s: float
    hypotheses: int


def follow(state: TrackerState, poses: Poses) -> Iterator[tuple[TrackerState, Taken]]:
    """Each tick that ends within the poses; of what averaging takes all that end in a batch have a share."""
    for batch in poses.batches():
        began_s = time.process_time()
        state, closed = tracker.gather_some(state, batch)
        share_s = (time.process_time() - began_s) / max(len(closed), 1)
        for tick in closed:
            began_s = time.process_time()
            state, _ = tracker.observe(state, tick, Detail.WEIGHTS)
            yield state, Taken(share_s + time.process_time() - began_s, sum(map(len, state.banks)))


def minutes(log: Path, after_s: float, seconds: float) -> tuple[Poses, Poses, Poses]:
    """The first ``seconds``, the same poses about ``after_s`` later, and all that comes before those."""
    short = Poses.collect(open_log(str(log)))
    tour = 2 * (len(short) - 1)
    rate_hz = 1e9 * (len(short) - 1) / float(short.stamp_ns[-1] - short.stamp_ns[0])
    count = round(seconds * rate_hz)
    first = tour * max(round(after_s * rate_hz / tour), 1)
    with tempfile.TemporaryDirectory() as scratch:
        path = write_long_log(log, (first + count + 1) / rate_hz, Path(scratch) / "long.mcap")
        poses = Poses.collect(open_log(str(path)))
    return poses[:count], poses[first : first + count], poses[:first]


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
    early, late, between = minutes(args.log, args.after, args.seconds)
    start = known = tracker.start(load_model(args.model))
    for state, _ in follow(start, between):
        known = state
    turns = [
        [
            (first, later)
            for (_, first), (_, later) in zip(follow(start, early), follow(known, late), strict=False)
        ]
        for _ in range(args.turns)
    ]
    taken = np.array(turns)  # (turns, ticks, 2, what)
    cost, many = np.median(taken, axis=0).mean(axis=0).T
    after = f"after {number((late.stamp_ns[0] - early.stamp_ns[0]) * 1e-9, 0)} s"
    rows = [
        [name, number(1e3 * c, 3), number(c / cost[0], 2), number(m, 0), number(m / many[0], 2)]
        for name, c, m in zip(("first", after), cost, many, strict=True)
    ]
    print(table(COLUMNS, rows, left=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
