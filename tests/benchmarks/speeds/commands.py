"""CPU time per recorded second and memory of a command on logs of several lengths."""

from collections.abc import Iterator
from statistics import median
from typing import Final, NamedTuple

from speeds.command import run
from speeds.figures import Setup
from speeds.long_logs import write_long_log

ONCE_FROM_S: Final = 600
"""Logs of at least this length are run once, as disturbances average out."""
IDLE: Final = ("--duration", "0.05")


class Measured(NamedTuple):
    """A log of ``seconds``: CPU time of the process, in total and without start-up, and its peak memory."""

    seconds: int
    cpu_s: float
    working_s: float
    peak_mb: float

    @property
    def cost(self) -> float:
        """CPU time per recorded time, without start-up."""
        return self.working_s / self.seconds


def lengths(setup: Setup, command: tuple[str, ...], idle: tuple[str, ...] = IDLE) -> Iterator[Measured]:
    """The figures for each length; with the options ``idle`` the command ends after start-up."""
    for seconds in setup.lengths_s:
        log = write_long_log(setup.log, seconds, setup.scratch / f"{seconds}_s.mcap")
        runs = 1 if seconds >= ONCE_FROM_S else setup.runs
        start_s = median(run(*command, str(log), *idle).cpu_s for _ in range(setup.runs)) if idle else 0.0
        ran = [run(*command, str(log)) for _ in range(runs)]
        log.unlink()
        cpu_s = median(r.cpu_s for r in ran)
        yield Measured(seconds, cpu_s, cpu_s - start_s, max(r.peak_mb for r in ran))
