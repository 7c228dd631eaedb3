"""The steps of a recording: its segments with the probabilities of all contacts, when they begin and end,
and what they touched."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.map.association import Sighting
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Segment

Array = NDArray[np.float64]

LEAST_PROBABILITY: Final = 1e-6
"""Of a contact in a step or belief: none is excluded. Takes and plans are as with 1e-4."""


@dataclass(frozen=True, eq=False)
class Step:
    """A segment of a recording, as a step of what is done in it.

    Parameters
    ----------
    segment : as found.
    probability : (7,) of the contacts in the order of ``STATES``, the mean of the smoothed beliefs.
    start_s, end_s : since the recording's first pose.
    boundary_sd_s : standard deviations of start and end, from the beliefs of the ticks around them.
    sighting : what the motion says of the touching elements; None where the contact is not sure enough.
    """

    segment: Segment
    probability: Array
    start_s: float
    end_s: float
    boundary_sd_s: tuple[float, float]
    sighting: Sighting | None

    @property
    def contact(self) -> Contact:
        return self.segment.contact

    @property
    def is_open(self) -> bool:
        """Whether the motion leaves the contact open."""
        return bool(self.segment.inseparable)


def steps_of(outcome: Outcome) -> list[Step]:
    """The steps of a recording in order of time; they cover all of it."""
    segments, beliefs, origin_ns = outcome.segments, outcome.beliefs, outcome.origin_ns
    stamps_ns, probability = beliefs.stamp_ns, beliefs.probability
    found, bounds = [], _boundary_sd_s(segments, stamps_ns, probability)
    for number, segment in enumerate(segments):
        rows = slice(*np.searchsorted(stamps_ns, [segment.start_ns, segment.end_ns + 1]).tolist())
        mean = np.eye(len(STATES))[segment.contact.column]
        if rows.start < rows.stop:
            mean = probability[rows].mean(axis=0)
        mean = np.maximum(mean, LEAST_PROBABILITY)
        span_s = [(stamp_ns - origin_ns) * 1e-9 for stamp_ns in (segment.start_ns, segment.end_ns)]
        sds = bounds[number], bounds[number + 1]
        sighting = sighting_of(segment, outcome.learned_world)
        found.append(Step(segment, mean / mean.sum(), span_s[0], span_s[1], sds, sighting))
    return found


def sighting_of(segment: Segment, touched: GrowingMap | None) -> Sighting | None:
    """The contact in the map that is the segment's: of its kind, with the longest common time."""
    common = [
        (min(one.stamp_ns, segment.end_ns) - max(one.onset_ns, segment.start_ns), number)
        for number, one in enumerate(() if touched is None else touched.sightings)
        if one.estimate.contact is segment.contact
    ]
    longest, number = max(common, default=(0, 0))
    return None if touched is None or longest <= 0 else touched.sightings[number]


def _boundary_sd_s(
    segments: Sequence[Segment], stamps_ns: NDArray[np.int64], probability: Array
) -> list[float]:
    """Standard deviations (S + 1,) of the boundaries of S segments.

    The probability p of the first label, tick by tick, is that of a boundary later than the tick: the sum of
    p (1 - p) times the tick is sd / sqrt(pi), if it is normal. First and last are those of the recording.
    """
    tick_s = float(np.median(np.diff(stamps_ns))) * 1e-9 if len(stamps_ns) > 1 else 0.0
    found = [0.0]
    for before, after in pairwise(segments):
        middles = [(one.start_ns + one.end_ns) // 2 for one in (before, after)]
        p = probability[slice(*np.searchsorted(stamps_ns, middles).tolist()), before.contact.column]
        spread_s = 0.0 if before.contact is after.contact else float((p * (1.0 - p)).sum()) * tick_s
        found.append(sqrt(np.pi * spread_s**2 + tick_s**2 / 12.0))
    return [*found, 0.0]
