"""Worker processes of a command on this machine, which end with it."""

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import get_context, parent_process, resource_tracker
from typing import Any, Final, Protocol, TypeVar

from contact_tracker.errors import ContactTrackerError
from contact_tracker.interrupts import deferred, end_in_order

T = TypeVar("T")
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_MOST_DEATHS: Final = 2
"""A call is given up when this many processes have ended while working on it."""
_ENDED: Final = "a process has ended before its work was done"


class Killed(ContactTrackerError):
    """The processes that worked on a call have ended."""


class Jobs(Protocol):
    """Calls a function with the arguments of each job; yields the arguments with the answer, in any order.

    The answer is None if the processes that worked on the job have ended.
    """

    def __call__(
        self, function: Callable[..., T], jobs: Iterable[tuple[Any, ...]]
    ) -> Iterator[tuple[tuple[Any, ...], T | None]]: ...


class Workers(Executor):
    """An executor with up to ``count`` processes, which first call ``prepare``.

    Each process has a thread of this one that starts it and waits for it. A process that ends is replaced,
    and its call is repeated once. If the context ends by an error, running calls are interrupted.
    """

    def __init__(self, count: int, prepare: Callable[[], None]) -> None:
        for name in _THREADS:  # one thread each in numerics, unless the environment says otherwise
            os.environ.setdefault(name, "1")
        self._prepare = prepare
        self._own = threading.local()
        self._lock = threading.Lock()
        self._processes: dict[int, ProcessPoolExecutor] = {}
        self._is_ended = False
        if os.name == "posix":
            resource_tracker.ensure_running()  # starting it later would unblock interrupts
        self._threads = ThreadPoolExecutor(count, initializer=_leave_interrupts_to_the_main_thread)

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Schedule a call. Its result is ``Killed`` if two processes have ended during it."""
        return self._threads.submit(self._call, fn, args, kwargs)

    def _call(self, function: Callable[..., T], arguments: tuple[Any, ...], options: dict[str, Any]) -> T:
        was_started = False
        for _ in range(_MOST_DEATHS):
            pid: int | None = getattr(self._own, "pid", None)
            try:
                if pid is None:
                    pid = self._start()
                was_started = True
                with self._lock:
                    if self._is_ended:
                        break
                    future = self._processes[pid].submit(_run, function, arguments, options)
                return future.result()
            except BrokenProcessPool:
                self._own.pid = None
                if self._is_ended:
                    break
                if pid is not None:
                    with self._lock:
                        ended = self._processes.pop(pid)
                    ended.shutdown()
        if was_started:
            raise Killed(f"{_ENDED}; it may have taken too much memory: try fewer --processes")
        reason = "as soon as it was started; there may be too little memory: try fewer --processes"
        raise ContactTrackerError(f"{_ENDED}, {reason}")

    def _start(self) -> int:
        """Start this thread's process; returns its id."""
        executor = ProcessPoolExecutor(1, get_context("spawn"), _begin, (self._prepare,))
        pid = self._own.pid = executor.submit(os.getpid).result()
        with self._lock:
            self._processes[pid] = executor
        return pid

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all processes after their calls; with ``cancel_futures`` at once."""
        with deferred("SIGINT"):
            if cancel_futures:
                self._threads.shutdown(wait=False, cancel_futures=True)
                with self._lock:
                    self._is_ended = True
                    for pid in self._processes:
                        with suppress(OSError):
                            os.kill(pid, signal.SIGTERM)
            self._threads.shutdown(wait)
            for executor in self._processes.values():
                executor.shutdown(wait)

    def __exit__(self, *error: Any) -> None:
        self.shutdown(cancel_futures=error[0] is not None)


@contextmanager
def local_processes(processes: int, prepare: Callable[[], None]) -> Iterator[Jobs]:
    """Local processes, each of which first calls ``prepare``; they end with this context.

    Raises
    ------
    ContactTrackerError
        A process ends as soon as it is started.
    """

    def answers(
        function: Callable[..., T], jobs: Iterable[tuple[Any, ...]]
    ) -> Iterator[tuple[tuple[Any, ...], T | None]]:
        waiting, at_work = iter(jobs), dict[Future[T], tuple[Any, ...]]()
        while True:
            for arguments in islice(waiting, 2 * processes - len(at_work)):
                at_work[workers.submit(function, *arguments)] = arguments
            if not at_work:
                return
            for future in wait(at_work, return_when=FIRST_COMPLETED).done:
                arguments = at_work.pop(future)
                yield arguments, None if isinstance(future.exception(), Killed) else future.result()

    with Workers(processes, prepare) as workers:
        yield answers


class Runner:
    """Runs a function on many arguments in ``processes`` (1: in this one); ``done`` is called after each.

    Other processes than this one first call ``prepare``.
    """

    def __init__(
        self,
        processes: int,
        done: Callable[[], None] = lambda: None,
        prepare: Callable[[], None] | None = None,
    ) -> None:
        self._processes = processes
        self._done = done
        self._prepare = prepare or _nothing

    def __call__(self, function: Callable[..., T], jobs: Sequence[tuple[Any, ...]]) -> list[T]:
        """Results in the order of ``jobs``; the first exception ends the others.

        Raises
        ------
        ContactTrackerError
            Two processes ended without an answer to a job, for example because it took too much memory.
        """
        processes = min(self._processes, len(jobs))
        if processes <= 1:
            return [self._counted(function(*job)) for job in jobs]
        with Workers(processes, self._prepare) as workers:
            return [self._counted(result) for result in workers.map(function, *zip(*jobs, strict=True))]

    def _counted(self, result: T) -> T:
        self._done()
        return result


def _nothing() -> None:
    """No preparation."""


def _leave_interrupts_to_the_main_thread() -> None:
    """Block interrupts in this thread, and in the processes that it starts.

    A terminal interrupts all processes of a command, but only one of them has to end the others.
    """
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _begin(prepare: Callable[[], None]) -> None:
    """Initialise a worker process."""
    end_in_order("SIGTERM")
    threading.Thread(target=_end_with_parent, daemon=True).start()
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
        os._exit(int(end.code or 1))
