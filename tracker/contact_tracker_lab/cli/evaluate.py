"""``contact-tracker evaluate``: the tracker's accuracy on recordings with ground truth."""

import argparse
from functools import partial
from typing import TYPE_CHECKING, Final

from contact_tracker.cli import arguments
from contact_tracker.cli.terminal import progress, say, show, warn
from contact_tracker.errors import DAMAGED, DONE, UsageError

if TYPE_CHECKING:
    from contact_tracker_lab.evaluation.evaluate import Evaluation

HELP: Final = "compare with the truth that recordings carry, or with your own labels"
DESCRIPTION: Final = """\
Segment recordings and compare with the truth in them, offline and online side by side: accuracy,
F1, confusion, boundaries, delays, calibration and geometry, for each recording and in total. These
score the contact at each time, the first one if there are several. --labels FILE compares with your
own labels, which may be coarse, as touch and no touch. With --relative-to the truth of elements, which
is in the frame of the recording, is not used."""
EXAMPLE: Final = "contact-tracker evaluate recordings/"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("logs", nargs="+", metavar="LOG", type=arguments.recording, help=arguments.LOGS_HELP)
    arguments.add_recording(parser, has_interval=False)
    arguments.add_wrench(parser)
    arguments.add_labels(parser, "your own labels of one LOG")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of tables")


def run(args: argparse.Namespace) -> int:
    from contact_tracker.cli import inputs
    from contact_tracker.motion.poses import Poses
    from contact_tracker.recording import need_truth
    from contact_tracker.segmenting import segmented
    from contact_tracker.trajectory import Trajectory
    from contact_tracker_lab.evaluation.evaluate import answers_to, evaluate
    from contact_tracker_lab.evaluation.report import Report

    model, known_map = inputs.load_model(args), inputs.load_map(args)
    names = inputs.recordings_in(args.logs, "evaluate")
    if args.labels is not None and len(names) != 1:
        raise UsageError(f"--labels are of one recording, and there are {len(names)}")
    if args.meaning and args.labels is None:
        raise UsageError("--meaning is of use with --labels only")
    evaluations = dict[str, "Evaluation"]()

    def evaluate_recording(name: str) -> int:
        selection = name, args.topic, args.frame, args.table
        truth = need_truth(*selection) if args.labels is None else inputs.load_labels(args, name)
        if args.relative_to is not None and any(interval.geometry for interval in truth.intervals):
            frames = f"in the recording's frame, not that of --relative-to {args.relative_to}"
            warn(f"{name}: elements are not compared: the truth has them {frames}")
            truth = truth.without_geometry()
        wrenches = inputs.load_wrenches(name, args, model, known_map)
        log = inputs.open_poses(args, name)
        arrivals = [*log.arrivals()]
        poses = Poses.collect(pose for arrival in arrivals for pose in arrival.poses)
        if not len(poses):
            raise log.no_poses(name)
        trajectory = Trajectory.from_log(log, name, poses, True)
        with progress(name, "poses", len(poses)) as set_done:
            result = segmented(trajectory, model, known_map, wrenches, progress=set_done)
        for line in result.warnings:
            warn(f"{name}: {line}")
        answers = answers_to(arrivals, model, known_map, log.source.read_as)
        evaluations[name] = evaluate(poses, truth, result.segmentation, answers)
        return DONE if log.damage is None else DAMAGED

    codes = list(inputs.run_each(partial(evaluate_recording, name) for name in names))
    if args.wrench is not None and evaluations:
        say("the online figures are those of the motion alone: wrenches are used offline")
    if evaluations:
        report = Report(evaluations)
        show(report.to_json() if args.json else report.to_text())
    unusable = [code for code in codes if code not in (DONE, DAMAGED)]
    return unusable[-1] if unusable else max(codes, default=DONE)
