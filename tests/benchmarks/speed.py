"""Speed and memory in one table: medians over runs, with targets.

    python tests/benchmarks/speed.py
    python tests/benchmarks/speed.py --only reading averaging
    python tests/benchmarks/speed.py --only offline live --lengths 60 600 3600 36000

Times are CPU time (of start-up: wall time). Each row is measured in a process of its own, and this one
imports little: a process inherits the peak memory of its parent. The time of minimising the paper's functions
is measured by minimisation.py.
"""

import argparse
import importlib
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

from long_logs import write_long_log

IN_PROCESS: Final = ("reading", "averaging", "online", "mapping")
"""Rows measured by the functions of ``speed_in_process``."""
ROWS: Final = (*IN_PROCESS, "offline", "live", "starting")
COLUMNS: Final = ("what", "figure", "unit", "target", "")
IDLE: Final = ("--duration", "0.05")
"""With these options a command ends after start-up."""
ONCE_FROM_S: Final = 600
"""Logs of at least this length are run once, as disturbances average out."""
START_RUNS: Final = 7
ROOT: Final = Path(__file__).resolve().parents[2]


class Setup(NamedTuple):
    """A 200 Hz log and a 1 kHz log, the model, the number of runs, lengths, and a folder for files."""

    log: Path
    fast_log: Path
    model: str
    runs: int
    lengths_s: tuple[int, ...]
    scratch: Path


class Figure(NamedTuple):
    """One row of the table; ``target`` in the same unit."""

    what: str
    value: float
    unit: str
    target: str = ""

    def cells(self) -> list[str]:
        """The row of the table; the last cell is ``ok`` or ``no`` if there is a target."""
        shown = f"{self.value:.0f}" if abs(self.value) >= 1000.0 else f"{self.value:.3g}"
        verdict = ""
        if self.target:
            sign, bound = self.target.split()
            reached = self.value <= float(bound) if sign == "<=" else self.value >= float(bound)
            verdict = "ok" if reached else "no"
        return [self.what, shown, self.unit, self.target, verdict]


class Ran(NamedTuple):
    """CPU time, and peak of the resident memory (10^6 bytes), of a command."""

    cpu_s: float
    peak_mb: float


def run(*arguments: str) -> Ran:
    """Run ``contact-tracker`` to its end; raises CalledProcessError if it fails."""
    process = _start(arguments, subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, arguments)
    return Ran(usage.ru_utime + usage.ru_stime, peak_mb(usage))


def first_lines_s(lines: int, *arguments: str) -> float:
    """Wall time from the start until ``lines`` are on stdout; then the process is ended."""
    begin_s = time.perf_counter()
    process = _start(arguments, subprocess.PIPE)
    assert process.stdout is not None
    with process.stdout as stdout:
        for _ in range(lines):
            if not stdout.readline():
                raise RuntimeError(f"contact-tracker {' '.join(arguments)} printed fewer than {lines} lines")
        taken_s = time.perf_counter() - begin_s
    process.kill()
    process.wait()
    return taken_s


def _start(arguments: tuple[str, ...], stdout: int) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-m", "contact_tracker", *arguments]
    return subprocess.Popen(command, stdout=stdout, stderr=subprocess.DEVNULL)


def peak_mb(usage: resource.struct_rusage) -> float:
    """Peak of the resident memory, in 10^6 bytes."""
    return usage.ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0) / 1e6


def offline(setup: Setup) -> list[Figure]:
    """``segment`` on logs of several lengths."""
    return lengths(setup, ("segment", "-o", str(setup.scratch / "out.csv")), "offline", ">= 60", "<= 500")


def live(setup: Setup) -> list[Figure]:
    """``live`` on logs of several lengths, as fast as possible; its memory must not grow."""
    return lengths(setup, ("live",), "live", ">= 10", "<= 150")


def lengths(setup: Setup, command: tuple[str, ...], name: str, faster: str, smaller: str) -> list[Figure]:
    """Recorded time per CPU time, without start-up, and peak memory; the targets are for the longest log."""
    figures = []
    for seconds in setup.lengths_s:
        log = write_long_log(setup.log, seconds, setup.scratch / f"{seconds}_s.mcap")
        runs = 1 if seconds >= ONCE_FROM_S else setup.runs
        start_s = median(run(*command, str(log), *IDLE).cpu_s for _ in range(setup.runs))
        ran = [run(*command, str(log)) for _ in range(runs)]
        log.unlink()
        speed = seconds / (median(one.cpu_s for one in ran) - start_s)
        unit_s, unit = next(one for one in ((3600, "h"), (60, "min"), (1, "s")) if seconds >= one[0])
        what, at_end = f"{name} {seconds / unit_s:g} {unit}", seconds == setup.lengths_s[-1]
        figures += [
            Figure(what, speed, "recorded s per CPU s", faster if at_end else ""),
            Figure(f"{what}: peak memory", max(one.peak_mb for one in ran), "MB", smaller if at_end else ""),
        ]
    return figures


def starting(setup: Setup) -> list[Figure]:
    """Wall time of ``--help``, and until the first label of a log is on stdout, after the header."""
    runs = range(max(setup.runs, START_RUNS))
    shown = median(first_lines_s(1, "--help") for _ in runs)
    label = median(first_lines_s(2, "live", str(setup.log)) for _ in runs)
    return [Figure("--help", shown, "s", "<= 0.25"), Figure("first label of a file", label, "s", "<= 1.5")]


def measure(row: str, setup: Setup) -> list[Figure]:
    """The figures of one row."""
    module = importlib.import_module("speed_in_process" if row in IN_PROCESS else "speed")
    figures: list[Figure] = getattr(module, row)(setup)
    return figures


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
    parser.add_argument("--lengths", type=int, nargs="+", default=(60, 600), metavar="S", help="of long logs")
    parser.add_argument("--tables", type=Path, metavar="JSON", help="keep figures with a target in this file")
    args = parser.parse_args(argv)
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"  # spawned, so that their numpy sees it
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as scratch:
        setup = Setup(args.log, args.fast_log, args.model, args.runs, tuple(args.lengths), Path(scratch))
        for row in args.only:
            print(f"measuring {row}", file=sys.stderr)
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                figures += pool.submit(measure, row, setup).result()
    from contact_tracker_lab.benchmark import runner  # large, so after the measurements
    from contact_tracker_lab.evaluation.tables import table

    print(table(COLUMNS, [figure.cells() for figure in figures]))
    if args.tables:
        aims = runner.Table(COLUMNS, [figure.cells() for figure in figures if figure.target])
        runner.keep(args.tables, runner.typed_command(), {"aims": aims})
    return 0


if __name__ == "__main__":
    sys.exit(main())
