"""``contact-tracker segment``: the contacts of a whole recording over time."""

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

from contact_tracker.cli import inputs
from contact_tracker.cli.arguments import PLACE
from contact_tracker.cli.source import Source
from contact_tracker.cli.terminal import progress, say, show, take_over_warnings, warn
from contact_tracker.config.parameters import Model
from contact_tracker.errors import DONE, ChoiceError, NoPoses, UsageError
from contact_tracker.exports.formats import (
    FIGURES,
    check_output,
    require_library,
    rows_of,
    write_outcome,
    write_pieces,
)
from contact_tracker.map.map import Map
from contact_tracker.outputs.parts import KnownParts
from contact_tracker.outputs.text import counted, table
from contact_tracker.processes import Workers
from contact_tracker.recording import list_sources
from contact_tracker.segmenting import OfflineTracker, segmented
from contact_tracker.tracking.belief import Detail, Segment
from contact_tracker.tracking.filter_bank import Report


def list_jobs(args: argparse.Namespace) -> list[argparse.Namespace]:
    """The arguments of a job for each recording of ``args.logs``, or with ``args.all`` for each source of
    poses in each recording.

    They are the arguments of the command with the job's ``log``, topic and frame, a unique ``name``, its
    ``output`` (None is stdout), and the outputs of the other jobs as ``other_outputs``.

    Raises
    ------
    UsageError
        Two jobs have the same output, or a recording that can be read only once is needed twice.
    InputError
        With ``args.all``, a recording cannot be read or has no source of poses.
    """
    if len(args.logs) > 1 and "-" in args.logs:
        raise UsageError("standard input is read alone, without other recordings")
    single = ([_job(args, log, args.topic, args.frame, log, [_stem(log)])] for log in args.logs)
    jobs = [*chain.from_iterable((_objects(log, args) for log in args.logs) if args.all else single)]
    outputs = [job.output for job in jobs if job.output is not None]
    if len(jobs) > 1 and args.output is not None and PLACE not in str(args.output):
        raise UsageError(
            f"{len(jobs)} outputs cannot all be {args.output}: write {PLACE} where the name of each goes, "
            f"as in {args.output.with_stem(PLACE)}"
        )
    if doubled := {str(output) for output in outputs if outputs.count(output) > 1}:
        raise UsageError(f"several recordings would be written to {min(doubled)}: segment them one by one")
    for job in jobs:
        job.other_outputs = [output for output in outputs if output != job.output]
    return jobs


def _job(
    args: argparse.Namespace, log: str, topic: str | None, frame: str | None, name: str, names: Iterable[str]
) -> argparse.Namespace:
    """The arguments of a job; ``names`` replace the placeholder in the output's name."""
    plain = "-".join(re.sub(r"[^\w.-]+", "_", part).strip("_") for part in names)
    output = None if args.output is None else Path(str(args.output).replace(PLACE, plain))
    changes = {"log": log, "topic": topic, "frame": frame, "name": name, "output": output}
    return argparse.Namespace(**{**vars(args), **changes})


def _objects(log: str, args: argparse.Namespace) -> Iterator[argparse.Namespace]:
    """The arguments of a job for each source of poses in a recording."""
    if log == "-":
        raise UsageError("--all reads a recording twice: name a file, not -")
    sources = [s for s in list_sources(log, args.table) if args.topic is None or s.topic == args.topic]
    sources = [s for s in sources if args.frame is None or s.is_named(args.frame)]
    if not sources:
        fault = NoPoses if args.topic is None and args.frame is None else ChoiceError
        raise fault(f"{log}: no such source of poses; contact-tracker info shows what is in it")
    for source in sources:
        body = source.child_frame_id or source.topic
        chosen = f"{source.topic}:{source.type}", source.frames or None
        yield _job(args, log, *chosen, f"{log} {source}", [_stem(log), body])


def _stem(log: str) -> str:
    """The name of a recording in the name of its output."""
    return "stdin" if log == "-" else Path(os.path.realpath(log)).stem


