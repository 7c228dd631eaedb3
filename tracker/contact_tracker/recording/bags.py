"""ROS bags that are not MCAP: recognising and reading them."""

from collections.abc import Callable, Iterator
from typing import Final

from contact_tracker.recording.items import Channel, RawMessage
from contact_tracker.recording.limits import WorkBudget

_SQLITE: Final = b"SQLite format 3\0"
_BAG: Final = b"#ROSBAG V"


def is_bag(begin: bytes) -> bool:
    """Whether a file with these first bytes is a ``.db3`` or a ``.bag`` file."""
    return begin.startswith((_SQLITE, _BAG))


def read_bag(
    path: str, wanted: Callable[[Channel], bool], report: Callable[[str], None], budget: WorkBudget
) -> Iterator[RawMessage]:
    """The messages of a ``.bag`` or a ``.db3`` file by log time.

    Parameters
    ----------
    wanted : messages of other channels are skipped unread.
    report : called with one line for each part that cannot be read.
    budget : bounds the decompressed size and the work.

    Raises
    ------
    UnreadableRecording
        It is not a valid bag.
    """
    with open(path, "rb") as file:
        is_sqlite = file.read(len(_SQLITE)) == _SQLITE
    if is_sqlite:
        from contact_tracker.recording.sqlite_bag import read_sqlite

        return read_sqlite(path, wanted, report, budget)
    from contact_tracker.recording.rosbag1 import read_rosbag1

    return read_rosbag1(path, wanted, report, budget)
