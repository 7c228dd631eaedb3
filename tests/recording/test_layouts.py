"""Poses read at fixed offsets equal those of the library, for any message and schema."""

import struct
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker.recording import list_sources
from contact_tracker.recording.decoding import MessageDecoder, Undecodable
from contact_tracker.recording.items import Channel, RawMessage
from contact_tracker.recording.layouts import Layouts
from contact_tracker.recording.message_types import POSE_TYPES
from contact_tracker.recording.reading import Reading
from contact_tracker.recording.sources import ChannelFilter
from mcap_logs import SCHEMAS

TAIL = {"geometry_msgs/msg/PoseWithCovarianceStamped": 36, "nav_msgs/msg/Odometry": 36 + 6 + 36}
TWO_NAMES = {"geometry_msgs/msg/TransformStamped", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"}
each_type = pytest.mark.parametrize("kind", [kind for kind in SCHEMAS if kind in POSE_TYPES])
numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
stamps = st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))
names = st.text(max_size=20)
bodies = st.tuples(stamps, st.lists(numbers, min_size=7, max_size=7))


def cdr(kind, order, frames, body, tail_value=0.25):
    """A message as written by DDS: values aligned to their size, relative to the fifth byte."""
    (sec, nanosec), values = body
    data = bytearray()

    def put(code, value):
        data.extend(bytes(-len(data) % struct.calcsize(code)) + struct.pack(order + code, value))

    if kind.endswith("TFMessage"):
        put("I", 1)
    put("i", sec)
    put("I", nanosec)
    for frame in frames[: 2 if kind in TWO_NAMES else 1]:
        text = frame.encode() + b"\0"
        put("I", len(text))
        data.extend(text)
    for value in [*values, *[tail_value] * TAIL.get(kind, 0)]:
        put("d", value)
    return bytes([0, order == "<", 0, 0]) + bytes(data)


def channel(kind, schema=None):
    return Channel("/pose", "cdr", kind, "ros2msg", (schema or SCHEMAS[kind]).encode())


def by_library(message):
    return shown(POSE_TYPES[message.channel.type](MessageDecoder(None).decode(message)))


def shown(observations):
    """The observations as bits, in which NaN equals NaN."""
    return [
        (
            o.frame_id,
            o.child_frame_id,
            o.pose.stamp_ns,
            struct.pack("7d", *o.pose.position_m, *o.pose.quat_xyzw),
        )
        for o in observations
    ]


@each_type
@settings(max_examples=30, deadline=None)
@given(
    order=st.sampled_from("<>"),
    frames=st.tuples(names, names),
    bodies=st.lists(bodies, min_size=2, max_size=4),
)
def test_layouts_read_the_same_as_the_library(kind, order, frames, bodies):
    decoder, on = MessageDecoder(None), channel(kind)
    for count, body in enumerate(bodies):
        message = RawMessage(on, 0, cdr(kind, order, frames, body, tail_value=float(count)))
        if count:
            assert decoder.layouts(message.channel).read(message.data) is not None, (
                "a layout is known and used"
            )
        assert shown(decoder.observe(message)) == by_library(message)


def transforms(order, parts):
    """A TFMessage of several transforms, each (frames, body)."""
    data = bytearray(struct.pack(order + "I", len(parts)))

    def put(code, value):
        data.extend(bytes(-len(data) % struct.calcsize(code)) + struct.pack(order + code, value))

    for frames, ((sec, nanosec), values) in parts:
        put("i", sec)
        put("I", nanosec)
        for frame in frames:
            text = frame.encode() + b"\0"
            put("I", len(text))
            data.extend(text)
        for value in values:
            put("d", value)
    return bytes([0, order == "<", 0, 0]) + bytes(data)


