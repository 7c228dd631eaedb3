"""Worker processes of a command on this machine, which end with it.

``local_processes`` calls a function with many arguments: if a process ends, the job that it was working on is
known, and no other job is lost. ``helpers`` is an executor for a caller that submits work while it continues
to read; if one process ends early, the command fails. Both use one executor of the standard library for each
process.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain
from multiprocessing import active_children, get_context
from typing import Any, Final, NamedTuple, Protocol, TypeVar

from contact_tracker.errors import ContactTrackerError
from contact_tracker.interrupts import end_in_order, end_with_parent, kept_from_children

T = TypeVar("T")
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "POLARS_MAX_THREADS")
_AHEAD: Final = 2
"""Jobs that a process of a batch has at once, so that it can continue before its answer is collected."""
_MOST_DEATHS: Final = 2
"""A job is given up when this many processes have ended while working on it."""
_ENDED: Final = "a process has ended before its work was done: it may have taken too much memory"


class Killed(NamedTuple):
    """Replaces the answer to a job if the processes that worked on it have ended."""


KILLED: Final = Killed()


class Jobs(Protocol):
    """Calls a function with the arguments of each job; yields the arguments with the answer, in any order."""

    def __call__(
        self, function: Callable[..., T], jobs: Iterable[tuple[Any, ...]]
    ) -> Iterator[tuple[tuple[Any, ...], T | Killed]]: ...


@contextmanager
def helpers(count: int, prepare: Callable[[], None]) -> Iterator[Executor]:
    """An executor with ``count`` processes, which first call ``prepare``; they end with this context.

    Raises
    ------
    ContactTrackerError
        A process ended before its work was done.
    """
    _use_one_thread_each()
    executor = _Helpers()
    try:
        with kept_from_children():
            executor.start(count, prepare)
        yield executor
        executor.check()
    except BrokenProcessPool:
        for process in active_children():  # else an executor waits for one that it has just started
            process.kill()
        raise ContactTrackerError(f"{_ENDED}; try --processes 1") from None
    finally:
        executor.shutdown(cancel_futures=True)


class _Helpers(Executor):
    """One ``ProcessPoolExecutor`` for each process.

    A shared one iterates over its table of processes while it still adds to it, which fails if a process ends
    in the meantime.
    """

    def __init__(self) -> None:
        self._executors: list[ProcessPoolExecutor] = []
        self._futures: list[list[Future[Any]]] = []

    def start(self, count: int, prepare: Callable[[], None]) -> None:
        """Start ``count`` processes, without waiting for them."""
        for _ in range(count):
            executor = _executor_of_one(prepare)
            self._executors.append(executor)
            self._futures.append([executor.submit(int)])

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Submit to the process with the fewest unfinished calls."""
        self._futures = [[f for f in futures if not f.done()] for futures in self._futures]
        least = min(range(len(self._futures)), key=lambda number: len(self._futures[number]))
        future = self._executors[least].submit(fn, *args, **kwargs)
        self._futures[least].append(future)
        return future

    def check(self) -> None:
        """Wait until every process has answered; raise ``BrokenProcessPool`` if one has ended."""
        for future in [executor.submit(int) for executor in self._executors]:
            future.result()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all processes after their present call; without ``cancel_futures`` after all calls."""
        if cancel_futures:
            for future in chain.from_iterable(self._futures):
                future.cancel()
        for executor in self._executors:
            executor.shutdown(wait, cancel_futures=cancel_futures)


def _executor_of_one(prepare: Callable[[], None]) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, get_context("spawn"), _begin, (prepare,))


def _use_one_thread_each() -> None:
    """Processes that are started from now on use one thread each in numerics, unless the environment sets
    another number."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")


class Runner:
    """Runs a function on many arguments in ``processes`` (1: in this one); ``done`` is called after each.

    Other processes than this one first call ``prepare``.
    """

    def __init__(
        self,
        processes: int,
        done: Callable[[], None] | None = None,
        prepare: Callable[[], None] | None = None,
    ) -> None:
        self._processes = processes
        self._done = done or (lambda: None)
        self._prepare = prepare or _nothing

    def __call__(self, function: Callable[..., T], jobs: Sequence[tuple[Any, ...]]) -> list[T]:
        """Results in the order of ``jobs``; the first exception ends the others.

        Raises
        ------
        ContactTrackerError
            A process ended without an answer, for example because it took too much memory.
        """
        processes = min(self._processes, len(jobs))
        if processes <= 1:
            return [self._counted(function(*job)) for job in jobs]
        results = dict[int, T]()
        numbered = ((number, function, job) for number, job in enumerate(jobs))
        with local_processes(processes, self._prepare, most_deaths=1, ahead=1) as call:
            for (number, *_), answer in call(_numbered, numbered):
                if isinstance(answer, Killed):
                    raise ContactTrackerError(f"{_ENDED}; try fewer --processes")
                results[number] = self._counted(answer)
        return [results[number] for number in range(len(jobs))]

    def _counted(self, result: T) -> T:
        self._done()
        return result


def _numbered(_: int, function: Callable[..., T], arguments: tuple[Any, ...]) -> T:
    return function(*arguments)


def _nothing() -> None:
    """No preparation."""


