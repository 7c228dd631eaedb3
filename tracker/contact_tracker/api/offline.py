"""Segmentation of a whole trajectory."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from contact_tracker.adaptation.report import Report
from contact_tracker.api.arrays import moment_ns
from contact_tracker.api.dataframes import is_table
from contact_tracker.api.given import (
    Deviations,
    ModelLike,
    errors_as,
    model_from,
    number_from,
    path_from,
)
from contact_tracker.api.learned_map import Known, Map, map_of
from contact_tracker.api.notices import log_counts, log_text, warn_of
from contact_tracker.api.trajectory import Trajectory, read
from contact_tracker.config.parameters import Model
from contact_tracker.errors import NoTruth, OutputError, UnreadableRecording, UsageError, printable
from contact_tracker.exports.columns import (
    BELIEF_COLUMNS,
    SEGMENT_COLUMNS,
    Columns,
    belief_columns,
    segment_columns,
    to_pandas,
)
from contact_tracker.exports.formats import (
    SUFFIXES,
    format_of,
    require_library,
    write_outcome,
    write_pieces,
)
from contact_tracker.exports.outcome import Outcome
from contact_tracker.exports.replacement import check_output
from contact_tracker.exports.summary_html import counts_html, ribbon_html, table_html, warnings_html
from contact_tracker.extras import extra
from contact_tracker.ground_truth import Truth
from contact_tracker.map.map import Map as KnownMap
from contact_tracker.motion.poses import Pose
from contact_tracker.outputs.adaptation import noise_text, warnings
from contact_tracker.outputs.text import table
from contact_tracker.recording import WrenchLog, parts_of, read_labels, read_truth, read_wrenches
from contact_tracker.recording.wrenches import RecordedEvidence, evidence_of
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.tracking.belief import Detail, Segment
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.viewer.parts import Part, known_parts
from contact_tracker.wrenches.wrenches import Wrenches

if TYPE_CHECKING:
    import pandas

    from contact_tracker.exports import parquet
    from contact_tracker.exports.figure import Axes, Figure
    from contact_tracker.viewer.notebook import Viewer
    from contact_tracker.viewer.offline import Shown

Rows = Literal["ticks", "segments"]


@dataclass(frozen=True, eq=False)
class Result:
    """The segments of a trajectory and the belief of each tick.

    Parameters
    ----------
    trajectory : the poses.
    segmentation : segments and smoothed beliefs in columns.
    report : the tracker's adaptation.
    notes : warnings from before the first pose.
    with_wrenches : whether measured wrenches decided as well as the motion.
    map : what the contacts have touched, for ``known`` with the next recording; None where a map or
        wrenches are given, or if no contact is sure enough.
    parts : all that is known of the object and its surroundings, as figures, reports and the viewer draw it.
    """

    trajectory: Trajectory
    segmentation: Segmentation
    report: Report | None
    notes: tuple[str, ...] = ()
    with_wrenches: bool = False
    map: Map | None = None
    parts: tuple[Part, ...] = ()

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
        outliers = {"outlier": self.segmentation.outliers} if self.segmentation.outliers else {}
        return {**self.trajectory.counts, **outliers}

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line per warning, including those of the trajectory and damage of the recording."""
        damage = () if self.trajectory.damage is None else (self.trajectory.damage,)
        return (*damage, *self.trajectory.notes, *self._own_warnings)

    @property
    def _own_warnings(self) -> tuple[str, ...]:
        """One line per warning that the trajectory does not have."""
        return (*self.notes, *(() if self.report is None else warnings(self.report)))

    def at(self, time: Any) -> Segment:
        """The segment that holds at a time: seconds or a duration since the first pose, or a date; raises
        UsageError outside of the recording."""
        stamp_ns = moment_ns(time, self._origin_ns)
        found = next((one for one in self.segments if one.start_ns <= stamp_ns <= one.end_ns), None)
        if found is None:
            raise UsageError(f"no segment at {time}: there are {self.trajectory.duration_s:.2f} s of poses")
        return found

    def to_pandas(self, rows: Rows = "ticks") -> "pandas.DataFrame":
        """A DataFrame of pandas with a row per tick or per segment; raises MissingExtra.

        The columns are those of Parquet files (docs/conventions.md).
        """
        return to_pandas(*self._columns(rows))

    def to_arrow(self, rows: Rows = "ticks") -> "parquet.Table":
        """A table of Arrow, like ``to_pandas``; ``polars.from_arrow`` takes it."""
        from contact_tracker.exports.parquet import to_arrow

        return to_arrow(*self._columns(rows))

    def to_parquet(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write a Parquet file with a row per tick.

        Writing is atomic. A recording is replaced only with ``overwrite``.

        Raises
        ------
        UsageError
            The existing file is a recording, or an input of this result.
        OutputError
            The file cannot be written.
        """
        self._write(path, overwrite, ".parquet")

    def to_mcap(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write a copy of the recording with channels for Foxglove; raises as ``to_parquet`` does.

        For a trajectory that is not from a recording there are only frames, beliefs and scene.
        """
        self._write(path, overwrite, ".mcap")

    def to_html(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write a self-contained report; raises as ``to_parquet`` does."""
        self._write(path, overwrite, ".html")

    def to_rrd(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write a file of the rerun viewer, which shows what ``show`` does; raises as ``to_parquet`` does."""
        self._write(path, overwrite, ".rrd")

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the output selected by the suffix of ``path``, like ``segment -o``, or ``.rrd``."""
        self._write(path, overwrite, *SUFFIXES, ".rrd")

    def plot(
        self,
        ax: "Axes | None" = None,
        curves: bool = False,
        labels: str | os.PathLike[str] | None = None,
        meanings: Mapping[str, str] | None = None,
    ) -> "Figure":
        """A figure of matplotlib: segments and probabilities, drawn on ``ax`` if given, else with what is
        known of the object and its surroundings below them.

        ``curves`` are the minima of the paper's objective functions over windows of 500 poses (its Fig. 5).
        Your own ``labels`` (and their ``meanings``, as of ``evaluate``) are drawn instead of the truth in the
        recording.
        """
        from contact_tracker.exports.figure import Figure, draw_figure, draw_on

        truth, stamps = self._truth, self.trajectory.stamp_ns
        if labels is not None:
            truth, _ = read_labels(path_from(labels, "labels"), int(stamps[0]), int(stamps[-1]), meanings)
        if ax is not None:
            draw_on(ax, self.segmentation, self._origin_ns, truth)
            figure = ax.get_figure(root=True)
            assert isinstance(figure, Figure)
            return figure
        found = None
        if curves:
            from contact_tracker.paper import window_curves

            found = window_curves.curves(self.trajectory.poses)
        return draw_figure(self.segmentation, self._origin_ns, found, self.parts, truth)

    def show(self, width: int = 1280, height: int = 720) -> "Viewer":
        """The rerun viewer as a notebook's widget, ``width`` and ``height`` in pixels; raises MissingExtra.

        It shows what ``contact-tracker view`` does, without the truth.
        """
        with extra("notebook", "the viewer in a notebook"):
            from contact_tracker.viewer.notebook import show_in_notebook

        sizes = (("width", width), ("height", height))
        width, height = (
            int(number_from(pixels, name, "of pixels", lambda count: count >= 1.0)) for name, pixels in sizes
        )

        return show_in_notebook(self._shown, width, height)

    @property
    def _shown(self) -> "Shown":
        """What the rerun viewer shows."""
        from contact_tracker.viewer.offline import Shown

        def found(poses: Iterable[Pose]) -> Iterator[Segmentation]:
            deque(poses, maxlen=0)
            yield self.segmentation

        trajectory = self.trajectory
        return Shown(
            trajectory.poses, found, None, trajectory.vertices_m, True, trajectory.name, parts=self.parts
        )

    def __str__(self) -> str:
        banner = (f"warning: {printable(text)}" for text in self.warnings)
        return "\n".join((*banner, *table(self.segments, self._origin_ns, self.with_wrenches)))

    def __repr__(self) -> str:
        return f"<Result of {self.trajectory!r}: {len(self.segments)} segments, {len(self.beliefs)} ticks>"

    def _repr_html_(self) -> str:
        shown = ribbon_html(self.segments) + table_html(self.segments, self._origin_ns)
        return f"{warnings_html(self.warnings)}{shown}{counts_html(self.counts)}"

    @property
    def _truth(self) -> Truth | None:
        """That of the recording, if it can be read again."""
        path = self.trajectory.path
        if path is not None and os.path.exists(path):
            with suppress(NoTruth):  # nothing that is drawn needs it
                return read_truth(path)
        return None

    @property
    def _origin_ns(self) -> int:
        return int(self.trajectory.stamp_ns[0])

    def _columns(self, rows: str) -> tuple[Columns, Any]:
        if rows == "ticks":
            return belief_columns(self.beliefs), BELIEF_COLUMNS
        if rows == "segments":
            return segment_columns(self.segments), SEGMENT_COLUMNS
        raise UsageError(f"rows is 'ticks' or 'segments', not {rows!r}")

    def _write(self, name: str | os.PathLike[str], overwrite: bool, *suffixes: str) -> None:
        path, trajectory = Path(path_from(name)), self.trajectory
        with errors_as(OutputError, str(path)):
            self._write_file(path, trajectory, overwrite, *suffixes)

    def _write_file(self, path: Path, trajectory: Trajectory, overwrite: bool, *suffixes: str) -> None:
        if path.suffix.lower() not in suffixes:
            raise UsageError(f"cannot write {path}: its name must end in {' or '.join(suffixes)}")
        log = trajectory.path if trajectory.path is not None and os.path.exists(trajectory.path) else None
        check = check_output(path, overwrite, () if log is None else parts_of(log), "overwrite=True")
        if path.suffix.lower() == ".rrd":
            from contact_tracker.viewer.offline import write_rrd

            write_rrd(path, self._shown, check)
            return
        require_library(path)
        if format_of(path).rows != "whole":
            write_pieces([self.segmentation], path, lambda: self._origin_ns, check)
            return
        source = trajectory.source
        outcome = Outcome(
            trajectory.name,
            trajectory.poses,
            self.segmentation,
            self._origin_ns,
            self.counts,
            self.warnings,
            "" if self.report is None else noise_text(self.report),
            "" if source is None else source.frame_id,
            "" if source is None else source.child_frame_id,
            trajectory.vertices_m,
            self.parts,
            lambda: self._truth,
            log,
            trajectory.log_offset_ns,
        )
        write_outcome(outcome, path, check)


def segment(
    trajectory: Any,
    model: ModelLike = "default",
    known: Known = None,
    noise: Deviations = None,
    wrench: str | Wrenches | None = None,
    mass_kg: float | None = None,
    accuracy: Deviations = None,
    states: Iterable[str] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Result:
    """Segment a whole trajectory into contacts.

    Parameters
    ----------
    trajectory : a ``Trajectory``, the path of a recording, or a table as for ``Trajectory.from_dataframe``.
    model : the name of a shipped model, a TOML file, or a loaded model.
    known : a map: a TOML file (docs/map.md), a table of the same keys, or a ``Map``.
    noise : standard deviations of a pose per axis, if known: ``"0.3mm,0.15deg"``, or a pair in metres and
        radians.
    wrench : the wrench of the hand or robot on the object, which decides between contacts that motion cannot
        distinguish: the topic in the recording, or ``Wrenches`` about the body's origin and in its axes.
    mass_kg : of the object, if known; else estimated from free motion.
    accuracy : standard deviations of the systematic errors of poses, as of calibration, in the form of
        ``noise``. They do not show in the poses, and increase the deviations of elements.
    states : the contacts that can occur, such as ``["f-f", "e-f"]`` (default: all); free motion always can.
    progress : called with the number of poses that are done.

    Raises
    ------
    InputError
        The trajectory cannot be used.
    UsageError
        An argument, the model or the map is invalid.

    Warns
    -----
    ContactTrackerWarning
        What ``contact-tracker segment`` warns of, once for this result; ``Result.warnings`` has it all.
    """
    if mass_kg is not None:
        if wrench is None:
            raise UsageError("mass_kg is of use with wrench only")
        mass_kg = number_from(mass_kg, "mass_kg", "above zero", lambda kg: kg > 0.0)
    given = model_from(model, noise, accuracy)
    notes = list[str]()
    known_map = map_of(known, notes.append, states)
    poses = _trajectory_of(trajectory)
    evidence = None
    if wrench is not None:
        used = _evidence_of(wrench, poses, given, known_map, mass_kg)
        evidence = used.evidence
        notes += used.warnings
        if not used.is_warning:
            log_text(used.text)
    tracker = OfflineTracker(given, known_map, wrenches=evidence, read_as=poses.read_as)
    found = Segmentation.join(list(tracker.pieces(poses, progress, Detail.WEIGHTS)))
    world = tracker.map
    learned = None if world is None else world.learned
    touched = Map(learned) if learned else None
    parts = known_parts(world, poses.poses, found.segments, known_map, poses.vertices_m)
    result = Result(poses, found, tracker.report, tuple(notes), evidence is not None, touched, parts)
    warn_of(result._own_warnings)
    log_counts(poses.name, {kind: count for kind, count in result.counts.items() if kind == "outlier"})
    return result


def _evidence_of(
    given: str | Wrenches, trajectory: Trajectory, model: Model, known_map: KnownMap, mass_kg: float | None
) -> RecordedEvidence:
    if isinstance(given, Wrenches):
        valid = given.valid
        found = WrenchLog(valid, len(given) - len(valid), 0, 0, "", "as given", None)
        return evidence_of(found, "the wrench", trajectory.poses, model, known_map, mass_kg)
    if not isinstance(given, str):
        raise UsageError(f"wrench is a topic or contact_tracker.Wrenches, not {type(given).__name__}")
    if trajectory.path is None or trajectory.source is None:
        raise UsageError(
            "wrench is a topic, but this trajectory is not from a recording that can be read again"
        )
    path, poses = trajectory.path, trajectory.poses
    with errors_as(UnreadableRecording, path):
        found = read_wrenches(path, given, trajectory.source, poses, trajectory.by_log_time)
    return evidence_of(found, given, poses, model, known_map, mass_kg)


def _trajectory_of(given: Any) -> Trajectory:
    if isinstance(given, Trajectory):
        return given
    if isinstance(given, str | os.PathLike):
        return read(given)
    if is_table(given):
        return Trajectory.from_dataframe(given)
    raise UsageError(
        f"a trajectory is a Trajectory, the path of a recording or a DataFrame, not {type(given).__name__}"
    )
