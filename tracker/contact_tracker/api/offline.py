"""Segmentation of a whole trajectory, and comparison of two takes of one task."""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from contact_tracker.api.learned_map import Known, Map, map_of
from contact_tracker.config.parameters import Model
from contact_tracker.contacts.task_frame import T_world_body, TaskFrame, task_frame
from contact_tracker.errors import (
    OutputError,
    StateError,
    UnreadableRecording,
    UsageError,
    extra,
    printable,
    shown,
)
from contact_tracker.exports import formats
from contact_tracker.exports.columns import COLUMNS, Columns, Kind, Rows, columns_of, to_pandas
from contact_tracker.exports.formats import FIGURES, ROWS, SUFFIXES
from contact_tracker.ground_truth import Truth
from contact_tracker.map.map import Map as KnownMap
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.parts import KnownParts, Part, known_parts
from contact_tracker.outputs.text import counted, table
from contact_tracker.recording import parts_of, read_labels, read_wrenches
from contact_tracker.segmenting import RecordedEvidence, evidence_as_given, evidence_of, segmented
from contact_tracker.sequences import comparison
from contact_tracker.sequences.comparison import TOLERANCE, compare_outcomes
from contact_tracker.sequences.graph import ContactGraph
from contact_tracker.sequences.plan import Plan
from contact_tracker.tracking.belief import Segment
from contact_tracker.trajectory import Trajectory, read
from contact_tracker.trajectory.arguments import (
    Deviations,
    ModelLike,
    errors_as,
    log_counts,
    log_text,
    model_from,
    number_from,
    path_from,
    python_words,
    warn_of,
    with_known_arguments,
    with_known_arguments_of_methods,
)
from contact_tracker.trajectory.arrays import cells_of, is_table, moment_ns
from contact_tracker.wrenches.wrenches import Wrenches

if TYPE_CHECKING:
    import pandas

    from contact_tracker.exports import parquet
    from contact_tracker.exports.figure import Axes, Figure
    from contact_tracker.viewer.views import Viewer


Progress = Callable[[int], None]
Labels = str | os.PathLike[str] | Any
"""The user's labels: a file, or a table with named columns, as a DataFrame."""


