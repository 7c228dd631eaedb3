"""``contact-tracker segment``: what held when, from the whole recording."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from contact_tracker.cli.arguments import add_model, add_recording, output_file
from contact_tracker.cli.known import add_known, knowledge_of
from contact_tracker.cli.terminal import progress

if TYPE_CHECKING:
    from contact_tracker.belief import Segmentation

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


def _output(text: str) -> Path | None:
    return None if text == "-" else output_file(".csv", ".jsonl")(text)


def run(args: argparse.Namespace) -> int:
    from contact_tracker.cli.source import Source
    from contact_tracker.model import load_model
    from contact_tracker.recording import open_log
    from contact_tracker.segmenter import segment

    model, knowledge = load_model(args.model), knowledge_of(args)
    source = Source(open_log(args.log, args.topic, args.frame), args)
    with progress("segment", "poses") as set_done:
        found = segment(source, model, set_done, knowledge)
    if args.output is None:
        _print(found, source.origin_ns)
    else:
        _write(found, args.output)
    return source.finish(found.outliers)


def _print(found: "Segmentation", origin_ns: int) -> None:
    from contact_tracker.outputs.words import table

    for line in table(found.segments, origin_ns):
        print(line)
    sys.stdout.flush()


def _write(found: "Segmentation", path: Path) -> None:
    from contact_tracker.outputs.rows import write_csv, write_jsonl
    from contact_tracker.whole_file import whole_file

    with whole_file(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        if path.suffix == ".csv":
            write_csv(found.segments, file)
        else:
            write_jsonl(found.beliefs, file)
