"""Wrenches on the object, from the messages of one topic (geometry_msgs/msg/WrenchStamped)."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from heapq import merge
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.errors import ChoiceError, InputError, NoPoses
from contact_tracker.motion.poses import BATCH, Pose, Poses
from contact_tracker.recording.decoding import LoggedPose, MessageDecoder, Undecodable, is_readable
from contact_tracker.recording.definitions import canonical
from contact_tracker.recording.items import Channel, PoseSource, RawMessage
from contact_tracker.recording.reading import Reading
from contact_tracker.recording.sources import ChannelFilter, Logged, peek, poses_by_source, take_prefix
from contact_tracker.recording.transforms import (
    REFERENCE,
    Chain,
    Composer,
    Step,
    TransformTree,
    frame_name,
    is_static,
    is_transform,
    may_be_step,
)
from contact_tracker.suggestions import suggestion
from contact_tracker.wrenches.wrenches import Wrenches, about_body, about_parent

_WRENCH: Final = "the wrench "
"""A frame name that does not occur in logs."""


class FramePoses(NamedTuple):
    """Where the frame of wrenches is.

    Parameters
    ----------
    poses : of the frame in the object, or in what the object's poses are in; at the stamps at which its
        transforms are known.
    in_object : which of the two.
    topics : where the transforms are.
    counts : ``bad_parent`` as docs/conventions.md says.
    """

    poses: Poses
    in_object: bool
    topics: tuple[str, ...]
    counts: Counter[str]


class FrameChain(NamedTuple):
    """Transforms to the frame of wrenches, and the first messages of what was found on the way.

    Parameters
    ----------
    steps : from the object, or from what its poses are in; None where there are none.
    in_object : which of the two.
    is_in_tree : whether any transform names the frame.
    """

    steps: Chain | None
    in_object: bool
    is_in_tree: bool
    known: Mapping[PoseSource, list[Logged]]


class _TransformFilter(ChannelFilter):
    """Accepts only what a chain may consist of: other than for poses, no topic is wanted for itself."""

    def __init__(self, relative_to: str) -> None:
        super().__init__(None)
        self._relative_to = relative_to

    def __call__(self, channel: Channel) -> bool:
        self.seen[channel.topic, channel.type, channel.encoding] = channel
        return may_be_step(channel, self._relative_to) and is_readable(channel)


def chain_to(path: str, frame_id: str, source: PoseSource) -> FrameChain:
    """The transforms that lead to a frame, from the object or from what its poses (``source``) are in: those
    of which fewer move."""
    known = dict[PoseSource, list[Logged]]()
    wanted = _TransformFilter(source.frame_id)
    reading = Reading(path, wanted)
    decoder = MessageDecoder(reading.budget)
    try:
        known.update(poses_by_source(peek(path, wanted), decoder))
    except NoPoses:
        return FrameChain(None, False, False, known)
    items = iter(reading)
    while (found := _chain(known, frame_id, source)).steps is None and (more := take_prefix(items)):
        for new, poses in poses_by_source(more, decoder).items():
            known.setdefault(new, poses)
    return found


def _chain(known: Mapping[PoseSource, list[Logged]], frame_id: str, source: PoseSource) -> FrameChain:
    steps = {of: Step(of, False) for of in known if is_transform(of)}
    start = source.frame_id
    for reference in known:  # poses that are relative to those of another topic, and so in no frame
        if reference.topic == source.frame_id and not is_transform(reference):
            steps[replace(reference, child_frame_id=REFERENCE)] = Step(reference, False)
            start = REFERENCE
    tree = TransformTree(steps)
    chains = list[tuple[int, bool, Chain]]()
    for begin, in_object in ((start, False), (source.child_frame_id, True)):
        found = tree.chain(begin, frame_id) if begin else None
        if found:
            along = Chain(Step(steps[step.source].source, step.inverted) for step in found)
            chains.append((sum(not is_static(step.source) for step in along), in_object, along))
    if not chains:
        return FrameChain(None, False, frame_id in tree, known)
    _, in_object, along = min(chains, key=lambda one: one[:2])
    return FrameChain(along, in_object, True, known)


def frame_poses(
    path: str, found: FrameChain, stamp_ns: NDArray[np.int64], log_time_ns: NDArray[np.int64]
) -> FramePoses:
    """Poses of the frame that a chain leads to, at the stamps (N,) of wrenches, which ascend.

    Parameters
    ----------
    log_time_ns : (N,) when each was logged.
    """
    steps = found.steps
    assert steps is not None
    wrench = PoseSource("", _WRENCH, "", _WRENCH)
    own = {step.source.topic for step in steps}
    reading = Reading(path, lambda channel: channel.topic in own and is_readable(channel))
    decoder = MessageDecoder(reading.budget)
    composer = Composer((*steps, Step(wrench, False)), len(steps), wrench, decoder.assumed, BATCH)
    composer.learn(found.known)
    origin = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    logged = log_time_ns.argsort(kind="stable")  # stamps may be in another order
    wrenches = (
        (wrench, Pose(at_ns, *origin), logged_ns)
        for at_ns, logged_ns in zip(stamp_ns[logged].tolist(), log_time_ns[logged].tolist(), strict=True)
    )
    transforms = (one for one in decoder.poses(reading) if one is not None)
    merged: Iterator[LoggedPose] = merge(wrenches, transforms, key=lambda one: one[2])
    composed = composer.compose(merged)
    poses = Poses.collect(one[1] for one in composed if one is not None)
    poses = poses[poses.stamp_ns.argsort(kind="stable")]
    return FramePoses(poses, found.in_object, tuple(sorted(own)), composer.counts)


WRENCH_TYPE: Final = "geometry_msgs/msg/WrenchStamped"
_MOST: Final = 4_000_000
"""Wrenches that are kept, of about 330 bytes each while they are read; what comes later is counted."""


@dataclass(frozen=True, eq=False)
class WrenchLog:
    """What one topic holds.

    Parameters
    ----------
    wrenches : finite ones, in order of time, about the body's origin and in its axes.
    dropped : messages that cannot be decoded, without a stamp, not finite, or of a stamp that is repeated.
    unplaced : wrenches that are left out, since the pose of their frame is not known at their stamp.
    bad_transforms : transforms to their frame that are left out: no pose, or a stamp that goes back.
    frame_id : of the messages.
    taken : words on what that frame was taken for.
    damage : one line if the recording is truncated or damaged.
    """

    wrenches: Wrenches
    dropped: int
    unplaced: int
    bad_transforms: int
    frame_id: str
    taken: str
    damage: str | None

    @property
    def noted(self) -> str:
        """What was left out, in words; nothing where all is well."""
        counts = (
            (self.dropped, "dropped {} that cannot be used"),
            (self.unplaced, f"left out {{}} at times at which the pose of {self.frame_id} is not known"),
            (self.bad_transforms, "left out {} transforms that are no poses, or whose stamps go back"),
        )
        return "; ".join(text.format(count) for count, text in counts if count)


def read_wrenches(
    path: str, topic: str, source: PoseSource, poses: Poses, by_log_time: bool = False
) -> WrenchLog:
    """The wrenches on ``topic`` of the object whose ``poses`` come from ``source``.

    Messages are about the origin and in the axes of their ``header.frame_id``. That is the body's frame, the
    frame in which its poses are, or one to which transforms lead from either. Without a name it is the
    body's; so is one that no transform names, where poses do not name the body's (they have no child frame).

    Parameters
    ----------
    by_log_time : whether poses have their log times as stamps, since their headers have none.

    Raises
    ------
    ChoiceError
        There is no such topic, it is of another type, its frame changes, or no transforms lead to it.
    InputError
        Nothing on it can be read, or its frame's pose is known at none of its stamps.
    """
    channels: dict[str, Channel] = {}

    def wanted(channel: Channel) -> bool:
        channels[channel.topic] = channel
        return channel.topic == topic and canonical(channel.type) == WRENCH_TYPE and is_readable(channel)

    reading = Reading(path, wanted)
    rows, frames, dropped = list[tuple[float, ...]](), dict[str, int](), 0
    stamps, log_times = list[int](), list[int]()
    for message, row in _decoded(reading):
        if row is None or len(stamps) == _MOST:
            dropped += 1
            continue
        frame_id, stamp_ns, numbers = row
        stamp_ns = message.log_time_ns if by_log_time else stamp_ns
        if not stamp_ns:
            dropped += 1
            continue
        frames[frame_id] = frames.get(frame_id, 0) + 1
        stamps.append(stamp_ns)
        log_times.append(message.log_time_ns)
        rows.append(numbers)
    if not stamps:
        raise _nothing(path, topic, channels)
    if len(frames) > 1:
        raise ChoiceError(f"{path}: {topic} changes its frame: {', '.join(sorted(frames)[:4])}")
    (frame_id,) = frames
    columns = np.array(rows, float)
    found = Wrenches(np.array(stamps, np.int64), columns[:, :3], columns[:, 3:]).valid
    dropped += len(stamps) - len(found)
    if not len(found):
        raise InputError(f"{path}: no wrench on {topic} is finite")
    logged = _LoggedWrenches(found, np.array(stamps, np.int64), np.array(log_times, np.int64))
    placed = _about_body(path, topic, frame_id, source, poses, logged)
    return WrenchLog(
        placed.wrenches,
        dropped,
        len(found) - len(placed.wrenches),
        placed.bad_transforms,
        frame_id,
        placed.taken,
        reading.damage,
    )


class _Placed(NamedTuple):
    """As of ``WrenchLog``."""

    wrenches: Wrenches
    taken: str
    bad_transforms: int = 0


class _LoggedWrenches(NamedTuple):
    """Wrenches in their own frame, and the log times of all stamps on their topic."""

    wrenches: Wrenches
    stamp_ns: NDArray[np.int64]
    log_time_ns: NDArray[np.int64]

    @property
    def logged_ns(self) -> NDArray[np.int64]:
        """When each wrench was logged."""
        stamps, first = np.unique(self.stamp_ns, return_index=True)
        return self.log_time_ns[first[stamps.searchsorted(self.wrenches.stamp_ns)]]


def _about_body(
    path: str, topic: str, frame_id: str, source: PoseSource, poses: Poses, logged: _LoggedWrenches
) -> _Placed:
    """The wrenches about the body's origin and in its axes; raises as ``read_wrenches``."""
    found, body, parent = logged.wrenches, source.child_frame_id, source.frame_id
    if not frame_id:
        return _Placed(found, "in no frame that is named: taken as the object's")
    if body and frame_name(frame_id) == frame_name(body):
        return _Placed(found, f"in the frame {frame_id}, the object's")
    if frame_name(frame_id) == frame_name(parent):
        return _Placed(about_body(found, poses), f"in the frame {frame_id}, that of the poses")
    chain = chain_to(path, frame_id, source)
    if chain.steps is None:
        if body or chain.is_in_tree:
            raise ChoiceError(_unconnected(path, topic, frame_id, source))
        return _Placed(found, f"in the frame {frame_id}, which no transform names: taken as the object's")
    frames = frame_poses(path, chain, found.stamp_ns, logged.logged_ns)
    start = body if frames.in_object else parent
    if not len(frames.poses):
        raise InputError(
            f"{path}: {topic} is in the frame {frame_id}, whose pose in {start} is not known at the time of "
            f"any wrench: are the stamps on {topic} and {', '.join(frames.topics)} of one clock?"
        )
    placed = found.at(found.stamp_ns.searchsorted(frames.poses.stamp_ns))
    placed = about_parent(placed, frames.poses)
    return _Placed(
        placed if frames.in_object else about_body(placed, poses),
        f"in the frame {frame_id}, whose pose in {start} is on {', '.join(frames.topics)}",
        frames.counts["bad_parent"],
    )


