"""Poses read at fixed offsets in CDR messages, several times faster than decoding by field.

With constant frame names, the messages of a channel differ only in stamps and seven numbers per pose, at the
same offsets, which follow from the definition of the message type. Layouts are those of known definitions: if
a file defines the type of a channel differently, its messages are left to the library.
"""

import struct
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.motion.poses import Pose, Poses

_ENCAPSULATION: Final = 4
_PLAIN: Final = (b"\0\0", b"\0\1")
"""How messages of the first version of CDR begin, in big and little endian."""
_STAMP: Final = 8
_NUMBERS: Final = 56
_COVARIANCE: Final = 288
_TWIST: Final = 48 + _COVARIANCE
_PER_SIZE: Final = 8
_MOST: Final = 64
"""Most layouts of one size, and in all: some channels have endlessly many frame names."""


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
        return np.dtype(
            {
                "names": ["sec", "nanosec", "numbers"],
                "formats": [f"{self.order}i4", f"{self.order}u4", (f"{self.order}f8", (7,))],
                "offsets": [block.stamp_at, block.stamp_at + 4, block.numbers_at],
                "itemsize": self.values.size,
            }
        )


class Layouts:
    """The known layouts of one channel, by message size."""

    def __init__(self, message_type: str) -> None:
        self._type = _TYPES.get(message_type)
        self._by_size: dict[int, list[_Layout]] = {}
        self._left = _MOST

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

    def learn(self, data: bytes, found: Sequence[Observation]) -> None:
        """Add the layout of a message, in which the library has ``found`` these poses."""
        if self._type is None or not self._left or len(self._by_size.get(len(data), ())) >= _PER_SIZE:
            return
        blocks = _blocks(data, self._type)
        if blocks and len(blocks) == len(found):
            self._left -= 1
            layout = _layout(data, self._type, blocks, found)
            self._by_size.setdefault(len(data), []).append(layout)


def _blocks(data: bytes, kind: _Type) -> tuple[_Block, ...]:
    """The blocks of a message; empty unless its size is that of its type and names."""
    if len(data) < max(kind.stamp_at, _ENCAPSULATION + 4) or data[:2] not in _PLAIN:
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


def _layout(data: bytes, kind: _Type, blocks: tuple[_Block, ...], found: Sequence[Observation]) -> _Layout:
    order = _order(data)
    fields, fixed, at = [order], list[tuple[int, int, bytes]](), 0
    for stamp_at, numbers_at in blocks:
        names_at = stamp_at + _STAMP
        fixed += [(at, stamp_at, data[at:stamp_at]), (names_at, numbers_at, data[names_at:numbers_at])]
        fields.append(f"{stamp_at - at}xiI{numbers_at - names_at}x7d")
        at = numbers_at + _NUMBERS + kind.tail
    fields.append(f"{kind.tail}x")
    frames = tuple((frame_id, child_frame_id) for frame_id, child_frame_id, _ in found)
    return _Layout(tuple(fixed), blocks, order, struct.Struct("".join(fields)), frames)
