"""Live: the command ``live`` on logs of several lengths, as fast as possible; its memory must not grow."""

from speeds.figures import Figure, Setup
from speeds.offline import commands


def measure(setup: Setup) -> list[Figure]:
    return commands(setup, ("live",), "live", ">= 10", "<= 150")
