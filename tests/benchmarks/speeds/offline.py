"""Offline: ``segment`` on logs from a minute to ten hours: time per recorded second, its growth, memory."""

from speeds.commands import lengths
from speeds.figures import Figure, Setup, length


def measure(setup: Setup) -> list[Figure]:
    command = ("segment", "-o", str(setup.scratch / "out.csv"))
    return commands(setup, command, "offline", ">= 60", "<= 500", "<= 1.1")


def commands(
    setup: Setup, command: tuple[str, ...], name: str, faster: str, smaller: str, growth: str
) -> list[Figure]:
    """A command on logs of all lengths, the start of the program aside; the targets are for the longest."""
    figures, costs = [], []
    for measured in lengths(setup, command):
        costs.append(measured.cost)
        what, at_end = f"{name} {length(measured.seconds)}", measured.seconds == setup.lengths_s[-1]
        figures += [
            Figure(what, 1.0 / measured.cost, "recorded s per CPU s", faster if at_end else ""),
            Figure(f"{what}: peak memory", measured.peak_mb, "MB", smaller if at_end else ""),
        ]
    if len(costs) > 1:
        against = f"{what} against {length(setup.lengths_s[0])}"
        figures.append(Figure(against, costs[-1] / costs[0], "x", growth))
    return figures
