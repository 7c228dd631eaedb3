"""ROS bags and message definitions other than ros2msg, by rosbags: rosbag1, SQLite rosbag2, ros1 and IDL."""

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.extras import MissingExtra, need
from contact_tracker.recording.items import Channel, RawMessage
from contact_tracker.recording.message_types import canonical

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

SQLITE_MAGIC: Final = b"SQLite format 3\0"
BAG_MAGIC: Final = b"#ROSBAG V2.0"
_RULE: Final = "=" * 80 + "\n"
_HEADER: Final = "std_msgs/msg/Header"
_MOST_VALUES: Final = 2**20
"""A sequence in a message is no longer."""


def definition_of_idl(text: str, type_name: str) -> str:
    """A ROS 2 definition in IDL as ros2msg has it; raises what the text leads rosbags to."""
    typesys = need("rosbags.typesys", "ros2idl")
    types: dict[str, Any] = {}
    for part in text.split(_RULE):
        if part.strip():
            types |= typesys.get_types_from_idl(part.partition("\n")[2] if part.startswith("IDL: ") else part)
    return _definition(_store(types), canonical(type_name))


def ros1_reading(text: str, type_name: str) -> tuple[str, Callable[[bytes], bytes]]:
    """The ros2msg definition of a ROS 1 type, and what makes CDR of its messages; raises what the text leads
    rosbags to."""
    typesys = need("rosbags.typesys", "ROS 1")
    name = canonical(type_name)
    types = typesys.get_types_from_msg(text, name)
    if _HEADER in types:  # rosbags makes the header of ROS 2 of it, which has no ``seq``
        constants, fields = types[_HEADER]
        types[_HEADER] = constants, [field for field in fields if field[0] != "seq"]
    store = _store(types)
    return _definition(store, name), lambda data: bytes(store.ros1_to_cdr(data, name))


def _store(types: dict[str, Any]) -> "Typestore":
    typesys = need("rosbags.typesys", "a ROS type")
    store: Typestore = typesys.get_typestore(typesys.Stores.EMPTY)
    store.max_sequence_length = _MOST_VALUES
    store.register(types)
    return store


def _definition(store: "Typestore", name: str) -> str:
    return store.generate_msgdef(name, ros_version=2)[0]


def is_bag(begin: bytes) -> bool:
    """Whether a file that begins so is a ``.db3`` or a ``.bag`` file."""
    return begin.startswith((SQLITE_MAGIC, BAG_MAGIC))


def read_bag(
    path: str, wanted: Callable[[Channel], bool], report: Callable[[str], None]
) -> Iterator[RawMessage]:
    """The messages of a ``.bag`` or a ``.db3`` file in the order of their log time.

    Parameters
    ----------
    wanted : messages of other channels are skipped unread.
    report : is told in a line what ended the file early.

    Raises
    ------
    UnreadableRecording
        It cannot be opened.
    """
    with open(path, "rb") as file:
        is_sqlite = file.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC
    with ExitStack() as stack:
        try:
            reader = stack.enter_context(_reader(path, is_sqlite))
            channels = {c.id: _channel(c, is_sqlite) for c in reader.connections}
        except MissingExtra:
            raise
        except Exception as error:  # it raises whatever a damaged file leads it to
            raise UnreadableRecording(f"it cannot be opened as a ROS bag: {_line(error)}") from error
        chosen = [c for c in reader.connections if wanted(channels[c.id])]
        if not chosen:
            return
        messages = reader.messages(chosen)
        while True:
            try:
                connection, log_time_ns, data = next(messages)
            except StopIteration:
                return
            except Exception as error:
                report(f"it is damaged: {_line(error)}")
                return
            yield RawMessage(channels[connection.id], log_time_ns, data)


def _reader(path: str, is_sqlite: bool) -> "AbstractContextManager[Any]":
    if is_sqlite:
        storage = need("rosbags.rosbag2.storage_sqlite3", "a .db3 file")
        # The path becomes part of an address there.
        return _opened(storage.Sqlite3Reader(Path(quote(os.path.abspath(path)))))
    reader: AbstractContextManager[Any] = need("rosbags.rosbag1", "a .bag file").Reader(path)
    return reader


@contextmanager
def _opened(reader: Any) -> Iterator[Any]:
    """A reader that has ``open`` and ``close`` only."""
    reader.open()
    try:
        yield reader
    finally:
        reader.close()


def _channel(connection: "Connection", is_sqlite: bool) -> Channel:
    definition = connection.msgdef
    text = definition.data.encode()
    if not is_sqlite:
        return Channel(connection.topic, "ros1", connection.msgtype, "ros1msg", text)
    encodings = {"MSG": "ros2msg", "IDL": "ros2idl"}
    encoding = encodings.get(definition.format.name, "")
    serialization = getattr(connection.ext, "serialization_format", "cdr")
    return Channel(connection.topic, serialization, connection.msgtype, encoding, text)


def _line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