@with_known_arguments_of_methods
class Result(Outcome):
    """The segments of a trajectory and the belief of each tick, with their outputs.

    ``trajectory`` has the poses, ``segmentation`` the segments and smoothed beliefs in columns, ``report``
    the tracker's adaptation; ``with_wrenches``: measured wrenches were evidence, besides the motion.
    """

    @property
    def map(self) -> Map | None:
        """The touched elements, for ``known`` with a further recording; None if elements or wrenches were
        given, or if no contact is sure enough."""
        learned = KnownParts.of(self).learned(self.learned_world)
        return Map(learned=learned) if learned else None

    @property
    def parts(self) -> tuple[Part, ...]:
        """The known parts of the object and its surroundings, as all outputs draw them."""
        return known_parts(self)

    def at(self, time: Any) -> Segment:
        """The segment at a time: seconds or a duration since the first pose, or a date; raises UsageError
        outside of the recording."""
        stamp_ns = moment_ns(time, self.origin_ns)
        for segment in self.segments:
            if segment.start_ns <= stamp_ns <= segment.end_ns:
                return segment
        raise UsageError(f"no segment at {time}: there are {self.trajectory.duration_s:.2f} s of poses")

    def task_frames(self, time: Any) -> list[TaskFrame]:
        """The task frames of the contacts at a time (as in ``at``), for hybrid control of force and motion:
        that of the joint in which the object moves, if any, then one per contact with known elements, the
        labelled contact first."""
        segment, stamps_ns = self.at(time), self.trajectory.stamp_ns
        stamp_ns = moment_ns(time, self.origin_ns)
        part = next(part for part in segment.parts if part.start_ns <= stamp_ns <= part.end_ns)
        contacts = [
            (segment.contact, segment.geometry),
            *((contact.contact, contact.geometry) for contact in part.further),
        ]
        row = int(np.abs(stamps_ns - stamp_ns).argmin())
        pose = T_world_body(self.trajectory.position_m[row], self.trajectory.quat_xyzw[row])
        joint = None if segment.joint is None else segment.joint.task_frame
        frames = (task_frame(contact, pair, pose) for contact, pair in contacts if pair is not None)
        return [frame for frame in (joint, *frames) if frame is not None]

    @property
    def graph(self) -> ContactGraph:
        """The graph of the contacts that occur, with their elements, and of the transitions between them."""
        return ContactGraph.of(self)

    @property
    def plan(self) -> Plan:
        """The recording as a plan, for ``PlanFollower`` and ``live --expect``."""
        return Plan.of(self)

    def plot_graph(self) -> "Figure":
        """A figure of matplotlib with the graph of contacts."""
        from contact_tracker.exports.sequence_figures import draw_graph

        return draw_graph(self.graph)

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

        Writing is atomic. A recording, or labels, are replaced only with ``overwrite``.

        Raises
        ------
        UsageError : the existing file is a recording, or an input of this result.
        OutputError : the file cannot be written.
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
        """Write a file for the rerun viewer with the content of ``show``; raises as ``to_parquet`` does."""
        self._write(path, overwrite, ".rrd")

    def save(self, path: str | os.PathLike[str], overwrite: bool = False, rows: Rows | None = None) -> None:
        """Write the output selected by the suffix of ``path``, like ``segment -o``, or ``.rrd``.

        CSV, JSON lines and Parquet have an entry per tick or per segment (``rows``); by default CSV per
        segment, the others per tick. A file ``.contacts`` has the complete result, for ``load``.
        """
        self._write(path, overwrite, *SUFFIXES, ".rrd", rows=rows)

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line per warning about the recording or the labels."""
        return tuple(map(python_words, super().warnings))

    @property
    def doubts(self) -> tuple[str, ...]:
        """One line per warning that makes all labels doubtful."""
        return tuple(map(python_words, super().doubts))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Load a result from a file ``.contacts`` of ``save``. No code in the file is run.

        Raises
        ------
        StateError : the file cannot be read, is no result, is damaged, or was saved by a version whose
            results have other parts.
        """
        from contact_tracker.saved_result import read_result

        name = path_from(path)
        with errors_as(StateError, name):
            return cls(**vars(read_result(Path(name))))

    def plot(
        self,
        ax: "Axes | None" = None,
        curves: bool = False,
        labels: Labels | None = None,
        meanings: Mapping[str, str] | None = None,
    ) -> "Figure":
        """A figure of matplotlib: segments and probabilities, drawn on ``ax`` if given, else with the known
        parts of the object and its surroundings below them.

        ``curves`` are the minima of the paper's objective functions over windows of 500 poses (its Fig. 5).
        Your own ``labels`` (and their ``meanings``, as in ``evaluate``) are drawn instead of the truth in the
        recording.
        """
        from contact_tracker.exports.figure import Axes, Figure, draw_figure, draw_on

        outcome = self
        if labels is not None:
            outcome = replace(self, labels=self.truth_by(labels, meanings))
        if ax is not None:
            if not isinstance(ax, Axes):
                raise UsageError(f"ax are axes of matplotlib, not {type(ax).__name__}")
            draw_on(ax, outcome)
            figure = ax.get_figure(root=True)
            assert isinstance(figure, Figure)
            return figure
        return draw_figure(outcome, curves)

    def truth_by(self, labels: Labels, meanings: Mapping[str, str] | None) -> Truth:
        """Your own labels as truth of the recording; parameters and errors as in ``evaluate``."""
        given: Any = {} if meanings is None else meanings
        if not isinstance(given, Mapping) or not all(isinstance(text, str) for text in chain(*given.items())):
            raise UsageError(f"meanings are states by label, as {{'touch': 'any'}}, not {shown(meanings)}")
        table = cells_of(labels) if is_table(labels) else path_from(labels, "labels")
        stamps = self.trajectory.stamp_ns
        return read_labels(table, int(stamps[0]), int(stamps[-1]), meanings)[0]

    def show(self, width: int = 1280, height: int = 720) -> "Viewer":
        """The rerun viewer of ``contact-tracker view`` as a notebook's widget, ``width`` and ``height`` in
        pixels; raises MissingExtra."""
        sizes = (("width", width), ("height", height))
        width, height = (
            int(number_from(pixels, name, "of pixels", lambda count: count >= 1.0)) for name, pixels in sizes
        )
        with extra("notebook", "the viewer in a notebook"):
            from contact_tracker.viewer.views import show_in_notebook

            return show_in_notebook(self, width, height)

    def __str__(self) -> str:
        banner = (f"warning: {printable(text)}" for text in self.warnings)
        return "\n".join((*banner, *table(self.segments, self.origin_ns, self.with_wrenches)))

    def __repr__(self) -> str:
        counts = counted(len(self.segments), "segment"), counted(len(self.beliefs), "tick")
        return f"<Result of {self.trajectory!r}: {', '.join(counts)}>"

    def _repr_html_(self) -> str:
        from contact_tracker.exports.report_html import summary_html

        return summary_html(self)

    def _columns(self, rows: Rows) -> tuple[Columns, dict[str, Kind]]:
        if not isinstance(rows, str) or rows not in ROWS:
            raise UsageError(f"rows are {' or '.join(map(repr, ROWS))}, not {shown(rows)}")
        return columns_of(rows, self.beliefs if rows == "ticks" else self.segments), COLUMNS[rows]

    def _write(
        self, name: str | os.PathLike[str], overwrite: bool, *suffixes: str, rows: Rows | None = None
    ) -> None:
        path = Path(path_from(name))
        with errors_as(OutputError, str(path)):
            if path.suffix.lower() not in suffixes:
                raise UsageError(f"cannot write {path}: its name must end in {' or '.join(suffixes)}")
            formats.rows_of(path, rows)
            read = () if self.log is None else parts_of(self.log)
            check = formats.check_output(path, overwrite, read, "overwrite=True")
            formats.require_library(path)
            formats.write_outcome(self, path, rows, check)


