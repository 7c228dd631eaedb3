"""Jobs over recordings in processes, each with a pipe of its own: one that is ended holds up no other."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from contact_tracker.errors import ContactTrackerError
from contact_tracker.interrupts import kept_from_children

T = TypeVar("T")


class Runner:
    """Runs a function on many arguments in ``processes`` (1: in this one); ``done`` is called after each.

    ``prepare`` is what other processes than this one do first.
    """

    def __init__(
        self,
        processes: int,
        done: Callable[[], None] | None = None,
        prepare: Callable[[], None] | None = None,
    ) -> None:
        self._processes = processes
        self._done = done or (lambda: None)
        self._prepare = prepare

    def __call__(self, function: Callable[..., T], jobs: Sequence[tuple[Any, ...]]) -> list[T]:
        """Results in the order of ``jobs``; the first exception ends the others.

        Raises
        ------
        ContactTrackerError
            A process ended without an answer, as one does that takes too much memory.
        """
        processes = min(self._processes, len(jobs))
        if processes <= 1:
            return [self._told(function(*job)) for job in jobs]
        results: dict[int, T] = {}
        waiting = iter(range(len(jobs)))
        at_work: dict[Connection, int] = {}
        with _workers(processes, self._prepare) as pipes:
            idle = list(pipes)
            while len(results) < len(jobs):
                for pipe, number in zip(idle, waiting, strict=False):
                    at_work[pipe] = number
                    _ask(pipe, (function, jobs[number]))
                idle = [pipe for pipe in wait(list(at_work)) if isinstance(pipe, Connection)]
                for pipe in idle:
                    results[at_work.pop(pipe)] = self._told(_answer(pipe))
        return [results[number] for number in range(len(jobs))]

    def _told(self, result: T) -> T:
        self._done()
        return result


@contextmanager
def _workers(count: int, prepare: Callable[[], None] | None) -> Iterator[list[Connection]]:
    """Our ends of the pipes to so many processes, which end with this context."""
    for library in ("OMP", "OPENBLAS", "MKL"):  # as many processes as cores: each takes one
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    context = get_context("spawn")
    pipes, processes = [], []
    try:
        with kept_from_children():
            for _ in range(count):
                ours, theirs = context.Pipe()
                process = context.Process(target=_work, args=(theirs, prepare), daemon=True)
                process.start()
                theirs.close()  # or nobody would notice its end
                pipes.append(ours)
                processes.append(process)
        yield pipes
    finally:
        for process in processes:
            process.terminate()
            process.join()
        for pipe in pipes:
            pipe.close()


def _work(pipe: Connection, prepare: Callable[[], None] | None) -> None:
    """In a process of its own: jobs in, results or exceptions out, for ever."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the parent, which ends its children
    if prepare is not None:
        prepare()
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):  # whoever wants to know has ended
        while True:
            function, arguments = pipe.recv()
            try:
                answer: tuple[Any, Exception | None] = function(*arguments), None
            except Exception as error:
                answer = None, error
            pipe.send(answer)


def _ask(pipe: Connection, job: tuple[Callable[..., Any], tuple[Any, ...]]) -> None:
    with _both_alive():
        pipe.send(job)


def _answer(pipe: Connection) -> Any:
    with _both_alive():
        result, error = pipe.recv()
    if error is not None:
        raise error
    return result


@contextmanager
def _both_alive() -> Iterator[None]:
    try:
        yield
    except (EOFError, OSError):  # nothing of an answer, or a part of it
        reason = "it may have taken too much memory; try fewer --processes"
        raise ContactTrackerError(f"a process has ended before its work was done: {reason}") from None
