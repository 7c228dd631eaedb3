"""``contact-tracker view``: everything about a recording in the rerun viewer."""

import argparse
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final

from contact_tracker.cli.arguments import add_model, add_recording, model_of, output_file
from contact_tracker.cli.known import add_known, knowledge_of
from contact_tracker.cli.replacement import add_overwrite, files_read
from contact_tracker.cli.terminal import progress
from contact_tracker.exports.replacement import check_output

if TYPE_CHECKING:
    from contact_tracker.motion.poses import Pose
    from contact_tracker.tracking.segmentation import Segmentation

HELP: Final = "see a recording in the rerun viewer"
DESCRIPTION: Final = """\
Show a recording in rerun: the moving body with the touching plane, line or point, labels and
probabilities over time (online and smoothed, beside the truth where it is known), and the paper's
objective functions."""
EXAMPLE: Final = "contact-tracker view recordings/all_states.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    add_recording(parser)
    add_model(parser)
    add_known(parser)
    parser.add_argument(
        "--save",
        type=output_file(".rrd"),
        metavar="FILE",
        help="write FILE.rrd, which rerun opens later, instead of opening the viewer",
    )
    add_overwrite(parser)


def run(args: argparse.Namespace) -> int:
    from contact_tracker.adaptation import OfflineTracker
    from contact_tracker.cli.source import Source
    from contact_tracker.recording import open_log, read_metadata, read_truth
    from contact_tracker.viewer.hull import vertices_from_metadata
    from contact_tracker.viewer.offline import open_viewer, write_rrd

    check_output(args.save, args.overwrite, files_read([args.log], args.model, args.known))
    tracker = OfflineTracker(model_of(args), knowledge_of(args))
    source = Source(open_log(args.log, args.topic, args.frame, relative_to=args.relative_to), args)
    truth, vertices_m = read_truth(args.log), vertices_from_metadata(read_metadata(args.log))
    with progress("segment", "poses", source.expected) as set_done:

        def found(poses: "Iterable[Pose]") -> "Iterator[Segmentation]":
            return source.counted(tracker.pieces(poses, set_done))

        if args.save is None:
            open_viewer(source, found, truth, vertices_m, paper=True)
        else:
            write_rrd(args.save, source, found, truth, vertices_m, paper=True)
    return source.finish(tracker.report)
