"""Figures and rows used in tables of several benchmarks."""

from collections.abc import Sequence

import numpy as np

from contact_tracker_lab.evaluation.tables import number


def median_of_known(values: Sequence[float]) -> float:
    """The median without nan values; nan if there are no others."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")


def shares_row(name: str, recordings: Sequence[tuple[float, ...]]) -> list[str]:
    """A row of the total duration (s) of ``recordings``, the first figure of each, and the other figures (s)
    as shares of it."""
    seconds, *parts = (sum(column) for column in zip(*recordings, strict=True))
    return [name, f"{seconds:.0f}", *(number(part / seconds) for part in parts)]
