"""Batch jobs on a Dask cluster (extra ``cluster``)."""

from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from typing import Final

from distributed import Client, KilledWorker

from contact_tracker.errors import ContactTrackerError, UsageError
from contact_tracker.processes import Jobs, answered
from contact_tracker.version import __version__

_CONNECT_S: Final = 15
_LEAST_TASKS: Final = 64
_TASKS_PER_THREAD: Final = 3
"""Tasks per thread that are submitted at a time; at least ``_LEAST_TASKS`` in all."""


@contextmanager
def dask_cluster(address: str) -> Iterator[Jobs]:
    """The workers of the scheduler at ``address``, which must have access to the same files and dataset.

    Raises
    ------
    UsageError : there is no scheduler, or a worker has another version of this package or none.
    ContactTrackerError : the scheduler ends before the work is done.
    """
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UsageError(f"no Dask scheduler answers at {address}: {reason}") from error
    with client:
        try:
            versions = set(client.run(_version).values())
        except Exception as error:
            reason = " ".join(str(error).split())
            raise UsageError(f"a worker of {address} cannot import contact_tracker: {reason}") from error
        if mismatches := versions - {__version__}:
            raise UsageError(
                f"a worker of {address} has contact-tracker {mismatches.pop()}, this is {__version__}"
            )
        pool, threads = client.get_executor(pure=False), sum(client.nthreads().values())
        limit = max(_LEAST_TASKS, _TASKS_PER_THREAD * threads)
        try:
            yield lambda function, jobs: answered(pool, function, iter(jobs), limit, KilledWorker)
        except CancelledError:
            lost = f"the scheduler at {address} is gone: run the same once more to go on"
            raise ContactTrackerError(lost) from None


def _version() -> str:
    return __version__
