"""Items of recordings: messages, poses in columns, attachments and metadata; and sources of poses."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from itertools import count
from typing import Final, NamedTuple

from mcap.records import Attachment, Metadata

from contact_tracker.motion.poses import AS_GIVEN, Poses, ReadAs

BELIEF_TOPIC: Final = "/contact/belief"
FRAMES_TOPIC: Final = "/contact/frames"
SCENE_TOPIC: Final = "/contact/scene"
TASK_TOPIC: Final = "/contact/task_frame"
MAP_TOPIC: Final = "/contact/map"
RESULT_TOPICS: Final = frozenset({BELIEF_TOPIC, FRAMES_TOPIC, SCENE_TOPIC, MAP_TOPIC, TASK_TOPIC})
ROWS: Final = "contact_tracker/pose_row"
"""The encoding of channels whose poses come in columns, as from tables."""
ROWS_AT_ONCE: Final = 10_000
"""Number of rows of a table that are read together; as many poses read ahead are always enough."""
BUFFER_BYTES: Final = 2**23
"""Total size (bytes) above which no more messages are read ahead."""
_PENDING_BYTES: Final = 8 * BUFFER_BYTES
_MESSAGE_BYTES: Final = 245
"""Memory of a buffered message besides its data (bytes), by tracemalloc."""


@dataclass(frozen=True)
class Channel:
    """A topic with its message type: name, encoding and text of the schema."""

    topic: str
    encoding: str
    type: str
    schema_encoding: str
    schema: bytes


@dataclass(frozen=True, order=True)
class PoseSource:
    """One stream of poses.

    Parameters
    ----------
    messages : number of messages on its topic, if the index has it.
    assumed : why the known definition of the type is used instead of that in the file, in words; else empty.
    """

    topic: str
    type: str
    frame_id: str
    child_frame_id: str
    messages: int | None = field(default=None, compare=False)
    read_as: ReadAs = field(default=AS_GIVEN, compare=False)
    assumed: str = field(default="", compare=False)

    @property
    def frames(self) -> str:
        """``parent->child``, or the one frame of a type without child."""
        return f"{self.frame_id}->{self.child_frame_id}" if self.child_frame_id else self.frame_id

    def __str__(self) -> str:
        return f"{self.topic} {self.frames or '(no frame)'} ({self.type})"

    def is_named(self, frame: str) -> bool:
        """Whether ``--frame`` names this source: ``parent->child``, the child, or the frame of a childless
        type."""
        return frame in (self.frames, self.child_frame_id or self.frame_id)


class RawMessage(NamedTuple):
    """An undecoded message."""

    channel: Channel
    log_time_ns: int
    data: bytes


class Rows(NamedTuple):
    """Poses in columns with the source of each, row by row; their stamps are their log times."""

    sources: Sequence[PoseSource]
    poses: Poses


Item = RawMessage | Rows | Attachment | Metadata


def in_log_order(chunks: Iterable[tuple[int, Iterable[Item]]]) -> Iterator[Item]:
    """The messages of all chunks by log time; other items at once.

    Each chunk comes with a lower bound of its log times (ns), in the order of these bounds. Messages are
    buffered as long as later chunks may have earlier ones, up to 64 MB.
    """
    pending, pending_bytes, number = list[tuple[int, int, RawMessage]](), 0, count()
    for begin_ns, items in chunks:
        while pending and (pending[0][0] < begin_ns or pending_bytes > _PENDING_BYTES):
            _, _, earliest = heappop(pending)
            pending_bytes -= len(earliest.data) + _MESSAGE_BYTES
            yield earliest
        for item in items:
            if isinstance(item, RawMessage):
                heappush(pending, (item.log_time_ns, next(number), item))
                pending_bytes += len(item.data) + _MESSAGE_BYTES
            else:
                yield item
    while pending:
        yield heappop(pending)[2]
