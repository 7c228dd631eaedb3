"""Decoding of ROS 2 messages (CDR) by a definition."""

from collections.abc import Callable
from contextlib import redirect_stderr
from io import StringIO
from typing import Any

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from contact_tracker.recording.definitions import Definition

Decoder = Callable[[bytes], Any]


def cdr_decoder(definition: Definition) -> Decoder | None:
    """The decoder of messages; an invalid definition can raise any error of the library."""
    text = definition.ros2msg.encode()
    schema = Schema(id=1, name=definition.type, encoding="ros2msg", data=text)
    with redirect_stderr(StringIO()):  # the parser also prints its errors
        decoder: Decoder | None = DecoderFactory().decoder_for("cdr", schema)
    return decoder
