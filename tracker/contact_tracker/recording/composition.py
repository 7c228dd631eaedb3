"""Poses of a body in another frame, composed along a chain of transforms that are interpolated to its stamps.

A pose is composed once each moving transform is known before and after it. Positions are interpolated
linearly, rotations along the shortest arc. Only samples that pending poses need are kept.
"""

import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import takewhile
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording.decoding import MessageDecoder, Undecodable, is_row, pose_row, row_channel
from contact_tracker.recording.items import Item, RawMessage
from contact_tracker.recording.sources import PoseSource
from contact_tracker.recording.stamping import Logged, Stamping
from contact_tracker.recording.transform_tree import Step, is_static

GAP_NS: Final = 1_000_000_000
"""Moving transforms are not interpolated over longer gaps."""
_MOST_WAITING: Final = 20_000
_MOST_KEPT: Final = 200_000
_PATIENCE_NS: Final = 5_000_000_000
"""Log time for which a pose waits for moving transforms: its stamp may lead."""
_KEPT_NS: Final = 10_000_000_000
"""Time for which samples of a transform are kept: stamps of poses may lag."""
_BACK_NS: Final = 10_000_000_000
_FORWARD_NS: Final = 3_600_000_000_000
"""A transform whose stamps jump by more is restarted."""
_FARTHEST_NS: Final = 2**61
_Placed = tuple[NDArray[np.float64], Rotation]


