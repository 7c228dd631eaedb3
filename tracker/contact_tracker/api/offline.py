"""Segmentation of a whole trajectory."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from contact_tracker.adaptation import OfflineTracker, Report
from contact_tracker.adaptation.with_wrenches import NoLoad, mass_doubt, wrench_evidence
from contact_tracker.api.given import Deviations, Known, ModelLike, knowledge_of, model_from
from contact_tracker.api.trajectory import Trajectory, read
from contact_tracker.errors import UsageError
from contact_tracker.exports.columns import (
    BELIEF_COLUMNS,
    SEGMENT_COLUMNS,
    Columns,
    belief_columns,
    segment_columns,
)
from contact_tracker.exports.outcome import Outcome
from contact_tracker.exports.replacement import check_output
from contact_tracker.exports.suffixes import SUFFIXES, WHOLE, require_library
from contact_tracker.exports.summary_html import notes_html, ribbon_html, table_html
from contact_tracker.exports.writing import write_outcome, write_pieces
from contact_tracker.extras import extra
from contact_tracker.motion.poses import Pose
from contact_tracker.outputs.adaptation import noise_text, warnings
from contact_tracker.outputs.text import table
from contact_tracker.recording import parts_of, read_wrenches
from contact_tracker.tracking.belief import Detail, Segment
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.wrenches.wrenches import Wrenches

if TYPE_CHECKING:
    from contact_tracker.exports import pandas_table, polars_table
    from contact_tracker.exports.figure import Figure
    from contact_tracker.viewer.notebook import Viewer

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
    """

    trajectory: Trajectory
    segmentation: Segmentation
    report: Report | None
    notes: tuple[str, ...] = ()
    with_wrenches: bool = False

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
        """One line per warning, including damage of the recording."""
        damage = self.trajectory.damage
        found = () if self.report is None else tuple(warnings(self.report))
        return (*(() if damage is None else (damage,)), *self.notes, *self.trajectory.notes, *found)

    def to_pandas(self, rows: Rows = "ticks") -> "pandas_table.DataFrame":
        """A DataFrame of pandas with a row per tick or per segment; raises MissingExtra.

        The columns are those of Parquet files (docs/conventions.md).
        """
        with extra("pandas", "a DataFrame of pandas"):
            from contact_tracker.exports.pandas_table import to_pandas

        return to_pandas(*self._columns(rows))

    def to_polars(self, rows: Rows = "ticks") -> "polars_table.DataFrame":
        """A DataFrame of polars, like ``to_pandas``."""
        with extra("tables", "a DataFrame of polars"):
            from contact_tracker.exports.polars_table import to_polars

        return to_polars(*self._columns(rows))

    def to_parquet(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write a Parquet file with a row per tick.

        Writing is atomic. A recording is replaced only with ``overwrite``.

        Raises
        ------
        MissingExtra
            pyarrow is not installed.
        UsageError
            The existing file is a recording, or an input of this result.
        OSError
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

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the output selected by the suffix of ``path``, like ``segment -o``."""
        self._write(path, overwrite, *SUFFIXES)

    def plot(self, curves: bool = True) -> "Figure":
        """A figure of matplotlib: labels, posteriors, and the paper's curves; raises MissingExtra.

        ``curves`` are the minima of the paper's objective functions over windows of 500 poses (its Fig. 5).
        """
        with extra("plot", "a figure"):
            from contact_tracker.exports.figure import draw_figure
        found = None
        if curves:
            from contact_tracker.paper import window_curves

            found = window_curves.curves(self.trajectory.poses)
        return draw_figure(self.segmentation, self._origin_ns, found)

    def show(self, width: int = 1280, height: int = 720) -> "Viewer":
        """The rerun viewer as a notebook's widget, ``width`` and ``height`` in pixels; raises MissingExtra.

        It shows what ``contact-tracker view`` does, without the truth.
        """
        with extra("notebook", "the viewer in a notebook"):
            from contact_tracker.viewer.notebook import show_in_notebook
        from contact_tracker.viewer.offline import Shown

        def found(poses: Iterable[Pose]) -> Iterator[Segmentation]:
            deque(poses, maxlen=0)
            yield self.segmentation

        trajectory = self.trajectory
        shown = Shown(trajectory.poses, found, None, trajectory.vertices_m, True, trajectory.name)
        return show_in_notebook(shown, width, height)

    def __str__(self) -> str:
        return "\n".join(table(self.segments, self._origin_ns, self.with_wrenches))

    def __repr__(self) -> str:
        return f"<Result of {self.trajectory!r}: {len(self.segments)} segments, {len(self.beliefs)} ticks>"

    def _repr_html_(self) -> str:
        notes = notes_html(self.counts, self.warnings)
        return f"{ribbon_html(self.segments)}{table_html(self.segments, self._origin_ns)}{notes}"

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
        path, trajectory = Path(name), self.trajectory
        if path.suffix.lower() not in suffixes:
            raise UsageError(f"cannot write {path}: its name must end in {' or '.join(suffixes)}")
        log = trajectory.path if trajectory.path is not None and os.path.exists(trajectory.path) else None
        check = check_output(path, overwrite, () if log is None else parts_of(log), "overwrite=True")
        require_library(path)
        if path.suffix.lower() not in WHOLE:
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
        )
        write_outcome(outcome, path, log, trajectory.log_offset_ns, check)


def segment(
    trajectory: Any,
    model: ModelLike = "default",
    known: Known = None,
    noise: Deviations = None,
    wrench: str | Wrenches | None = None,
    mass_kg: float | None = None,
    accuracy: Deviations = None,
) -> Result:
    """Segment a whole trajectory into contacts.

    Parameters
    ----------
    trajectory : a ``Trajectory``, the path of a recording, or a table as for ``Trajectory.from_dataframe``.
    model : the name of a shipped model, a TOML file, or a loaded model.
    known : a TOML file of prior knowledge (docs/knowledge.md), or a table of the same keys.
    noise : standard deviations of a pose per axis, if known: ``"0.3mm,0.15deg"``, or a pair in metres and
        radians.
    wrench : the wrench of the hand or robot on the object, which decides between contacts that motion cannot
        distinguish: the topic in the recording, or ``Wrenches`` about the body's origin and in its axes.
    mass_kg : of the object, if known; else estimated from free motion.
    accuracy : standard deviations of the systematic errors of poses, as of calibration, in the form of
        ``noise``. They do not show in the poses, and increase the deviations of elements.

    Raises
    ------
    InputError
        The trajectory cannot be used.
    UsageError
        An argument, the model or the prior knowledge is invalid.
    """
    given = model_from(model, noise, accuracy)
    notes = list[str]()
    knowledge = knowledge_of(known, notes.append)
    poses = _trajectory_of(trajectory)
    evidence = None
    if wrench is not None:
        measured = _wrenches_of(wrench, poses, notes.append)
        try:
            evidence, load = wrench_evidence(poses.poses, measured, given, knowledge, mass_kg)
            notes.extend(filter(None, [mass_doubt(load, mass_kg)]))
        except NoLoad as reason:
            notes.append(f"the wrench is not used: {reason}")
    frame_moves = poses.source is not None and poses.source.frame_moves
    tracker = OfflineTracker(given, knowledge, wrenches=evidence, frame_moves=frame_moves)
    found = Segmentation.join(list(tracker.pieces(poses, None, Detail.WEIGHTS)))
    return Result(poses, found, tracker.report, tuple(notes), evidence is not None)


def _wrenches_of(given: str | Wrenches, trajectory: Trajectory, note: Callable[[str], None]) -> Wrenches:
    if isinstance(given, Wrenches):
        return given
    if trajectory.path is None or trajectory.source is None:
        raise UsageError(
            "wrench is a topic, but this trajectory is not from a recording that can be read again"
        )
    found = read_wrenches(trajectory.path, given, trajectory.source, trajectory.poses, trajectory.by_log_time)
    if found.noted:
        note(f"of the messages on {given}: {found.noted}")
    return found.wrenches


def _trajectory_of(given: Any) -> Trajectory:
    if isinstance(given, Trajectory):
        return given
    if isinstance(given, str | os.PathLike):
        return read(given)
    if hasattr(given, "columns") or isinstance(given, Mapping):
        return Trajectory.from_dataframe(given)
    raise UsageError(
        f"a trajectory is a Trajectory, the path of a recording or a DataFrame, not {type(given).__name__}"
    )
