"""Sorting of messages by log time, from chunks that overlap in time."""

from collections.abc import Iterable, Iterator
from heapq import heappop, heappush
from itertools import count
from typing import Final

from contact_tracker.recording.items import BUFFER_BYTES, Item, RawMessage

_PENDING_BYTES: Final = 8 * BUFFER_BYTES


def in_log_order(chunks: Iterable[tuple[int, Iterable[Item]]]) -> Iterator[RawMessage]:
    """The messages of all chunks by log time.

    Each chunk comes with a lower bound of its log times (ns), in the order of these bounds. Messages are
    buffered as long as later chunks may have earlier ones, up to 64 MB.
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
