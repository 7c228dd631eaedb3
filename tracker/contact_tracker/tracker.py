"""The online tracker of one stream of poses; it adapts to the stream and checks it for mistakes."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final, Self

from contact_tracker.checks.check import Stream
from contact_tracker.checks.checks import INSPECTED, Checks
from contact_tracker.config.parameters import Model
from contact_tracker.inspection.stream_checks import NOTHING_INSPECTED, Finding, Inspection, inspect
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.free_motion import kalman_prediction
from contact_tracker.motion.pose_validation import Arrival, require_valid
from contact_tracker.motion.poses import AS_GIVEN, Outliers, Pose, Poses, ReadAs
from contact_tracker.tracking.belief import Belief, Detail, Segment
from contact_tracker.tracking.filter_bank import FilterBank, Report, mixed_with_uniform, report_of
from contact_tracker.tracking.state import FilterState

BATCH_POSES: Final = 50
"""Number of poses that are inspected together."""


@dataclass(eq=False)
class Tracker:
    """Online tracker of one object: chooses the noise by evidence and checks the stream for mistakes.

    Its size in memory is bounded, however long the stream.

    Parameters
    ----------
    filters : of different noise, side by side.
    inspection : of the poses.
    checks : of the stream and of the map.
    uninspected : the latest ``many`` poses; the filters have the first ``taken_in`` elements of this list and
        get the others at the end of the tick.
    last_ns : stamp of the last pose.
    late : number of poses left out because their tick was closed, see ``update``.
    """

    filters: FilterBank
    inspection: Inspection
    checks: Checks = field(default_factory=Checks)
    uninspected: list[Pose | Poses] = field(default_factory=list)
    many: int = 0
    taken_in: int = 0
    last_ns: int | None = None
    late: int = 0

    def __post_init__(self) -> None:
        self._doubt = self.may_be_in_doubt

    @classmethod
    def start(
        cls, model: Model, lag_s: float = 0.0, known_map: Map = EMPTY_MAP, read_as: ReadAs = AS_GIVEN
    ) -> Self:
        """The tracker before the first pose.

        Parameters
        ----------
        lag_s : fixed lag in seconds; beliefs come later by it and are more accurate.
        read_as : units and conventions in which the poses were read.
        """
        kalman_prediction()  # loaded here, so that no call of ``update`` waits for it
        return cls(FilterBank(model, lag_s, known_map), NOTHING_INSPECTED._replace(read_as=read_as))

    def update(self, arrival: Arrival, detail: Detail = Detail.FORMATION) -> list[Belief]:
        """Update by an arrival (``PoseGate.arrive``); returns the beliefs of the ticks that it closes.

        A tick is complete once the gate expects no more poses of it. Poses that come more than a tick after
        their own was closed are left out and counted.
        """
        beliefs = list[Belief]()
        for pose in arrival.poses:
            grid = self.filters.grid
            if grid is not None and grid.is_late(pose.stamp_ns):
                self.late += 1
            else:
                beliefs += self._add_valid(pose, detail)
        grid, next_ns = self.filters.grid, arrival.next_ns
        if next_ns is not None and (grid is None or not grid.goes_on(next_ns)):  # the tick is complete
            beliefs += self._update_filters(detail, next_ns)
        return beliefs

    def finish(self) -> list[Belief]:
        """End of the stream: the beliefs of the last, partial tick and of the ticks within the lag.

        The stream may go on afterwards, as after a gap.
        """
        beliefs = self._update_filters(Detail.FORMATION)
        self.inspect_added()
        last = self.filters.finish()
        self.checks = self.checks.finish()
        self._doubt = self.may_be_in_doubt
        return [*beliefs, *self._in_doubt(last)]

    def add(self, poses: Pose | Poses, detail: Detail = Detail.FORMATION) -> list[Belief]:
        """Update by one pose or several, in order; returns the beliefs of the ticks that they close.

        While the poses may be in doubt, probabilities are mixed with uniform ones. ``BATCH_POSES`` poses are
        inspected at the arrival of the next pose, which seldom closes a tick as well.

        Raises
        ------
        InvalidPose
            Poses did not pass the gate, or are earlier than the last pose.
        """
        if isinstance(poses, Pose):
            require_valid(Poses.collect([poses]), self.last_ns)
            return self._add_valid(poses, detail)
        beliefs = list[Belief]()
        if len(poses):
            require_valid(poses, self.last_ns)
        while len(poses):
            if self.many >= BATCH_POSES:
                self.inspect_added()
            room = BATCH_POSES - self.many
            part, poses = poses[:room], poses[room:]
            self.last_ns = int(part.stamp_ns[-1])
            self.uninspected.append(part)
            self.many += len(part)
            beliefs += self._update_filters(detail)
        return beliefs

    def _add_valid(self, pose: Pose, detail: Detail) -> list[Belief]:
        """``add`` for one pose that has passed the gate."""
        if self.many >= BATCH_POSES:
            self.inspect_added()
        self.last_ns = pose.stamp_ns
        self.uninspected.append(pose)
        self.many += 1
        if self.many < BATCH_POSES and self.filters.waits(pose.stamp_ns):  # most poses
            return []
        return self._update_filters(detail)

    def _update_filters(self, detail: Detail, until_ns: int | None = None) -> list[Belief]:
        """Update the filters and the checks by the poses since their last update, and close the ticks that
        end before ``until_ns``; returns the beliefs of closed ticks."""
        filters, checks, beliefs = self.filters.copied(), self.checks, list[Belief]()
        is_settled = checks.contradiction.is_settled
        if self.taken_in < len(self.uninspected):
            poses = Poses.join(self.uninspected[self.taken_in :])
            beliefs += filters.add(poses, detail)
            if not is_settled:
                checks = checks.update(poses, self._stream(filters), "contradiction")
        if until_ns is not None:
            beliefs += filters.pass_time(until_ns, detail)
        self.filters, self.checks = filters, checks  # together, so that an interrupted call changes nothing
        self.taken_in = len(self.uninspected)
        if not is_settled:
            self._doubt = self.may_be_in_doubt
        return self._in_doubt(beliefs)

    def _in_doubt(self, beliefs: list[Belief]) -> list[Belief]:
        """The beliefs, mixed with uniform ones while the stream may be in doubt."""
        if not self._doubt:
            return beliefs
        possible = self.filters.known_map.allowed
        return [replace(b, probability=mixed_with_uniform(b.probability, possible)) for b in beliefs]

    def inspect_added(self) -> None:
        """Inspect the added poses, all of which the filters have, if there are any."""
        if self.many:
            poses = Poses.join(self.uninspected)
            self.inspect_poses(poses)
            self.check("conventions", poses)
            self.uninspected, self.many, self.taken_in = [], 0, 0
            self._doubt = self.may_be_in_doubt

    def inspect_poses(self, poses: Poses) -> None:
        """Update the inspection and the checks of poses (``INSPECTED``), but not the filters."""
        if self.filters.known_map.lists_elements:
            stream = self.stream
            for start in range(0, len(poses), BATCH_POSES):
                self.checks = self.checks.update(poses[start : start + BATCH_POSES], stream, *INSPECTED)
        self.inspection = inspect(self.inspection, poses)

    def check(self, name: str, poses: Poses) -> None:
        """Update the check ``name`` by poses, but not the filters."""
        self.checks = self.checks.update(poses, self.stream, name)

    def check_segments(self, segments: Iterable[Segment]) -> None:
        """Update the checks by the next segments."""
        self.checks = self.checks.update_segments(segments, self.stream)

    @property
    def stream(self) -> Stream:
        """State of the stream that the checks read."""
        return self._stream(self.filters)

    def _stream(self, filters: FilterBank) -> Stream:
        best, grid, sigma = filters.best, filters.grid, None
        if grid is not None and grid.stream is not None:
            noise = grid.stream.noise
            sigma = noise.sigma_at(-filters.body_m), noise.sigma_rotation_rad
        return Stream(
            filters.known_map,
            filters.model,
            None if grid is None else grid.model,
            None if best is None else best.model,
            sigma,
            filters.body_m,
            filters.is_decided,
            filters.motion.is_at_rest,
            self.inspection,
        )

    @property
    def is_decided(self) -> bool:
        """Whether the choice of ticks and noise is final."""
        return self.filters.is_decided

    @property
    def best(self) -> FilterState | None:
        """The most probable filter; None before the second pose."""
        return self.filters.best

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the stream so far."""
        return self.checks.findings(self.stream)

    @property
    def is_in_doubt(self) -> bool:
        """Whether a finding makes labels unreliable."""
        return any(finding.doubts_labels for finding in self.findings)

    @property
    def may_be_in_doubt(self) -> bool:
        """Whether labels are unreliable or may prove so: impacts may be shorter than a tick, and the map or
        the conventions of the poses may be wrong."""
        stream = self.stream
        return self.checks.is_likely(stream) or any(f.doubts_labels for f in self.checks.findings(stream))

    @property
    def suspicions(self) -> tuple[str, ...]:
        """Likely mistakes, not yet confirmed, because of which no label is certain."""
        suspects = self._doubt and not self.is_in_doubt
        return self.checks.suspicions(self.stream) if suspects else ()

    @property
    def outliers(self) -> Outliers:
        """Numbers of poses left out of their ticks so far."""
        return self.filters.outliers

    @property
    def report(self) -> Report | None:
        """Report of the stream that ends here; None before the second pose."""
        return self._report(is_end=True)

    @property
    def report_so_far(self) -> Report | None:
        """Report of a stream that has not ended, without findings that need its end."""
        return self._report()

    @property
    def report_of_part(self) -> Report | None:
        """Report of a stream that goes on, but is not read further."""
        report = self._report(is_cut_short=True)
        return None if report is None else report._replace(is_cut_short=True)

    def _report(self, is_end: bool = False, is_cut_short: bool = False) -> Report | None:
        findings = self.checks.findings(self.stream._replace(is_end=is_end, is_cut_short=is_cut_short))
        return report_of(self.filters, self.is_decided, findings)
