"""Figures over several recordings, as the tables of benchmarks have them."""

from collections.abc import Sequence
from functools import reduce
from operator import add
from pathlib import Path
from typing import Final

import numpy as np

from contact_tracker_lab.benchmark.runner import Job
from contact_tracker_lab.evaluation.evaluate import Evaluation
from contact_tracker_lab.evaluation.tables import number

FIGURES: Final = (
    *("accuracy offline", "accuracy online", "sure and wrong offline", "sure and wrong online"),
    *("ECE offline", "ECE online", "worst accuracy offline", "worst accuracy online"),
    *("within 3 sd", "median sd"),
)


def recordings_in(folders: Sequence[Path]) -> dict[str, list[Job]]:
    """One job for each recording of the ``folders``, by the folders' names."""
    return {folder.name: [(str(path),) for path in sorted(folder.glob("*.mcap"))] for folder in folders}


def figures(evaluations: Sequence[Evaluation]) -> list[str]:
    """The ``FIGURES`` over recordings."""
    both = [(one.offline, one.online) for one in evaluations]
    accuracy = np.array([[tally.accuracy() for tally in pair] for pair in both])
    geometry = reduce(add, [one.geometry for one in evaluations])
    columns = (
        accuracy.mean(axis=0),
        np.mean([[tally.sure_wrong for tally in pair] for pair in both], axis=0),
        np.mean([[tally.calibration_error for tally in pair] for pair in both], axis=0),
        accuracy.min(axis=0),
        [geometry.within_3_sd, geometry.median_sd],
    )
    return [number(float(value)) for column in columns for value in column]


def mean_of_known(values: Sequence[float]) -> float:
    """The mean without nan values; nan if there are no others."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")


def median_of_known(values: Sequence[float]) -> float:
    """The median without nan values; nan if there are no others."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")


def shares_row(name: str, recordings: Sequence[tuple[float, ...]]) -> list[str]:
    """A row of the total duration (s) of ``recordings``, the first figure of each, and the other figures (s)
    as shares of it."""
    seconds, *parts = (sum(column) for column in zip(*recordings, strict=True))
    return [name, f"{seconds:.0f}", *(number(part / seconds) for part in parts)]
