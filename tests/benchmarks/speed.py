"""Speed and memory in one table: medians over runs, with targets.

    python tests/benchmarks/speed.py
    python tests/benchmarks/speed.py --only reading averaging
    python tests/benchmarks/speed.py --only offline live --long

Times are CPU time (of start-up: wall time). Each part runs in a process of its own, whose peak memory is
reported too. The time of minimising the paper's functions is measured by minimisation.py.
"""

import argparse
import importlib
import os
import resource
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Final

from speeds.figures import Figure, Setup, length, peak_mb

ROWS: Final = ("reading", "averaging", "online", "offline", "live", "growing", "viewing", "starting")
COLUMNS: Final = ("what", "figure", "unit", "target", "")
IN_COMMANDS: Final = ("offline", "live", "starting")
"""Rows that measure the command line, including its memory."""
LENGTHS_S: Final = (60, 600)
LONG_S: Final = (*LENGTHS_S, 3600, 36000)
ROOT: Final = Path(__file__).resolve().parents[2]


def measure(row: str, setup: Setup) -> list[Figure]:
    """The figures of one row, and the peak memory of this process."""
    figures: list[Figure] = importlib.import_module(f"speeds.{row}").measure(setup)
    if row in IN_COMMANDS:
        return figures
    used = peak_mb(resource.getrusage(resource.RUSAGE_SELF))
    return [*figures, Figure(f"{row}: peak memory", used, "MB")]


def measure_apart(row: str, setup: Setup) -> list[Figure]:
    """``measure`` in a new process. This one imports little, as its peak memory would be counted there."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(measure, row, setup).result()


def line(figure: Figure) -> tuple[str, ...]:
    shown = f"{figure.value:.0f}" if abs(figure.value) >= 1000.0 else f"{figure.value:.3g}"
    return figure.what, shown, figure.unit, figure.target, verdict(figure)


def verdict(figure: Figure) -> str:
    """``ok`` or ``no`` if there is a target, else empty."""
    if not figure.target:
        return ""
    sign, bound = figure.target.split()
    reached = figure.value <= float(bound) if sign == "<=" else figure.value >= float(bound)
    return "ok" if reached else "no"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    recordings = ROOT / "recordings"
    parser.add_argument("--only", nargs="+", choices=ROWS, default=ROWS, metavar="NAME", help=" ".join(ROWS))
    parser.add_argument("--log", type=Path, default=recordings / "paper_experiment.mcap", metavar="MCAP")
    parser.add_argument("--fast-log", type=Path, default=recordings / "robot_1khz.mcap", metavar="MCAP")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--tables", type=Path, metavar="JSON", help="keep figures with a target in this file")
    parser.add_argument("--long", action="store_true", help=f"logs up to {length(LONG_S[-1])}")
    args = parser.parse_args(argv)
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"  # spawned, so that their numpy sees it
    rows: list[Figure] = []
    with tempfile.TemporaryDirectory() as scratch:
        lengths = LONG_S if args.long else LENGTHS_S
        setup = Setup(args.log, args.fast_log, args.model, args.runs, lengths, Path(scratch))
        for row in args.only:
            print(f"measuring {row}", file=sys.stderr)
            rows += measure_apart(row, setup)
    import kept_tables
    from contact_tracker_lab.evaluation.tables import table

    print(table(COLUMNS, [line(figure) for figure in rows]))
    if args.tables:
        targets = [list(line(figure)) for figure in rows if figure.target]
        kept_tables.keep(
            args.tables, "python tests/benchmarks/speed.py", {"aims": kept_tables.Table(COLUMNS, targets)}
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
