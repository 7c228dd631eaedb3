"""The common interface of all checks of a stream."""

from collections.abc import Iterable, Sequence
from typing import ClassVar, Final, NamedTuple, Self

from contact_tracker.config.parameters import Model
from contact_tracker.geometry.elements import Array
from contact_tracker.inspection.stream_checks import Finding, Inspection
from contact_tracker.map.map import Map
from contact_tracker.motion.poses import Poses
from contact_tracker.tracking.belief import Segment

MIXED_UP: Final = "units", "bodies"
"""Kinds of findings that make speeds and turns meaningless: they are not of one object in metres."""


class Stream(NamedTuple):
    """State of a stream, without its poses.

    Parameters
    ----------
    map : prior knowledge.
    model : model that the user asked for.
    first, best : models of the first and of the most probable filter; None before the second pose.
    sigma : given noise of a pose (m, rad); None before the second pose.
    body_m : (3,) tracked point of the body.
    is_chosen : whether the choice of ticks and noise is final.
    is_at_rest : whether the object rests.
    inspection : statistics of the poses alone.
    is_end : whether the stream ends here.
    is_cut_short : whether it goes on, but is not read further.
    """

    map: Map
    model: Model
    first: Model | None
    best: Model | None
    sigma: tuple[float, float] | None
    body_m: Array
    is_chosen: bool
    is_at_rest: bool
    inspection: Inspection
    is_end: bool = False
    is_cut_short: bool = False

    @property
    def is_filtered(self) -> bool:
        """Whether the poses look filtered: by the evidence, a tick has more noise than errors that average
        out would leave."""
        least_m = self.model.noise.floor_position_m
        return self.best is not None and self.best.noise.floor_position_m > least_m


class Check:
    """One check of a stream as an immutable value; subclasses override the methods that they need."""

    suspicion: ClassVar[str] = ""
    """What may be wrong while ``is_likely``."""

    def update(self, poses: Poses, stream: Stream) -> Self:
        """Updated by poses."""
        return self

    def update_segments(self, segments: Iterable[Segment], stream: Stream) -> Self:
        """Updated by the next segments, in order of time."""
        return self

    def is_likely(self, stream: Stream) -> bool:
        """Whether there may soon be a finding that makes labels unreliable, or at the end of the stream would
        be one if it went on."""
        return False

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        """The findings so far; ``earlier``: findings of checks that come before."""
        return []


def has_doubts(findings: Iterable[Finding], *kinds: str) -> bool:
    """Whether a finding of one of these ``kinds`` makes labels unreliable."""
    return any(finding.doubts_labels and finding.kind in kinds for finding in findings)
