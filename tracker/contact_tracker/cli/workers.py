"""Worker processes of one command."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from contact_tracker.cli.terminal import take_over_warnings

if TYPE_CHECKING:
    from concurrent.futures import Executor


def add_processes(parser: argparse.ArgumentParser) -> None:
    """``--processes``."""
    parser.add_argument(
        "--processes",
        type=_count,
        default=1,
        metavar="N",
        help="processes that fit segments in parallel; helps with recordings of many minutes (default: 1)",
    )


@contextmanager
def workers(processes: int) -> "Iterator[Executor | None]":
    """An executor with one process less than ``processes``, None without any; raises as
    ``processes.helpers``."""
    if processes == 1:
        yield None
        return
    from contact_tracker.processes import helpers

    with helpers(processes - 1, take_over_warnings) as executor:
        yield executor


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 64:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of processes, 1 to 64")
    return int(text)
