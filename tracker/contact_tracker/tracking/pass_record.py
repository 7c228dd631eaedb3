"""What a pass over a recording leaves for a map: its ticks, and what its sure segments say about elements."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from contact_tracker.map.sighting import MAP_INSERTION_PROBABILITY, Sighting
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.segment_fit import FinishedSegment, SegmentFit
from contact_tracker.tracking.state import FilterState

MOST_TICKS: Final = 36_000
"""Number of ticks up to which a recording is kept for a second pass, an hour of most: 1 kB each."""


class PassRecord:
    """The ``ticks`` of a pass, the ``state`` after it, the ``contacts`` and ``sightings`` of its segments."""

    def __init__(self) -> None:
        self.ticks: list[Tick] = []
        self.contacts: list[Contact] = []
        self.sightings: list[Sighting] = []
        self.state: FilterState | None = None
        self.is_full = False
        self.best = self

    @property
    def map(self) -> GrowingMap | None:
        """The map of the best pass, or of a very long recording as it has grown; None without poses."""
        if self.state is None:
            return None
        start = self.state.map
        if self.is_full:
            return start
        world = GrowingMap.learn(self.best.sightings, start.reach_m, prior=start.prior)
        return replace(world, origins=start.origins, prior_is_dropped=start.prior_is_dropped)

    @property
    def log_evidence(self) -> float:
        """Log probability of all ticks, relative to that of free motion (nats)."""
        return 0.0 if self.state is None else self.state.log_evidence

    def note(self, state: FilterState, tick: Tick) -> None:
        """Append a tick, one of those that lead to ``state``."""
        self.state = state
        self.is_full = self.is_full or len(self.ticks) == MOST_TICKS
        if not self.is_full:
            self.ticks.append(tick)
        elif self.ticks:
            self.ticks.clear()
            self.sightings.clear()

    def note_segment(self, finished: FinishedSegment, fit: SegmentFit, parts: Sequence[Segment]) -> None:
        """Append a segment with its moved and resting parts; only a sure one says something about its
        elements."""
        if fit.contact is not Contact.FREE:
            self.contacts.append(fit.contact)
        is_sure = any(one.probability >= MAP_INSERTION_PROBABILITY and not one.inseparable for one in parts)
        if fit.estimate is not None and is_sure and not self.is_full:
            index, start_ns = finished.ticks.window.index, int(finished.rows["start_ns"][0])
            span = int(index[0]), int(index[-1]) + 1
            self.sightings.append(Sighting(*span, fit.estimate, start_ns, finished.end_ns))
