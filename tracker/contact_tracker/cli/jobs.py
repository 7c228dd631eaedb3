"""Input and output of each of several recordings, or of several objects in one."""

import argparse
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from contact_tracker.errors import UsageError

PLACE: Final = "{}"
"""Placeholder for the name of a recording, and of an object, in an output's name."""


@dataclass(frozen=True)
class Job:
    """One recording and source. ``name`` is unique among the jobs; ``output`` None is stdout, and
    ``other_outputs`` are those of the other jobs."""

    log: str
    topic: str | None
    frame: str | None
    name: str
    output: Path | None
    other_outputs: tuple[Path, ...] = ()

    def arguments(self, args: argparse.Namespace) -> argparse.Namespace:
        """``args`` for this job alone."""
        return argparse.Namespace(**{**vars(args), **vars(self)})


def jobs_of(args: argparse.Namespace) -> list[Job]:
    """A job for each of ``args.logs``, with ``args.all`` for each source of poses in each of them.

    Raises
    ------
    UsageError
        Two jobs have the same output, or a recording that can be read only once is needed twice.
    InputError
        With ``args.all``, a recording cannot be read or has no source of poses.
    """
    if len(args.logs) > 1 and "-" in args.logs:
        raise UsageError("standard input is read alone, without other recordings")
    found = [job for log in args.logs for job in (_objects(log, args) if args.all else _whole(log, args))]
    outputs = [job.output for job in found if job.output is not None]
    if len(found) > 1 and args.output is not None and PLACE not in str(args.output):
        raise UsageError(
            f"{len(found)} outputs cannot all be {args.output}: write {PLACE} where the name of each goes, "
            f"as in {args.output.with_stem(PLACE)}"
        )
    if doubled := {str(output) for output in outputs if outputs.count(output) > 1}:
        raise UsageError(f"several recordings would be written to {min(doubled)}: take them one by one")
    return [
        replace(one, other_outputs=tuple(each for each in outputs if each != one.output)) for one in found
    ]


def _whole(log: str, args: argparse.Namespace) -> Iterator[Job]:
    yield Job(log, args.topic, args.frame, log, _output(args.output, [_stem(log)]))


def _objects(log: str, args: argparse.Namespace) -> Iterator[Job]:
    from contact_tracker.errors import ChoiceError, NoPoses
    from contact_tracker.recording import list_sources

    if log == "-":
        raise UsageError("--all reads a recording twice: name a file, not -")
    sources = [s for s in list_sources(log, args.table) if args.topic is None or s.topic == args.topic]
    sources = [s for s in sources if args.frame is None or s.is_named(args.frame)]
    if not sources:
        fault = NoPoses if args.topic is None and args.frame is None else ChoiceError
        raise fault(f"{log}: no such source of poses; contact-tracker info shows what is in it")
    for source in sources:
        body = source.child_frame_id or source.topic
        output = _output(args.output, [_stem(log), body])
        yield Job(log, f"{source.topic}:{source.type}", source.frames or None, f"{log} {source}", output)


def _stem(log: str) -> str:
    return "stdin" if log == "-" else Path(os.path.realpath(log)).stem


def _output(pattern: Path | None, names: Iterable[str]) -> Path | None:
    if pattern is None:
        return None
    plain = "-".join(re.sub(r"[^\w.-]+", "_", name).strip("_") for name in names)
    return Path(str(pattern).replace(PLACE, plain))
