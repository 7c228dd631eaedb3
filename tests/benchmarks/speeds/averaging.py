"""Averaging: from poses to ticks, including noise and free motion."""

from pathlib import Path

from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import TickGrid
from contact_tracker.recording import open_log
from speeds.figures import Figure, Setup, cpu_s


def measure(setup: Setup) -> list[Figure]:
    model = load_model(setup.model)
    targets = ((setup.log, "<= 0.4"), (setup.fast_log, "<= 0.8"))
    return [f for log, target in targets for f in _figures(log, target, model, setup.runs)]


def _figures(log: Path, target: str, model: Model, runs: int) -> list[Figure]:
    poses = Poses.collect(open_log(str(log)))
    count = average(poses, model)
    taken = cpu_s(lambda: average(poses, model), runs)
    return [
        Figure(f"{log.stem}: averaging", 1e6 * taken / len(poses), "us per pose"),
        Figure(f"{log.stem}: averaging", 1e3 * taken / count, "ms per tick", target),
    ]


def average(poses: Poses, model: Model) -> int:
    """Average poses into ticks; returns the number of ticks that they close."""
    grid, count = TickGrid(model), 0
    for some in poses.batches():
        count += len(grid.add(some))
    return count
