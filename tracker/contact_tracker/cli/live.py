"""``contact-tracker live``: the present contact, from past data only."""

import argparse
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Final

from contact_tracker.cli import arguments
from contact_tracker.cli.terminal import StatusLine, say
from contact_tracker.errors import DIFFERENT, DONE, INTERRUPTED, UsageError
from contact_tracker.exports.formats import TICKS, check_output, require_library
from contact_tracker.interrupts import SIGNALS, deferred
from contact_tracker.suggestions import near_file

if TYPE_CHECKING:
    from contact_tracker.cli.source import Source
    from contact_tracker.map.map import Map
    from contact_tracker.sequences.plan import Plan
    from contact_tracker.states import Contact
    from contact_tracker.tracking.belief import Belief
    from contact_tracker.tracking.informative_motion import InformativeMotion
    from contact_tracker.viewer.sinks import Sink
    from contact_tracker.viewer.views import LiveViewer

HELP: Final = "the present contact: a line per change while poses stream in"
DESCRIPTION: Final = """\
Follow the contacts in a recording or a stream of poses; each answer uses only the data up to its
time. A line per change goes to stdout: time, contact, probability, onset and place of the contact.
Times are seconds since the recording's first pose."""
_SUGGESTED_NS: Final = 3_000_000_000
"""Least time (ns) between suggestions for other states, in which a user can read and make the motions: with
half or double of it, 17 or 7 instead of 10 lines in 44 s of ``mug_first_take``, without it 50."""
EXAMPLE: Final = "contact-tracker live recordings/paper_experiment.mcap --json | head -n 1"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", metavar="LOG", help=arguments.LOG_HELP)
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


def run(args: argparse.Namespace) -> int:
    if args.state is None or not args.state.exists():
        if args.state is not None and (near := near_file(args.state)):
            say(f"{args.state} is new{near}")
        return _run(args)
    from contact_tracker.saved_state import continued

    with continued(args.state):
        return _run(args)


def _run(args: argparse.Namespace) -> int:
    if not args.web:
        return _follow(args, None)
    from contact_tracker.viewer.sinks import web_viewer

    with web_viewer() as (url, sink, wait):
        say(f"open {url} in a browser on this machine; Ctrl-C ends it")
        code = _follow(args, sink)
        if code < 128:  # no signal has ended the stream
            wait()
    return code


def _follow(args: argparse.Namespace, sink: "Sink | None") -> int:
    """Follow a stream and return the exit code; ``sink`` is the target of a view in a browser."""
    from contact_tracker.cli.source import SavedStream, Source, paced
    from contact_tracker.motion.poses import Poses
    from contact_tracker.recording import Follow
    from contact_tracker.tracker import Tracker

    model, known_map = arguments.load_model(args), arguments.load_map(args)
    if args.lag > model.search.window_s:
        raise UsageError(f"--lag is {model.search.window_s:g} s at most: older ticks are not estimated again")
    if args.suggest and args.lag:
        raise UsageError("--suggest is for the present contact: leave --lag out")
    if args.state is not None and (args.start or args.duration is not None):
        raise UsageError("--state resumes a whole stream: leave --start and --duration out")
    if args.state is not None and args.expect is not None:
        raise UsageError("--expect follows a plan from its first step: leave --state out")
    plan = None
    if args.expect is not None:
        from contact_tracker.sequences.plan import Plan

        plan = Plan.read(args.expect)
    read = [*arguments.files_read([args.log], args.model, args.known), *filter(None, [args.expect])]
    check_output(args.state, True, read)
    check = check_output(args.output, args.overwrite, read, written=[args.state])
    arguments.check_map_out(args, known_map)
    if args.output is not None:
        require_library(args.output)
    follow = Follow() if args.follow else None
    log = arguments.open_poses(args, args.log, follow, True)
    tracker = Tracker.start(model, args.lag, known_map, log.source.read_as)
    source, parts = Source(log, args.log, args), None
    if args.map_out is not None:
        from contact_tracker.outputs.parts import KnownParts

        parts = KnownParts()
    with (
        _viewer(args, known_map, source, sink) as viewer,
        StatusLine() as status,
        _ticks(args.output, source, check) as write,
    ):
        printer = _Printer(args.json, source, status, args.suggest, plan)
        saved = None
        if args.state is not None:
            saved = SavedStream(args.state, tracker, source, printer.changes, follow)
            tracker = saved.tracker

        def report(beliefs: "list[Belief]") -> None:
            if beliefs:
                source.warn_of_problems(tracker.report_so_far, beliefs[-1].stamp_ns)
                source.report_suspicion(beliefs[-1].stamp_ns, tracker.suspicions)
            for belief in beliefs:
                with deferred(*SIGNALS):  # so that the file has every printed belief, in full
                    motions = suggested() if belief is beliefs[-1] else ()  # for the newest belief only
                    printer.show(belief, motions)
                    if viewer is not None:
                        viewer.belief(belief, None if tracker.best is None else tracker.best.map)
                        if args.suggest:
                            viewer.suggest(belief.stamp_ns, next(iter(motions), None))
                    write([belief])

        def suggested() -> "tuple[InformativeMotion, ...]":
            if not args.suggest or tracker.best is None:
                return ()
            from contact_tracker.tracking.informative_motion import informative_motions

            return informative_motions(tracker.best)

        def has_to_end() -> bool:
            return saved is not None and saved.signal > 0

        stop_code = DONE
        try:
            arrivals = source.arrivals()
            for arrival in paced(arrivals, args.rate, has_to_end) if args.rate else arrivals:
                if saved is not None:
                    saved.begin_pose()
                if viewer is not None:
                    for pose in arrival.poses:
                        viewer.pose(pose)
                if parts is not None and arrival.poses:
                    parts.add_poses(Poses.collect(arrival.poses))
                report(tracker.update(arrival))
                if saved is not None and saved.end_pose():
                    stop_code = 128 + saved.signal
                    break
        except KeyboardInterrupt:
            stop_code = INTERRUPTED
        except SystemExit as exit_:  # another signal
            stop_code = int(exit_.code or DONE)
        if saved is None:
            report(tracker.finish())
        else:
            saved.save()
    code = source.finish(tracker.report, tracker.outliers, tracker.late)
    if parts is not None:
        arguments.write_map(args.map_out, parts.learned(None if tracker.best is None else tracker.best.map))
    if code == DONE and printer.has_left:
        code = DIFFERENT
    return code if stop_code == DONE else stop_code


