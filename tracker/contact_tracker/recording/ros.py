"""Decoding of ROS 2 messages (CDR) by the channel's definition, or else by the known one of its type."""

from collections.abc import Callable
from contextlib import redirect_stderr
from functools import cache
from io import StringIO
from typing import Any

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from contact_tracker.recording.definition_work import DecodingWork, work_of
from contact_tracker.recording.definitions import completed, definition_of, is_complete
from contact_tracker.recording.extras import MissingExtra
from contact_tracker.recording.items import Channel
from contact_tracker.recording.message_types import canonical
from contact_tracker.recording.parsed_definitions import fields_of_idl, ros2msg_of

Decoder = Callable[[bytes], Any]
Reading = tuple[Decoder, DecodingWork]
"""A decoder, and how much work its messages take."""


def cdr_reading(channel: Channel) -> Reading | None:
    """The decoder by the definition in the file, ros2msg or ros2idl; None if that is unusable."""
    name = canonical(channel.type)
    try:
        text = channel.schema.decode(errors="replace")
        if channel.schema_encoding == "ros2idl":
            text = ros2msg_of(fields_of_idl(text), name)
        return _reading(name, completed(text)) if text.strip() else None
    except MissingExtra:
        raise
    except Exception:  # an invalid text can raise anything
        return None


def lacks_parts(channel: Channel) -> bool:
    """Whether the definition in the file lacks known nested types."""
    return channel.schema_encoding == "ros2msg" and not is_complete(channel.schema.decode(errors="replace"))


def known_reading(channel: Channel) -> Reading | None:
    """The decoder by the known definition of the channel's type; None for unknown types."""
    return _known_reading(canonical(channel.type))


@cache  # of few types, but of all channels whose definitions cannot be used
def _known_reading(name: str) -> Reading | None:
    known = definition_of(name)
    return None if known is None else _reading(name, known)


def _reading(name: str, text: str) -> Reading | None:
    work = work_of(text)
    schema = Schema(id=1, name=name, encoding="ros2msg", data=text.encode())
    with redirect_stderr(StringIO()):  # the parser also prints its errors
        decoder = DecoderFactory().decoder_for("cdr", schema)
    return None if decoder is None else (decoder, work)
