"""Worker processes of a command on this machine; they end with the command."""

import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from itertools import islice
from multiprocessing import get_context, parent_process, resource_tracker
from typing import Any, Final, TypeVar

from contact_tracker.errors import ContactTrackerError
from contact_tracker.interrupts import deferred, end_in_order

T = TypeVar("T")
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
MOST_WORKERS: Final = 61 if os.name == "nt" else 1024
"""Largest number of processes; on Windows the library refuses more."""
_ENDED: Final = "a process has ended before its work was done; it may have taken too much memory: try fewer"

Jobs = Callable[[Callable[..., Any], Iterable[tuple[Any, ...]]], Iterator[tuple[tuple[Any, ...], Any]]]
"""Calls a function with the arguments of each job; yields the arguments with the answer, in any order. The
answer is None if the processes that worked on the job have ended."""


class Workers(ProcessPoolExecutor):
    """Up to ``count`` processes, at most ``MOST_WORKERS``, which first call ``prepare`` and end with this
    context.

    If the context ends by an error, running calls are interrupted. Workers block interrupts, which a terminal
    sends to all processes: this process ends them.

    Raises
    ------
    ContactTrackerError
        At the end of the context: a process was killed.
    """

    def __init__(self, count: int, prepare: Callable[[], None] | None = None) -> None:
        for name in _THREADS:  # one numerical thread each, unless the environment sets it
            os.environ.setdefault(name, "1")
        if os.name == "posix":
            resource_tracker.ensure_running()  # starting it later would unblock interrupts
        super().__init__(min(count, MOST_WORKERS), get_context("spawn"), _begin, (prepare,))

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Schedule a call, which may start a process."""
        if not hasattr(signal, "pthread_sigmask"):
            return super().submit(_run, fn, args, kwargs)
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(_run, fn, args, kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def __exit__(self, *error: Any) -> None:
        with deferred("SIGINT"):
            for process in [*(self._processes or {}).values()] if error[0] is not None else ():
                process.terminate()
            self.shutdown(cancel_futures=error[0] is not None)
        if isinstance(error[1], BrokenProcessPool):
            raise ContactTrackerError(f"{_ENDED} --processes")


@contextmanager
def local_processes(processes: int, prepare: Callable[[], None]) -> Iterator[Jobs]:
    """A context of local processes, each of which first calls ``prepare``; they end with the context.

    If a process is killed, the jobs at work in all of them are done again, one at a time in a single process.
    A job during which this process is killed as well has no answer.

    Raises
    ------
    ContactTrackerError
        A process ends as soon as it is started.
    """

    def answers(
        function: Callable[..., T], jobs: Iterable[tuple[Any, ...]]
    ) -> Iterator[tuple[tuple[Any, ...], T | None]]:
        waiting = iter(jobs)
        while lost := (yield from answered(start(processes), function, waiting, 2 * processes)):
            while lost:
                worker = start(1)
                worker.submit(os.getpid).result()  # else a failed start would seem to be the job's fault
                retried = iter(lost)
                for job in (yield from answered(worker, function, retried, 1)):
                    yield job, None
                worker.shutdown()
                lost = [*retried]

    def start(count: int) -> Workers:
        return stack.enter_context(Workers(count, prepare))

    with ExitStack() as stack:
        yield answers


def answered(
    pool: Executor,
    function: Callable[..., T],
    waiting: Iterator[tuple[Any, ...]],
    most: int,
    killed: type[Exception] = BrokenProcessPool,
) -> Generator[tuple[tuple[Any, ...], T | None], None, list[tuple[Any, ...]]]:
    """Yield answers until no job is ``waiting`` or the pool is broken; return the jobs that are then at work.

    Parameters
    ----------
    most : largest number of jobs at work.
    killed : an error of this type is the answer None.
    """
    at_work = dict[Future[T], tuple[Any, ...]]()
    while True:
        for arguments in islice(waiting, most - len(at_work)):
            try:
                at_work[pool.submit(function, *arguments)] = arguments
            except BrokenProcessPool:
                return [*at_work.values(), arguments]
        if not at_work:
            return []
        ended = wait(at_work, return_when=FIRST_COMPLETED).done
        broken = {future for future in ended if isinstance(future.exception(), BrokenProcessPool)}
        for future in ended - broken:
            yield at_work.pop(future), None if isinstance(future.exception(), killed) else future.result()
        if broken:
            return [*at_work.values()]


def _begin(prepare: Callable[[], None] | None) -> None:
    """Initialise a worker process."""
    end_in_order("SIGTERM")
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare()


def _end_with_parent() -> None:
    """End with the parent, even if that is killed; otherwise this process would wait for work forever."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run(function: Callable[..., T], arguments: tuple[Any, ...], options: dict[str, Any]) -> T:
    try:
        return function(*arguments, **options)
    except SystemExit as end:  # temporary files have been removed
        if isinstance(end.code, str):
            raise
        os._exit(int(end.code or 1))