def run(args: argparse.Namespace) -> int:
    if args.output is not None:
        require_library(args.output)
        args.rows = rows_of(args.output, args.rows)
    elif args.rows is not None:
        raise UsageError("--rows needs -o FILE")
    jobs = list_jobs(args)
    is_figure = args.output is not None and args.output.suffix.lower() in FIGURES
    if (args.labels is not None or args.meaning) and not (args.labels and is_figure and len(jobs) == 1):
        raise UsageError("--labels FILE needs a single LOG and -o FILE.png, .pdf or .svg; evaluate compares")
    if args.graph and (args.labels is not None or not is_figure):
        raise UsageError("--graph needs -o FILE.png, .pdf or .svg, without --labels")
    if args.labels is not None and jobs[0].log == "-":
        raise UsageError("--labels reads the recording twice, which standard input does not allow")
    if args.map_out is not None and len(jobs) > 1:
        raise UsageError("--map-out needs a single LOG: pass the map on with --known and --map-out")
    notes = list[str]()
    model, known_map = inputs.load_model(args), inputs.load_map(args, _noting(notes))
    workers = Workers(args.processes - 1, take_over_warnings) if args.processes > 1 else nullcontext()
    with workers as executor:  # this process works, too

        def segment(job: argparse.Namespace) -> int:
            if job.output is None and len(jobs) > 1:
                show(job.name)
            return _segment(job, model, known_map, executor, notes)

        codes = list(inputs.run_each((partial(segment, job) for job in jobs), len(jobs) == 1))
    return next(filter(None, codes), DONE)


def _say_what_decides(segments: Sequence[Segment], report: Report | None) -> None:
    """Say what would decide contacts if none is decided, no joint named, and no mistake suspected."""
    is_in_doubt = report is not None and any(finding.doubts_labels for finding in report.findings)
    if segments and all(one.inseparable and one.joint is None for one in segments) and not is_in_doubt:
        say(
            "no contact is decided: move the object in more directions (live LOG --suggest names motions), "
            "or list known elements of the object and the surroundings (--known)"
        )


def _noting(notes: list[str]) -> Callable[[str], None]:
    """A function that prints a warning and appends it to ``notes``."""

    def note(line: str) -> None:
        warn(line)
        notes.append(line)

    return note


def _segment(
    args: argparse.Namespace, model: Model, known_map: Map, executor: Executor | None, warnings: list[str]
) -> int:
    """Segment one recording and return the exit code; ``warnings`` are those so far."""
    read = [*args.logs, *inputs.files_read([args.log], args.model, args.known)]
    check = check_output(args.output, args.overwrite, read, written=args.other_outputs)
    inputs.check_map_out(args, known_map)
    labels = None if args.labels is None else inputs.load_labels(args, args.log)
    notes = [*warnings]
    wrenches = inputs.load_wrenches(args.log, args, model, known_map, _noting(notes))
    log = inputs.open_poses(args, args.log)
    source = Source(log, args.log, args)
    with progress("segment", "poses", source.expected) as set_done:
        count = 0
        is_drawn = args.output is not None and args.rows is None
        trajectory = source.trajectory() if is_drawn or args.map_out is not None else None
        if is_drawn and trajectory is not None:
            outcome = segmented(trajectory, model, known_map, wrenches, executor, set_done, notes)
            if args.graph:
                from contact_tracker.exports.sequence_figures import write_contact_graph

                write_contact_graph(outcome, args.output, check)
            else:
                write_outcome(replace(outcome, labels=labels), args.output, check=check)
            report, touched, outliers = outcome.report, outcome.touched, outcome.segmentation.outliers
        else:  # incrementally, to save memory
            tracker = OfflineTracker(model, known_map, executor, wrenches, log.source.read_as)
            pieces = tracker.pieces(source if trajectory is None else trajectory, set_done, Detail.WEIGHTS)
            if args.output is None:
                segments = [segment for piece in pieces for segment in piece.segments]
            else:
                count = write_pieces(pieces, args.output, args.rows, lambda: source.log.origin_ns, check)
            report, touched, outliers = tracker.report, tracker.map, tracker.outliers
    source.warn_of_damage()
    if args.output is None:
        for line in table(segments, log.origin_ns, wrenches is not None):
            show(line)
        sys.stdout.flush()
    code = source.finish(report, outliers)
    if args.output is None:
        _say_what_decides(segments, report)
    else:
        rows = "" if args.rows is None else f": {counted(count, args.rows.removesuffix('s'))}"
        say(f"wrote {args.output}{rows}")
    if args.map_out is not None and trajectory is not None:
        parts = KnownParts(vertices_m=trajectory.vertices_m)
        parts.add_poses(trajectory.poses)
        inputs.write_map(args.map_out, parts.learned(touched))
    return code
