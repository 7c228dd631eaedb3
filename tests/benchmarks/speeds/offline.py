"""Offline: ``segment`` on logs from a minute to ten hours: time per recorded second, its growth, memory."""

from statistics import median

from speeds.command import run
from speeds.figures import Figure, Setup, length
from speeds.long_logs import write_long_log

ONCE_FROM_S = 1800
"""Longer logs are run once: what disturbs a measurement has averaged out."""


def measure(setup: Setup) -> list[Figure]:
    command = ("segment", "-o", str(setup.scratch / "out.csv"))
    return commands(setup, command, "offline", ">= 60", "<= 500", "<= 1.1")


def commands(
    setup: Setup, command: tuple[str, ...], name: str, faster: str, smaller: str, growth: str
) -> list[Figure]:
    """A command on logs of all lengths, the start of the program aside; the targets are for the longest."""
    figures, first, last = [], 0.0, setup.lengths_s[-1]
    for seconds in setup.lengths_s:
        log = write_long_log(setup.log, seconds, setup.scratch / f"{seconds}_s.mcap")
        runs = 1 if seconds >= ONCE_FROM_S else setup.runs
        idle = median(run(*command, str(log), "--duration", "0.05").cpu_s for _ in range(setup.runs))
        ran = [run(*command, str(log)) for _ in range(runs)]
        log.unlink()
        per_s = (median(r.cpu_s for r in ran) - idle) / seconds
        first, what, at_end = first or per_s, f"{name} {length(seconds)}", seconds == last
        figures += [
            Figure(what, 1.0 / per_s, "recorded s per CPU s", faster if at_end else ""),
            Figure(f"{what}: peak memory", max(r.peak_mb for r in ran), "MB", smaller if at_end else ""),
        ]
        if at_end and len(setup.lengths_s) > 1:
            figures.append(Figure(f"{what} against {length(setup.lengths_s[0])}", per_s / first, "x", growth))
    return figures
