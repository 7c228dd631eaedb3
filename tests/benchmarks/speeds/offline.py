"""Offline: ``segment`` on logs of several lengths: time per recorded second, memory."""

from speeds.commands import lengths
from speeds.figures import Figure, Setup, length


def measure(setup: Setup) -> list[Figure]:
    command = ("segment", "-o", str(setup.scratch / "out.csv"))
    return commands(setup, command, "offline", ">= 60", "<= 500")


def commands(setup: Setup, command: tuple[str, ...], name: str, faster: str, smaller: str) -> list[Figure]:
    """Figures of a command on logs of several lengths, without start-up; the targets are for the longest."""
    figures = []
    for measured in lengths(setup, command):
        what, at_end = f"{name} {length(measured.seconds)}", measured.seconds == setup.lengths_s[-1]
        figures += [
            Figure(what, 1.0 / measured.cost, "recorded s per CPU s", faster if at_end else ""),
            Figure(f"{what}: peak memory", measured.peak_mb, "MB", smaller if at_end else ""),
        ]
    return figures
