"""``contact-tracker info``: the pose sources of a recording, and their quality."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from contact_tracker.cli import inputs
from contact_tracker.cli.terminal import show, warn
from contact_tracker.config.loading import load_model
from contact_tracker.errors import DAMAGED, DONE, NoPoses, UsageError
from contact_tracker.outputs.adaptation import summary_json, summary_lines
from contact_tracker.recording import PoseSource, SourceSummary, open_log, summarise, summarise_log
from contact_tracker.tracker import BATCH_POSES, Tracker
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.filter_bank import Report

_ONCE: Final = "composing poses reads the recording twice, which standard input does not allow"
TRACKED_SOURCES: Final = 4
"""Largest number of sources whose adaptation is computed, which takes seconds each."""
MOST_UPDATES: Final = 1300
"""Approximate limit of the updates (ticks times trackers) of all sources together: some 2 s of CPU time. The
first 30 s of a source usually need fewer."""


def run(args: argparse.Namespace) -> int:
    if args.relative_to is not None and args.log == "-":
        raise UsageError(_ONCE)
    summary = summarise(args.log, args.table)
    chosen = [source for source in summary.sources if _is_chosen(source, args)]
    if summary.sources and (not chosen or args.relative_to is not None):
        chosen = [_composed(args)]
    summary = replace(summary, sources=tuple(chosen))
    tracked = [source for source in summary.sources if source.poses][:TRACKED_SOURCES]
    reports = _reports(tracked)
    losses = [f"{source.source}: {source.loss}" for source in summary.sources if source.loss is not None]
    for line in losses:
        warn(f"{args.log}: {line}")
    if args.json:
        show(json.dumps(summary_json(summary, reports), indent=1, allow_nan=False))
    else:
        for line in summary_lines(summary, reports):
            show(line)
    for line in summary.assumptions:
        warn(f"{args.log}: {line}")
    if summary.damage is not None:
        warn(f"{args.log}: {summary.damage}")
    if not summary.sources and args.log != "-":
        open_log(args.log, table=args.table)  # raises an error with the reason
    if not any(source.poses for source in summary.sources):
        raise NoPoses(f"{args.log}: no pose in it that can be used")
    return DONE if summary.damage is None and not losses else DAMAGED


def _composed(args: argparse.Namespace) -> SourceSummary:
    """The source composed of transforms between the requested frames; raises ChoiceError if there is none."""
    if args.log == "-":
        raise UsageError(f"no pose source is published with this topic and frame; {_ONCE}")
    return summarise_log(inputs.open_poses(args, args.log))


def _is_chosen(source: SourceSummary, args: argparse.Namespace) -> bool:
    """Whether a source has the requested topic and frame."""
    on_topic = args.topic is None or source.source.topic == args.topic
    return on_topic and (args.frame is None or source.source.is_named(args.frame))


def _reports(sources: Sequence[SourceSummary]) -> dict[PoseSource, Report | None]:
    """The default tracker's adaptation to the first valid poses of each source; all sources together take
    about ``MOST_UPDATES`` at most."""
    reports, remaining = dict[PoseSource, "Report | None"](), MOST_UPDATES
    for number, source in enumerate(sources):
        share = remaining // (len(sources) - number)
        tracker, used = Tracker.start(load_model(), read_as=source.source.read_as), 0
        start = 0
        for start in range(0, len(source.beginning), BATCH_POSES):
            beliefs = tracker.add(source.beginning[start : start + BATCH_POSES], Detail.WEIGHTS)
            used += len(beliefs) * len(tracker.filters.filters)
            if used >= share:
                break
        remaining -= used
        tracker.inspect_added()
        is_part = min(start + BATCH_POSES, len(source.beginning)) < source.poses
        reports[source.source] = tracker.report_of_part if is_part else tracker.report
    return reports
