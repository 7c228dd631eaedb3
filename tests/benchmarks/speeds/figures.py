"""Set-up and figures of the speed benchmark, and CPU time. Imports nothing large: see ``peak_mb``."""

import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import NamedTuple


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


def cpu_s(work: Callable[[], object], runs: int) -> float:
    """Median CPU time of ``work``, all threads together."""
    taken = []
    for _ in range(runs):
        begin_s = time.process_time()
        work()
        taken.append(time.process_time() - begin_s)
    return median(taken)


def peak_mb(usage: resource.struct_rusage) -> float:
    """Peak of the resident memory, in 10^6 bytes.

    A process inherits the peak of its parent, so the parents must stay small.
    """
    return usage.ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0) / 1e6


def length(seconds: float) -> str:
    """``90 s``, ``10 min``, ``1 h``."""
    unit, name = next(((u, n) for u, n in ((3600, "h"), (60, "min")) if seconds >= u), (1, "s"))
    return f"{seconds / unit:g} {name}"
