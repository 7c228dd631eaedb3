"""Batch jobs on a Dask cluster (extra ``cluster``)."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any, Final, TypeVar

from distributed import Client, KilledWorker, as_completed

from contact_tracker import __version__
from contact_tracker.errors import ContactTrackerError, UsageError
from contact_tracker.processes import Jobs

T = TypeVar("T")
_CONNECT_S: Final = 15
_LEAST: Final = 64
_AHEAD: Final = 3
"""Tasks per thread that are submitted at a time, at least ``_LEAST``, instead of all at once."""
_LOOK_EVERY_S: Final = 10.0


@contextmanager
def dask_cluster(address: str) -> Iterator[Jobs]:
    """The workers of the scheduler at ``address``, which must have access to the same files and dataset.

    Raises
    ------
    UsageError
        There is no scheduler, or a worker has another version of this package or none.
    """
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UsageError(f"no Dask scheduler answers at {address}: {reason}") from error
    with client:
        _check_versions(client, address)
        yield lambda function, jobs: _answers(client, address, function, jobs)


def _version() -> str:
    from contact_tracker import __version__ as there

    return there


def _check_versions(client: Client, address: str) -> None:
    try:
        found = set(client.run(_version).values())
    except Exception as error:
        reason = " ".join(str(error).split())
        raise UsageError(f"a worker of {address} cannot import contact_tracker: {reason}") from error
    if others := found - {__version__}:
        raise UsageError(f"a worker of {address} has contact-tracker {others.pop()}, this is {__version__}")


def _answers(
    client: Client, address: str, function: Callable[..., T], jobs: Iterable[tuple[Any, ...]]
) -> Iterator[tuple[tuple[Any, ...], T | None]]:
    source, at_work = iter(jobs), dict[Any, tuple[Any, ...]]()
    finished = as_completed(loop=client.loop)
    window, next_look_s = _LEAST, 0.0

    def fill() -> None:
        nonlocal window, next_look_s
        if time.monotonic() >= next_look_s:
            window = max(_LEAST, _AHEAD * sum(client.nthreads().values()))
            next_look_s = time.monotonic() + _LOOK_EVERY_S
        for arguments in islice(source, window - len(at_work)):
            future = client.submit(function, *arguments, pure=False)
            at_work[future.key] = arguments
            finished.add(future)

    fill()
    for future in finished:
        arguments = at_work.pop(future.key)
        error = future.exception() if future.status == "error" else None
        answer: T | None = None
        if future.status == "finished":
            answer = future.result()
        elif isinstance(error, Exception):
            if not isinstance(error, KilledWorker):
                raise error
        else:
            raise ContactTrackerError(f"the scheduler at {address} is gone: run the same once more to go on")
        future.release()
        fill()
        yield arguments, answer
