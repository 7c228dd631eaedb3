"""The function of a batch in processes of this machine; one that is killed costs what it was doing, no more.

Each process has an executor of its own: when it ends, it is certain which recording it was at.
"""

import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, Final, NamedTuple, Protocol, TypeVar

from contact_tracker.errors import ContactTrackerError
from contact_tracker.interrupts import end_with_parent, kept_from_children

T = TypeVar("T")
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "POLARS_MAX_THREADS")
_AHEAD: Final = 2
"""Jobs that a process has at once: the next one waits for no answer."""
_MOST_DEATHS: Final = 2
"""A job during which so many processes have ended is given up."""


class Killed(NamedTuple):
    """Instead of an answer: the processes that were to give it have ended."""


KILLED: Final = Killed()


class Jobs(Protocol):
    """Calls a function with the arguments of each job, and gives these with the answer, in any order."""

    def __call__(
        self, function: Callable[..., T], jobs: Iterable[tuple[Any, ...]]
    ) -> Iterator[tuple[tuple[Any, ...], T | Killed]]: ...


@contextmanager
def local_processes(processes: int, prepare: Callable[[], None]) -> Iterator[Jobs]:
    """So many processes of this machine, which first ``prepare``; they end with this context.

    Raises
    ------
    ContactTrackerError
        One cannot even start.
    """
    for name in _THREADS:  # as many processes as cores: each takes one
        os.environ.setdefault(name, "1")
    lanes = [_Lane() for _ in range(processes)]
    try:
        _start(lanes, prepare)
        yield lambda function, jobs: _answers(lanes, prepare, function, jobs)
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
    """One process and the tasks that it was given, the first of which it is at."""

    def __init__(self) -> None:
        self.tasks: deque[tuple[_Task, Future[Any]]] = deque()
        self._is_given_one = False
        self._executor: ProcessPoolExecutor | None = None
        self._started: Future[int] | None = None

    def begin(self, prepare: Callable[[], None]) -> None:
        """Start the process, without waiting for it."""
        self._executor = ProcessPoolExecutor(1, get_context("spawn"), _begin, (prepare,))
        self._started = self._executor.submit(os.getpid)

    def wait_until_started(self) -> None:
        assert self._started is not None
        try:
            self._started.result()
        except BrokenProcessPool:
            reason = "there may be too little memory; try fewer --processes"
            raise ContactTrackerError(f"a process ended as soon as it was started: {reason}") from None

    def give(self, task: _Task, function: Callable[..., Any]) -> bool:
        """Whether the process has taken it; else it has ended."""
        assert self._executor is not None
        self._is_given_one = True  # stays so if an interrupt comes before it is in ``tasks``
        try:
            self.tasks.append((task, self._executor.submit(_call, function, task.arguments)))
        except BrokenProcessPool:
            self._is_given_one = False
            return False
        self._is_given_one = False
        return True

    def stop(self) -> None:
        """End the process in the middle of what it is at; ``join`` waits for it."""
        is_at_work = self._is_given_one or any(not future.done() for _, future in self.tasks)
        if (
            is_at_work
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
    function: Callable[..., T],
    jobs: Iterable[tuple[Any, ...]],
) -> Iterator[tuple[tuple[Any, ...], T | Killed]]:
    source, again = iter(jobs), deque[_Task]()

    def fill() -> None:
        for _ in range(_AHEAD):
            for lane in lanes:
                while len(lane.tasks) < _AHEAD:
                    task = again.popleft() if again else _next(source)
                    if task is None:
                        return
                    if lane.give(task, function):
                        continue
                    again.appendleft(task)
                    if lane.tasks:  # it has ended at one of them, which is found out when that is collected
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
            answers += _collect(lane, prepare, again)
        fill()
        yield from answers


def _next(source: Iterator[tuple[Any, ...]]) -> _Task | None:
    arguments = next(source, None)
    return None if arguments is None else _Task(arguments)


def _collect(
    lane: _Lane, prepare: Callable[[], None], again: deque[_Task]
) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """The answers of a process; if it has ended, another takes its place, and its tasks come ``again``."""
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
            if task.deaths >= _MOST_DEATHS:
                yield task.arguments, KILLED
                again.extendleft(reversed(waiting))
            else:
                again.extendleft(reversed([task, *waiting]))
            return
        lane.tasks.popleft()
        yield task.arguments, answer


def _begin(prepare: Callable[[], None]) -> None:
    """In a process of its own."""
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    end_with_parent()
    prepare()


def _call(function: Callable[..., T], arguments: tuple[Any, ...]) -> T:
    try:
        return function(*arguments)
    except SystemExit as leave:  # what was begun is cleared away
        os._exit(int(leave.code or 1))
