"""Figures over several recordings, as the tables of benchmarks have them."""

from collections.abc import Sequence
from functools import reduce
from operator import add
from pathlib import Path
from typing import Final

import numpy as np

from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.tracking.belief import Segment
from contact_tracker_lab.benchmark.runner import Job
from contact_tracker_lab.evaluation.evaluate import Evaluation
from contact_tracker_lab.evaluation.metrics import finite_values, quantile
from contact_tracker_lab.evaluation.tables import number

NAN: Final = float("nan")
FIGURES: Final = (
    *("accuracy offline", "accuracy online", "sure and wrong offline", "sure and wrong online"),
    *("ECE offline", "ECE online", "worst accuracy offline", "worst accuracy online"),
    *("within 3 sd", "median sd"),
)


def read_gated(path: Path | str) -> Poses:
    """The poses of a recording that pass the gate."""
    return gate(Poses.collect(open_log(str(path))))


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
    finite = finite_values(np.array(values))
    return float(np.mean(finite)) if len(finite) else NAN


def median_of_known(values: Sequence[float]) -> float:
    """The median without nan values; nan if there are no others."""
    return quantile(finite_values(np.array(values)), 0.5)


def share_within_3(deviations_sd: Sequence[float]) -> float:
    """Share of known deviations that are at most three; nan without."""
    return mean_of_known([float(sd <= 3.0) if np.isfinite(sd) else NAN for sd in deviations_sd])


def duration_s(stretch: Poses | Segment) -> float:
    """From the first pose to the last, or of a segment."""
    if isinstance(stretch, Segment):
        return (stretch.end_ns - stretch.start_ns) * 1e-9
    return float(stretch.stamp_ns[-1] - stretch.stamp_ns[0]) * 1e-9


def shares_row(name: str, recordings: Sequence[tuple[float, ...]]) -> list[str]:
    """A row of the total duration (s) of ``recordings``, the first figure of each, and the other figures (s)
    as shares of it."""
    seconds, *parts = (sum(column) for column in zip(*recordings, strict=True))
    return [name, f"{seconds:.0f}", *(number(part / seconds) for part in parts)]
