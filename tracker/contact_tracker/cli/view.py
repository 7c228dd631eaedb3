"""``contact-tracker view``: recordings and their segmentation in the rerun viewer."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

from contact_tracker.cli import inputs
from contact_tracker.cli.source import Source
from contact_tracker.cli.terminal import say
from contact_tracker.config.parameters import Model
from contact_tracker.errors import DONE, UsageError
from contact_tracker.exports.formats import check_output, write_outcome
from contact_tracker.map.map import Map
from contact_tracker.recording import read_truth
from contact_tracker.viewer import sinks
from contact_tracker.viewer.views import Draw, begin


def run(args: argparse.Namespace) -> int:
    logs = list(dict.fromkeys(args.logs))
    if args.save is not None and len(logs) > 1:
        raise UsageError(
            f"{args.save} can have one recording: save each LOG alone; rerun opens several files"
        )
    check = check_output(args.save, args.overwrite, inputs.files_read(logs, args.model, args.known))
    if args.save is None and not args.web:
        sinks.to_viewer()  # raises an error without a screen, before recordings are read
    model, known_map = inputs.load_model(args), inputs.load_map(args)
    with _opener(args, check, len(logs) > 1) as open_view:
        works = (partial(_view, log, args, model, known_map, open_view) for log in logs)
        codes = list(inputs.run_each(works, len(logs) == 1))
    return next(filter(None, reversed(codes)), DONE)


@contextmanager
def _opener(
    args: argparse.Namespace, check: Callable[[], None], are_several: bool
) -> Iterator[Callable[[str], Draw]]:
    """A context with the function that opens the view of a recording in a file, a window or a browser."""
    if args.save is not None:
        yield lambda _: lambda outcome: write_outcome(outcome, args.save, check=check)
    elif args.web:
        with sinks.web_viewer() as (url, sink, wait):
            say(f"open {url} in a browser on this machine; Ctrl-C ends it")
            yield lambda name: begin(sink, name, are_several)
            wait()
    else:
        sink = sinks.to_viewer()
        yield lambda name: begin(sink, name, are_several)


def _view(
    log: str, args: argparse.Namespace, model: Model, known_map: Map, open_view: Callable[[str], Draw]
) -> int:
    source = Source(inputs.open_poses(args, log), log, args)
    truth, trajectory = read_truth(log), source.trajectory()
    draw = open_view(trajectory.name)
    outcome = source.segment(trajectory, model, known_map)
    draw(replace(outcome, labels=truth))
    code = source.finish(outcome.report, outcome.segmentation.outliers)
    if args.save is not None:
        say(f"wrote {args.save}")
    return code
