"""ROS messages decoded: CDR by the definition that the channel has, or else by that of its type's name."""

from collections.abc import Callable
from contextlib import redirect_stderr
from io import StringIO
from typing import Any, TypeVar

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from contact_tracker.recording.bags import definition_of_idl, ros1_reading
from contact_tracker.recording.definitions import completed, definition_of
from contact_tracker.recording.extras import MissingExtra
from contact_tracker.recording.items import Channel
from contact_tracker.recording.message_types import canonical

Decoder = Callable[[bytes], Any]
_T = TypeVar("_T")


def cdr_reading(channel: Channel) -> Decoder | None:
    """What decodes CDR in ros2msg, in ros2idl or without a definition; None if nothing can."""
    name = canonical(channel.type)
    text: str | None = channel.schema.decode(errors="replace")
    if channel.schema_encoding == "ros2idl":
        text = _tried(lambda: definition_of_idl(channel.schema.decode(), name))
    decoder = _decoder(name, completed(text)) if text and text.strip() else None
    if decoder is not None or channel.schema_encoding == "ros2idl":
        return decoder
    known = definition_of(name)
    return None if known is None else _decoder(name, known)


def ros1_decoding(channel: Channel) -> Decoder | None:
    """The same of a channel of ROS 1."""
    name = canonical(channel.type)
    found = _tried(lambda: ros1_reading(channel.schema.decode(), name))
    if found is None:
        return None
    text, to_cdr = found
    decoder = _decoder(name, text)
    return None if decoder is None else lambda data: decoder(to_cdr(data))


def _tried(read: Callable[[], _T]) -> _T | None:
    try:
        return read()
    except MissingExtra:
        raise
    except Exception:  # it raises whatever the text leads it to
        return None


def _decoder(name: str, text: str) -> Decoder | None:
    schema = Schema(id=1, name=name, encoding="ros2msg", data=text.encode())
    with redirect_stderr(StringIO()):  # the parser prints what it then raises
        return _tried(lambda: DecoderFactory().decoder_for("cdr", schema))
