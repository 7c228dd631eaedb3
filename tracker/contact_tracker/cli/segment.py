"""``contact-tracker segment``: the contacts of a whole recording over time."""

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from contact_tracker.cli.arguments import add_model, add_recordings, model_of, output_file
from contact_tracker.cli.jobs import PLACE, jobs_of
from contact_tracker.cli.known import add_known, knowledge_of
from contact_tracker.cli.replacement import add_overwrite, files_read
from contact_tracker.cli.terminal import detail, fail, progress, show
from contact_tracker.cli.workers import add_processes, workers
from contact_tracker.cli.wrench import add_wrench, evidence_of
from contact_tracker.config.table_reading import AS_NAMED
from contact_tracker.errors import ChoiceError, InputError
from contact_tracker.exit_codes import DONE, INPUT, USAGE
from contact_tracker.exports.replacement import check_output
from contact_tracker.exports.suffixes import SUFFIXES, WHOLE, require_library

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from contact_tracker.adaptation import OfflineTracker
    from contact_tracker.cli.source import Source
    from contact_tracker.config.parameters import Model
    from contact_tracker.landmarks.prior_map import PriorMap
    from contact_tracker.motion.poses import Pose
    from contact_tracker.recording import PoseLog
    from contact_tracker.tracking.belief import Segment
    from contact_tracker.tracking.segmentation import Segmentation

HELP: Final = "what held when: smoothed segments of whole recordings"
DESCRIPTION: Final = """\
Cut a recording into segments of one contact each, with all the data at hand: the most probable
sequence, smoothed probabilities and the geometry of each segment. FILE.csv and FILE.srt (subtitles)
get an entry per segment, FILE.jsonl and FILE.parquet one per tick; FILE.mcap is the recording with
what Foxglove draws beside it, FILE.html a report, and FILE.png, .pdf and .svg a figure; without -o a
table goes to stdout."""
EXAMPLE: Final = "contact-tracker segment recordings/paper_experiment.mcap -o out.csv"


def configure(parser: argparse.ArgumentParser) -> None:
    add_recordings(parser)
    parser.add_argument(
        "--all", action="store_true", help="every source of poses in turn, instead of the one that is chosen"
    )
    add_model(parser)
    add_known(parser)
    add_wrench(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=_output,
        metavar="FILE",
        help=f"write FILE with the suffix {', '.join(SUFFIXES)}, whole or not at all; - is a table on stdout "
        f"(the default); {PLACE} in FILE is the name of the recording (with --all: and of the object)",
    )
    add_overwrite(parser)
    add_processes(parser)


def _output(text: str) -> Path | None:
    return None if text == "-" else output_file(*SUFFIXES)(text)


def run(args: argparse.Namespace) -> int:
    jobs = jobs_of(args)
    if args.output is not None:
        require_library(args.output)
    model, knowledge = model_of(args), knowledge_of(args)
    with workers(args.processes) as executor:
        if len(jobs) == 1:
            return _segment(jobs[0].arguments(args), model, knowledge, executor)
        code = DONE
        for job in jobs:
            if job.output is None:
                show(job.name)
            try:
                done = _segment(job.arguments(args), model, knowledge, executor)
            except (InputError, ChoiceError) as error:  # continue with the others
                fail(str(error))
                done = INPUT if isinstance(error, InputError) else USAGE
            code = code or done
    return code


def _segment(
    args: argparse.Namespace, model: "Model", knowledge: "PriorMap", executor: "Executor | None"
) -> int:
    from contact_tracker.adaptation import OfflineTracker
    from contact_tracker.cli.source import Source
    from contact_tracker.recording import open_log
    from contact_tracker.tracking.belief import Detail

    read = [*args.logs, *files_read([args.log], args.model, args.known)]
    check = check_output(args.output, args.overwrite, read, written=args.other_outputs)
    wrenches = evidence_of(args.log, args, model, knowledge)
    log = open_log(args.log, args.topic, args.frame, relative_to=args.relative_to, table=args.table)
    source = Source(log, args.log, args)
    tracker = OfflineTracker(model, knowledge, executor, wrenches, log.source.frame_moves)
    with progress("segment", "poses", source.expected) as set_done:
        if args.output is None:
            found = source.counted(tracker.pieces(source, set_done, Detail.WEIGHTS))
            segments = [one for piece in found for one in piece.segments]
        else:
            _write(source, log, tracker, set_done, args, check)
            detail(f"wrote {args.output}")
    if args.output is None:
        _print(segments, source.origin_ns, wrenches is not None)
    return source.finish(tracker.report)


def _print(segments: "Iterable[Segment]", origin_ns: int, with_wrenches: bool) -> None:
    from contact_tracker.outputs.text import table

    for line in table(segments, origin_ns, with_wrenches):
        show(line)
    sys.stdout.flush()


def _write(
    source: "Source",
    log: "PoseLog",
    tracker: "OfflineTracker",
    set_done: Callable[[int], None],
    args: argparse.Namespace,
    check: Callable[[], None],
) -> None:
    """Write incrementally where the format allows it, to save memory."""
    from contact_tracker.exports.writing import write_outcome, write_pieces
    from contact_tracker.motion.poses import Poses
    from contact_tracker.tracking.belief import Detail
    from contact_tracker.tracking.pose_buffer import with_pose_callback
    from contact_tracker.tracking.segmentation import Segmentation

    def pieces(poses: "Iterable[Pose]") -> "Iterator[Segmentation]":
        return source.counted(tracker.pieces(poses, set_done, Detail.WEIGHTS))

    if args.output.suffix.lower() not in WHOLE:
        write_pieces(pieces(source), args.output, lambda: source.origin_ns, check)
        return
    kept: list[Poses] = []
    found = Segmentation.join(list(with_pose_callback(source, pieces, kept.append)))
    outcome = source.outcome(Poses.join(kept), found, tracker.report)
    is_readable = not source.is_stdin and os.path.exists(args.log) and args.table == AS_NAMED
    read = args.log if is_readable else None
    write_outcome(outcome, args.output, read, log.stamping.log_offset_ns, check)
