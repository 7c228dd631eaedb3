"""Rows of ``speed.py`` that are measured within one process: CPU time per pose and per tick."""

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median
from typing import Final

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model
from contact_tracker.geometry.linalg import unit
from contact_tracker.map.elements import LearnedElements, MapElement
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import MOST_LEARNED
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import TickGrid
from contact_tracker.recording import open_log
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.contact_filter import ContactFilter
from long_logs import write_long_log
from speed import Figure, Setup

ONLINE_S: Final = 120.0


def cpu_s(work: Callable[[], object], runs: int) -> float:
    """Median CPU time of ``work``, all threads together."""
    taken = []
    for _ in range(runs):
        begin_s = time.process_time()
        work()
        taken.append(time.process_time() - begin_s)
    return median(taken)


def reading(setup: Setup) -> list[Figure]:
    """Validated poses from a log, one by one and in columns as offline."""
    figures = []
    for log in (setup.log, setup.fast_log):
        count = len(Poses.collect(open_log(str(log))))
        each = cpu_s(lambda log=log: list(open_log(str(log))), setup.runs) / count  # type: ignore[misc]
        columns = cpu_s(lambda log=log: list(open_log(str(log)).batches()), setup.runs) / count  # type: ignore[misc]
        figures += [
            Figure(f"{log.stem}: poses", 1e6 * each, "us per pose", "<= 15"),
            Figure(f"{log.stem}: in columns, as offline", 1e6 * columns, "us per pose"),
        ]
    return figures


def averaging(setup: Setup) -> list[Figure]:
    """From poses to ticks, including noise and free motion."""
    model, figures = load_model(setup.model), list[Figure]()
    for log, target in ((setup.log, "<= 0.4"), (setup.fast_log, "<= 0.8")):
        poses = Poses.collect(open_log(str(log)))
        count = average(poses, model)
        taken_s = cpu_s(lambda poses=poses: average(poses, model), setup.runs)  # type: ignore[misc]
        figures.append(Figure(f"{log.stem}: averaging", 1e3 * taken_s / count, "ms per tick", target))
    return figures


def average(poses: Poses, model: Model) -> int:
    """Average poses into ticks; returns the number of ticks that they close."""
    grid = TickGrid(model)
    return sum(len(grid.add(batch)) for batch in poses.batches())


def online(setup: Setup) -> list[Figure]:
    """CPU time per tick, from the log's bytes to the belief."""
    model, figures = load_model(setup.model), list[Figure]()
    for source, share, p99 in ((setup.log, "<= 10", "<= 5"), (setup.fast_log, "<= 25", "")):
        log = write_long_log(source, ONLINE_S, setup.scratch / f"{source.stem}_online.mcap")
        taken_ms = 1e3 * np.median([track(log, model) for _ in range(setup.runs)], axis=0)
        name, (middle, high) = source.stem, np.percentile(taken_ms, [50.0, 99.0])
        figures += [
            Figure(f"{name}: share of a core", float(0.1 * taken_ms.mean() / model.tick_s), "%", share),
            Figure(f"{name}: p50", float(middle), "ms per tick"),
            Figure(f"{name}: p99", float(high), "ms per tick", p99),
            Figure(f"{name}: max of {len(taken_ms)}", float(taken_ms.max()), "ms per tick"),
        ]
    return figures


def track(log: Path, model: Model) -> Array:
    """CPU time (T,) of each belief, in seconds, of a log that is tracked as ``live`` does."""
    tracker, gate, taken_s = Tracker.start(model), PoseGate(), list[float]()
    begin_s = time.process_time()
    for pose in open_log(str(log)):
        for _ in tracker.update(gate.arrive(pose)):
            now_s = time.process_time()
            taken_s.append(now_s - begin_s)
            begin_s = now_s
    return np.array(taken_s)


def mapping(setup: Setup) -> list[Figure]:
    """Time per tick with a map of as many elements as a file holds, relative to that without a map, and time
    of all passes of ``segment`` relative to that of the first one, for the log and two takes of a mug.

    The map has the elements of the log, so that contacts agree with it, and others at random. Both are
    tracked alternately, tick by tick, so that the load of the machine affects both.
    """
    model, poses = load_model(setup.model), Poses.collect(open_log(str(setup.log)))
    tracker = OfflineTracker(model)
    for _ in tracker.pieces(poses):
        pass
    assert tracker.map is not None
    known_map = Map(learned=filled(tracker.map.learned, np.random.default_rng(0)))
    runs = []
    for _ in range(setup.runs):
        streams = [(TickGrid(model), ContactFilter.start(model, known_map=m)) for m in (EMPTY_MAP, known_map)]
        runs.append(list(zip(*(costs(stream, poses) for stream in streams), strict=False)))
    without, within = np.median(np.array(runs), axis=0).mean(axis=0)  # of (runs, ticks, 2)
    figures = [Figure(f"a map of {MOST_LEARNED} elements: a tick", float(within / without), "x", "<= 1.5")]
    takes = [setup.log.with_name(f"mug_{take}_take.mcap") for take in ("first", "second")]
    for log in (setup.log, *takes):
        poses = Poses.collect(open_log(str(log)))
        first, passes = (
            cpu_s(partial(segment, model, poses, uses_map), setup.runs) for uses_map in (False, True)
        )
        figures.append(Figure(f"{log.stem}: passes with a map", passes / first, "x", "<= 2.2"))
    return figures


def segment(model: Model, poses: Poses, uses_map: bool) -> None:
    """Segment poses, with passes with a map or in a single one."""
    for _ in OfflineTracker(model, uses_map=uses_map).pieces(poses):
        pass


def filled(learned: LearnedElements, rng: np.random.Generator) -> LearnedElements:
    """The elements with others at random, up to ``MOST_LEARNED``, each touched once and known to a
    millimetre."""
    elements = dict(learned.elements)
    for number in range(MOST_LEARNED - len(elements)):
        kind, direction = "fev"[number // 2 % 3], unit(rng.normal(size=3))
        place_m = rng.normal(0.0, 0.3, 1 if kind == "f" else 3)
        key = number % 2, 1 + max(n for _, n in elements)
        elements[key] = MapElement(kind, direction * (kind != "v"), place_m)
    known, information = len(learned.information), 1e6 * np.eye(sum(e.size for e in elements.values()))
    information[:known, :known] = learned.information
    return LearnedElements(elements, {key: learned.counts.get(key, 1) for key in elements}, information)


Stream = tuple[TickGrid, ContactFilter]
"""A filter and its ticks."""


def costs(stream: Stream, poses: Poses) -> Iterator[float]:
    """CPU time (s) of each tick that ends within the poses; ticks of a batch share that of its averaging."""
    grid, contact_filter = stream
    for batch in poses.batches():
        begin_s = time.process_time()
        closed = grid.add(batch)
        share_s = (time.process_time() - begin_s) / max(len(closed), 1)
        for tick in closed:
            begin_s = time.process_time()
            contact_filter.update(tick, Detail.WEIGHTS)
            yield share_s + time.process_time() - begin_s
