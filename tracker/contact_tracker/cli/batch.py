"""``contact-tracker batch``: many recordings into one dataset."""

import argparse
import os
import sys
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Final

from contact_tracker.batch.dataset import OWN_FILES, Batch, open_dataset
from contact_tracker.batch.finding import find, missing_among, pattern_beside, tables_beside
from contact_tracker.batch.lerobot import LeRobot
from contact_tracker.batch.segmenting import Settings
from contact_tracker.cli import inputs
from contact_tracker.cli.arguments import without
from contact_tracker.cli.terminal import progress, say, take_over_warnings, warn
from contact_tracker.errors import DAMAGED, DONE, UnreadableRecording, UsageError, extra
from contact_tracker.exports.formats import check_output
from contact_tracker.outputs.text import counted
from contact_tracker.processes import Jobs, Workers, local_processes
from contact_tracker.suggestions import near_file

_MOST_SHOWN: Final = 10
"""Largest number of printed errors of recordings."""
_MOST_KINDS: Final = 6
"""Largest number of printed kinds of warnings."""
_MOST_NAMED: Final = 3
"""Largest number of missing recordings that an error names."""
_NOTHING_THERE: Final = "no such file or folder"


def run(args: argparse.Namespace) -> int:
    if "://" in str(args.output):
        raise UsageError(
            f"cannot write {args.output}: a dataset is a folder of this machine or a shared disk"
        )
    if any(os.path.isfile(os.path.join(log, "meta", "info.json")) for log in args.logs):
        return _annotate(args)

    words = without(args.table.given[1:], ("output", "processes", "scheduler"), args.parsers[0])
    options = (word for word in words if word not in args.logs)
    table = replace(args.table, given=("batch", "-o", str(args.output), *options))
    settings = Settings(
        inputs.load_model(args),
        inputs.load_map(args),
        args.topic,
        args.frame,
        args.relative_to,
        args.ticks,
        table,
        args.wrench,
    )
    recordings = list(find(_names(args.logs)))
    read = [*(log.name for log in recordings), *inputs.files_read([], args.model, args.known)]
    for name in OWN_FILES:
        check_output(args.output / name, True, read)

    def report(line: str) -> None:
        if batch.bad + batch.damaged <= _MOST_SHOWN:
            warn(line)

    with (
        open_dataset(Path(os.path.abspath(args.output))) as dataset,
        progress("batch", "recordings", len(recordings)) as set_done,
    ):
        batch = Batch(settings, dataset, report, set_done)
        batch.run(recordings, lambda: _workers(args))
    if (more_bad := batch.bad + batch.damaged - _MOST_SHOWN) > 0:
        warn(f"{more_bad} more cannot be used or are damaged: the summary names them")
    say(
        f"recordings: {batch.total}, of which {batch.done} new or changed, "
        f"{batch.unchanged} unchanged; {batch.bad} unusable, {batch.damaged} damaged; "
        f"{args.output / 'summary.parquet'}"
    )
    if batch.warned:
        kinds = "; ".join(f"{kind} ({count})" for kind, count in batch.warnings.most_common(_MOST_KINDS))
        ellipsis = "; ..." if len(batch.warnings) > _MOST_KINDS else ""
        say(
            f"warnings: {batch.warned} of the new ones have some: {kinds}{ellipsis}: the column warnings of "
            "the summary has them in full"
        )
    return DAMAGED if batch.bad or batch.damaged else DONE


def _annotate(args: argparse.Namespace) -> int:
    """Write a copy of a LeRobot data set with the contacts of its frames."""
    unused = {"--topic": args.topic, "--frame": args.frame, "--ticks": args.ticks}
    unused |= {"--relative-to": args.relative_to, "--scheduler": args.scheduler}
    option = next((name for name, value in unused.items() if value not in (None, False)), None)
    if len(args.logs) > 1 or option is not None:
        raise UsageError(f"a LeRobot data set is segmented alone, without {option or 'other recordings'}")
    data = LeRobot.open(args.logs[0]).read_as(args.table)
    model, known_map = inputs.load_model(args), inputs.load_map(args)
    with Workers(args.processes or os.cpu_count() or 1, take_over_warnings) as executor:
        bad = data.annotate(args.output, model, known_map, warn, executor, args.wrench)
    episodes = counted(len(list(data.episodes())), "episode")
    say(f"wrote {args.output}: {episodes}, of which {bad} cannot be used")
    return DAMAGED if bad else DONE


def _names(logs: list[str]) -> list[str]:
    """The names of recordings in ``logs``; ``-`` stands for those on standard input, which are separated by
    newlines, or by NUL if the input has any.

    A list on standard input comes from another program, and some of its files may be gone: each of these gets
    a row. A missing LOG, or a list without any existing file, is a mistake in the call.

    Raises
    ------
    UnreadableRecording
        A LOG, or every file of the list on standard input, does not exist.
    UsageError
        Standard input has no names.
    """
    for log in logs:
        if tables := tables_beside(log):
            are = "table is" if len(tables) == 1 else "tables are"
            say(f"{log}: {len(tables)} {are} left out: name them, as {pattern_beside(tables[0])}")
    missing = missing_among(log for log in logs if log != "-")
    if address := next((log for log in missing if "://" in log), None):
        raise UsageError(
            f"{address}: addresses are not read: copy the recordings to a disk, or mount them there"
        )
    if missing:
        unnamed = f" and {len(missing) - _MOST_NAMED} more" if len(missing) > _MOST_NAMED else ""
        effect = "; nothing was segmented" if len(logs) > len(missing) else ""
        named = f"{', '.join(missing[:_MOST_NAMED])}{unnamed}: {_NOTHING_THERE}"
        is_pattern = any(mark in missing[0] for mark in "*?[")
        remedy = "; a shell replaces patterns without quotes" if is_pattern else near_file(missing[0])
        raise UnreadableRecording(f"{named}{remedy}{effect}")
    listed = _listed() if "-" in logs else []
    return [name for log in logs for name in (listed if log == "-" else [log])]


def _listed() -> list[str]:
    """The names on standard input."""
    data = sys.stdin.buffer.read()
    lines = data.split(b"\0") if b"\0" in data else data.splitlines()
    names = [os.fsdecode(line) for line in lines if line]
    if not names:
        raise UsageError("there are no names of recordings on standard input")
    if len(missing_among(names)) < len(names):
        return names
    if len(names) == 1:
        raise UnreadableRecording(f"{names[0]}: {_NOTHING_THERE}, the only name on standard input")
    raise UnreadableRecording(
        f"none of the {len(names)} names on standard input exists, such as {names[0]}; "
        f"relative ones start from {os.getcwd()}"
    )


def _workers(args: argparse.Namespace) -> AbstractContextManager[Jobs]:
    """The processes that segment recordings, on this machine or a cluster."""
    if args.scheduler is None:
        return local_processes(args.processes or os.cpu_count() or 1, take_over_warnings)
    with extra("cluster", "--scheduler"):
        from contact_tracker.batch.cluster import dask_cluster
    return dask_cluster(args.scheduler)
