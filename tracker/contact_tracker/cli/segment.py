"""``contact-tracker segment``: what held when, from the whole recording."""

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from contact_tracker.cli.arguments import add_model, add_recording, model_of, output_file
from contact_tracker.cli.known import add_known, knowledge_of
from contact_tracker.cli.replacement import add_overwrite, check_output, files_read
from contact_tracker.cli.terminal import progress, show
from contact_tracker.cli.workers import add_processes, workers

if TYPE_CHECKING:
    from contact_tracker.tracking.belief import Segment
    from contact_tracker.tracking.segmentation import Segmentation

HELP: Final = "what held when: smoothed segments of a whole recording"
DESCRIPTION: Final = """\
Cut a recording into segments of one contact each, with all the data at hand: the most probable
sequence, smoothed probabilities and the geometry of each segment. FILE.csv gets a row per segment,
FILE.jsonl an object per tick; without -o a table goes to stdout."""
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
        help="write FILE.csv or FILE.jsonl, whole or not at all; - is a table on stdout (the default)",
    )
    add_overwrite(parser)
    add_processes(parser)


def _output(text: str) -> Path | None:
    return None if text == "-" else output_file(".csv", ".jsonl")(text)


def run(args: argparse.Namespace) -> int:
    from contact_tracker.adaptation import OfflineTracker
    from contact_tracker.cli.source import Source
    from contact_tracker.recording import open_log
    from contact_tracker.tracking.belief import Detail

    check_output(args.output, args.overwrite, files_read([args.log], args.model, args.known))
    model, knowledge = model_of(args), knowledge_of(args)
    source = Source(open_log(args.log, args.topic, args.frame, relative_to=args.relative_to), args)
    with progress("segment", "poses") as set_done, workers(args.processes) as executor:
        tracker = OfflineTracker(model, knowledge, executor)
        found = source.counted(tracker.pieces(source, set_done, Detail.WEIGHTS))
        if args.output is None:
            segments = [one for piece in found for one in piece.segments]
        else:
            _write(found, args.output)
    if args.output is None:
        _print(segments, source.origin_ns)
    return source.finish(tracker.report)


def _print(segments: "Iterable[Segment]", origin_ns: int) -> None:
    from contact_tracker.outputs.text import table

    for line in table(segments, origin_ns):
        show(line)
    sys.stdout.flush()


def _write(found: "Iterable[Segmentation]", path: Path) -> None:
    """Piece by piece: what is written need not be kept."""
    from contact_tracker.atomic_file import whole_file
    from contact_tracker.outputs.tables import write_csv, write_jsonl

    with whole_file(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        if path.suffix.lower() == ".csv":
            write_csv((one for piece in found for one in piece.segments), file)
        else:
            write_jsonl((one for piece in found for one in piece.beliefs), file)
