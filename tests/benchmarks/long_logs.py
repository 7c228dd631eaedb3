"""A log of any length: the poses of a recording forward and backward repeatedly, without jumps.

Imports nothing of the tracker, so that a process that measures the memory of others stays small.
"""

import struct
from collections.abc import Iterator
from itertools import chain, cycle, islice
from pathlib import Path
from typing import Final

from mcap.reader import make_reader
from mcap.writer import Writer

TYPE: Final = "geometry_msgs/msg/PoseStamped"
STAMP: Final = struct.Struct("<iI")
_STAMP_AT: Final = 4
"""Offset of the stamp in a little-endian CDR message that begins with a header: after the encapsulation."""


def write_long_log(source: Path, seconds: float, path: Path) -> Path:
    """Write ``seconds`` of the one PoseStamped topic of ``source`` to ``path``, at the same rate.

    Only the stamps change, so that little memory is needed and the log compresses as others.
    """
    with source.open("rb") as file:
        reader = make_reader(file)
        records = [r for r in reader.iter_messages() if r[0] is not None and r[0].name == TYPE]
    schema, channel, _ = records[0]
    assert schema is not None
    stamps = [message.log_time for _, _, message in records]
    period_ns = (stamps[-1] - stamps[0]) // (len(stamps) - 1)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="benchmark")
        schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
        channel_id = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
        count = round(seconds * 1e9 / period_ns)
        for number, data in enumerate(_forward_and_backward([r[2].data for r in records], count)):
            stamp_ns = stamps[0] + number * period_ns
            stamped = data[:_STAMP_AT] + STAMP.pack(*divmod(stamp_ns, 10**9)) + data[_STAMP_AT + STAMP.size :]
            writer.add_message(channel_id, stamp_ns, stamped, stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _forward_and_backward(messages: list[bytes], count: int) -> Iterator[bytes]:
    """The first ``count`` of endless repetitions; at the ends no message is repeated."""
    return islice(cycle(chain(messages, messages[-2:0:-1])), count)
