"""A copy of a recording with result channels added."""

from collections.abc import Iterable, Iterator
from heapq import merge
from pathlib import Path
from typing import IO, Final

from mcap.writer import Writer

from contact_tracker.recording.items import RESULT_TOPICS, Attachment, Channel, Item, Metadata, RawMessage
from contact_tracker.recording.reading import Reading

_CHUNK_SIZE: Final = 1024 * 1024
_LIBRARY: Final = "contact-tracker"


def write_beside(path: Path, log: str | None, added: Iterable[RawMessage]) -> None:
    """Write a recording and result messages, merged by log time.

    Parameters
    ----------
    log : the recording, which is read again; None to write the result alone. Damaged parts are left out.
    added : messages on ``RESULT_TOPICS`` by log time; they replace those of the recording on these topics.

    Raises
    ------
    UnreadableRecording
        The recording can no longer be read.
    OSError
        The file cannot be written.
    """
    with path.open("wb") as file:
        _write(
            file,
            () if log is None else Reading(log, lambda channel: channel.topic not in RESULT_TOPICS),
            added,
        )


def _write(file: IO[bytes], items: Iterable[Item], added: Iterable[RawMessage]) -> None:
    writer = Writer(file, chunk_size=_CHUNK_SIZE)
    writer.start(profile="", library=_LIBRARY)  # profile ros2 requires CDR
    numbers: dict[Channel, int] = {}
    for message in merge(_messages(items, writer), added, key=lambda message: message.log_time_ns):
        channel = message.channel
        if channel not in numbers:
            numbers[channel] = _register(writer, channel)
        writer.add_message(numbers[channel], message.log_time_ns, message.data, message.log_time_ns)
    writer.finish()  # type: ignore[no-untyped-call]


def _messages(items: Iterable[Item], writer: Writer) -> Iterator[RawMessage]:
    """The messages; other items are written at once."""
    for item in items:
        match item:
            case RawMessage():
                yield item
            case Attachment(name, data):
                media_type = "application/json" if name.endswith(".json") else "application/octet-stream"
                writer.add_attachment(0, 0, name, media_type, data)
            case Metadata(name, values):
                writer.add_metadata(name, dict(values))


def _register(writer: Writer, channel: Channel) -> int:
    has_schema = bool(channel.type or channel.schema_encoding)
    schema = (
        writer.register_schema(channel.type, channel.schema_encoding, channel.schema) if has_schema else 0
    )
    return writer.register_channel(channel.topic, channel.encoding, schema)