@with_known_arguments
def segment(
    trajectory: Any,
    model: ModelLike = "default",
    known: Known = None,
    noise: Deviations = None,
    wrench: str | Wrenches | None = None,
    accuracy: Deviations = None,
    states: Iterable[str] | None = None,
    progress: Progress | bool | None = None,
) -> Result:
    """Segment a whole trajectory into contacts.

    Parameters
    ----------
    trajectory : a ``Trajectory``, the path of a recording, or a table as for ``Trajectory.from_dataframe``.
    model : the name of a shipped model, a TOML file, or a loaded model.
    known : the map: a TOML file (docs/map.md), a table of the same keys, or a ``Map``.
    noise : standard deviations of a pose per axis, if known: ``"0.3mm,0.15deg"``, or a pair in metres and
        radians.
    wrench : the wrench of the hand or robot on the object, which decides between contacts that motion cannot
        distinguish: the topic in the recording, or ``Wrenches`` about the body's origin and in its axes.
    accuracy : standard deviations of the systematic errors of poses, as of calibration, in the form of
        ``noise``. They cannot be estimated from the poses, and increase the deviations of elements.
    states : the contacts that can occur, as ``["f-f", "e-f"]`` (default: all); free motion always can.
    progress : called with the number of processed poses; True shows a bar on stderr.

    Raises
    ------
    InputError : the trajectory cannot be used.
    UsageError : an argument, the model or the map is invalid.

    Warns
    -----
    ContactTrackerWarning : the warnings of ``contact-tracker segment``, once for this result;
        ``Result.warnings`` has them all.
    """
    if not (progress is None or isinstance(progress, bool) or callable(progress)):
        raise UsageError(
            f"progress is True, or a function that takes the number of poses, not {shown(progress)}"
        )
    parameters = model_from(model, noise, accuracy)
    notes = list[str]()
    known_map = map_of(known, notes.append, states)
    if isinstance(trajectory, Trajectory):
        poses = trajectory
    elif isinstance(trajectory, str | os.PathLike):
        poses = read(trajectory)
    elif is_table(trajectory):
        poses = Trajectory.from_dataframe(trajectory)
    else:
        raise UsageError(
            "a trajectory is a Trajectory, the path of a recording or a DataFrame, not "
            f"{type(trajectory).__name__}: of arrays take Trajectory.from_arrays"
        )
    evidence = None
    if wrench is not None:
        evidence, load, warnings = _evidence_of(wrench, poses, parameters, known_map)
        notes += warnings
        if load:
            log_text(load)
    from tqdm import tqdm

    with tqdm(total=len(poses), unit=" poses", disable=progress is not True) as bar:

        def show(done: int) -> None:
            bar.update(done - bar.n)

        set_done = show if progress is True else progress or None
        outcome = segmented(poses, parameters, known_map, evidence, progress=set_done, notes=notes)
    result = Result(**vars(outcome))
    warn_of(result.own_warnings)
    outliers = result.segmentation.outliers
    log_counts(poses.name, {"outlier": outliers.total}, outliers, result.origin_ns)
    return result


