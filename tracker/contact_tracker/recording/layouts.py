"""Poses read at known places in CDR messages: several times faster than decoding field by field.

Where frame names do not change, all messages of a channel differ in the stamp and in seven numbers only, at
the same bytes. Those places follow from the message type. What is in a message is said by its schema, though,
and that comes from the file: a layout is used only once the library's decoder has found there what was put
there for a test. Messages that no layout fits are left to the library.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.motion.poses import Pose, Poses

_ENCAPSULATION: Final = 4
_STAMP: Final = 8
_NUMBERS: Final = 56
_COVARIANCE: Final = 288
_TWIST: Final = 48 + _COVARIANCE
_PER_SIZE: Final = 8
_TRIALS: Final = 64
"""So many layouts of one size, and so many trials, are enough: other channels have endless frame names."""
# None of them is another one read with another sign, width, byte order or place.
_TEST_STAMP: Final = (3_012_345_678, 4_023_456_789)
_TEST_NUMBERS: Final = (1.7, -2.75e-3, 3.1e9, 0.1, -0.2, 0.3, -0.9)


class Observation(NamedTuple):
    """One pose as published, before any validation; ``child_frame_id`` is empty where the type has none."""

    frame_id: str
    child_frame_id: str
    pose: Pose


class ObservedColumns(NamedTuple):
    """The same of many poses of one source."""

    frame_id: str
    child_frame_id: str
    poses: Poses


class _Type(NamedTuple):
    """``stamp_at`` which byte the stamp is; how many names follow it; how many bytes follow the numbers."""

    stamp_at: int
    names: int
    tail: int


_TYPES: Final[Mapping[str, _Type]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": _Type(4, 1, 0),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _Type(4, 1, _COVARIANCE),
        "geometry_msgs/msg/TransformStamped": _Type(4, 2, 0),
        "nav_msgs/msg/Odometry": _Type(4, 2, _COVARIANCE + _TWIST),
        "tf2_msgs/msg/TFMessage": _Type(8, 2, 0),  # of one transform
    }
)


class _Layout(NamedTuple):
    """``head`` and ``names`` are the bytes before and after the stamp that do not change."""

    head: bytes
    names: bytes
    stamp_at: int
    names_at: int
    names_end: int
    values: struct.Struct
    frame_id: str
    child_frame_id: str

    def read(self, data: bytes) -> Observation | None:
        """The pose, if these bytes are as expected; ``data`` has the size of the layout."""
        if data[self.names_at : self.names_end] != self.names or data[: self.stamp_at] != self.head:
            return None
        sec, nanosec, px, py, pz, x, y, z, w = self.values.unpack(data)
        pose = Pose(sec * 1_000_000_000 + nanosec, (px, py, pz), (x, y, z, w))
        return Observation(self.frame_id, self.child_frame_id, pose)

    def read_all(self, messages: Sequence[bytes]) -> ObservedColumns | None:
        """The poses of messages, if all are as expected; all have the size of the layout."""
        rows = np.frombuffer(b"".join(messages), self.columns)
        for name, expected in (("head", self.head), ("names", self.names)):
            if (rows[name] != np.frombuffer(expected, np.uint8)).any():
                return None
        stamp_ns = rows["sec"].astype(np.int64) * 1_000_000_000 + rows["nanosec"]
        numbers = rows["numbers"].astype(float)
        return ObservedColumns(
            self.frame_id, self.child_frame_id, Poses(stamp_ns, numbers[:, :3], numbers[:, 3:])
        )

    @property
    def columns(self) -> np.dtype[np.void]:
        """What is where, as ``values`` has it."""
        order, sec = self.values.format[0], "i" if "i" in self.values.format else "u"
        return np.dtype(
            {
                "names": ["head", "sec", "nanosec", "names", "numbers"],
                "formats": [
                    ("u1", (self.stamp_at,)),
                    f"{order}{sec}4",
                    f"{order}u4",
                    ("u1", (len(self.names),)),
                    (f"{order}f8", (7,)),
                ],
                "offsets": [0, self.stamp_at, self.stamp_at + 4, self.names_at, self.names_end],
                "itemsize": self.values.size,
            }
        )


class Layouts:
    """The layouts met on one channel, by the size of the message."""

    def __init__(self, message_type: str) -> None:
        self._type = _TYPES.get(message_type)
        self._by_size: dict[int, list[_Layout]] = {}
        self._trials = _TRIALS

    def read(self, data: bytes) -> Observation | None:
        """The pose in a message, or None if that is for the library to say."""
        for layout in self._by_size.get(len(data), ()):
            observation = layout.read(data)
            if observation is not None:
                return observation
        return None

    def read_all(self, messages: Sequence[bytes]) -> ObservedColumns | None:
        """The poses in messages, if one layout fits all of them."""
        size, *others = {len(data) for data in messages}
        if others:
            return None
        found = (layout.read_all(messages) for layout in self._by_size.get(size, ()))
        return next((columns for columns in found if columns is not None), None)

    def learn(self, data: bytes, decode: Callable[[bytes], list[Observation]]) -> None:
        """Look for the layout of a message that ``decode`` has read; it is asked for test messages."""
        if self._type is None or not self._trials or len(self._by_size.get(len(data), ())) >= _PER_SIZE:
            return
        self._trials -= 1
        for sec in "iI":
            values = _values(data, self._type, sec)
            if values is not None and (layout := _tried(data, self._type, values, decode)) is not None:
                self._by_size.setdefault(len(data), []).append(layout)
                return


def _values(data: bytes, kind: _Type, sec: str) -> struct.Struct | None:
    """Where stamp and numbers are, if the message has the size that its type and its names give it."""
    if len(data) <= kind.stamp_at:
        return None
    order = "<" if data[1] & 1 else ">"
    names_at = end = kind.stamp_at + _STAMP
    for _ in range(kind.names):
        end += (_ENCAPSULATION - end) % 4
        if end + 4 > len(data):
            return None
        end += 4 + struct.unpack_from(f"{order}I", data, end)[0]
    start = end + (_ENCAPSULATION - end) % 8
    if start + _NUMBERS + kind.tail != len(data):
        return None
    return struct.Struct(f"{order}{kind.stamp_at}x{sec}I{start - names_at}x7d{kind.tail}x")


def _tried(
    data: bytes, kind: _Type, values: struct.Struct, decode: Callable[[bytes], list[Observation]]
) -> _Layout | None:
    """The layout, if the library finds there what was put there."""
    numbers_at, names_at = len(data) - kind.tail - _NUMBERS, kind.stamp_at + _STAMP
    test = bytearray(data)
    order = values.format[0]
    test[kind.stamp_at : names_at] = struct.pack(f"{order}II", *_TEST_STAMP)
    test[numbers_at : numbers_at + _NUMBERS] = struct.pack(f"{order}7d", *_TEST_NUMBERS)
    found = decode(bytes(test))
    if len(found) != 1:
        return None
    frame_id, child_frame_id, _ = found[0]
    head, names = data[: kind.stamp_at], data[names_at:numbers_at]
    layout = _Layout(head, names, kind.stamp_at, names_at, numbers_at, values, frame_id, child_frame_id)
    return layout if layout.read(bytes(test)) == found[0] else None
