"""The map as each contact of a recording may use it: as the other contacts have learned it."""

from bisect import bisect_left, bisect_right
from typing import Final, NamedTuple

from contact_tracker.map.world_map import Map, MapView

MARGIN_S: Final = 1.0
"""Time before and after a contact in which the next pass may begin or end the same contact."""


class LeaveOneOut(NamedTuple):
    """A ``map`` of a recording with ticks of ``tick_s``.

    A contact does not use what it has itself shown: an element that no other contact touched is new to it. So
    a wrong estimate does not confirm itself.
    """

    map: Map
    tick_s: float

    def at(self, tick: int) -> MapView:
        """The map for contacts that begin in the tick with this number."""
        sightings, margin = self.map.sightings, round(MARGIN_S / self.tick_s)
        first = bisect_right(sightings, tick - margin, key=lambda one: one.end)
        end = bisect_left(sightings, tick + margin, key=lambda one: one.first)
        return self.map.without(one.first for one in sightings[first:end])