def _evidence_of(
    wrench: str | Wrenches, trajectory: Trajectory, model: Model, known_map: KnownMap
) -> RecordedEvidence:
    if isinstance(wrench, Wrenches):
        return evidence_as_given(wrench, "the wrench", trajectory.poses, model, known_map)
    if not isinstance(wrench, str):
        raise UsageError(f"wrench is a topic or contact_tracker.Wrenches, not {type(wrench).__name__}")
    if trajectory.path is None or trajectory.source is None:
        raise UsageError(
            "wrench is a topic, but this trajectory is not from a recording that can be read again"
        )
    path, poses = trajectory.path, trajectory.poses
    with errors_as(UnreadableRecording, path):
        wrenches = read_wrenches(path, wrench, trajectory.source, poses, trajectory.by_log_time)
    return evidence_of(wrenches, wrench, poses, model, known_map)


@with_known_arguments_of_methods
class Comparison(comparison.Comparison):
    """Two takes, step by step, with their outputs."""

    def to_pandas(self) -> "pandas.DataFrame":
        """A DataFrame of pandas with a row per step (docs/assembly.md); raises MissingExtra."""
        return to_pandas(self.columns, {**comparison.COLUMNS})

    def plot(self) -> "Figure":
        """A figure of matplotlib with both takes and their alignment."""
        from contact_tracker.exports.sequence_figures import draw_comparison

        return draw_comparison(self)

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write a CSV with a row per step, or the figure, by the suffix.

        Raises
        ------
        UsageError : the suffix is another one, or the existing file is a recording or one of the takes.
        OutputError : the file cannot be written.
        """
        from contact_tracker.exports.sequence_figures import write_comparison

        name = Path(path_from(path))
        with errors_as(OutputError, str(name)):
            if name.suffix.lower() not in (".csv", *FIGURES):
                raise UsageError(f"cannot write {name}: its name must end in .csv, {', '.join(FIGURES)}")
            read = [part for take in self.takes if take.log is not None for part in parts_of(take.log)]
            write_comparison(self, name, formats.check_output(name, overwrite, read, "overwrite=True"))


@with_known_arguments
def compare(first: Any, second: Any, tolerance: float = TOLERANCE) -> Comparison:
    """Align two takes of one task by contacts and places, as ``contact-tracker compare`` does.

    Parameters
    ----------
    first, second : results of ``segment``, or its inputs, of the same object in the same place.
    tolerance : share of the longer duration by which a step may differ.

    Raises
    ------
    InputError : a trajectory cannot be used.
    UsageError : an argument is invalid, or there are too many segments.

    Warns
    -----
    ContactTrackerWarning : places are not compared, as no element that touched is where it was, or none
        can be compared.
    """
    tolerance = number_from(tolerance, "tolerance", "between 0 and 1", lambda share: 0.0 < share < 1.0)
    takes = [take if isinstance(take, Result) else segment(take) for take in (first, second)]
    result = compare_outcomes(takes[0], takes[1], tolerance)
    warn_of(result.notes)
    return Comparison(**vars(result))
