"""Processes that help one command: they start when it begins and end with it."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from contact_tracker.cli.terminal import take_over_warnings
from contact_tracker.errors import ContactTrackerError
from contact_tracker.interrupts import end_with_parent, kept_from_children

if TYPE_CHECKING:
    from concurrent.futures import Executor


def add_processes(parser: argparse.ArgumentParser) -> None:
    """``--processes``."""
    parser.add_argument(
        "--processes",
        type=_count,
        default=1,
        metavar="N",
        help="others fit the elements of segments while one reads on; helps with recordings of many minutes "
        "(default: 1)",
    )


@contextmanager
def workers(processes: int) -> "Iterator[Executor | None]":
    """One less than ``processes``, None without any.

    Raises
    ------
    ContactTrackerError
        One ended before its work was done.
    """
    if processes == 1:
        yield None
        return
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import active_children, get_context

    executor = ProcessPoolExecutor(processes - 1, get_context("spawn"), _begin)
    try:
        with kept_from_children():
            for _ in range(processes - 1):
                executor.submit(int)  # starts one
        yield executor
    except BrokenProcessPool:
        for process in active_children():  # the executor waits for one that it started meanwhile
            process.kill()
        reason = "it may have taken too much memory; try --processes 1"
        raise ContactTrackerError(f"a process has ended before its work was done: {reason}") from None
    finally:
        executor.shutdown(cancel_futures=True)


def _begin() -> None:
    """In a process of its own."""
    take_over_warnings()
    end_with_parent()


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 64:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of processes, 1 to 64")
    return int(text)
