"""The check for a contradiction with the map, by a filter without it, and all checks of a stream in their
order."""

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self

import numpy as np

from contact_tracker.checks.check import Check, Stream, has_doubts
from contact_tracker.checks.clearance import Clearance, Impacts
from contact_tracker.checks.conventions import Conventions
from contact_tracker.checks.map_use import MapUse, Repeatability
from contact_tracker.config.parameters import Model
from contact_tracker.geometry.elements import Array, Point
from contact_tracker.hypotheses.evidence import SAME_FIT_RATIO
from contact_tracker.inspection.stream_checks import Finding, findings
from contact_tracker.map.map import Map
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import TickGrid
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.tracking.ambiguity import freedom_of
from contact_tracker.tracking.belief import Belief, Detail, Segment
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker.tracking.state import FilterState

WRONG_NATS: Final = 8.0
"""Lead (nats) of the tracker without the map from which the map is reported as wrong. Correct directions cost
up to 7 nats: if they are off by 2.5 standard deviations, or while a wrong contact fits."""
LOST_NATS: Final = 15.0
"""Increase of the lead (nats) since any tick from which the map is reported as wrong: one part of it may be
wrong after another has fitted. Correct maps lose up to 8 nats."""
DOUBTED_NATS: Final = 6.0
"""Lead (nats) above which probabilities are reduced."""
AT_ORIGIN_M: Final = 1e-3
"""Largest distance of a vertex from the origin of the body's frame for which it may be the point by which a
machine is controlled. Of arms with 0.05 and 0.3 mm of noise it is up to 0.1 and 1 mm once a plane fits."""
LONGEST_S: Final = 60.0
"""Time in motion (s) after which the comparison ends: an error that is not detected by then is harmless."""


@dataclass(eq=False)
class Comparison:
    """Filters with and without a map that run for their evidence only, on ticks of their own, and their time
    in motion (s)."""

    grid: TickGrid
    with_map: ContactFilter
    without_map: ContactFilter
    moved_s: float = 0.0

    @classmethod
    def start(cls, model: Model, body_m: Array, known_map: Map) -> Self:
        """The filters before the first pose."""
        filters = ContactFilter.start(model, known_map=known_map), ContactFilter.start(model)
        return cls(TickGrid(model, body_m), *filters)

    def copied(self) -> Self:
        """A copy that can be updated without changing these filters."""
        return replace(
            self, **{name: copy(getattr(self, name)) for name in ("grid", "with_map", "without_map")}
        )

    @property
    def lead(self) -> float:
        """Log evidence (nats) without the map over that with it."""
        return self.without_map.state.log_evidence - self.with_map.state.log_evidence

    def update(self, poses: Poses) -> Iterator[tuple[Belief, Belief]]:
        """Update by poses; yields the beliefs of each tick with and without the map, the latter with its
        geometry."""
        for tick in self.grid.add(poses):
            with_map = self.with_map.update(tick, Detail.WEIGHTS, tests_curvature=False)
            without_map = self.without_map.update(tick, Detail.GEOMETRY, tests_curvature=False)
            state = self.without_map.state
            self.moved_s += state.model.tick_s * state.window.latest_motion_ratio
            yield with_map, without_map


@dataclass(frozen=True, eq=False)
class Contradiction(Check):
    """Evidence against the map: whether it contradicts the motion.

    Known elements are a prior. A correct prior hardly lowers the evidence; with a wrong one true contacts fit
    badly or not at all. So a filter without the map runs beside one with it; the difference of their log
    evidence is the evidence against the map.

    Parameters
    ----------
    filters : None before the second pose and once the comparison ``is_settled``.
    lead : log evidence (nats) without the map over that with it, in the ticks that count.
    lost : largest increase of the lead since any tick.
    is_found : whether a contradiction is found.
    """

    suspicion = "what is given (--up, --states, or known elements) may not fit the motion"

    filters: Comparison | None = None
    lead: float = 0.0
    lost: float = 0.0
    is_settled: bool = False
    is_found: bool = False

    def is_likely(self, stream: Stream) -> bool:
        doubted = DOUBTED_NATS if stream.map.lists_elements else WRONG_NATS
        return self.is_found or (not self.is_settled and self.lead > doubted)

    def update(self, poses: Poses, stream: Stream) -> "Contradiction":
        """Updated by poses; nothing is compared if the map has no named elements and allows all states.

        Noise that is taken for motion has more evidence without the map. So the comparison restarts when the
        model or the tracked point changes. Until the model is chosen, it is not settled, and ticks at rest do
        not count; if noise is filtered, which looks like motion at rest as well, nothing is found.
        """
        if stream.best is None or self.is_settled:
            return self
        if not (stream.map.lists_elements or stream.map.states):
            return replace(self, is_settled=True)
        if not len(poses):
            return self
        grid, check = None if self.filters is None else self.filters.grid, self
        if grid is not None and (grid.model != stream.best or (grid.body_m != stream.body_m).any()):
            check = Contradiction()
        filters = check.filters or Comparison.start(stream.best, stream.body_m, stream.map)
        return check._compared(filters.copied(), poses, stream)

    def _compared(self, filters: Comparison, poses: Poses, stream: Stream) -> "Contradiction":
        lead, lost, is_found, difference = self.lead, self.lost, self.is_found, filters.lead
        for with_map, without_map in filters.update(poses):
            previous, difference = difference, filters.lead
            is_counted = stream.is_chosen or not stream.is_at_rest
            is_counted &= not (stream.map.up is not None and _is_scripted(without_map))
            if is_counted and not _is_undecided(with_map, without_map, filters.without_map.state):
                lead += difference - previous
                lost = max(lost + difference - previous, 0.0)
            may_be_found = stream.is_chosen or not stream.is_filtered
            is_found = may_be_found and (is_found or _refutes(lead, lost, stream.map))
            if stream.is_chosen and (is_found or filters.moved_s > LONGEST_S):
                return Contradiction(None, lead, lost, is_settled=True, is_found=is_found)
        return Contradiction(filters, lead, lost, is_found=is_found)

    def finish(self) -> "Contradiction":
        """The check at the end of the stream; if the noise was not chosen, labels were in doubt."""
        if self.filters is None:
            return self
        known_map = self.filters.with_map.state.known_map
        return replace(self, is_found=self.is_found or _refutes(self.lead, self.lost, known_map))

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        if not self.is_found or has_doubts(earlier, "impacts", "knowledge"):
            return []
        sides = (("object", stream.map.listed_object), ("surroundings", stream.map.listed_environment))
        named = " and the ".join(name for name, listed in sides if listed)
        fault = f"what is given of the {named}" if named else "what is given"
        if stream.map.up is not None:
            fault = f"--up or {fault}" if named else "--up"
        excluded = ", ".join(contact for contact in CONTACTS if contact not in stream.map.possible)
        text = (
            f"{fault} does not fit the motion, which contacts explain better without it: leave it out, or "
            "check its size, direction and place (in metres; of the surroundings in the frame of the poses, "
            "of the object in its own)"
        )
        if excluded:
            subject = f"{fault}, or --states" if stream.map.lists_elements else "--states"
            subject += f", which leaves out {excluded},"
            text = f"{subject} does not fit the motion: other contacts explain more: check it"
        return [Finding("knowledge", text, True)]


