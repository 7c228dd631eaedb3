"""Online: CPU time per tick, from the log's bytes to the belief, by the run length of the contact."""

import time
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.recording import open_log
from contact_tracker.tracker import Tracker
from speeds.figures import Figure, Setup
from speeds.long_logs import write_long_log

Array = NDArray[np.float64]

SECONDS: Final = 120.0
AGES_S: Final = (0.0, 3.0, 10.0, 20.0, 30.0)
"""A recording of 10 s per contact, forward and backward, has contacts of 20 s, and of 30 s with its rest."""


class Ticks(NamedTuple):
    """``cpu_s`` (T,) of each tick, ``age_s`` (T,) of its labelled contact, and whether it was
    ``uninformative`` (T,), as at rest; ``poses`` in all of them."""

    cpu_s: Array
    age_s: Array
    uninformative: NDArray[np.bool_]
    poses: int


def measure(setup: Setup) -> list[Figure]:
    model = load_model(setup.model)
    return [
        *_figures(setup.log, model, setup, share="<= 10", p99="<= 5"),
        *_figures(setup.fast_log, model, setup, share="<= 25", p99=""),
    ]


def _figures(source: Path, model: Model, setup: Setup, share: str, p99: str) -> list[Figure]:
    log = write_long_log(source, SECONDS, setup.scratch / f"{source.stem}_online.mcap")
    runs = [track(log, model) for _ in range(setup.runs)]
    taken_ms = 1e3 * np.median([run.cpu_s for run in runs], axis=0)  # the same ticks in each run
    name, age_s = source.stem, runs[0].age_s
    figures = [
        Figure(f"{name}: share of a core", float(0.1 * taken_ms.mean() / model.tick_s), "%", share),
        Figure(f"{name}: in total", float(1e3 * taken_ms.sum() / runs[0].poses), "us per pose"),
        *_spread(name, taken_ms, p99),
    ]
    for low_s, high_s in zip(AGES_S, (*AGES_S[1:], np.inf), strict=True):
        among = taken_ms[(age_s >= low_s) & (age_s < high_s)]
        ages = f"{low_s:g} to {high_s:g} s" if high_s < np.inf else f"over {low_s:g} s"
        figures += _spread(f"{name}: contact of {ages}", among) if len(among) else []
    return [*figures, *_spread(f"{name}: uninformative", taken_ms[runs[0].uninformative])]


def _spread(what: str, taken_ms: Array, p99: str = "") -> list[Figure]:
    middle, high = np.percentile(taken_ms, [50.0, 99.0])
    return [
        Figure(f"{what}: p50", float(middle), "ms per tick"),
        Figure(f"{what}: p99", float(high), "ms per tick", p99),
        Figure(f"{what}: max of {len(taken_ms)}", float(taken_ms.max()), "ms per tick"),
    ]


def track(log: Path, model: Model) -> Ticks:
    """Track a log as ``live`` does, with the CPU time of each belief."""
    tracker, gate, poses, cpu_s, age_s, uninformative = Tracker.start(model), PoseGate(), 0, [], [], []
    begin_s = time.process_time()
    for pose in open_log(str(log)):
        poses += 1
        for belief in tracker.update(gate.arrive(pose)):
            now_s = time.process_time()
            cpu_s.append(now_s - begin_s)
            age_s.append(1e-9 * (belief.stamp_ns - belief.onset_ns))
            uninformative.append(not tracker.filters.filters[0].state.hazard_exposure)
            begin_s = now_s
    return Ticks(np.array(cpu_s), np.array(age_s), np.array(uninformative), poses)
