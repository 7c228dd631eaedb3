"""Jobs over recordings, each in a process of its own."""

import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import active_children, get_context
from typing import Any, TypeVar

T = TypeVar("T")


class Runner:
    """Runs a function on many arguments in ``processes`` (1: in this one); ``done`` is told after each."""

    def __init__(self, processes: int, done: Callable[[], None] | None = None) -> None:
        self._processes = processes
        self._done = done or (lambda: None)

    def __call__(self, function: Callable[..., T], jobs: Sequence[tuple[Any, ...]]) -> list[T]:
        """Results in the order of ``jobs``; the first exception ends the others."""
        if min(self._processes, len(jobs)) <= 1:
            return [self._told(function(*job)) for job in jobs]
        for library in ("OMP", "OPENBLAS", "MKL"):  # as many processes as cores: each takes one
            os.environ.setdefault(f"{library}_NUM_THREADS", "1")
        context = get_context("spawn")
        with ProcessPoolExecutor(self._processes, context, initializer=_leave_interrupts) as pool:
            try:
                futures = [pool.submit(function, *job) for job in jobs]
                for future in as_completed(futures):
                    self._told(future.result())
            except BaseException:  # nobody waits for what is still running
                for child in active_children():
                    child.terminate()
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        return [future.result() for future in futures]

    def _told(self, result: T) -> T:
        self._done()
        return result


def _leave_interrupts() -> None:
    """An interrupt is for the parent, which ends its children."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