@settings(max_examples=40, deadline=None)
@given(
    order=st.sampled_from("<>"),
    frames=st.lists(st.tuples(names, names), min_size=2, max_size=5),
    seed=st.randoms(use_true_random=False),
    data=st.data(),
)
def test_several_transforms_are_read_as_the_library_decodes_them(order, frames, seed, data):
    decoder, on = MessageDecoder(None), channel("tf2_msgs/msg/TFMessage")
    for count in range(3):
        message = RawMessage(on, 0, transforms(order, [(pair, data.draw(bodies)) for pair in frames]))
        if count:
            assert len(decoder.layouts(message.channel).read(message.data)) == len(frames)
        assert shown(decoder.observe(message)) == by_library(message)
    for _ in range(10):
        damaged = bytearray(message.data)
        damaged[seed.randrange(len(damaged))] = seed.randrange(256)
        same_outcome(decoder, RawMessage(on, 0, bytes(damaged)))


@each_type
def test_layouts_are_learned_and_changed_names_are_distinguished(kind):
    decoder, on, body = MessageDecoder(None), channel(kind), ((5, 6), [0.1, 0.2, 0.3, 0.5, 0.5, 0.5, 0.5])
    pairs = [("world", "cube"), ("would", "ball"), ("a", "longer name")]
    pairs += [("world", "ball"), ("would", "cube")] if kind in TWO_NAMES else []
    for repeated in range(3):
        for frames in pairs:
            data = cdr(kind, "<", frames, body)
            assert (decoder.layouts(on).read(data) is not None) is (repeated > 0)
            (found,) = decoder.observe(RawMessage(on, 0, data))
            assert found.frame_id == frames[0]
            assert found.child_frame_id == (frames[1] if kind in TWO_NAMES else "")


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
@given(bodies=st.lists(bodies, min_size=3, max_size=3))
def test_the_schema_of_the_file_takes_precedence(kind, change, bodies):
    decoder, on = MessageDecoder(None), channel(kind, SCHEMAS[kind].replace(*change))
    for body in bodies:
        message = RawMessage(on, 0, cdr(kind, "<", ("world", "cube"), body))
        same_outcome(decoder, message)


@each_type
@settings(max_examples=40, deadline=None)
@given(seed=st.randoms(use_true_random=False), body=bodies)
def test_damaged_messages_are_read_like_by_the_library(kind, seed, body):
    decoder, on = MessageDecoder(None), channel(kind)
    whole = cdr(kind, "<", ("world", "cube"), body)
    decoder.observe(RawMessage(on, 0, whole))
    for _ in range(10):
        data = bytearray(whole)
        data[seed.randrange(len(data))] = seed.randrange(256)
        cut = seed.choice([0, 0, 1, seed.randrange(len(data))])
        same_outcome(
            decoder, RawMessage(on, 0, bytes(data)[: len(data) - cut] + bytes(seed.choice([0, 0, 5])))
        )


def same_outcome(decoder, message):
    expected = found = None
    with suppress(Undecodable, AttributeError, TypeError, ValueError):
        expected = by_library(message)
    with suppress(Undecodable):
        found = shown(decoder.observe(message))
    assert found == expected


def test_the_number_of_layouts_is_bounded():
    layouts = Layouts("geometry_msgs/msg/PoseStamped")
    decoder, on = MessageDecoder(None), channel("geometry_msgs/msg/PoseStamped")
    for count in range(300):
        data = cdr(on.type, "<", (f"frame {count}",), ((1, 2), [0.0] * 7))
        layouts.learn(data, decoder.observe(RawMessage(on, 0, data)))
    assert sum(map(len, layouts._by_size.values())) <= 64


@pytest.mark.parametrize("name", ["paper/paper_00", "hard/hard_00", "robot/robot_00"])
def test_on_real_recordings(shared_recordings, name):
    path = str(shared_recordings / "physics" / f"{name}.mcap")
    (source,) = list_sources(path)
    decoder, library = MessageDecoder(None), MessageDecoder(None)
    items = [m for m in Reading(path, ChannelFilter(source.topic)) if isinstance(m, RawMessage)]
    for message in items[::7]:
        assert decoder.observe(message) == POSE_TYPES[source.type](library.decode(message))
    assert all(decoder.layouts(message.channel).read(message.data) for message in items)
    moved = replace(items[0].channel, topic="/elsewhere")
    assert decoder.observe(items[0]._replace(channel=moved)) == decoder.observe(items[0])
