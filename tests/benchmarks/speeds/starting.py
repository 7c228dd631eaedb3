"""Start-up: wall time of ``--help`` and until the first label of a log is on stdout."""

from statistics import median
from typing import Final

from speeds.command import first_lines_s
from speeds.figures import Figure, Setup

LEAST_RUNS: Final = 7


def measure(setup: Setup) -> list[Figure]:
    runs = range(max(setup.runs, LEAST_RUNS))
    shown = median(first_lines_s(1, "--help") for _ in runs)
    label = median(first_lines_s(2, "live", str(setup.log)) for _ in runs)  # the first line is the header
    return [
        Figure("--help", shown, "s", "<= 0.25"),
        Figure("first label of a file", label, "s", "<= 1.5"),
    ]
