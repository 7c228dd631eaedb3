"""``contact-tracker live``: the present contact, from past data only."""

import argparse
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from contact_tracker.cli import inputs
from contact_tracker.cli.source import SavedStream, Source, paced
from contact_tracker.cli.terminal import StatusLine, say
from contact_tracker.errors import DIFFERENT, DONE, INTERRUPTED, UsageError
from contact_tracker.exports.formats import check_output, json_line, open_rows
from contact_tracker.interrupts import SIGNALS, deferred
from contact_tracker.map.map import Map
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs.parts import KnownParts
from contact_tracker.outputs.text import CHANGES_HEADER, Changes, change_lines, status_text
from contact_tracker.recording import Follow, read_metadata
from contact_tracker.saved_state import continued
from contact_tracker.sequences.plan import Plan, PlanFollower
from contact_tracker.states import Contact
from contact_tracker.suggestions import near_file
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.informative_motion import InformativeMotion, informative_motions
from contact_tracker.trajectory import vertices_from_metadata

if TYPE_CHECKING:
    from contact_tracker.viewer.sinks import Sink
    from contact_tracker.viewer.views import LiveViewer

_SUGGESTED_NS: Final = 3_000_000_000
"""Least time (ns) between suggestions for other states, in which a user can read and make the motions: with
half or double of it, 17 or 7 instead of 10 lines in 44 s of ``mug_first_take``, without it 50."""


def run(args: argparse.Namespace) -> int:
    is_resumed = args.state is not None and args.state.exists()
    if args.state is not None and not is_resumed and (near := near_file(args.state)):
        say(f"{args.state} is new{near}")
    with continued(args.state if is_resumed else None):
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
    model, known_map = inputs.load_model(args), inputs.load_map(args)
    if args.lag > model.search.window_s:
        raise UsageError(f"--lag is {model.search.window_s:g} s at most: older ticks are not estimated again")
    if args.suggest and args.lag:
        raise UsageError("--suggest is for the present contact: leave --lag out")
    if args.state is not None and (args.start or args.duration is not None):
        raise UsageError("--state resumes a whole stream: leave --start and --duration out")
    if args.state is not None and args.expect is not None:
        raise UsageError("--expect follows a plan from its first step: leave --state out")
    plan = None if args.expect is None else Plan.read(args.expect)
    read = [*inputs.files_read([args.log], args.model, args.known), *filter(None, [args.expect])]
    check_output(args.state, True, read)
    check = check_output(args.output, args.overwrite, read, written=[args.state])
    inputs.check_map_out(args, known_map)
    follow = Follow() if args.follow else None
    log = inputs.open_poses(args, args.log, follow, True)
    tracker = Tracker.start(model, args.lag, known_map, log.source.read_as)
    source, parts = Source(log, args.log, args), None if args.map_out is None else KnownParts()
    origin_ns = partial(getattr, log, "origin_ns")
    write_to: Any = nullcontext(lambda _: None)
    if args.output is not None:
        write_to = open_rows(args.output, "ticks", origin_ns, check)
    with _viewer(args, known_map, origin_ns, sink) as viewer, StatusLine() as status, write_to as write:
        printer = _Printer(args.json, source, status, args.suggest, plan)
        saved = None
        if args.state is not None:
            saved = SavedStream(args.state, tracker, source, printer.changes, follow)
            tracker = saved.tracker

        def report(beliefs: list[Belief]) -> None:
            if beliefs:
                source.warn_of_problems(tracker.report_so_far, beliefs[-1].stamp_ns)
                source.report_suspicion(beliefs[-1].stamp_ns, tracker.suspicions)
            for belief in beliefs:
                with deferred(*SIGNALS):  # so that the file has every printed belief, in full
                    best, motions = tracker.best, tuple[InformativeMotion, ...]()
                    if args.suggest and best is not None and belief is beliefs[-1]:
                        motions = informative_motions(best)
                    printer.show(belief, motions)
                    if viewer is not None:
                        viewer.belief(belief, None if best is None else best.map)
                        if args.suggest:
                            viewer.suggest(belief.stamp_ns, next(iter(motions), None))
                    write([belief])

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
        inputs.write_map(args.map_out, parts.learned(None if tracker.best is None else tracker.best.map))
    if code == DONE and printer.has_left:
        code = DIFFERENT
    return code if stop_code == DONE else stop_code


def _viewer(
    args: argparse.Namespace, known_map: Map, origin_ns: Callable[[], int], sink: "Sink | None"
) -> "AbstractContextManager[LiveViewer | None]":
    if sink is None and not args.rerun:
        return nullcontext()
    from contact_tracker.viewer.views import LiveViewer

    vertices_m = vertices_from_metadata(read_metadata(args.log))
    return LiveViewer(vertices_m, sink, origin_ns, known_map)


class _Printer:
    """Prints each belief as JSON, or a line when it is news (``Changes``)."""

    def __init__(
        self, as_json: bool, source: Source, status: StatusLine, suggests: bool, plan: Plan | None
    ) -> None:
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

    def show(self, belief: Belief, motions: tuple[InformativeMotion, ...]) -> None:
        """Print a belief and the suggested ``motions``."""
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

    def _is_news(self, motions: tuple[InformativeMotion, ...], stamp_ns: int) -> bool:
        """Whether the first of the ``motions``, the most informative one, is for states for which none is
        printed, not more often than ``_SUGGESTED_NS``."""
        states = [motion.states for motion in motions]
        self._suggested &= {*states}
        if not states or states[0] in self._suggested or stamp_ns < self._suggest_from_ns:
            return False
        self._suggest_from_ns = stamp_ns + _SUGGESTED_NS
        self._suggested |= {*states}
        return True
