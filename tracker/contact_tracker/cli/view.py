"""``contact-tracker view``: recordings and their segmentation in the rerun viewer."""

import argparse
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from contact_tracker.cli.arguments import LOG_HELP, add_interval, add_model, add_source, model_of, output_file
from contact_tracker.cli.known import add_known, knowledge_of
from contact_tracker.cli.replacement import add_overwrite, files_read
from contact_tracker.cli.terminal import fail, progress, say
from contact_tracker.errors import ChoiceError, InputError, UsageError
from contact_tracker.exit_codes import DONE, INPUT, USAGE
from contact_tracker.exports.replacement import check_output

if TYPE_CHECKING:
    from contact_tracker.config.parameters import Model
    from contact_tracker.landmarks.prior_map import PriorMap
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
    parser.add_argument("logs", nargs="+", metavar="LOG", help=LOG_HELP)
    add_source(parser)
    add_interval(parser)
    add_model(parser)
    add_known(parser)
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--save",
        type=output_file(".rrd"),
        metavar="FILE",
        help="write FILE.rrd, which rerun opens later, instead of opening the viewer",
    )
    where.add_argument(
        "--web",
        action="store_true",
        help="serve it to a browser on this machine, without a window, until interrupted",
    )
    add_overwrite(parser)


def run(args: argparse.Namespace) -> int:
    logs = list(dict.fromkeys(args.logs))
    if args.save is not None and len(logs) > 1:
        raise UsageError(f"{args.save} can hold one recording: save each LOG of its own; rerun opens several")
    check = check_output(args.save, args.overwrite, files_read(logs, args.model, args.known))
    model, knowledge = model_of(args), knowledge_of(args)
    code = DONE
    with _shower(args, check, len(logs) > 1) as show:
        for log in logs:
            try:
                code = _view(log, args, model, knowledge, show) or code
            except (InputError, ChoiceError) as error:  # continue with the others
                if len(logs) == 1:
                    raise
                fail(str(error))
                code = INPUT if isinstance(error, InputError) else USAGE
    return code


@contextmanager
def _shower(
    args: argparse.Namespace, check: Callable[[], None], are_several: bool
) -> "Iterator[Callable[[Shown], None]]":
    """The function that shows a recording in a file, a window or a browser, by the arguments."""
    from contact_tracker.viewer.offline import show, write_rrd
    from contact_tracker.viewer.sinks import to_viewer

    if args.save is not None:
        yield lambda shown: write_rrd(args.save, shown, check)
    elif args.web:
        from contact_tracker.viewer.web import WebViewer

        with WebViewer() as web:
            say(f"open {web.url} in a browser on this machine; Ctrl-C ends it")
            yield lambda shown: show(shown, web.sink, are_several)
            web.wait_until_interrupted()
    else:
        sink = to_viewer()
        yield lambda shown: show(shown, sink, are_several)


def _view(
    log: str, args: argparse.Namespace, model: "Model", knowledge: "PriorMap", show: "Callable[[Shown], None]"
) -> int:
    from contact_tracker.adaptation import OfflineTracker
    from contact_tracker.cli.source import Source
    from contact_tracker.recording import open_log, read_metadata, read_truth
    from contact_tracker.viewer.hull import vertices_from_metadata
    from contact_tracker.viewer.offline import Shown

    poses = open_log(log, args.topic, args.frame, relative_to=args.relative_to, table=args.table)
    tracker = OfflineTracker(model, knowledge, frame_moves=poses.source.frame_moves)
    source = Source(poses, log, args)
    truth, vertices_m = read_truth(log), vertices_from_metadata(read_metadata(log))
    with progress("segment", "poses", source.expected) as set_done:

        def found(poses: "Iterable[Pose]") -> "Iterator[Segmentation]":
            return source.counted(tracker.pieces(poses, set_done))

        name = None if source.is_stdin else Path(log).name or log
        show(Shown(source, found, truth, vertices_m, True, name, lambda: source.origin_ns))
    return source.finish(tracker.report)