def _refutes(lead: float, lost: float, known_map: Map) -> bool:
    """Whether the lead refutes the map; right states without elements lead by up to 8 nats when handled."""
    return (known_map.lists_elements and lead > WRONG_NATS) or lost > LOST_NATS


def _is_undecided(with_map: Belief, without_map: Belief, state: FilterState) -> bool:
    """Whether the motion does not decide between the contacts of the two trackers: they are one contact that
    fits as well with the map, or one that the motion in few directions does not distinguish: the second, in
    this ``state``, has more evidence because something else, such as the hand, adds a constraint (T24). It
    may be one contact on other elements, as of a hinge, on which faces fit across its axis."""
    label = without_map.contact
    if with_map.contact is not label and (
        with_map.contact not in without_map.inseparable
        or not freedom_of(label, state.window, state.onset_of(label)).underused
    ):
        return False
    residual, rival = (
        1.0 if belief.contact is Contact.FREE else float(belief.residual[belief.contact.column])
        for belief in (with_map, without_map)
    )
    return not residual >= SAME_FIT_RATIO * max(1.0, rival)  # nan, while unknown, means undecided


def _is_scripted(belief: Belief) -> bool:
    """Whether a vertex touches at the origin of the body's frame: it may be the tool centre point of a robot,
    which a script moves in a plane that no surface has."""
    geometry = belief.geometry if belief.contact is Contact.VF else None
    point = None if geometry is None else geometry.object
    return isinstance(point, Point) and bool(np.linalg.norm(point.point_m) < AT_ORIGIN_M)


FILTERED: Final = (
    "poses look filtered, interpolated or rounded, or contacts soft (errors do not average out): the noise "
    "of a tick is judged by evidence; record raw poses if you can, or give their noise with --noise"
)
INSPECTED: Final = "impacts", "clearance"
"""Checks that are updated in the batches in which poses are inspected."""


class Checks(NamedTuple):
    """All checks in order; a check may be silent if an earlier one explains the same fault."""

    impacts: Impacts = Impacts()
    conventions: Conventions = Conventions()
    clearance: Clearance = Clearance()
    contradiction: Contradiction = Contradiction()
    repeatability: Repeatability = Repeatability()
    map_use: MapUse = MapUse()

    def update(self, poses: Poses, stream: Stream, *names: str) -> "Checks":
        """The named checks updated by poses."""
        return self._replace(**{name: getattr(self, name).update(poses, stream) for name in names})

    def update_segments(self, segments: Iterable[Segment], stream: Stream) -> "Checks":
        """The checks updated by the next segments."""
        listed = tuple(segments)
        return Checks._make(check.update_segments(listed, stream) for check in self)

    def finish(self) -> "Checks":
        """The checks at the end of the stream."""
        return self._replace(contradiction=self.contradiction.finish())

    def is_likely(self, stream: Stream) -> bool:
        """Whether there may soon be a finding that makes labels unreliable."""
        return any(check.is_likely(stream) for check in self)

    def suspicions(self, stream: Stream) -> tuple[str, ...]:
        """What may be wrong in words, before there is a finding."""
        return tuple(check.suspicion for check in self if check.is_likely(stream))

    def findings(self, stream: Stream) -> tuple[Finding, ...]:
        """Findings so far; at the end of the stream also what is still suspected."""
        result = list(findings(stream.inspection, stream.is_cut_short))
        if stream.is_filtered and not stream.inspection.bodies:
            result.append(Finding("filtered", FILTERED, False))
        for check in self:
            result += check.findings(stream, result)
        if stream.is_end and not any(finding.doubts_labels for finding in result):
            undecided = "no label is certain, as the motion does not decide it: check that, or record more"
            texts = (f"{suspicion}: {undecided}" for suspicion in self.suspicions(stream))
            result += [Finding("suspicion", text, True) for text in texts]
        return tuple(result)
