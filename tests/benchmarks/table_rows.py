"""Figures and rows that tables of several benchmarks have."""

from collections.abc import Sequence

import numpy as np

from contact_tracker.evaluation.tables import number


def median_of_known(values: Sequence[float]) -> float:
    """The median without nan; nan if nothing else is there."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")


def shares_row(name: str, recordings: Sequence[tuple[float, ...]]) -> list[str]:
    """The length of all ``recordings`` (s), which is the first figure of each, and shares: the others (s)."""
    seconds, *parts = (sum(column) for column in zip(*recordings, strict=True))
    return [name, f"{seconds:.0f}", *(number(part / seconds) for part in parts)]
