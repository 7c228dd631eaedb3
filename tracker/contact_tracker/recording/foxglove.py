"""Decoding of protobuf and JSON messages, as recorded by Foxglove's tools, to objects with attributes."""

import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from mcap.records import Schema

from contact_tracker.extras import module_of_extra
from contact_tracker.recording.items import Channel


def protobuf_reading(channel: Channel) -> Callable[[bytes], Any] | None:
    """The decoder of a protobuf channel; an invalid schema can raise any error of the library."""
    factory = module_of_extra("mcap_protobuf.decoder", "foxglove", "protobuf").DecoderFactory()
    decoder: Callable[[bytes], Any] | None = factory.decoder_for(
        channel.encoding, Schema(id=1, name=channel.type, encoding="protobuf", data=channel.schema)
    )
    return decoder


def decode_json(data: bytes) -> Any:
    """A JSON object; raises ValueError."""
    return json.loads(data, object_hook=lambda values: SimpleNamespace(**values))
