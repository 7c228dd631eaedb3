"""Frames that move or rest in their parents, as transforms in a log and as 4 x 4 matrices at any time."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from contact_tracker.motion.poses import Poses
from mcap_logs import TF, Topic, transform

START_NS = 10**9
MOUNT = (np.array([0.05, -0.02, 0.11]), Rotation.from_euler("xyz", [0.3, -0.5, 0.7]))
TABLE = (np.array([0.4, 1.2, -0.3]), Rotation.from_euler("xyz", [-0.2, 0.4, 2.1]))


@dataclass
class Frame:
    """The poses of a frame in its parent, published at ``stamps_ns``; one stamp for a static frame."""

    parent: str
    child: str
    stamps_ns: np.ndarray
    position_m: np.ndarray
    rotation: Rotation

    @classmethod
    def of(cls, parent: str, child: str, poses: Poses) -> Self:
        return cls(parent, child, poses.stamp_ns, poses.position_m, Rotation.from_quat(poses.quat_xyzw))

    @property
    def poses(self) -> Poses:
        return Poses(self.stamps_ns, self.position_m, self.rotation.as_quat())

    @property
    def topic(self) -> Topic:
        name = "/tf" if len(self.stamps_ns) > 1 else "/tf_static"
        parts = ((p.stamp_ns, transform(*p, self.parent, self.child)) for p in self.poses)
        return Topic(name, TF, [(stamp_ns, {"transforms": [part]}) for stamp_ns, part in parts])

    def under(self, parent: str) -> Self:
        return replace(self, parent=parent)

    def only(self, rows: np.ndarray) -> Self:
        """At some of its stamps."""
        columns = self.stamps_ns[rows], self.position_m[rows], self.rotation[rows]
        return replace(self, **dict(zip(("stamps_ns", "position_m", "rotation"), columns, strict=True)))

    def at(self, stamps_ns: np.ndarray) -> np.ndarray:
        """4 x 4 matrices (N, 4, 4) from child to parent."""
        if len(self.stamps_ns) == 1:
            return matrices(
                np.repeat(self.position_m, len(stamps_ns), 0), self.rotation[[0] * len(stamps_ns)]
            )
        begin_ns = self.stamps_ns[0]
        sample_s, time_s = (self.stamps_ns - begin_ns) * 1e-9, (stamps_ns - begin_ns) * 1e-9
        position = np.column_stack([np.interp(time_s, sample_s, column) for column in self.position_m.T])
        return matrices(position, Slerp(sample_s, self.rotation)(np.clip(time_s, 0.0, sample_s[-1])))


def matrices(position: np.ndarray, rotation: Rotation) -> np.ndarray:
    stacked = np.zeros((len(position), 4, 4))
    stacked[:, :3, :3], stacked[:, :3, 3], stacked[:, 3, 3] = rotation.as_matrix(), position, 1.0
    return stacked


def static(parent: str, child: str, place: tuple[np.ndarray, Rotation] = MOUNT) -> Frame:
    return Frame(parent, child, np.array([START_NS]), place[0][None], Rotation.concatenate([place[1]]))


def moving(
    parent: str, child: str, seed: int = 5, hz: float = 73.0, start_s: float = -0.1, end_s: float = 6.2
) -> Frame:
    """A moving frame with its own stamps."""
    rng = np.random.default_rng(seed)
    t = np.arange(start_s, end_s, 1.0 / hz)
    phase = rng.uniform(0, 6, (2, 3))
    turn = Rotation.from_rotvec(0.9 * np.sin(1.3 * t[:, None] + phase[0]))
    place = 0.4 * np.cos(1.7 * t[:, None] + phase[1])
    return Frame(parent, child, START_NS + np.round(t * 1e9).astype(np.int64), place, turn)


def by_name(topics: Iterable[Topic]) -> list[Topic]:
    """The transforms with one topic of each name."""
    messages: dict[str, list[tuple[int, object]]] = {}
    for topic in topics:
        messages.setdefault(topic.name, []).extend(topic.messages)
    return [Topic(name, TF, rows) for name, rows in messages.items()]
