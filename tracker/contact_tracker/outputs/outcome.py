"""A recording with its segmentation, from which the command line and Python make all outputs."""

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from contact_tracker.errors import NoTruth, UnreadableRecording
from contact_tracker.ground_truth import Truth
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.losses import counts_text
from contact_tracker.outputs.adaptation import noise_text, warnings
from contact_tracker.recording import read_truth
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.filter_bank import Report
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Outcome:
    """The segments of a trajectory and the belief of each tick.

    Parameters
    ----------
    trajectory : the poses.
    segmentation : segments and smoothed beliefs in columns.
    report : the tracker's adaptation; None without poses.
    notes : warnings from before the first pose.
    with_wrenches : whether measured wrenches were evidence, besides the motion.
    known_map : the prior knowledge of the object and its surroundings.
    touched : map of the touched elements, for drawings.
    labels : the user's labels, shown instead of the truth in the recording.
    """

    trajectory: Trajectory
    segmentation: Segmentation
    report: Report | None = None
    notes: tuple[str, ...] = ()
    with_wrenches: bool = False
    known_map: Map = EMPTY_MAP
    touched: GrowingMap | None = None
    labels: Truth | None = None

    @property
    def learned_world(self) -> GrowingMap | None:
        """Map of the touched elements, estimated from the motion alone; None if elements or wrenches were
        given."""
        return None if self.known_map.lists_elements or self.with_wrenches else self.touched

    @property
    def segments(self) -> tuple[Segment, ...]:
        """The segments in order of time, with one label each; they cover all ticks."""
        return self.segmentation.segments

    @property
    def beliefs(self) -> Beliefs:
        """One belief per tick, with the label of its segment and smoothed probabilities."""
        return self.segmentation.beliefs

    @property
    def counts(self) -> Mapping[str, int]:
        """Numbers of dropped and repaired poses, by kind (docs/conventions.md)."""
        outliers = self.segmentation.outliers.total
        return {**self.trajectory.counts, **({"outlier": outliers} if outliers else {})}

    @property
    def noted(self) -> str:
        """``counts`` in words, with the times of the first outliers."""
        return counts_text(self.counts, self.segmentation.outliers, self.origin_ns)

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line per warning, including those of the trajectory and damage of the recording."""
        damage = () if self.trajectory.damage is None else (self.trajectory.damage,)
        return (*damage, *self.trajectory.notes, *self.own_warnings)

    @property
    def own_warnings(self) -> tuple[str, ...]:
        """One line per warning of the segmentation, without those of the trajectory."""
        return (*self.notes, *warnings(self.report))

    @property
    def doubts(self) -> tuple[str, ...]:
        """One line per warning that makes all labels doubtful."""
        findings = () if self.report is None else self.report.findings
        return tuple(finding.text for finding in findings if finding.doubts_labels)

    @property
    def noise(self) -> str:
        """The noise to which the tracker has adapted, in words; empty if unknown."""
        return "" if self.report is None else noise_text(self.report)

    @property
    def origin_ns(self) -> int:
        """Stamp from which displayed times count."""
        origin_ns = self.trajectory.origin_ns
        return int(self.trajectory.stamp_ns[0]) if origin_ns is None else origin_ns

    @property
    def log(self) -> str | None:
        """The recording, if it can be read again."""
        path = self.trajectory.path
        return path if path is not None and os.path.exists(path) else None

    @property
    def truth(self) -> Truth | None:
        """The ``labels``, or the truth of the recording, if it can be read again."""
        if self.labels is None and self.log is not None:
            with suppress(NoTruth, UnreadableRecording):  # nothing that is drawn needs it
                return read_truth(self.log)
        return self.labels
