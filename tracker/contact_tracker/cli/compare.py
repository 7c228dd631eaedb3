"""``contact-tracker compare``: two takes of one task, step by step."""

import argparse
import json

from contact_tracker.cli import inputs
from contact_tracker.cli.source import Source
from contact_tracker.cli.terminal import say, show, warn
from contact_tracker.errors import DIFFERENT, DONE, UsageError
from contact_tracker.exports.formats import check_output
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.sequences.comparison import TOLERANCE, compare_outcomes


def run(args: argparse.Namespace) -> int:
    if "-" in (args.log, args.second):
        raise UsageError("compare reads two files or folders, not -")
    read = inputs.files_read([args.log, args.second], args.model, args.known)
    check = check_output(args.output, args.overwrite, read)

    model, known_map = inputs.load_model(args), inputs.load_map(args)
    sources = [Source(inputs.open_poses(args, log), log, args) for log in (args.log, args.second)]
    trajectories = [source.trajectory() for source in sources]  # both, before the work on one
    takes, codes = list[Outcome](), list[int]()
    for source, trajectory in zip(sources, trajectories, strict=True):
        takes.append(source.segment(trajectory, model, known_map, f"{source.name}: segment"))
        codes.append(source.finish(takes[-1].report, takes[-1].segmentation.outliers))
    result = compare_outcomes(takes[0], takes[1], TOLERANCE if args.tolerance is None else args.tolerance)
    for note in result.notes:
        warn(note)
    if args.json:
        show(json.dumps(result.to_json(), allow_nan=False))
    else:
        for line in result.lines():
            show(line)
    if args.output is not None:
        from contact_tracker.exports.sequence_figures import write_comparison

        write_comparison(result, args.output, check)
        say(f"wrote {args.output}")
    return codes[0] or codes[1] or (DIFFERENT if result.differences else DONE)
