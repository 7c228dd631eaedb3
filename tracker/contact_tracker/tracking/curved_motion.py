"""Test of free motion for contact with a curved surface, which is none of the six contacts."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hypotheses.curved_contact import curved_evidence, fit_curved
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.map.map import Map
from contact_tracker.motion.window import Window
from contact_tracker.tracking.ambiguity import p_curved

Array = NDArray[np.float64]

SPAN_TICKS: Final = 60
"""Number of ticks that are tested together."""
LEAST_TICKS: Final = 40
"""Least number of ticks; in fewer, smooth motion of a hand may fit by chance."""
LEAST_ACTIVITY: Final = 10.0
"""Least motion in them for a test."""
AGAIN: Final = 1.5
"""Free motion is tested again when its duration has grown by this factor."""


class CurvedMotion(NamedTuple):
    """The last test of free motion since tick ``since``: ``after`` this many ticks, with the ``probability``
    of a curved surface."""

    since: int
    after: int
    probability: float


NO_CURVED_MOTION: Final = CurvedMotion(-1, 0, 0.0)


def update_curved_motion(
    before: CurvedMotion, window: Window, since: int, scales: EvidenceParameters, known_map: Map
) -> CurvedMotion:
    """The estimate after another tick of free motion since tick ``since``; ``window`` are the last ticks."""
    known = before if before.since == since else CurvedMotion(since, 0, 0.0)
    age = int(window.index[-1]) + 1 - since
    if age < max(LEAST_TICKS, AGAIN * known.after):
        return known
    first = max(int(window.index.searchsorted(since)), len(window) - SPAN_TICKS)
    last = window.cut(first, None)
    probability = p_curved(curved_evidence(last, scales)) if _is_testable(last, known_map) else 0.0
    return CurvedMotion(since, age, probability)


def curved_probabilities(window: Window, scales: EvidenceParameters, known_map: Map) -> Array:
    """Probability (n,) of curved contact in each tick of a segment of free motion, by parts of the segment.

    The surface found in one part is tried in the others, as its elements are hard to find in some.
    """
    pieces = np.array_split(np.arange(len(window)), max(len(window) // SPAN_TICKS, 1))
    windows = [window.cut(int(rows[0]), int(rows[-1]) + 1) for rows in pieces if len(rows)]
    fits = [fit_curved(one, scales) if _is_testable(one, known_map) else None for one in windows]
    best = max((fit for fit in fits if fit is not None), key=lambda fit: fit.log_evidence, default=None)
    found = np.zeros(len(window))
    for rows, one, fit in zip(pieces, windows, fits, strict=False):
        if fit is None or best is None:
            continue
        evidence = fit.log_evidence
        if p_curved(evidence) <= 0.5 < p_curved(best.log_evidence):
            evidence = max(evidence, fit_curved(one, scales, best).log_evidence)
        found[rows] = p_curved(evidence)
    return found


def is_mostly_curved(probability: Array) -> bool:
    """Whether most of a segment, by the probability in each tick (n,), is on a curved surface."""
    return bool(np.mean(probability > 0.5) > 0.5)


def _is_testable(window: Window, known_map: Map) -> bool:
    """Whether curved contact is tested: motion suffices, and the object is not completely known."""
    enough = len(window) >= LEAST_TICKS and float(window.motion_ratio.sum()) >= LEAST_ACTIVITY
    return enough and not known_map.object_complete