@contextmanager
def local_processes(
    processes: int,
    prepare: Callable[[], None],
    most_deaths: int = _MOST_DEATHS,
    ahead: int = _AHEAD,
) -> Iterator[Jobs]:
    """Local processes, each of which first calls ``prepare``; they end with this context.

    A job is given up when ``most_deaths`` processes have ended while working on it; each process has up to
    ``ahead`` jobs.

    Raises
    ------
    ContactTrackerError
        A process ends as soon as it is started.
    """
    _use_one_thread_each()
    lanes = [_Lane() for _ in range(processes)]
    try:
        _start(lanes, prepare)
        yield lambda function, jobs: _answers(lanes, prepare, most_deaths, ahead, function, jobs)
    finally:
        with kept_from_children():  # an interrupt waits until they have ended
            for lane in lanes:
                lane.stop()
            for lane in lanes:
                lane.join()


@dataclass
class _Task:
    arguments: tuple[Any, ...]
    deaths: int = 0


class _Lane:
    """One process and its tasks, of which it is working on the first."""

    def __init__(self) -> None:
        self.tasks: deque[tuple[_Task, Future[Any]]] = deque()
        self._is_submitting = False
        self._executor: ProcessPoolExecutor | None = None
        self._started: Future[int] | None = None

    def begin(self, prepare: Callable[[], None]) -> None:
        """Start the process, without waiting for it."""
        self._executor = _executor_of_one(prepare)
        self._started = self._executor.submit(os.getpid)

    def wait_until_started(self) -> None:
        assert self._started is not None
        try:
            self._started.result()
        except BrokenProcessPool:
            reason = "as soon as it was started; there may be too little memory: try fewer --processes"
            raise ContactTrackerError(f"a process has ended before its work was done, {reason}") from None

    def give(self, task: _Task, function: Callable[..., Any]) -> bool:
        """Submit a task; returns False if the process has ended."""
        assert self._executor is not None
        self._is_submitting = True  # stays so if an interrupt comes before it is in ``tasks``
        try:
            self.tasks.append((task, self._executor.submit(_call, function, task.arguments)))
        except BrokenProcessPool:
            self._is_submitting = False
            return False
        self._is_submitting = False
        return True

    def stop(self) -> None:
        """Interrupt the process if it is working; ``join`` waits for its end."""
        is_working = self._is_submitting or any(not future.done() for _, future in self.tasks)
        if (
            is_working
            and self._started is not None
            and self._started.done()
            and self._started.exception() is None
        ):
            with suppress(OSError):
                os.kill(self._started.result(), signal.SIGTERM)

    def join(self) -> None:
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)


def _start(lanes: Iterable[_Lane], prepare: Callable[[], None]) -> None:
    with kept_from_children():
        for lane in lanes:
            lane.begin(prepare)
    for lane in lanes:
        lane.wait_until_started()


def _answers(
    lanes: list[_Lane],
    prepare: Callable[[], None],
    most_deaths: int,
    ahead: int,
    function: Callable[..., T],
    jobs: Iterable[tuple[Any, ...]],
) -> Iterator[tuple[tuple[Any, ...], T | Killed]]:
    source, again = iter(jobs), deque[_Task]()

    def fill() -> None:
        for many in range(1, ahead + 1):  # first one task for each
            for lane in lanes:
                while len(lane.tasks) < many:
                    task = again.popleft() if again else _next(source)
                    if task is None:
                        return
                    if lane.give(task, function):
                        continue
                    again.appendleft(task)
                    if lane.tasks:  # it has ended during one of them, which ``_collect`` handles
                        break
                    lane.join()
                    _start([lane], prepare)

    while True:
        fill()
        futures = [future for lane in lanes for _, future in lane.tasks]
        if not futures:
            return
        wait(futures, return_when=FIRST_COMPLETED)
        answers = list[tuple[tuple[Any, ...], T | Killed]]()
        for lane in lanes:
            answers += _collect(lane, prepare, most_deaths, again)
        fill()
        yield from answers


def _next(source: Iterator[tuple[Any, ...]]) -> _Task | None:
    arguments = next(source, None)
    return None if arguments is None else _Task(arguments)


def _collect(
    lane: _Lane, prepare: Callable[[], None], most_deaths: int, again: deque[_Task]
) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """The answers of a process; if it has ended, it is replaced and its tasks are queued in ``again``."""
    while lane.tasks and lane.tasks[0][1].done():
        task, future = lane.tasks[0]
        try:
            answer = future.result()
        except BrokenProcessPool:
            task.deaths += 1
            waiting = [other for other, _ in lane.tasks][1:]
            lane.tasks.clear()
            lane.join()
            _start([lane], prepare)
            if task.deaths >= most_deaths:
                yield task.arguments, KILLED
                again.extendleft(reversed(waiting))
            else:
                again.extendleft(reversed([task, *waiting]))
            return
        lane.tasks.popleft()
        yield task.arguments, answer


def _begin(prepare: Callable[[], None]) -> None:
    """Initialise a worker process."""
    end_in_order("SIGTERM")
    end_with_parent()
    prepare()


def _call(function: Callable[..., T], arguments: tuple[Any, ...]) -> T:
    try:
        return function(*arguments)
    except SystemExit as end:  # temporary files have been removed
        os._exit(int(end.code or 1))
