"""Messages in the order in which they were logged, from chunks that overlap in time."""

from collections.abc import Iterable, Iterator
from heapq import heappop, heappush
from itertools import count
from typing import Final

from contact_tracker.recording.items import Item, RawMessage

_PENDING_BYTES: Final = 256 * 2**20


def in_log_order(chunks: Iterable[tuple[int, Iterable[Item]]]) -> Iterator[RawMessage]:
    """The messages of all chunks by their log time.

    Chunks come with the time in nanoseconds before which none of their messages was logged, in the order of
    these times. Messages are held as long as chunks to come may have earlier ones, up to 256 MB of them.
    """
    pending, pending_bytes, number = list[tuple[int, int, RawMessage]](), 0, count()
    for begin_ns, items in chunks:
        while pending and (pending[0][0] < begin_ns or pending_bytes > _PENDING_BYTES):
            _, _, earliest = heappop(pending)
            pending_bytes -= len(earliest.data)
            yield earliest
        for item in items:
            if isinstance(item, RawMessage):
                heappush(pending, (item.log_time_ns, next(number), item))
                pending_bytes += len(item.data)
    while pending:
        yield heappop(pending)[2]