def _viewer(
    args: argparse.Namespace, known_map: "Map", source: "Source", sink: "Sink | None"
) -> "AbstractContextManager[LiveViewer | None]":
    if sink is None and not args.rerun:
        return nullcontext()
    from contact_tracker.recording import read_metadata
    from contact_tracker.trajectory import vertices_from_metadata
    from contact_tracker.viewer.views import LiveViewer

    vertices_m = vertices_from_metadata(read_metadata(args.log))
    return LiveViewer(vertices_m, sink, lambda: source.log.origin_ns, known_map)


def _ticks(
    path: Path | None, source: "Source", check: Callable[[], None]
) -> "AbstractContextManager[Callable[[list[Belief]], None]]":
    """A context with the function that writes beliefs to the output file of all ticks, if any."""
    if path is None:
        return nullcontext(lambda _: None)
    from contact_tracker.exports.formats import open_rows

    return open_rows(path, "ticks", lambda: source.log.origin_ns, check)


class _Printer:
    """Prints each belief as JSON, or a line when it is news (``Changes``)."""

    def __init__(
        self, as_json: bool, source: "Source", status: StatusLine, suggests: bool, plan: "Plan | None"
    ) -> None:
        from contact_tracker.outputs.text import Changes
        from contact_tracker.sequences.plan import PlanFollower

        self._follower = None if plan is None else PlanFollower(plan)
        self.changes = Changes()
        self._as_json = as_json
        self._source = source
        self._status = status
        self._suggests = suggests
        self._suggested: set[frozenset[Contact]] = set()
        self._suggest_from_ns = -(2**63)

    @property
    def has_left(self) -> bool:
        """Whether the stream has left its plan, if any."""
        return self._follower is not None and self._follower.has_left

    def show(self, belief: "Belief", motions: "tuple[InformativeMotion, ...]") -> None:
        """Print a belief and the suggested ``motions``."""
        from contact_tracker.exports.formats import json_line
        from contact_tracker.outputs.text import CHANGES_HEADER, change_lines, status_text

        is_first, origin_ns = self.changes.label is None, self._source.log.origin_ns
        changes = self.changes.update(belief)
        progress = None if self._follower is None else self._follower.update(belief)
        if self._as_json:
            keys: dict[str, object] = {}
            if self._suggests:
                keys["suggestions"] = [motion.to_json() for motion in motions]
            if progress is not None:
                keys["plan"] = progress.to_json()
            self._status.print(json_line(belief, keys))
        else:
            lines = [CHANGES_HEADER] if is_first and changes[0] else []
            lines += change_lines(belief, *changes, origin_ns)
            at = f"{(belief.stamp_ns - origin_ns) * 1e-9:8.2f}  "
            if self._follower is not None and (text := self._follower.news):
                lines.append(f"{at}plan: {text}")
            if self._is_news(motions, belief.stamp_ns):
                lines.append(f"{at}to decide, {'; '.join(map(str, motions))}")
            for line in lines:
                self._status.print(line)
        self._status.show(lambda: status_text(belief, origin_ns))

    def _is_news(self, motions: "tuple[InformativeMotion, ...]", stamp_ns: int) -> bool:
        """Whether the first of the ``motions``, the most informative one, is for states for which none is
        printed, not more often than ``_SUGGESTED_NS``."""
        states = [motion.states for motion in motions]
        self._suggested &= {*states}
        if not states or states[0] in self._suggested or stamp_ns < self._suggest_from_ns:
            return False
        self._suggest_from_ns = stamp_ns + _SUGGESTED_NS
        self._suggested |= {*states}
        return True
