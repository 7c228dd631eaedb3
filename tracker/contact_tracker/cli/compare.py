"""``contact-tracker compare``: two takes of one task, step by step."""

import argparse
from typing import TYPE_CHECKING, Final

from contact_tracker.cli import arguments
from contact_tracker.cli.terminal import progress, say, show, warn
from contact_tracker.errors import DIFFERENT, DONE, UsageError
from contact_tracker.exports.formats import FIGURES, check_output

if TYPE_CHECKING:
    from contact_tracker.cli.source import Source
    from contact_tracker.config.parameters import Model
    from contact_tracker.map.map import Map
    from contact_tracker.outputs.outcome import Outcome
    from contact_tracker.trajectory import Trajectory

HELP: Final = "which steps of a take are missing, new, longer or elsewhere in another"
DESCRIPTION: Final = f"""\
Align two takes of one task, with one object in one place, by their contacts and touching elements, and
label each step as the same, missing or new in B, longer or shorter, elsewhere, or open (the motion does
not determine it). In the table ? marks a contact that the motion leaves open, p is the probability that
the segments are of one step, or that the step is in one take only, and "by" is the difference
(docs/assembly.md). The exit code is {DIFFERENT} if a step differs."""
EXAMPLE: Final = "contact-tracker compare recordings/mug_first_take.mcap recordings/mug_second_take.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "log", metavar="A", help="the take to compare with: a file of poses, or a folder of parts"
    )
    parser.add_argument("second", metavar="B", help="the other take")
    arguments.add_recording(parser)
    text = "share of its longer duration by which a step may differ (default: 0.25)"
    parser.add_argument("--tolerance", type=arguments.share, metavar="SHARE", help=text)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    text = "write FILE.csv, a row per step, or the figure FILE.png, .pdf or .svg as well"
    arguments.add_output(parser, (".csv", *FIGURES), text)


def run(args: argparse.Namespace) -> int:
    if "-" in (args.log, args.second):
        raise UsageError("compare reads two files or folders, not -")
    read = arguments.files_read([args.log, args.second], args.model, args.known)
    check = check_output(args.output, args.overwrite, read)

    from contact_tracker.cli.source import Source
    from contact_tracker.sequences.comparison import TOLERANCE, compare_outcomes

    model, known_map = arguments.load_model(args), arguments.load_map(args)
    sources = [Source(arguments.open_poses(args, log), log, args) for log in (args.log, args.second)]
    trajectories = [source.trajectory() for source in sources]  # both, before the work on one
    (first, code), (second, second_code) = (
        _segmented(*take, model, known_map) for take in zip(sources, trajectories, strict=True)
    )
    result = compare_outcomes(first, second, TOLERANCE if args.tolerance is None else args.tolerance)
    for note in result.notes:
        warn(note)
    if args.json:
        import json

        show(json.dumps(result.to_json(), allow_nan=False))
    else:
        for line in result.lines():
            show(line)
    if args.output is not None:
        from contact_tracker.exports.sequence_figures import write_comparison

        write_comparison(result, args.output, check)
        say(f"wrote {args.output}")
    return code or second_code or (DIFFERENT if result.differences else DONE)


def _segmented(
    source: "Source", trajectory: "Trajectory", model: "Model", known_map: "Map"
) -> "tuple[Outcome, int]":
    from contact_tracker.segmenting import segmented

    with progress(f"{source.name}: segment", "poses", len(trajectory)) as set_done:
        outcome = segmented(trajectory, model, known_map, progress=set_done)
    return outcome, source.finish(outcome.report, outcome.segmentation.outliers)
