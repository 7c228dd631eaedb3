"""CPU time per tick and peak memory of whole commands on logs from a minute to hours.

    python tests/benchmarks/hours.py
    python tests/benchmarks/hours.py --only live --lengths 60 600 3600 36000

The poses of a log are played forward and backward repeatedly and written to a log of the given length; each
command reads it in a process of its own. ``x`` is the ratio to the figure in the line above.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from contact_tracker.config.loading import load_model
from speeds.commands import IDLE, Measured, lengths
from speeds.figures import Setup, length

ROOT: Final = Path(__file__).resolve().parents[2]
ROWS: Final = ("segment", "view", "live", "evaluate")
MODEL: Final = "default"
HEADER: Final = f"{'command':10}{'log':>8}{'CPU s':>9}{'ms per tick':>13}{'x':>7}{'peak MB':>9}{'x':>7}"


def command(row: str, scratch: Path) -> tuple[str, ...]:
    """The command line without the log."""
    match row:
        case "segment":
            return "segment", "-o", str(scratch / "out.csv")
        case "view":
            return "view", "--save", str(scratch / "out.rrd")
    return (row,)


def lines(row: str, setup: Setup) -> Iterator[str]:
    """A line for each length."""
    before: Measured | None = None
    tick_s = load_model(setup.model).tick_s
    idle = () if row == "evaluate" else IDLE  # it has no --duration
    for measured in lengths(setup, command(row, setup.scratch), idle):
        growth, larger = " " * 7, " " * 7
        if before is not None:
            growth = f"{measured.cost / before.cost:7.2f}"
            larger = f"{measured.peak_mb / before.peak_mb:7.2f}"
        per_tick = f"{1e3 * measured.cost * tick_s:13.2f}{growth}"
        taken = f"{row:10}{length(measured.seconds):>8}{measured.cpu_s:9.1f}"
        yield f"{taken}{per_tick}{measured.peak_mb:9.0f}{larger}"
        before = measured


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    log = ROOT / "recordings" / "paper_experiment.mcap"
    parser.add_argument("--only", nargs="+", choices=ROWS, default=ROWS, metavar="NAME", help=" ".join(ROWS))
    parser.add_argument("--lengths", nargs="+", type=int, default=(60, 600, 3600), metavar="S")
    parser.add_argument("--log", type=Path, default=log, metavar="MCAP", help="with truth, for evaluate")
    parser.add_argument("--runs", type=int, default=1, help="of logs that are shorter than ten minutes")
    args = parser.parse_args(argv)
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    with tempfile.TemporaryDirectory() as scratch:
        setup = Setup(args.log, args.log, MODEL, args.runs, tuple(args.lengths), Path(scratch))
        print(HEADER, flush=True)
        for row in args.only:
            for line in lines(row, setup):
                print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
