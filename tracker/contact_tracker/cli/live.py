"""``contact-tracker live``: what holds now, from the data up to now."""

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from contact_tracker.cli.arguments import add_model, add_recording, model_of, positive, seconds
from contact_tracker.cli.known import add_known, knowledge_of
from contact_tracker.cli.status import INTERRUPTED
from contact_tracker.cli.terminal import StatusLine
from contact_tracker.errors import UsageError

if TYPE_CHECKING:
    from contact_tracker.cli.source import Source
    from contact_tracker.tracking.belief import Belief
    from contact_tracker.viewer.null_viewer import LiveView

HELP: Final = "what holds now: a line per change while poses stream in"
DESCRIPTION: Final = """\
Follow the contacts of a recording or of a stream of poses, each answer from the data up to its
time only. A line per change goes to stdout: time, contact, probability, onset and where the
contact lies. Times are seconds since the recording's first pose."""
EXAMPLE: Final = "contact-tracker live recordings/paper_experiment.mcap --json | head -n 1"


def configure(parser: argparse.ArgumentParser) -> None:
    add_recording(parser)
    add_model(parser)
    add_known(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object per tick instead")
    parser.add_argument("--rate", type=positive, metavar="X", help="replay at X times the recorded speed")
    parser.add_argument(
        "--lag",
        type=seconds,
        default=0.0,
        metavar="S",
        help="speak of S seconds ago, and know better (default: 0, of now)",
    )
    parser.add_argument("--follow", action="store_true", help="wait for more at the end of a growing file")
    parser.add_argument("--rerun", action="store_true", help="show it in the rerun viewer as well")


def run(args: argparse.Namespace) -> int:
    from contact_tracker import adaptation
    from contact_tracker.cli.source import Source, paced
    from contact_tracker.recording import Follow, open_log

    model, knowledge = model_of(args), knowledge_of(args)
    if args.lag > model.search.window_s:
        raise UsageError(
            f"--lag is {model.search.window_s:g} s at most: what is older is not looked at again"
        )
    state = adaptation.start(model, args.lag, knowledge)
    log = open_log(args.log, args.topic, args.frame, Follow() if args.follow else None, count_late=True)
    source = Source(log, args)
    interrupted = False
    with _viewer(args) as viewer, StatusLine() as status:
        show = _shower(args.json, source, status)

        def say(beliefs: "list[Belief]") -> None:
            for belief in beliefs:
                show(belief)
                viewer.belief(belief)

        try:
            for pose in paced(source, args.rate) if args.rate else source:
                viewer.pose(pose)
                state, beliefs = adaptation.advance(state, pose)
                say(beliefs)
        except KeyboardInterrupt:
            interrupted = True
        state, beliefs = adaptation.finish(state)
        say(beliefs)
    source.outliers = state.outliers
    code = source.finish(adaptation.report(state))
    return INTERRUPTED if interrupted else code


def _viewer(args: argparse.Namespace) -> "LiveView":
    from contact_tracker.viewer.null_viewer import NoViewer

    if not args.rerun:
        return NoViewer()
    from contact_tracker.recording import read_metadata
    from contact_tracker.viewer.hull import vertices_from_metadata
    from contact_tracker.viewer.live import LiveViewer

    return LiveViewer(vertices_from_metadata(read_metadata(args.log)))


def _shower(as_json: bool, source: "Source", status: StatusLine) -> "Callable[[Belief], None]":
    """What to do with each belief: a JSON line, or a line where the contact changed or became settled."""
    from contact_tracker.outputs.tables import json_line
    from contact_tracker.outputs.text import CHANGES_HEADER, change_line, is_settled, status_text

    previous, settled = None, False

    def show(belief: "Belief") -> None:
        nonlocal previous, settled
        changed, settles = belief.contact is not previous, is_settled(belief)
        if as_json:
            status.print(json_line(belief))
        elif changed or (settles and not settled):
            if previous is None:
                status.print(CHANGES_HEADER)
            status.print(change_line(belief, source.origin_ns))
        previous, settled = belief.contact, settles or (settled and not changed)
        status.show(lambda: status_text(belief, source.origin_ns))

    return show
