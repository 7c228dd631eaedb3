"""``contact-tracker compare``: two takes of one task, step by step."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from contact_tracker.cli import inputs
from contact_tracker.cli.arguments import without
from contact_tracker.cli.source import Source
from contact_tracker.cli.terminal import say, show, warn
from contact_tracker.config.table_reading import TableReading
from contact_tracker.errors import DAMAGED, DIFFERENT, DONE, ChoiceError, InputError, UsageError
from contact_tracker.exports.formats import check_output
from contact_tracker.saved_result import SUFFIX, read_result
from contact_tracker.sequences.comparison import TOLERANCE, compare_outcomes
from contact_tracker.trajectory import Trajectory

_OF_POSES: Final = ("topic", "frame", "relative_to")
"""Options about the poses of a recording, beside those of tables."""
_OWN: Final = ("tolerance", "json", "output", "overwrite")
"""Options that ``segment`` does not have, or not for the result of one take."""


def run(args: argparse.Namespace) -> int:
    logs = list(dict.fromkeys((args.log, args.second)))
    if "-" in logs:
        raise UsageError("compare reads two files or folders, not -")
    read = inputs.files_read(logs, args.model, args.known)
    check = check_output(args.output, args.overwrite, read)
    saved = [log for log in logs if log.lower().endswith(SUFFIX)]
    words = without(args.table.given[1:], (*_OWN, "verbosity", "wide"), args.parsers[0])
    if saved == logs and (args.table.words() or not {*words} <= {*logs, "--"}):
        raise UsageError("saved results are compared as they are: give options of poses to segment")

    model, known_map = inputs.load_model(args), inputs.load_map(args)
    takes, codes = {log: read_result(Path(log)) for log in saved}, [DONE]
    for log, take in takes.items():
        codes.append(DONE if take.trajectory.damage is None else DAMAGED)
        for line in take.warnings:
            warn(f"{log}: {line}")
    for source, trajectory in _read_all(args, [log for log in logs if log not in saved]):
        take = takes[source.name] = source.segment(trajectory, model, known_map, f"{source.name}: segment")
        codes.append(source.finish(take.report, take.segmentation.outliers))
    tolerance = TOLERANCE if args.tolerance is None else args.tolerance
    result = compare_outcomes(takes[args.log], takes[args.second], tolerance)
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
    return max(codes) or (DIFFERENT if result.differences else DONE)


def _read_all(args: argparse.Namespace, logs: Sequence[str]) -> list[tuple[Source, Trajectory]]:
    """The poses of all recordings, before the work on one. Options hold for all: if they fit all but one, the
    error has the commands for that one."""
    read, faults = list[tuple[Source, Trajectory]](), dict[str, Exception]()
    for log in logs:
        try:
            read.append(_read(args, log))
        except (InputError, UsageError) as error:
            faults[log] = error
    for log, fault in faults.items():
        raise _with_commands(args, log, fault) if read else fault
    return read


def _read(args: argparse.Namespace, log: str) -> tuple[Source, Trajectory]:
    source = Source(inputs.open_poses(args, log), log, args)
    return source, source.trajectory()


def _with_commands(args: argparse.Namespace, log: str, fault: Exception) -> Exception:
    """The ``fault`` of a recording to which the options do not fit, with the commands that save and compare
    its result; the fault itself if the options are not to blame."""
    saved, words = f"{Path(log).stem}{SUFFIX}", args.table.given[1:]
    options = without(words, (*_OF_POSES, *_OWN), args.parsers[0])
    alone = ("segment", log, "-o", saved, *(word for word in options if word not in (args.log, args.second)))
    table = TableReading(given=alone)
    try:
        _read(argparse.Namespace(**vars(args) | dict.fromkeys(_OF_POSES) | {"table": table}), log)
        text = f"{fault}: options hold for both takes. Segment {log} without them: {table.command(log)}"
    except (InputError, UsageError) as error:
        if "contact-tracker segment" not in str(error):
            return fault
        text = str(error)
    given = (args.table.given[0], *(saved if word == log else word for word in words))
    return ChoiceError(f"{text}; then compare its result: {replace(args.table, given=given).command(log)}")
