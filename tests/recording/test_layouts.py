"""Poses read at fixed offsets equal those of the library, for any message and schema."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker.recording.bytestream import WorkBudget
from contact_tracker.recording.decoding import POSE_TYPES, MessageDecoder, Undecodable, poses_at
from contact_tracker.recording.items import Channel, PoseSource, RawMessage
from mcap_logs import SCHEMAS

TAIL = {"geometry_msgs/msg/PoseWithCovarianceStamped": 36, "nav_msgs/msg/Odometry": 36 + 6 + 36}
TWO_NAMES = {"geometry_msgs/msg/TransformStamped", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"}
each_type = pytest.mark.parametrize("kind", [kind for kind in SCHEMAS if kind in POSE_TYPES])
numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
stamps = st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))
names = st.text(max_size=20)
part = st.tuples(st.tuples(names, names), stamps, st.lists(numbers, min_size=7, max_size=7))


def cdr(kind, order, *parts, tail=0.25):
    """A message as written by DDS, of several parts in the type that may have them, each (frames, stamp,
    numbers): values aligned to their size, relative to the fifth byte."""
    data = bytearray()

    def put(code, *values):
        for value in values:
            data.extend(bytes(-len(data) % struct.calcsize(code)) + struct.pack(order + code, value))

    if kind.endswith("TFMessage"):
        put("I", len(parts))
    for frames, (sec, nanosec), values in parts if kind.endswith("TFMessage") else parts[:1]:
        put("i", sec)
        put("I", nanosec)
        for frame in frames[: 2 if kind in TWO_NAMES else 1]:
            text = frame.encode() + b"\0"
            put("I", len(text))
            data.extend(text)
        put("d", *values, *[tail] * TAIL.get(kind, 0))
    return bytes([0, order == "<", 0, 0]) + bytes(data)


def channel(kind, schema=None):
    return Channel("/pose", "cdr", kind, "ros2msg", (schema or SCHEMAS[kind]).encode())


def new_decoder():
    return MessageDecoder(WorkBudget())


def by_library(message):
    """The poses as the library decodes them by the definition."""
    try:
        decoded = new_decoder().decode(message)
        result = list(poses_at(POSE_TYPES[message.channel.type], decoded))
    except (Undecodable, TypeError, ValueError, OverflowError):
        return [None]
    name = message.channel.topic, message.channel.type
    return [as_bits(PoseSource(*name, frame, child), pose) for frame, child, pose in result]


def as_bits(source, pose):
    """In which NaN equals NaN."""
    return source, pose.stamp_ns, struct.pack("7d", *pose.position_m, *pose.quat_xyzw)


def shown(decoder, message):
    """The poses of a decoder; None where the message cannot be decoded."""
    decoder.counts.clear()
    result = [as_bits(*entry[:2]) for entry in decoder.poses([message])]
    return result + [None] * decoder.counts["undecodable"]


@each_type
@settings(max_examples=40, deadline=None)
@given(
    order=st.sampled_from("<>"),
    parts=st.lists(part, min_size=1, max_size=5),
    seed=st.randoms(use_true_random=False),
)
def test_layouts_read_the_same_as_the_library(kind, order, parts, seed):
    """Also of damaged messages."""
    decoder, on = new_decoder(), channel(kind)
    for count in range(1, len(parts) + 1):
        message = RawMessage(on, 0, cdr(kind, order, *parts[:count], tail=float(count)))
        assert len(by_library(message)) == (count if kind.endswith("TFMessage") else 1)
        assert shown(decoder, message) == by_library(message)
    for _ in range(10):
        damaged = bytearray(message.data)
        damaged[seed.randrange(len(damaged))] = seed.randrange(256)
        damaged_message = RawMessage(on, 0, bytes(damaged))
        assert shown(decoder, damaged_message) == by_library(damaged_message)


def test_bodies_of_one_name_are_numbered_where_their_stamps_are_equal():
    decoder, on = new_decoder(), channel("tf2_msgs/msg/TFMessage")
    for second in (0, 1):
        parts = [(("", name), (0, stamp), [0.0] * 7) for name, stamp in (("", 0), ("0", second))]
        message = RawMessage(on, 0, cdr(on.type, "<", *parts))
        assert shown(decoder, message) == by_library(message)


@each_type
@pytest.mark.parametrize(
    "change",
    [
        ("int32 sec", "uint32 sec"),
        ("float64 x\nfloat64 y\n", "float64 y\nfloat64 x\n"),
        ("float64 z", "float32 z"),
        ("int32 sec\nuint32 nanosec\n", "uint32 nanosec\nint32 sec\n"),
        ("string frame_id", "int32 number\nstring frame_id"),
        ("string frame_id", "uint8[] frame_id"),
    ],
    ids=lambda change: change[1].replace("\n", " "),
)
@settings(max_examples=10, deadline=None)
@given(parts=st.lists(part, min_size=3, max_size=3))
def test_the_schema_of_the_file_takes_precedence(kind, change, parts):
    decoder, on = new_decoder(), channel(kind, SCHEMAS[kind].replace(*change))
    for body in parts:
        message = RawMessage(on, 0, cdr(kind, "<", body))
        assert shown(decoder, message) == by_library(message)


def test_known_layouts_need_no_library(monkeypatch):
    """Also of endlessly many frame names."""
    monkeypatch.setattr(MessageDecoder, "decode", None)
    decoder, on = new_decoder(), channel("geometry_msgs/msg/PoseStamped")
    data = [cdr(on.type, "<", ((f"frame {count}",), (1, 2), [0.0] * 7)) for count in range(300)]
    result = list(decoder.poses(RawMessage(on, 0, entry) for entry in data))
    assert [source.frame_id for source, _, _ in result] == [f"frame {count}" for count in range(300)]
