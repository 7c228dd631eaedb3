"""Poses read at fixed offsets in CDR messages, several times faster than decoding by field.

With constant frame names, the messages of a channel differ only in stamps and seven numbers per pose, at the
same offsets, which follow from the message type. As the schema in the file may define that type differently,
a layout is used only after the library's decoder has read back test values written at these offsets.
Messages that fit no layout are left to the library.
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
"""Most layouts of one size, and most trials: some channels have endlessly many frame names."""
# None equals another one read with another sign, width, byte order or offset.
_TEST_STAMP: Final = (3_012_345_678, 4_023_456_789)
_TEST_NUMBERS: Final = (1.7, -2.75e-3, 3.1e9, 0.1, -0.2, 0.3, -0.9)


class Observation(NamedTuple):
    """One pose as published, before validation; ``child_frame_id`` is empty where the type has none."""

    frame_id: str
    child_frame_id: str
    pose: Pose


class ObservedColumns(NamedTuple):
    """Many poses of one source as published."""

    frame_id: str
    child_frame_id: str
    poses: Poses


class _Type(NamedTuple):
    """Layout of a message type: ``stamp_at``, offset of the first stamp; number of names after it; bytes
    after the numbers; whether there may be several such blocks after their count."""

    stamp_at: int
    names: int
    tail: int
    repeats: bool = False


_TYPES: Final[Mapping[str, _Type]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": _Type(4, 1, 0),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _Type(4, 1, _COVARIANCE),
        "geometry_msgs/msg/TransformStamped": _Type(4, 2, 0),
        "nav_msgs/msg/Odometry": _Type(4, 2, _COVARIANCE + _TWIST),
        "tf2_msgs/msg/TFMessage": _Type(8, 2, 0, repeats=True),
    }
)


class _Block(NamedTuple):
    """Offsets of the stamp and of the numbers of one pose."""

    stamp_at: int
    numbers_at: int


class _Layout(NamedTuple):
    """``fixed`` are the constant bytes around stamps and numbers with their offsets, ``frames`` the frame
    names of each pose."""

    fixed: tuple[tuple[int, int, bytes], ...]
    blocks: tuple[_Block, ...]
    order: str
    sec: str
    values: struct.Struct
    frames: tuple[tuple[str, str], ...]

    def read(self, data: bytes) -> list[Observation] | None:
        """The poses if the constant bytes match, else None; ``data`` has the size of the layout."""
        for start, end, expected in self.fixed:
            if data[start:end] != expected:
                return None
        values = self.values.unpack(data)
        found = list[Observation]()
        for i, (frame_id, child_frame_id) in enumerate(self.frames):
            sec, nanosec, px, py, pz, x, y, z, w = values[9 * i : 9 * i + 9]
            pose = Pose(sec * 1_000_000_000 + nanosec, (px, py, pz), (x, y, z, w))
            found.append(Observation(frame_id, child_frame_id, pose))
        return found

    def read_all(self, messages: Sequence[bytes]) -> ObservedColumns | None:
        """The poses of messages with one each if all match, else None; all have the size of the layout."""
        if len(self.blocks) != 1:
            return None
        rows = np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), -1)
        for start, end, expected in self.fixed:
            if (rows[:, start:end] != np.frombuffer(expected, np.uint8)).any():
                return None
        (block,) = self.blocks
        fields = rows.reshape(-1).view(self._columns(block))
        stamp_ns = fields["sec"].astype(np.int64) * 1_000_000_000 + fields["nanosec"]
        numbers = fields["numbers"].astype(float)
        return ObservedColumns(*self.frames[0], Poses(stamp_ns, numbers[:, :3], numbers[:, 3:]))

    def _columns(self, block: _Block) -> np.dtype[np.void]:
        """The structured dtype of a message."""
        sec = "i" if self.sec == "i" else "u"
        return np.dtype(
            {
                "names": ["sec", "nanosec", "numbers"],
                "formats": [f"{self.order}{sec}4", f"{self.order}u4", (f"{self.order}f8", (7,))],
                "offsets": [block.stamp_at, block.stamp_at + 4, block.numbers_at],
                "itemsize": self.values.size,
            }
        )


class Layouts:
    """The known layouts of one channel, by message size."""

    def __init__(self, message_type: str) -> None:
        self._type = _TYPES.get(message_type)
        self._by_size: dict[int, list[_Layout]] = {}
        self._trials = _TRIALS

    def read(self, data: bytes) -> list[Observation] | None:
        """The poses in a message; None if no layout fits."""
        for layout in self._by_size.get(len(data), ()):
            observations = layout.read(data)
            if observations is not None:
                return observations
        return None

    def read_all(self, messages: Sequence[bytes]) -> ObservedColumns | None:
        """The poses in messages; None unless one layout fits all of them."""
        size, *others = {len(data) for data in messages}
        if others:
            return None
        found = (layout.read_all(messages) for layout in self._by_size.get(size, ()))
        return next((columns for columns in found if columns is not None), None)

    def learn(self, data: bytes, decode: Callable[[bytes], list[Observation]]) -> None:
        """Add the layout of a message, if ``decode`` reads back the values of test messages."""
        if self._type is None or not self._trials or len(self._by_size.get(len(data), ())) >= _PER_SIZE:
            return
        self._trials -= 1
        blocks = _blocks(data, self._type)
        for sec in "iI" if blocks else "":
            if (layout := _tried(data, self._type, blocks, sec, decode)) is not None:
                self._by_size.setdefault(len(data), []).append(layout)
                return


def _blocks(data: bytes, kind: _Type) -> tuple[_Block, ...]:
    """The blocks of a message; empty unless its size is that of its type and names."""
    if len(data) < max(kind.stamp_at, _ENCAPSULATION + 4):
        return ()
    order = _order(data)
    count = struct.unpack_from(f"{order}I", data, _ENCAPSULATION)[0] if kind.repeats else 1
    stamp_at, blocks = kind.stamp_at, list[_Block]()
    while len(blocks) < count and stamp_at + _STAMP <= len(data):
        end = stamp_at + _STAMP
        for _ in range(kind.names):
            end += (_ENCAPSULATION - end) % 4
            if end + 4 > len(data):
                return ()
            end += 4 + struct.unpack_from(f"{order}I", data, end)[0]
        start = end + (_ENCAPSULATION - end) % 8
        blocks.append(_Block(stamp_at, start))
        stamp_at = start + _NUMBERS + kind.tail
    return tuple(blocks) if len(blocks) == count and stamp_at == len(data) else ()


def _order(data: bytes) -> str:
    return "<" if data[1] & 1 else ">"


def _tried(
    data: bytes,
    kind: _Type,
    blocks: tuple[_Block, ...],
    sec: str,
    decode: Callable[[bytes], list[Observation]],
) -> _Layout | None:
    """The layout, if the library reads back test values at its offsets."""
    order, test = _order(data), bytearray(data)
    fields, fixed, at = [order], list[tuple[int, int, bytes]](), 0
    for i, (stamp_at, numbers_at) in enumerate(blocks):
        names_at = stamp_at + _STAMP
        struct.pack_into(f"{order}II", test, stamp_at, *(part + i for part in _TEST_STAMP))
        struct.pack_into(f"{order}7d", test, numbers_at, *(number + i for number in _TEST_NUMBERS))
        fixed += [(at, stamp_at, data[at:stamp_at]), (names_at, numbers_at, data[names_at:numbers_at])]
        fields.append(f"{stamp_at - at}x{sec}I{numbers_at - names_at}x7d")
        at = numbers_at + _NUMBERS + kind.tail
    fields.append(f"{kind.tail}x")
    if len(blocks) > 1 and kind.tail:
        return None
    found = decode(bytes(test))
    if len(found) != len(blocks):
        return None
    frames = tuple((frame_id, child_frame_id) for frame_id, child_frame_id, _ in found)
    layout = _Layout(tuple(fixed), blocks, order, sec, struct.Struct("".join(fields)), frames)
    return layout if layout.read(bytes(test)) == found else None
