"""``contact-tracker segment``: what held when, from the whole recording."""

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from contact_tracker.cli.arguments import add_model, add_recording, model_of, output_file
from contact_tracker.cli.known import add_known, knowledge_of
from contact_tracker.cli.replacement import add_overwrite, files_read
from contact_tracker.cli.terminal import detail, progress, show
from contact_tracker.cli.workers import add_processes, workers
from contact_tracker.exports.replacement import check_output
from contact_tracker.exports.suffixes import SUFFIXES, WHOLE, require_library

if TYPE_CHECKING:
    from contact_tracker.adaptation import OfflineTracker
    from contact_tracker.cli.source import Source
    from contact_tracker.motion.poses import Pose
    from contact_tracker.recording import PoseLog
    from contact_tracker.tracking.belief import Segment
    from contact_tracker.tracking.segmentation import Segmentation

HELP: Final = "what held when: smoothed segments of a whole recording"
DESCRIPTION: Final = """\
Cut a recording into segments of one contact each, with all the data at hand: the most probable
sequence, smoothed probabilities and the geometry of each segment. FILE.csv and FILE.srt (subtitles)
get an entry per segment, FILE.jsonl and FILE.parquet one per tick; FILE.mcap is the recording with
what Foxglove draws beside it, and FILE.html a report; without -o a table goes to stdout."""
EXAMPLE: Final = "contact-tracker segment recordings/paper_experiment.mcap -o out.csv"


def configure(parser: argparse.ArgumentParser) -> None:
    add_recording(parser)
    add_model(parser)
    add_known(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=_output,
        metavar="FILE",
        help=f"write FILE with the suffix {', '.join(SUFFIXES)}, whole or not at all; - is a table on stdout "
        "(the default)",
    )
    add_overwrite(parser)
    add_processes(parser)


def _output(text: str) -> Path | None:
    return None if text == "-" else output_file(*SUFFIXES)(text)


def run(args: argparse.Namespace) -> int:
    from contact_tracker.adaptation import OfflineTracker
    from contact_tracker.cli.source import Source
    from contact_tracker.recording import open_log
    from contact_tracker.tracking.belief import Detail

    check_output(args.output, args.overwrite, files_read([args.log], args.model, args.known))
    if args.output is not None:
        require_library(args.output)
    model, knowledge = model_of(args), knowledge_of(args)
    log = open_log(args.log, args.topic, args.frame)
    source = Source(log, args.log, args)
    with progress("segment", "poses", source.expected) as set_done, workers(args.processes) as executor:
        tracker = OfflineTracker(model, knowledge, executor)
        if args.output is None:
            found = source.counted(tracker.pieces(source, set_done, Detail.WEIGHTS))
            segments = [one for piece in found for one in piece.segments]
        else:
            _write(source, log, tracker, set_done, args)
            detail(f"wrote {args.output}")
    if args.output is None:
        _print(segments, source.origin_ns)
    return source.finish(tracker.report)


def _print(segments: "Iterable[Segment]", origin_ns: int) -> None:
    from contact_tracker.outputs.text import table

    for line in table(segments, origin_ns):
        show(line)
    sys.stdout.flush()


def _write(
    source: "Source",
    log: "PoseLog",
    tracker: "OfflineTracker",
    set_done: Callable[[int], None],
    args: argparse.Namespace,
) -> None:
    """Piece by piece where that is possible: what is written need not be kept."""
    from contact_tracker.exports.writing import write_outcome, write_pieces
    from contact_tracker.motion.poses import Poses
    from contact_tracker.tracking.belief import Detail
    from contact_tracker.tracking.pose_buffer import watched
    from contact_tracker.tracking.segmentation import Segmentation

    def pieces(poses: "Iterable[Pose]") -> "Iterator[Segmentation]":
        return source.counted(tracker.pieces(poses, set_done, Detail.WEIGHTS))

    if args.output.suffix.lower() not in WHOLE:
        write_pieces(pieces(source), args.output, lambda: source.origin_ns)
        return
    kept: list[Poses] = []
    found = Segmentation.join(list(watched(source, pieces, kept.append)))
    outcome = source.outcome(Poses.join(kept), found, tracker.report)
    is_readable = not source.is_stdin and os.path.exists(args.log)
    write_outcome(outcome, args.output, args.log if is_readable else None, log.stamping.log_offset_ns)
