"""All checks of a stream, in order of precedence."""

from collections.abc import Iterable
from typing import Final, NamedTuple

from contact_tracker.checks.check import Stream
from contact_tracker.checks.clearance import Clearance, Impacts
from contact_tracker.checks.contradiction import Contradiction
from contact_tracker.checks.conventions import Conventions
from contact_tracker.checks.map_use import MapUse, Repeatability
from contact_tracker.inspection.stream_checks import Finding, findings
from contact_tracker.motion.poses import Poses
from contact_tracker.tracking.belief import Segment

TRACKED: Final = "conventions", "contradiction"
"""Checks that are updated by poses as the filters take them in."""
INSPECTED: Final = "impacts", "clearance"
"""Checks that are updated by poses as they are inspected, in batches."""


class Checks(NamedTuple):
    """A later check may be silent where an earlier one explains the same."""

    impacts: Impacts = Impacts()
    conventions: Conventions = Conventions()
    clearance: Clearance = Clearance()
    contradiction: Contradiction = Contradiction()
    repeatability: Repeatability = Repeatability()
    map_use: MapUse = MapUse()

    def update(self, poses: Poses, stream: Stream, *names: str) -> "Checks":
        """The named checks updated by poses."""
        return self._replace(**{name: getattr(self, name).update(poses, stream) for name in names})

    @property
    def basis(self) -> tuple[object, ...]:
        """What doubts depend on, as ``Inspection.basis``."""
        compared = self.conventions.nats, self.conventions.found, self.conventions.is_settled
        return self.impacts, *compared, self.clearance, self.contradiction

    def update_segments(self, segments: Iterable[Segment], stream: Stream) -> "Checks":
        """The checks updated by the next segments."""
        some = tuple(segments)
        return Checks._make(one.update_segments(some, stream) for one in self)

    def finish(self) -> "Checks":
        """At the end of the stream."""
        return self._replace(contradiction=self.contradiction.finish())

    def is_likely(self, stream: Stream) -> bool:
        """Whether there may soon be a finding that makes labels unreliable."""
        return any(one.is_likely(stream) for one in self)

    def findings(self, stream: Stream) -> tuple[Finding, ...]:
        """Findings so far."""
        found = list(findings(stream.inspection, self.conventions.fitting_units))
        for one in self:
            found += one.findings(stream, found)
        return tuple(found)
