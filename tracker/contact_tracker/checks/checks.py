"""All checks of a stream, in order of precedence."""

from collections.abc import Iterable
from typing import Final, NamedTuple

from contact_tracker.checks.check import Check, Stream
from contact_tracker.checks.clearance import Clearance
from contact_tracker.checks.contradiction import Contradiction
from contact_tracker.checks.conventions import Conventions
from contact_tracker.checks.impacts import Impacts
from contact_tracker.checks.map_use import MapUse
from contact_tracker.checks.repeatability import Repeatability
from contact_tracker.inspection.stream_checks import Finding, findings
from contact_tracker.motion.poses import Poses
from contact_tracker.tracking.belief import Segment

OF_POSES: Final = Clearance, Impacts
"""Checks that are updated with the inspection of the poses; the others with the filters."""


class Checks(NamedTuple):
    """A later check may be silent where an earlier one explains the same."""

    impacts: Impacts = Impacts()
    conventions: Conventions = Conventions()
    clearance: Clearance = Clearance()
    contradiction: Contradiction = Contradiction()
    repeatability: Repeatability = Repeatability()
    map_use: MapUse = MapUse()

    def update(self, poses: Poses, stream: Stream, *kinds: type[Check]) -> "Checks":
        """The checks, those of these kinds updated by poses."""
        return Checks._make(one.update(poses, stream) if isinstance(one, kinds) else one for one in self)

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

    def findings(self, stream: Stream, is_end: bool = False) -> tuple[Finding, ...]:
        """Findings so far, or at the end of the stream."""
        found = list(findings(stream.inspection, self.conventions.fitting_units))
        for one in self:
            found += one.findings(stream, found)
            if is_end:
                found += one.final_findings(stream, found)
        return tuple(found)
