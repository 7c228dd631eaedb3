"""``contact-tracker info``: which poses a recording holds, and how good they are."""

import argparse
import json
from typing import TYPE_CHECKING, Final

from contact_tracker.cli.status import DAMAGED, DONE
from contact_tracker.cli.terminal import show, warn
from contact_tracker.errors import NoPoses

if TYPE_CHECKING:
    from contact_tracker.adaptation import Report
    from contact_tracker.recording import SourceSummary

HELP: Final = "which poses are in a recording, and how good they are"
DESCRIPTION: Final = """\
List the sources of poses in a recording with their topics, frames, rates, gaps and estimated
noise, and whatever else the recording holds."""
EXAMPLE: Final = "contact-tracker info recordings/vision_30hz.mcap"
MOST_POSES: Final = 20_000


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", metavar="LOG", help="an MCAP file, a folder of its parts, or - for stdin")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of text")


def run(args: argparse.Namespace) -> int:
    from dataclasses import replace

    from contact_tracker.adaptation import Report
    from contact_tracker.outputs.summary import summary_json, summary_lines
    from contact_tracker.recording import PoseSource, summarise

    summary, reports = summarise(args.log), dict[PoseSource, Report | None]()
    if args.log != "-":  # stdin cannot be read again
        sources = [_with_noise(args.log, s) if s.poses else (s, None) for s in summary.sources]
        summary = replace(summary, sources=tuple(source for source, _ in sources))
        reports = {source.source: adapted for source, adapted in sources}
    if args.json:
        show(json.dumps(summary_json(summary, reports), indent=1, allow_nan=False))
    else:
        for line in summary_lines(summary, reports):
            show(line)
    if summary.damage is not None:
        warn(f"{args.log}: {summary.damage}")
    if not any(source.poses for source in summary.sources):
        raise NoPoses(f"{args.log}: no pose in it that can be used")
    return DONE if summary.damage is None else DAMAGED


def _with_noise(path: str, summary: "SourceSummary") -> "tuple[SourceSummary, Report | None]":
    """``summary`` with the sensor noise, and what the default tracker adapts to: by the first valid poses."""
    from dataclasses import replace
    from itertools import islice

    from contact_tracker import adaptation
    from contact_tracker.config.loading import load_model
    from contact_tracker.motion.poses import Poses
    from contact_tracker.motion.sensor_noise import estimate_noise
    from contact_tracker.recording import open_log
    from contact_tracker.tracking.belief import Detail

    log = open_log(path, summary.source.topic, summary.source.frames)
    poses = Poses.collect(islice(log, MOST_POSES))
    log.close()
    position_m, rotation_rad = estimate_noise(poses)
    state, _ = adaptation.advance(adaptation.start(load_model()), poses, Detail.WEIGHTS)
    summary = replace(summary, sigma_position_m=position_m, sigma_rotation_rad=rotation_rad)
    return summary, adaptation.report(state)
