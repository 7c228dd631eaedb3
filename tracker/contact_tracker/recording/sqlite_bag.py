"""The container of rosbag2 in SQLite, a ``.db3`` file.

A database can define tables by expressions that run when they are read. An authorizer allows only plain
tables here, and the work is bounded.
"""

import os
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from typing import Any, Final
from urllib.parse import quote

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.items import Channel, RawMessage
from contact_tracker.recording.limits import RECORD_LIMIT, TooMuchWork, WorkBudget

_TABLES: Final = frozenset({"messages", "topics", "message_definitions"})
_HIDDEN: Final = 6
"""Index in ``table_xinfo`` of whether a column is hidden or generated."""
_STEPS: Final = 10_000
"""Steps of the virtual machine between checks of their number."""
_LEAST_STEPS: Final = 50_000_000
_STEPS_PER_BYTE: Final = 20
_ERRORS: Final = (sqlite3.Error, UnicodeDecodeError)
"""Of SQLite; the second where its message would quote bytes that are no text."""
_MOST_NAMED: Final = 500
"""With more topics all messages are read and filtered afterwards."""


def read_sqlite(
    path: str, wanted: Callable[[Channel], bool], report: Callable[[str], None], budget: WorkBudget
) -> Iterator[RawMessage]:
    """The messages of a ``.db3`` file by log time; parameters as of ``read_rosbag1``.

    Raises
    ------
    UnreadableRecording
        It is not a database of rosbag2.
    """
    size = os.path.getsize(path)
    budget.count_read(size)
    if os.path.exists(f"{path}-wal") and os.path.getsize(f"{path}-wal"):
        report("its last messages are in a write-ahead log that is not read: open it once with sqlite3")
    try:
        with closing(_opened(path, size)) as file:
            _check_tables(file)
            topics = _channels(file, report)
            chosen = {number: channel for number, channel in topics.items() if wanted(channel)}
            try:
                yield from _messages(file, chosen, budget, size)
            except (*_ERRORS, TooMuchWork) as error:
                report(f"it is damaged: {_words(error)}")
    except _ERRORS as error:
        raise UnreadableRecording(f"it cannot be opened as a rosbag2 database: {_words(error)}") from error


def _words(error: Exception) -> str:
    return "its tables are malformed" if isinstance(error, UnicodeDecodeError) else str(error)


def _opened(path: str, size: int) -> sqlite3.Connection:
    uri = f"file:{quote(os.path.abspath(path))}?mode=ro&immutable=1"
    file = sqlite3.connect(uri, uri=True, isolation_level=None)
    file.text_factory = lambda data: data.decode(errors="replace")
    file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, RECORD_LIMIT)
    for pragma in ("trusted_schema = off", "cell_size_check = on", "mmap_size = 0"):
        file.execute(f"pragma {pragma}")
    left = (_LEAST_STEPS + _STEPS_PER_BYTE * size) // _STEPS

    def count_steps() -> int:
        nonlocal left
        left -= 1
        return left < 0

    file.set_progress_handler(count_steps, _STEPS)
    return file


def _check_tables(file: sqlite3.Connection) -> None:
    """Raise UnreadableRecording unless all tables of rosbag2 exist and are plain."""
    found = dict(file.execute("select name, type from sqlite_master").fetchall())
    missing = {"messages", "topics"} - found.keys()
    if missing:
        raise UnreadableRecording(f"it is no database of rosbag2: it has no table {min(missing)}")
    for name in _TABLES & found.keys():
        columns = file.execute(f"pragma table_xinfo({name})").fetchall()
        if found[name] != "table" or any(column[_HIDDEN] for column in columns):
            raise UnreadableRecording(f"it is no database of rosbag2: {name} is no plain table")
    file.set_authorizer(_allowed)


def _allowed(action: int, table: str | None, column: str | None, *_: Any) -> int:
    is_select = action == sqlite3.SQLITE_SELECT
    is_read = action == sqlite3.SQLITE_READ and table in _TABLES | {"sqlite_master"}
    return sqlite3.SQLITE_OK if is_select or is_read else sqlite3.SQLITE_DENY


def _channels(file: sqlite3.Connection, report: Callable[[str], None]) -> Mapping[int, Channel]:
    definitions = dict[str, tuple[str, str]]()
    is_defined = "select name from sqlite_master where name = 'message_definitions'"
    if file.execute(is_defined).fetchone():
        columns = "topic_type, encoding, encoded_message_definition"
        for kind, *definition in file.execute(f"select {columns} from message_definitions"):
            definitions[str(kind)] = str(definition[0]), str(definition[1])
    channels, unreadable = dict[int, Channel](), 0
    for number, *about in file.execute("select id, name, type, serialization_format from topics"):
        if not all(isinstance(one, str) for one in about):
            unreadable += 1
            continue
        topic, kind, encoding = about
        schema_encoding, text = definitions.get(kind, ("", ""))
        channels[number] = Channel(topic, encoding, kind, schema_encoding, text.encode())
    if unreadable:
        report(f"it is damaged: {unreadable} of its topics cannot be read")
    return channels


def _messages(
    file: sqlite3.Connection, channels: Mapping[int, Channel], budget: WorkBudget, size: int
) -> Iterator[RawMessage]:
    """The messages by log time, while they are together no longer than the file of ``size`` bytes: pages that
    refer to themselves, or to one another, make any number of long ones.

    They are fetched one by one after sorting, which would keep them all.
    """
    which = f"where topic_id in ({', '.join('?' * len(channels))})" if len(channels) <= _MOST_NAMED else ""
    rows = file.execute(
        f"select topic_id, timestamp, rowid from messages {which} order by timestamp",
        [*channels] if which else [],
    )
    fetch = file.cursor()
    for number, log_time_ns, row in rows:
        budget.count_records(1)
        channel = channels.get(number)
        if channel is None or not isinstance(log_time_ns, int):
            continue
        found = fetch.execute("select data from messages where rowid = ?", [row]).fetchone()
        if found is not None and isinstance(found[0], bytes):
            size -= len(found[0])
            if size < 0:
                raise TooMuchWork("its messages are longer than the file")
            yield RawMessage(channel, max(log_time_ns, 0), found[0])
