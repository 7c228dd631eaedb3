"""The commands with their options; each is done by the module of its name, which is imported when it runs."""

import argparse
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Final, NamedTuple

from contact_tracker.cli import arguments
from contact_tracker.errors import DAMAGED, DIFFERENT, INPUT
from contact_tracker.exports.formats import FIGURES, FORMATS, ROWS, SUFFIXES, TICKS


class Command(NamedTuple):
    """A command: its name, the text of its ``--help``, and the function that adds its options."""

    name: str
    help: str
    description: str
    example: str
    configure: Callable[[argparse.ArgumentParser], None]
    package: str = "contact_tracker.cli"

    def run(self, args: argparse.Namespace) -> int:
        """Run the command; returns its exit code."""
        code: int = import_module(f"{self.package}.{self.name}").run(args)
        return code


def _configure_live(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", metavar="LOG", type=arguments.recording, help=arguments.LOG_HELP)
    arguments.add_recording(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object per tick instead")
    parser.add_argument(
        "--rate", type=arguments.positive, metavar="X", help="replay at X times the recorded speed"
    )
    text = "report the state of S seconds ago, using the poses since then (default: 0)"
    parser.add_argument("--lag", type=arguments.seconds, default=0.0, metavar="S", help=text)
    text = (
        "say which small motions at once would decide while the contact is open: where they change, or "
        '"suggestions" in --json'
    )
    parser.add_argument("--suggest", action="store_true", help=text)
    text = (
        "say when the contacts leave this plan, once, and which step comes next: lines with plan:, or "
        f'"plan" in --json; the exit code is {DIFFERENT} if it was left'
    )
    parser.add_argument("--expect", metavar="PLAN.toml", help=text)
    parser.add_argument("--follow", action="store_true", help="wait for more at the end of a growing file")
    text = (
        "resume from FILE, if it exists, and save the state to it: every 10 s, and when the stream "
        "ends or is interrupted, with the poses of the last, partial tick"
    )
    parser.add_argument("--state", type=Path, metavar="FILE", help=text)
    views = parser.add_mutually_exclusive_group()
    views.add_argument("--rerun", action="store_true", help="show it in the rerun viewer as well")
    text = "show it in a browser on this machine as well, until interrupted"
    views.add_argument("--web", action="store_true", help=text)
    text = "write all ticks to FILE.csv, .jsonl or .parquet as well; FILE appears at the end of the stream"
    arguments.add_output(parser, TICKS, text)
    arguments.add_map_out(parser)


def _configure_segment(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("logs", metavar="LOG", type=arguments.recording, nargs="+", help=arguments.LOG_HELP)
    arguments.add_recording(parser)
    text = "every source of poses in turn, instead of the one that is chosen"
    parser.add_argument("--all", action="store_true", help=text)
    arguments.add_wrench(parser)
    arguments.add_output(
        parser,
        ("-", *SUFFIXES),
        f"write FILE with the suffix {', '.join(SUFFIXES)}, whole or not at all; - is a table on stdout (the "
        f"default); {arguments.PLACE} in FILE is the name of the recording (with --all: and of the object)",
    )
    suffixes = ", ".join(suffix for suffix, format_ in FORMATS.items() if len(format_.rows) > 1)
    text = f"entries of {suffixes}: one per tick or per segment (default: .csv segments, the others ticks)"
    parser.add_argument("--rows", choices=ROWS, help=text)
    text = "draw the contacts and the transitions between them in FILE.png, .pdf or .svg instead"
    parser.add_argument("--graph", action="store_true", help=text)
    arguments.add_labels(parser, "your own labels of LOG, shown in a figure above those that are found")
    arguments.add_map_out(parser)
    several = "processes that fit segments in parallel; helps with recordings of many minutes (default: 1)"
    arguments.add_processes(parser, 64, 1, several)


def _configure_compare(parser: argparse.ArgumentParser) -> None:
    text = "the take to compare with: a file of poses, a folder of parts, or FILE.contacts of segment -o"
    parser.add_argument("log", metavar="A", help=text)
    parser.add_argument("second", metavar="B", help="the other take")
    arguments.add_recording(parser)
    text = "share of its longer duration by which a step may differ (default: 0.25)"
    parser.add_argument("--tolerance", type=arguments.share, metavar="SHARE", help=text)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    text = "write FILE.csv, a row per step, or the figure FILE.png, .pdf or .svg as well"
    arguments.add_output(parser, (".csv", *FIGURES), text)


def _configure_batch(parser: argparse.ArgumentParser) -> None:
    text = "recordings, folders to search for MCAP files and ROS bags, or - for names on stdin, one a line"
    parser.add_argument("logs", nargs="+", metavar="LOG", type=arguments.recording, help=text)
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DATASET", help="the folder of the dataset"
    )
    parser.add_argument(
        "--ticks", action="store_true", help="write the beliefs of all ticks, too: some ten times as much"
    )
    arguments.add_recording(parser, has_interval=False)
    arguments.add_wrench(parser)
    workers = parser.add_mutually_exclusive_group()
    arguments.add_processes(workers, 1024, None, "recordings at once (default: as many as there are cores)")
    workers.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="work on this Dask cluster instead")


def _configure_view(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("logs", nargs="+", metavar="LOG", type=arguments.recording, help=arguments.LOG_HELP)
    arguments.add_recording(parser)
    views = parser.add_mutually_exclusive_group()
    text = "write FILE.rrd, which rerun opens later, instead of opening the viewer"
    views.add_argument("--save", type=arguments.output_file(".rrd"), metavar="FILE", help=text)
    text = "serve it to a browser on this machine, without a window, until interrupted"
    views.add_argument("--web", action="store_true", help=text)
    arguments.add_overwrite(parser)


def _configure_info(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", metavar="LOG", type=arguments.recording, help=arguments.LOG_HELP)
    arguments.add_source(
        parser,
        "the sources on this topic only",
        "the sources of this frame only: CHILD, or 'PARENT->CHILD'; composed along all transforms between if "
        "nothing is published between these two",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object instead of text")


COMMANDS: Final = (
    Command(
        "live",
        "the present contact: a line per change while poses stream in",
        """\
Follow the contacts in a recording or a stream of poses; each answer uses only the data up to its
time. A line per change goes to stdout: time, contact, probability, onset and place of the contact.
Times are seconds since the recording's first pose.""",
        "contact-tracker live recordings/paper_experiment.mcap --json | head -n 1",
        _configure_live,
    ),
    Command(
        "segment",
        "the contacts of whole recordings over time, as smoothed segments",
        """\
Cut a recording into segments of one contact each, from all its data: the most probable sequence,
smoothed probabilities and the geometry of each segment. FILE.csv, FILE.srt (subtitles) and
FILE.tex (LaTeX) get an entry per segment, FILE.jsonl and FILE.parquet one per tick, unless --rows says
otherwise; FILE.mcap is the recording with drawings for Foxglove, FILE.html a report, FILE.png, .pdf and
.svg a figure, FILE.graphml the graph of contacts, FILE.toml a plan for live --expect; without -o a
table goes to stdout.""",
        "contact-tracker segment recordings/paper_experiment.mcap -o out.csv",
        _configure_segment,
    ),
    Command(
        "compare",
        "which steps of a take are missing, new, longer or elsewhere in another",
        f"""\
Align two takes of one task, with one object in one place, by their contacts and touching elements, and
label each step as the same, missing or new in B, longer or shorter, elsewhere, or open (the motion does
not determine it). In the table ? marks a contact that the motion leaves open, p is the probability that
the segments are of one step, or that the step is in one take only, and "by" is the difference
(docs/assembly.md). The exit code is {DIFFERENT} if a step differs.""",
        "contact-tracker compare recordings/mug_first_take.mcap recordings/mug_second_take.mcap",
        _configure_compare,
    ),
    Command(
        "batch",
        "segment many recordings into one dataset of Parquet files",
        f"""\
Segment many recordings into a dataset: a Parquet file of segments for each of them, and
DATASET/summary.parquet with a row for each. Run again, it processes only recordings that are new or
whose content has changed, and all if the model has changed. A recording that cannot be used is a row
with the error, the others are segmented, and the exit code is {DAMAGED}. If LOG is a LeRobot data set
(a folder), DATASET is a copy with the contacts of its frames (docs/batch.md). If a LOG does not exist or
is a folder without recordings, no recording is processed, and the exit code is {INPUT}.""",
        "contact-tracker batch recordings/ --output dataset",
        _configure_batch,
    ),
    Command(
        "view",
        "show recordings in the rerun viewer",
        """\
Show recordings in rerun: the moving body with the touching plane, line or point, labels and
probabilities over time (online and smoothed, with the truth if it is known). Times are seconds since
a recording's first pose. Several recordings are separate entries of the viewer's list.""",
        "contact-tracker view recordings/all_states.mcap",
        _configure_view,
    ),
    Command(
        "info",
        "which poses are in a recording, and how good they are",
        """\
List the sources of poses in a recording with their topics, frames, rates, gaps and estimated
noise, and the other contents of the recording.""",
        "contact-tracker info recordings/vision_30hz.mcap",
        _configure_info,
    ),
)
