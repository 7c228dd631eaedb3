"""Wrenches on the object from messages of geometry_msgs/msg/WrenchStamped."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from heapq import merge
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.errors import ChoiceError, InputError
from contact_tracker.motion.poses import BATCH, Pose, Poses
from contact_tracker.recording.decoding import Undecodable, is_readable
from contact_tracker.recording.definitions import canonical
from contact_tracker.recording.items import Channel, PoseSource, RawMessage
from contact_tracker.recording.reading import Reading
from contact_tracker.recording.sources import Logged, may_be_step, poses_by_source, take_prefix
from contact_tracker.recording.transforms import (
    REFERENCE,
    Chain,
    Composer,
    Step,
    TransformTree,
    frame_name,
    is_static,
    is_transform,
)
from contact_tracker.suggestions import suggestion
from contact_tracker.wrenches.wrenches import Wrenches, about_body, about_parent

_WRENCH: Final = "the wrench "
"""A frame name that does not occur in logs."""
WRENCH_TYPE: Final = "geometry_msgs/msg/WrenchStamped"
_MOST: Final = 4_000_000
"""Most wrenches that are kept, at about 330 bytes each while they are read; later ones are counted."""


@dataclass(frozen=True, eq=False)
class WrenchLog:
    """The wrenches on one topic.

    Parameters
    ----------
    wrenches : finite wrenches in order of time, about the origin of the body and in its axes.
    dropped : number of messages that cannot be decoded, have no stamp or a repeated one, or are not finite.
    unplaced : number of wrenches left out, as the pose of their frame is not known at their stamp.
    bad_transforms : number of transforms to their frame left out: no pose, or a stamp that goes back.
    frame_id : frame of the messages.
    taken : the assumed meaning of that frame, in words.
    """

    wrenches: Wrenches
    dropped: int
    unplaced: int
    bad_transforms: int
    frame_id: str
    taken: str

    @property
    def noted(self) -> str:
        """What was left out, in words; empty if nothing was."""
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

    Wrenches are about the origin and in the axes of their ``header.frame_id``: the body's frame, the parent
    frame of its poses, or a frame to which transforms lead from either. An empty name stands for the body's
    frame, as does a name that no transform has, if the poses have no child frame.

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

    reading, rows, dropped = Reading(path, wanted), list[tuple[str, int, int, tuple[float, ...]]](), 0
    for message in reading:
        if isinstance(message, RawMessage):
            frame, stamp_ns, numbers_of = _decoded(reading, message)
            stamp_ns = message.log_time_ns if by_log_time and numbers_of else stamp_ns
            if stamp_ns and len(rows) < _MOST:
                rows.append((frame, stamp_ns, message.log_time_ns, numbers_of))
            else:
                dropped += 1
    if not rows:
        if (channel := channels.get(topic)) is None:
            names = [name for name in sorted(channels) if canonical(channels[name].type) == WRENCH_TYPE]
            listing = f"{', '.join(names[:8]) or 'none'}{suggestion(topic, names)}"
            raise ChoiceError(f"{path}: no topic {topic}; of {WRENCH_TYPE} there is {listing}")
        if canonical(channel.type) != WRENCH_TYPE or not is_readable(channel):
            kind = channel.type or "of no type"
            raise ChoiceError(f"{path}: {topic} is {kind}; only {WRENCH_TYPE} is read")
        raise InputError(f"{path}: no message on {topic} can be used")
    frames, stamps, log_times, numbers = zip(*rows, strict=True)
    frame_id, *further = sorted({*frames})
    if further:
        raise ChoiceError(f"{path}: {topic} changes its frame: {', '.join([frame_id, *further][:4])}")
    stamp_column, columns = np.array(stamps, np.int64), np.array(numbers, float)
    wrenches = Wrenches(stamp_column, columns[:, :3], columns[:, 3:]).valid
    dropped += len(stamps) - len(wrenches)
    if not len(wrenches):
        raise InputError(f"{path}: no wrench on {topic} is finite")
    every_ns, first = np.unique(stamp_column, return_index=True)
    logged_ns = np.array(log_times, np.int64)[first[every_ns.searchsorted(wrenches.stamp_ns)]]
    placed, taken, bad = _about_body(path, topic, frame_id, source, poses, wrenches, logged_ns)
    unplaced = len(wrenches) - len(placed)
    return WrenchLog(placed, dropped, unplaced, bad, frame_id, taken)


def _about_body(
    path: str,
    topic: str,
    frame_id: str,
    source: PoseSource,
    poses: Poses,
    wrenches: Wrenches,
    logged_ns: NDArray[np.int64],
) -> tuple[Wrenches, str, int]:
    """The wrenches about the origin of the body and in its axes, the assumed meaning of their frame, and the
    number of bad transforms; ``logged_ns`` (N,) are log times. Raises as ``read_wrenches``."""
    body, parent = source.child_frame_id, source.frame_id
    if not frame_id:
        return wrenches, "in no frame that is named: taken as the object's", 0
    if body and frame_name(frame_id) == frame_name(body):
        return wrenches, f"in the frame {frame_id}, the object's", 0
    if frame_name(frame_id) == frame_name(parent):
        return about_body(wrenches, poses), f"in the frame {frame_id}, that of the poses", 0
    reading = Reading(path, lambda channel: may_be_step(channel, source.frame_id) and is_readable(channel))
    groups, read_ahead = reading.decoder.groups(reading), dict[PoseSource, list[Logged]]()
    steps, in_object, is_in_tree = tuple[Step, ...](), False, False
    while not steps and (following := take_prefix(groups)):
        read_ahead = {**poses_by_source(following), **read_ahead}
        steps, in_object, is_in_tree = _chain(read_ahead, frame_id, source)
    if not steps:
        if body or is_in_tree:
            ends = [f"the object ({body})"] if body else []
            ends += [f"its poses ({parent})"] if parent else []
            raise ChoiceError(
                f"{path}: {topic} is in the frame {frame_id}, and no transforms (/tf, /tf_static) lead there "
                f"from the frame of {' or of '.join(ends) or 'the poses, which name none'}: record them too, "
                "or transform the wrenches first"
            )
        return wrenches, f"in the frame {frame_id}, which no transform names: taken as the object's", 0
    wrench, topics = PoseSource("", _WRENCH, "", _WRENCH), {step.source.topic for step in steps}
    reading = Reading(path, lambda channel: channel.topic in topics and is_readable(channel))
    composer = Composer((*steps, Step(wrench, False)), wrench, BATCH, read_ahead)
    origin, order = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), logged_ns.argsort(kind="stable")
    times_ns = zip(wrenches.stamp_ns[order].tolist(), logged_ns[order].tolist(), strict=True)
    stamped = ((wrench, Pose(stamp_ns, *origin), log_time_ns) for stamp_ns, log_time_ns in times_ns)
    merged = merge(stamped, reading.decoder.poses(reading), key=lambda logged: logged[2])
    frame_poses = Poses.collect(pose for _, pose, _ in composer.compose(merged))
    frame_poses = frame_poses[frame_poses.stamp_ns.argsort(kind="stable")]  # by stamp, not by log time
    start, names = body if in_object else parent, ", ".join(sorted(topics))
    if not len(frame_poses):
        raise InputError(
            f"{path}: {topic} is in the frame {frame_id}, whose pose in {start} is not known at the time of "
            f"any wrench: are the stamps on {topic} and {names} of one clock?"
        )
    placed = about_parent(wrenches.at(wrenches.stamp_ns.searchsorted(frame_poses.stamp_ns)), frame_poses)
    taken = f"in the frame {frame_id}, whose pose in {start} is on {names}"
    return placed if in_object else about_body(placed, poses), taken, composer.counts["bad_parent"]


def _chain(
    read_ahead: Mapping[PoseSource, list[Logged]], frame_id: str, source: PoseSource
) -> tuple[Chain, bool, bool]:
    """The transforms that lead to a frame from the frame of the poses or from the object, whichever has fewer
    moving ones; empty without any. Then whether they start at the object, and whether any transform names the
    frame."""
    named, start = dict[PoseSource, PoseSource](), source.frame_id
    for reference in read_ahead:  # poses relative to another topic are in no frame
        if reference.topic == source.frame_id and not is_transform(reference):
            named[replace(reference, child_frame_id=REFERENCE)], start = reference, REFERENCE
    tree = TransformTree(filter(is_transform, read_ahead), named)
    chains = list[tuple[int, bool, Chain]]()
    for begin, in_object in ((start, False), (source.child_frame_id, True)):
        if begin and (along := tree.chain(begin, frame_id)):
            chains.append((sum(not is_static(step.source) for step in along), in_object, along))
    _, in_object, shortest = min(chains, key=lambda candidate: candidate[:2], default=(0, False, ()))
    return shortest, in_object, frame_id in tree


def _decoded(reading: Reading, message: RawMessage) -> tuple[str, int, tuple[float, ...]]:
    """Frame, stamp (ns) and numbers (N, N m) of a message; empty if it does not match its schema."""
    try:
        decoded = reading.decoder.decode(message)
        header, force, moment = decoded.header, decoded.wrench.force, decoded.wrench.torque
        stamp_ns = int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)
        numbers = (force.x, force.y, force.z, moment.x, moment.y, moment.z)
        return str(header.frame_id), stamp_ns, tuple(map(float, numbers))
    except (Undecodable, AttributeError, TypeError, ValueError):
        return "", 0, ()
