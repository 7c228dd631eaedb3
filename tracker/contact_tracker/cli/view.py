"""``contact-tracker view``: recordings and their segmentation in the rerun viewer."""

import argparse
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from contact_tracker.cli import arguments
from contact_tracker.cli.terminal import progress, say
from contact_tracker.errors import UsageError
from contact_tracker.exit_codes import DONE
from contact_tracker.exports.replacement import check_output

if TYPE_CHECKING:
    from contact_tracker.config.parameters import Model
    from contact_tracker.map.map import Map
    from contact_tracker.motion.poses import Pose
    from contact_tracker.tracking.segmentation import Segmentation
    from contact_tracker.viewer.offline import Shown

HELP: Final = "see recordings in the rerun viewer"
DESCRIPTION: Final = """\
Show recordings in rerun: the moving body with the touching plane, line or point, labels and
probabilities over time (online and smoothed, beside the truth where it is known), and the paper's
objective functions. Times are seconds since a recording's first pose. Several recordings are beside
each other in the viewer's list."""
EXAMPLE: Final = "contact-tracker view recordings/all_states.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("logs", nargs="+", metavar="LOG", help=arguments.LOG_HELP)
    arguments.add_source(parser)
    arguments.add_interval(parser)
    arguments.add_model(parser)
    arguments.add_known(parser)
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--save",
        type=arguments.output_file(".rrd"),
        metavar="FILE",
        help="write FILE.rrd, which rerun opens later, instead of opening the viewer",
    )
    where.add_argument(
        "--web",
        action="store_true",
        help="serve it to a browser on this machine, without a window, until interrupted",
    )
    arguments.add_overwrite(parser)


def run(args: argparse.Namespace) -> int:
    logs = list(dict.fromkeys(args.logs))
    if args.save is not None and len(logs) > 1:
        raise UsageError(f"{args.save} can hold one recording: save each LOG of its own; rerun opens several")
    check = check_output(args.save, args.overwrite, arguments.files_read(logs, args.model, args.known))
    model, known_map = arguments.load_model(args), arguments.load_map(args)
    with _shower(args, check, len(logs) > 1) as show:
        works = (partial(_view, log, args, model, known_map, show) for log in logs)
        codes = list(arguments.run_each(works, len(logs) == 1))
    return next(filter(None, reversed(codes)), DONE)


@contextmanager
def _shower(
    args: argparse.Namespace, check: Callable[[], None], are_several: bool
) -> "Iterator[Callable[[Shown], None]]":
    """The function that shows a recording in a file, a window or a browser, by the arguments."""
    from contact_tracker.viewer.offline import show, write_rrd
    from contact_tracker.viewer.sinks import to_viewer, web_viewer

    if args.save is not None:
        yield lambda shown: write_rrd(args.save, shown, check)
    elif args.web:
        with web_viewer() as web:
            say(f"open {web.url} in a browser on this machine; Ctrl-C ends it")
            yield lambda shown: show(shown, web.sink, are_several)
            web.wait_until_interrupted()
    else:
        sink = to_viewer()
        yield lambda shown: show(shown, sink, are_several)


def _view(
    log: str, args: argparse.Namespace, model: "Model", known_map: "Map", show: "Callable[[Shown], None]"
) -> int:
    from contact_tracker.cli.source import Source
    from contact_tracker.recording import read_metadata, read_truth
    from contact_tracker.segmenting import OfflineTracker
    from contact_tracker.viewer.offline import Shown
    from contact_tracker.viewer.scene import vertices_from_metadata

    poses = arguments.open_poses(args, log)
    tracker = OfflineTracker(model, known_map, read_as=poses.source.read_as)
    source = Source(poses, log, args)
    truth, vertices_m = read_truth(log), vertices_from_metadata(read_metadata(log))
    with progress("segment", "poses", source.expected) as set_done:

        def found(poses: "Iterable[Pose]") -> "Iterator[Segmentation]":
            return source.counted(tracker.pieces(poses, set_done))

        name = None if source.is_stdin else Path(log).name or log
        known = known_map, lambda: tracker.map
        show(Shown(source, found, truth, vertices_m, True, name, lambda: source.origin_ns, *known))
    code = source.finish(tracker.report)
    if args.save is not None:
        say(f"wrote {args.save}")
    return code