class Composer:
    """Converts messages to rows of poses of one body in the first frame of a chain.

    Parameters
    ----------
    steps : the chain, from the wanted frame to the body.
    body : index of the step that gives the stamps.
    source : name of the composed poses.
    at_once : number of poses composed together; 1 for a live stream.

    Attributes
    ----------
    counts : ``no_parent``, ``parent_gap`` and ``bad_parent`` as docs/conventions.md says, ``undecodable`` and
        ``log_time_as_stamp``, and ``known_definition`` as of ``PoseLog``.
    why : why the known definition of a type was used, in words.
    """

    def __init__(
        self,
        steps: Sequence[Step],
        body: int,
        source: PoseSource,
        decoder: MessageDecoder,
        at_once: int,
    ) -> None:
        self.counts: Counter[str] = Counter()
        self.why: str | None = None
        self._steps, self._body = steps, body
        self._channel = row_channel(source.topic, source.type, source.frame_id, source.child_frame_id)
        self._decoder = decoder
        self._at_once = at_once
        self._tracks = {step.source: _Track(self.counts, is_static(step.source)) for step in steps}
        self._parents = [self._tracks[s.source] for i, s in enumerate(steps) if i != body]
        self._waiting: deque[Logged] = deque()
        self._stampings = dict[PoseSource, Stamping]()

    def learn(self, known: Mapping[PoseSource, list[Logged]]) -> None:
        """Take from messages read ahead how poses are stamped, and static transforms: poses may precede
        them."""
        for source, logged in known.items():
            if source in self._tracks and is_static(source):
                for pose, _ in logged[:1]:
                    self._tracks[source].add(pose)
            elif source in self._tracks and len(logged) > 1:
                self._stampings[source] = Stamping(logged)

    def compose(self, items: Iterable[Item]) -> Iterator[Item]:
        """The composed poses as messages; other messages are dropped."""
        body = self._steps[self._body].source
        for item in items:
            if not isinstance(item, RawMessage):
                continue
            try:
                observations = self._decoder.observe(item)
            except Undecodable:
                self.counts["undecodable"] += 1
                continue
            why = self._decoder.assumption(item.channel)
            for frame_id, child_frame_id, pose in observations:
                source = PoseSource(item.channel.topic, item.channel.type, frame_id, child_frame_id)
                if source == body:
                    stamped = self._stamped(pose, source, item)
                    self.counts["log_time_as_stamp"] += stamped is not pose
                    self._waiting.append((stamped, item.log_time_ns))
                elif source in self._tracks:
                    self._tracks[source].add(self._stamped(pose, source, item))
                else:
                    continue
                if why is not None:
                    self.why = why
                    self.counts["known_definition"] += 1
            yield from self._ready(item.log_time_ns)
        yield from self._emit(len(self._waiting))

    def _stamped(self, pose: Pose, source: PoseSource, message: RawMessage) -> Pose:
        """The pose, with its log time as stamp if it has none."""
        stamping = self._stampings.get(source)
        if is_row(message.channel):
            return pose
        if stamping is None:  # too few poses to tell what zero means
            return pose if pose.stamp_ns else pose._replace(stamp_ns=message.log_time_ns)
        if not stamping.lacks_stamp(pose.stamp_ns, message.log_time_ns):
            return pose
        return pose._replace(stamp_ns=stamping.from_log_time(message.log_time_ns))

    def _ready(self, now_ns: int) -> Iterator[Item]:
        """Pending poses that can be composed, once there are enough, and those that have waited too long."""
        if self._waiting and now_ns - self._waiting[0][1] > _PATIENCE_NS:
            late = takewhile(lambda logged: now_ns - logged[1] > _PATIENCE_NS, self._waiting)
            yield from self._emit(sum(1 for _ in late))
        if len(self._waiting) < self._at_once:
            return
        until_ns = min((track.until_ns for track in self._parents), default=2**63)
        if self._waiting[self._at_once - 1][0].stamp_ns <= until_ns:
            ready = takewhile(lambda logged: logged[0].stamp_ns <= until_ns, self._waiting)
            yield from self._emit(sum(1 for _ in ready))
        elif len(self._waiting) > _MOST_WAITING:
            yield from self._emit(_MOST_WAITING // 2)

    def _emit(self, many: int) -> Iterator[Item]:
        logged = [self._waiting.popleft() for _ in range(many)]
        if not logged:
            return
        poses = Poses.collect(pose for pose, _ in logged)
        good = np.ones(len(poses), bool)
        norms = np.linalg.norm(poses.quat_xyzw, axis=1)
        usable = np.isfinite(norms) & (norms > 0)
        quats = np.where(usable[:, None], poses.quat_xyzw, [0.0, 0.0, 0.0, 1.0])
        whole: _Placed | None = None
        for i, (source, inverted) in enumerate(self._steps):
            if i == self._body:
                part: _Placed = poses.position_m, Rotation.from_quat(quats)
            else:
                *part_, known = self._tracks[source].at(poses.stamp_ns)
                part = part_[0], part_[1]
                good &= known
            part = _inverse(part) if inverted else part
            whole = part if whole is None else _product(whole, part)
        self._forget()
        assert whole is not None
        self._count_lost(poses.stamp_ns[~good])
        positions, rotations = whole
        # A quaternion keeps its norm, so that the pose gate validates it as published.
        numbers = np.hstack([positions, rotations.as_quat() * np.where(usable, norms, np.nan)[:, None]])
        for i in np.flatnonzero(good).tolist():
            row = pose_row(int(poses.stamp_ns[i]), numbers[i])
            yield RawMessage(self._channel, logged[i][1], row)

    def _forget(self) -> None:
        ends_ns = [track.until_ns for track in self._parents] + [pose.stamp_ns for pose, _ in self._waiting]
        for track in self._parents:
            track.forget(min(ends_ns) - _KEPT_NS)

    def _count_lost(self, stamps_ns: NDArray[np.int64]) -> None:
        for stamp_ns in stamps_ns.tolist():
            if all(track.spans(stamp_ns) for track in self._parents):
                self.counts["parent_gap"] += 1
            else:
                self.counts["no_parent"] += 1


class _Track:
    """Samples of one transform of a chain, as long as pending poses need them."""

    def __init__(self, counts: Counter[str], static: bool) -> None:
        self._counts = counts
        self._static = static
        self._samples: deque[Pose] = deque()
        self._first_ns: int | None = None

    @property
    def until_ns(self) -> int:
        """Stamp of the last sample."""
        if self._static and self._samples:
            return 2**63
        return self._samples[-1].stamp_ns if self._samples else -(2**63)

    def spans(self, stamp_ns: int) -> bool:
        """Whether there are samples before and after a stamp."""
        return self._first_ns is not None and self._first_ns <= stamp_ns <= self.until_ns

    def add(self, pose: Pose) -> None:
        norm = float(np.linalg.norm(pose.quat_xyzw))
        is_pose = abs(norm - 1) < 0.05 and all(map(math.isfinite, pose.position_m))
        if not is_pose or abs(pose.stamp_ns) > _FARTHEST_NS:
            self._counts["bad_parent"] += 1
            return
        if self._static:
            self._samples.clear()
        elif self._samples and pose.stamp_ns <= self._samples[-1].stamp_ns:
            if pose.stamp_ns > self._samples[-1].stamp_ns - _BACK_NS:
                self._counts["bad_parent"] += pose.stamp_ns < self._samples[-1].stamp_ns
                return
            self._start_anew()
        elif self._samples and pose.stamp_ns > self._samples[-1].stamp_ns + _FORWARD_NS:
            self._start_anew()
        if self._static:
            self._first_ns = -(2**63)
        elif self._first_ns is None:
            self._first_ns = pose.stamp_ns
        self._samples.append(pose)
        if len(self._samples) > _MOST_KEPT:
            self._samples.popleft()

    def _start_anew(self) -> None:
        self._samples.clear()
        self._first_ns = None

    def forget(self, stamp_ns: int) -> None:
        """Drop the samples before the last one up to a stamp."""
        while len(self._samples) > 1 and self._samples[1].stamp_ns <= stamp_ns:
            self._samples.popleft()

    def at(self, stamps_ns: NDArray[np.int64]) -> tuple[NDArray[np.float64], Rotation, NDArray[np.bool_]]:
        """Interpolated position and rotation at stamps, and whether they are known there."""
        samples = self._about(int(stamps_ns.min()))
        if not len(samples):
            unknown = np.zeros(len(stamps_ns), bool)
            return np.zeros((len(stamps_ns), 3)), Rotation.identity(len(stamps_ns)), unknown
        if self._static or len(samples) == 1:
            known = np.full(len(stamps_ns), True) if self._static else stamps_ns == samples.stamp_ns[0]
            rotation = Rotation.from_quat(np.repeat(samples.quat_xyzw, len(stamps_ns), axis=0))
            return np.repeat(samples.position_m, len(stamps_ns), axis=0), rotation, known
        return self._between(samples, stamps_ns)

    def _about(self, stamp_ns: int) -> Poses:
        """The samples from the last one before a stamp onwards."""
        about = deque[Pose]()
        for sample in reversed(self._samples):
            about.appendleft(sample)
            if sample.stamp_ns <= stamp_ns:
                break
        return Poses.collect(about)

    def _between(
        self, samples: Poses, stamps_ns: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], Rotation, NDArray[np.bool_]]:
        known = (stamps_ns >= samples.stamp_ns[0]) & (stamps_ns <= samples.stamp_ns[-1])
        after = np.clip(np.searchsorted(samples.stamp_ns, stamps_ns, side="left"), 1, len(samples) - 1)
        is_wide = np.diff(samples.stamp_ns)[after - 1] > GAP_NS
        is_exact = (stamps_ns == samples.stamp_ns[after]) | (stamps_ns == samples.stamp_ns[after - 1])
        known &= ~is_wide | is_exact | samples.repeats[after - 1]
        origin_ns = samples.stamp_ns[0]
        times = (samples.stamp_ns - origin_ns) * 1e-9
        wanted = np.clip((stamps_ns - origin_ns) * 1e-9, 0, times[-1])
        apart = np.append(True, np.diff(times) > 0.0)  # of stamps that seconds do not tell apart the first
        times, quats, positions = times[apart], samples.quat_xyzw[apart], samples.position_m[apart]
        wanted = np.minimum(wanted, times[-1])
        if len(times) == 1:
            rotation = Rotation.from_quat(np.repeat(quats, len(wanted), axis=0))
        else:
            rotation = Slerp(times, Rotation.from_quat(quats))(wanted)
        columns = [np.interp(wanted, times, column) for column in positions.T]
        return np.column_stack(columns), rotation, known


def _product(first: _Placed, second: _Placed) -> _Placed:
    return first[0] + first[1].apply(second[0]), first[1] * second[1]


def _inverse(placed: _Placed) -> _Placed:
    back = placed[1].inv()
    return -back.apply(placed[0]), back
