"""ROS 2 messages decoded: CDR by the definition that the channel has, or else by that of its type's name."""

from collections.abc import Callable
from contextlib import redirect_stderr
from io import StringIO
from typing import Any

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from contact_tracker.recording.definitions import completed, definition_of, is_complete
from contact_tracker.recording.extras import MissingExtra
from contact_tracker.recording.items import Channel
from contact_tracker.recording.message_types import canonical
from contact_tracker.recording.parsed_definitions import fields_of_idl, ros2msg_of

Decoder = Callable[[bytes], Any]


def cdr_reading(channel: Channel) -> Decoder | None:
    """What decodes CDR by the definition in the file, in ros2msg or ros2idl; None if that cannot be used."""
    name = canonical(channel.type)
    try:
        text = channel.schema.decode(errors="replace")
        if channel.schema_encoding == "ros2idl":
            text = ros2msg_of(fields_of_idl(text), name)
        return _decoder(name, completed(text)) if text.strip() else None
    except MissingExtra:
        raise
    except Exception:  # it raises whatever the text leads it to
        return None


def lacks_parts(channel: Channel) -> bool:
    """Whether the definition in the file uses known parts that it does not define."""
    return channel.schema_encoding == "ros2msg" and not is_complete(channel.schema.decode(errors="replace"))


def known_reading(channel: Channel) -> Decoder | None:
    """What decodes CDR by the known definition of a type of that name; None where none is known."""
    name = canonical(channel.type)
    known = definition_of(name)
    return None if known is None else _decoder(name, known)


def _decoder(name: str, text: str) -> Decoder | None:
    schema = Schema(id=1, name=name, encoding="ros2msg", data=text.encode())
    with redirect_stderr(StringIO()):  # the parser prints what it then raises
        return DecoderFactory().decoder_for("cdr", schema)