def _decoded(reading: Reading) -> Iterator[tuple[RawMessage, tuple[str, int, tuple[float, ...]] | None]]:
    """Each message with its frame, stamp and numbers; None if it is not what its schema promises."""
    decoder = MessageDecoder(reading.budget)
    for item in reading:
        if not isinstance(item, RawMessage):
            continue
        try:
            decoded = decoder.decode(item)
            header, force, moment = decoded.header, decoded.wrench.force, decoded.wrench.torque
            stamp_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
            numbers = (force.x, force.y, force.z, moment.x, moment.y, moment.z)
            yield item, (str(header.frame_id), int(stamp_ns), tuple(map(float, numbers)))
        except (Undecodable, AttributeError, TypeError, ValueError):
            yield item, None


def _unconnected(path: str, topic: str, frame_id: str, source: PoseSource) -> str:
    ends = [f"the object ({source.child_frame_id})"] if source.child_frame_id else []
    ends += [f"its poses ({source.frame_id})"] if source.frame_id else []
    to = " or of ".join(ends) or "the poses, which name none"
    return (
        f"{path}: {topic} is in the frame {frame_id}, and no transforms (/tf, /tf_static) lead there from "
        f"the frame of {to}: record them too, or transform the wrenches first"
    )


def _nothing(path: str, topic: str, channels: dict[str, Channel]) -> ChoiceError | InputError:
    there = channels.get(topic)
    if there is None:
        names = [name for name, channel in sorted(channels.items()) if canonical(channel.type) == WRENCH_TYPE]
        return ChoiceError(
            f"{path}: no topic {topic}; of {WRENCH_TYPE} there is {', '.join(names[:8]) or 'none'}"
            f"{suggestion(topic, names)}"
        )
    if canonical(there.type) != WRENCH_TYPE or not is_readable(there):
        return ChoiceError(f"{path}: {topic} is {there.type or 'of no type'}; only {WRENCH_TYPE} is read")
    return InputError(f"{path}: no message on {topic} can be used")
