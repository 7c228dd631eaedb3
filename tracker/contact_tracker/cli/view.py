"""``contact-tracker view``: recordings and their segmentation in the rerun viewer."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

from contact_tracker.cli import arguments
from contact_tracker.cli.terminal import progress, say
from contact_tracker.errors import DONE, UsageError
from contact_tracker.exports.formats import check_output, write_outcome

if TYPE_CHECKING:
    from contact_tracker.config.parameters import Model
    from contact_tracker.map.map import Map
    from contact_tracker.viewer.views import Draw

HELP: Final = "show recordings in the rerun viewer"
DESCRIPTION: Final = """\
Show recordings in rerun: the moving body with the touching plane, line or point, labels and
probabilities over time (online and smoothed, with the truth if it is known), and the paper's
objective functions. Times are seconds since a recording's first pose. Several recordings are
separate entries of the viewer's list."""
EXAMPLE: Final = "contact-tracker view recordings/all_states.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("logs", nargs="+", metavar="LOG", help=arguments.LOG_HELP)
    arguments.add_recording(parser)
    views = parser.add_mutually_exclusive_group()
    text = "write FILE.rrd, which rerun opens later, instead of opening the viewer"
    views.add_argument("--save", type=arguments.output_file(".rrd"), metavar="FILE", help=text)
    text = "serve it to a browser on this machine, without a window, until interrupted"
    views.add_argument("--web", action="store_true", help=text)
    arguments.add_overwrite(parser)


def run(args: argparse.Namespace) -> int:
    logs = list(dict.fromkeys(args.logs))
    if args.save is not None and len(logs) > 1:
        raise UsageError(
            f"{args.save} can have one recording: save each LOG alone; rerun opens several files"
        )
    check = check_output(args.save, args.overwrite, arguments.files_read(logs, args.model, args.known))
    if args.save is None and not args.web:
        from contact_tracker.viewer.sinks import to_viewer

        to_viewer()  # raises an error without a screen, before recordings are read
    model, known_map = arguments.load_model(args), arguments.load_map(args)
    with _opener(args, check, len(logs) > 1) as open_view:
        works = (partial(_view, log, args, model, known_map, open_view) for log in logs)
        codes = list(arguments.run_each(works, len(logs) == 1))
    return next(filter(None, reversed(codes)), DONE)


@contextmanager
def _opener(
    args: argparse.Namespace, check: Callable[[], None], are_several: bool
) -> "Iterator[Callable[[str], Draw]]":
    """A context with the function that opens the view of a recording in a file, a window or a browser."""
    from contact_tracker.viewer.sinks import to_viewer, web_viewer
    from contact_tracker.viewer.views import begin

    if args.save is not None:
        yield lambda _: lambda outcome: write_outcome(outcome, args.save, check=check)
    elif args.web:
        with web_viewer() as (url, sink, wait):
            say(f"open {url} in a browser on this machine; Ctrl-C ends it")
            yield lambda name: begin(sink, name, are_several)
            wait()
    else:
        sink = to_viewer()
        yield lambda name: begin(sink, name, are_several)


def _view(
    log: str, args: argparse.Namespace, model: "Model", known_map: "Map", open_view: "Callable[[str], Draw]"
) -> int:
    from contact_tracker.cli.source import Source
    from contact_tracker.recording import read_truth
    from contact_tracker.segmenting import segmented

    source = Source(arguments.open_poses(args, log), log, args)
    truth, trajectory = read_truth(log), source.trajectory()
    draw = open_view(trajectory.name)
    with progress("segment", "poses", len(trajectory)) as set_done:
        outcome = segmented(trajectory, model, known_map, progress=set_done)
        draw(replace(outcome, labels=truth))
    code = source.finish(outcome.report, outcome.segmentation.outliers)
    if args.save is not None:
        say(f"wrote {args.save}")
    return code
