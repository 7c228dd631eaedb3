"""The online tracker of one stream, which adapts to it and checks it for mistakes."""

from dataclasses import dataclass, field, replace
from typing import Final, Self

from contact_tracker.adaptation import clearance, contradiction, impacts
from contact_tracker.adaptation.clearance import Clearance
from contact_tracker.adaptation.contradiction import Contradiction
from contact_tracker.adaptation.conventions import NOTHING_KNOWN, Conventions
from contact_tracker.adaptation.conventions import advance as advance_conventions
from contact_tracker.adaptation.conventions import findings as convention_findings
from contact_tracker.adaptation.filter_bank import FilterBank
from contact_tracker.adaptation.impacts import Impacts
from contact_tracker.adaptation.mixture import mixed_with_uniform
from contact_tracker.adaptation.report import Report, map_findings, report_of
from contact_tracker.config.parameters import Model
from contact_tracker.inspection.stream_checks import (
    NOTHING_INSPECTED,
    Finding,
    Inspection,
    findings,
    inspect,
)
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.motion.pose_validation import Arrival, is_valid, require_valid
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.state import FilterState

BATCH_POSES: Final = 50
"""Number of poses that are inspected together."""


@dataclass(eq=False)
class Tracker:
    """One object's stream: chooses the noise by evidence, checks the stream for mistakes.

    Bounded in size, however long the stream.

    Parameters
    ----------
    filters : of different noise, side by side.
    inspection, conventions, contradiction, clearance, impacts : checks of the poses, of their conventions
        and of prior knowledge.
    uninspected : the latest ``many`` poses; the filters have the first ``taken_in`` parts of these and get
        the others at the end of the tick.
    last_ns : stamp of the last pose.
    late : number of poses that were left out, see ``update``.
    """

    filters: FilterBank
    inspection: Inspection
    conventions: Conventions = NOTHING_KNOWN
    contradiction: Contradiction = field(default_factory=Contradiction)
    clearance: Clearance = field(default_factory=Clearance)
    impacts: Impacts = field(default_factory=Impacts)
    uninspected: list[Pose | Poses] = field(default_factory=list)
    many: int = 0
    taken_in: int = 0
    last_ns: int | None = None
    late: int = 0

    @classmethod
    def start(
        cls, model: Model, lag_s: float = 0.0, knowledge: PriorMap = EMPTY_MAP, frame_moves: bool = False
    ) -> Self:
        """The tracker before the first pose.

        Parameters
        ----------
        lag_s : with a fixed lag beliefs are later and more accurate.
        frame_moves : whether poses are in the frame of a body that moves, as the user asked.
        """
        return cls(FilterBank(model, lag_s, knowledge), NOTHING_INSPECTED._replace(frame_moves=frame_moves))

    def update(self, arrival: Arrival, detail: Detail = Detail.FORMATION) -> list[Belief]:
        """Update by what a pose brings (``PoseGate.arrive``); returns the beliefs of the ticks it closes.

        A tick does not wait for poses that are held or late: it is complete once none is waited for. Poses
        that come more than a tick after theirs was closed are left out and counted.
        """
        beliefs = list[Belief]()
        for pose in arrival.poses:
            if self.filters.is_late(pose.stamp_ns):
                self.late += 1
            else:
                beliefs += self.add(pose, detail)
        if arrival.next_ns is not None and not self.filters.goes_on(arrival.next_ns):  # the tick is complete
            beliefs += self._update_filters(detail)
            beliefs += self._pass_time(arrival.next_ns, detail)
        return beliefs

    def finish(self) -> list[Belief]:
        """End of the stream: the beliefs of the last, partial tick and of the ticks within the lag.

        The stream may go on, as after a gap.
        """
        beliefs = self._update_filters(Detail.FORMATION)
        self._inspect()
        last = self.filters.finish()
        self.contradiction = contradiction.finish(self.contradiction)
        return [*beliefs, *self._in_doubt(last)]

    def add(self, poses: Pose | Poses, detail: Detail = Detail.FORMATION) -> list[Belief]:
        """Update by one pose or several, in order; returns the beliefs of the ticks that they close.

        While the poses may be in doubt, probabilities are mixed with uniform ones.

        Raises
        ------
        InvalidPose
            They did not pass the gate, or are not after those before.
        """
        if isinstance(poses, Pose):
            if not is_valid(poses, self.last_ns):
                require_valid(Poses.collect([poses]), self.last_ns)
            self.last_ns = poses.stamp_ns
            self.uninspected.append(poses)
            self.many += 1
            if self.many < BATCH_POSES and self.filters.goes_on(poses.stamp_ns):
                return []  # most poses: the filters need them at the end of the tick only
            return self._update_all(detail)
        beliefs = list[Belief]()
        if len(poses):
            require_valid(poses, self.last_ns)
            self.last_ns = int(poses.stamp_ns[-1])
        while len(poses):
            room = max(BATCH_POSES - self.many, 1)
            some, poses = poses[:room], poses[room:]
            self.uninspected.append(some)
            self.many += len(some)
            beliefs += self._update_all(detail)
        return beliefs

    def _update_all(self, detail: Detail) -> list[Belief]:
        """Update the filters, and if there are enough poses the inspection."""
        beliefs = self._update_filters(detail)
        if self.many >= BATCH_POSES:
            self._inspect()
        return beliefs

    def _update_filters(self, detail: Detail) -> list[Belief]:
        """Update the filters and the checks by the poses that they do not have yet."""
        if self.taken_in == len(self.uninspected):
            return []
        poses, filters = Poses.join(self.uninspected[self.taken_in :]), self.filters.copied()
        beliefs = filters.add(poses, detail)
        self.filters, self.taken_in = filters, len(self.uninspected)  # an interrupted call changes nothing
        self.check_conventions(poses)
        self.check_prior_map(poses)
        return self._in_doubt(beliefs)

    def _pass_time(self, until_ns: int, detail: Detail) -> list[Belief]:
        """Close the ticks that are over by this time."""
        filters = self.filters.copied()
        beliefs = filters.pass_time(until_ns, detail)
        self.filters = filters
        return self._in_doubt(beliefs)

    def _in_doubt(self, beliefs: list[Belief]) -> list[Belief]:
        """The beliefs, mixed with uniform ones while the stream may be in doubt."""
        if not beliefs or not self.may_be_in_doubt:
            return beliefs
        possible = self.filters.knowledge.allowed
        return [replace(one, probability=mixed_with_uniform(one.probability, possible)) for one in beliefs]

    def _inspect(self) -> None:
        if self.uninspected:
            self.inspect_poses(Poses.join(self.uninspected))
        self.uninspected, self.many, self.taken_in = [], 0, 0

    def inspect_poses(self, poses: Poses) -> None:
        """Update the inspection and the tests of clearance and impacts by poses, which are tracked
        elsewhere."""
        knowledge = self.filters.knowledge
        for first in range(0, len(poses) if knowledge else 0, BATCH_POSES):
            some = poses[first : first + BATCH_POSES]
            self.clearance = clearance.advance(self.clearance, knowledge, some)
            self.impacts = impacts.advance(self.impacts, knowledge, some)
        self.inspection = inspect(self.inspection, poses)

    def check_conventions(self, poses: Poses) -> None:
        """Update the test of conventions by poses, which may be tracked elsewhere."""
        grid = self.filters.grid
        if grid is None or grid.stream is None:
            return
        sigma = grid.stream.noise.sigma_position_m, grid.stream.noise.sigma_rotation_rad
        self.conventions = advance_conventions(
            self.conventions, grid.model, sigma, poses, has_odd_unit=self.inspection.units
        )

    def check_prior_map(self, poses: Poses) -> None:
        """Update the test of a contradiction to the prior map by poses, which are tracked elsewhere."""
        filters, best = self.filters, self.best
        if best is not None:
            self.contradiction = contradiction.advance(
                self.contradiction,
                best.model,
                filters.knowledge,
                poses,
                filters.is_decided,
                filters.rest.ticks_at_rest > 0,
                self.inspection.filtered,
            )

    @property
    def is_decided(self) -> bool:
        """Whether the choice of ticks and noise is final."""
        return self.filters.is_decided

    @property
    def best(self) -> FilterState | None:
        """The most probable filter; None before the rate of the stream is known."""
        return self.filters.best

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the stream."""
        in_stream = findings(self.inspection, self.conventions.fitting_units)
        fast = impacts.findings(self.impacts, self.filters.model.tick_s)
        mixed_up = convention_findings(self.conventions)
        if self.inspection.bodies or self.inspection.units:
            fast = mixed_up = ()
        return (
            *in_stream,
            *fast,
            *mixed_up,
            *(clearance.findings(self.clearance) or (() if fast else self._contradictions)),
        )

    @property
    def _contradictions(self) -> tuple[Finding, ...]:
        """A contradiction to the prior map, reported if no other finding explains it."""
        return contradiction.findings(self.contradiction, self.filters.knowledge)

    @property
    def is_in_doubt(self) -> bool:
        """Whether a finding makes labels unreliable."""
        return any(finding.doubts_labels for finding in self.findings)

    @property
    def may_be_in_doubt(self) -> bool:
        """The same, or it is not known yet: impacts may be shorter than a tick, and the prior map or the
        conventions of the poses may be wrong."""
        if self.contradiction.is_likely or self.conventions.is_likely:
            return True
        knowledge = self.filters.knowledge
        too_early = bool(knowledge.object and knowledge.environment) and not self.inspection.blocks
        may_be_short = self.filters.model.tick_s > impacts.LONGEST_TICK_S and (
            too_early or self.impacts.is_near
        )
        return self.is_in_doubt or may_be_short

    @property
    def outliers(self) -> int:
        """Poses left out of their ticks so far."""
        return self.filters.outliers

    @property
    def report(self) -> Report | None:
        """Report of the stream so far; None before its rate is known."""
        filters, best = self.filters, self.best
        if best is None or filters.grid is None or filters.grid.stream is None:
            return None
        found = (
            *self.findings,
            *clearance.final_findings(self.clearance, filters.knowledge),
            *map_findings(best.map),
        )
        frames = filters.filters[0].state.sliding_window.frames  # others may wait
        return report_of(filters.model, best.model, self.is_decided, filters.grid.stream.noise, frames, found)
