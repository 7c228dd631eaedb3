"""The check for a contradiction with the map, by a filter without it, and all checks of a stream in order of
precedence."""

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self

from contact_tracker.checks.check import Check, Stream, has_doubts
from contact_tracker.checks.clearance import Clearance, Impacts
from contact_tracker.checks.conventions import Conventions
from contact_tracker.checks.map_use import MapUse, Repeatability
from contact_tracker.config.parameters import Model
from contact_tracker.geometry.elements import Array
from contact_tracker.hypotheses.evidence import SAME_FIT_RATIO
from contact_tracker.inspection.stream_checks import Finding, findings
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import TickGrid
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.tracking.belief import Belief, Detail, Segment
from contact_tracker.tracking.contact_filter import ContactFilter

WRONG_NATS: Final = 8.0
"""Lead of the tracker without the map above which the map is reported as wrong. Correct
directions cost up to 7 nats: if they are off by 2.5 standard deviations, or while a wrong contact fits."""
LOST_NATS: Final = 15.0
"""The same for the lead since any tick: one part of the map may be wrong after another has fitted.
Correct ones lose up to 8 nats."""
DOUBTED_NATS: Final = 6.0
"""Lead above which probabilities are reduced."""
LONGEST_S: Final = 60.0
"""Seconds of motion after which the comparison ends: an error that is not detected by then is harmless."""


@dataclass(eq=False)
class ReferenceFilter:
    """A filter with ticks of its own that runs for its evidence only, and the seconds of motion since its
    start."""

    grid: TickGrid
    filter: ContactFilter
    moved_s: float = 0.0

    @classmethod
    def start(cls, model: Model, body_m: Array, known_map: Map = EMPTY_MAP) -> Self:
        """The filter before the first pose."""
        return cls(TickGrid(model, body_m), ContactFilter.start(model, known_map=known_map))

    def copied(self) -> Self:
        """A copy that is updated without a change of this one."""
        return replace(self, grid=copy(self.grid), filter=copy(self.filter))

    @property
    def log_evidence(self) -> float:
        """Of contacts against free motion (nats)."""
        return self.filter.state.log_evidence

    def update(self, poses: Poses, detail: Detail = Detail.WEIGHTS) -> Iterator[Belief]:
        """Update by poses, tick by tick as the beliefs of this ``detail`` are taken."""
        for tick in self.grid.add(poses):
            belief = self.filter.update(tick, detail, tests_curvature=False)
            state = self.filter.state
            self.moved_s += state.model.tick_s * state.window.latest_motion_ratio
            yield belief


@dataclass(frozen=True, eq=False)
class Contradiction(Check):
    """Evidence against the map: whether it contradicts the motion.

    Known elements are a prior. A correct one hardly lowers the evidence; with a wrong one true contacts fit
    badly or not at all. So a filter without the map runs beside one with it; the difference of their evidence
    is the evidence against the map.

    Parameters
    ----------
    with_map, without_map : the filters; None before the second pose and once the comparison
        ``is_settled``.
    lead : the part that counts of the evidence of the second over the first (nats).
    lost : its largest increase until now since any tick.
    is_found : whether a contradiction is found.
    """

    with_map: ReferenceFilter | None = None
    without_map: ReferenceFilter | None = None
    lead: float = 0.0
    lost: float = 0.0
    is_settled: bool = False
    is_found: bool = False

    def is_likely(self, stream: Stream) -> bool:
        doubted = DOUBTED_NATS if stream.map.lists_elements else WRONG_NATS
        return self.is_found or (not self.is_settled and self.lead > doubted)

    def update(self, poses: Poses, stream: Stream) -> "Contradiction":
        """Updated by poses. Without named elements, where all states can occur, nothing is compared.

        Noise that is taken for motion has more evidence without the map. So the comparison begins again where
        the model or the tracked point changes, and until it is chosen the comparison is not settled, and
        nothing counts while the object rests; where noise is filtered, it is taken for motion at rest as
        well, and nothing is found.
        """
        if stream.best is None or self.is_settled:
            return self
        if not (stream.map.lists_elements or stream.map.states):
            return replace(self, is_settled=True)
        if not len(poses):
            return self
        before = self
        grid = None if self.with_map is None else self.with_map.grid
        if grid is not None and (grid.model != stream.best or (grid.body_m != stream.body_m).any()):
            before = Contradiction()
        return before._compared(poses, stream)

    def _compared(self, poses: Poses, stream: Stream) -> "Contradiction":
        assert stream.best is not None
        first = (self.with_map or ReferenceFilter.start(stream.best, stream.body_m, stream.map)).copied()
        second = (self.without_map or ReferenceFilter.start(stream.best, stream.body_m)).copied()
        difference = second.log_evidence - first.log_evidence
        lead, lost, is_found = self.lead, self.lost, self.is_found
        for one, other in zip(first.update(poses), second.update(poses, Detail.SHARED), strict=True):
            before, difference = difference, second.log_evidence - first.log_evidence
            is_counted = stream.is_chosen or not stream.is_at_rest
            if is_counted and not _is_undecided(one, other):
                lead += difference - before
                lost = max(lost + difference - before, 0.0)
            may_be_found = stream.is_chosen or not stream.inspection.filtered
            is_found = may_be_found and (is_found or _refutes(lead, lost, stream.map))
            if stream.is_chosen and (is_found or second.moved_s > LONGEST_S):
                return Contradiction(None, None, lead, lost, is_settled=True, is_found=is_found)
        return Contradiction(first, second, lead, lost, is_found=is_found)

    def finish(self) -> "Contradiction":
        """At the end of the stream, whose noise may not have been chosen: labels were in doubt then."""
        if self.with_map is None:
            return self
        known_map = self.with_map.filter.state.known_map
        return replace(self, is_found=self.is_found or _refutes(self.lead, self.lost, known_map))

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        if not self.is_found or has_doubts(earlier, "impacts", "knowledge"):
            return []
        sides = (("object", stream.map.listed_object), ("surroundings", stream.map.listed_environment))
        given = " and the ".join(name for name, listed in sides if listed)
        what = f"what is given of the {given}" if given else "what is given"
        if stream.map.up is not None:
            what = f"--up or {what}" if given else "--up"
        others = ", ".join(one for one in CONTACTS if one not in stream.map.possible)
        text = (
            f"{what} does not fit the motion, which contacts explain better without it: leave it out, or "
            "check its size, direction and place (in metres; of the surroundings in the frame of the poses, "
            "of the object in its own)"
        )
        if others:
            given = f"{what}, or --states" if stream.map.lists_elements else "--states"
            text = (
                f"{given}, which leaves out {others}, does not fit the motion: "
                "other contacts explain more: check it"
            )
        return [Finding("knowledge", text, True)]


def _refutes(lead: float, lost: float, known_map: Map) -> bool:
    """Of right states alone the lead was up to 8 nats in everyday handling."""
    return (known_map.lists_elements and lead > WRONG_NATS) or lost > LOST_NATS


def _is_undecided(with_map: Belief, without_map: Belief) -> bool:
    """Whether motion in few directions does not decide between the contacts of the two trackers: that of the
    second has more evidence because something else, such as the hand, keeps a constraint (T24)."""
    if not without_map.p_restricted or with_map.contact not in without_map.inseparable:
        return False
    residual, other = (
        1.0 if one.contact is Contact.FREE else float(one.residual[one.contact.column])
        for one in (with_map, without_map)
    )
    return not residual >= SAME_FIT_RATIO * max(1.0, other)  # nan, not known yet: not decided


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
