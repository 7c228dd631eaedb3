"""Poses of the frame of wrenches at their stamps, if it is neither the object's frame nor that of its poses,
composed from transforms."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from heapq import merge
from itertools import chain, islice
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.errors import NoPoses
from contact_tracker.motion.poses import BATCH, NO_POSES, Poses
from contact_tracker.recording.composition import Composer
from contact_tracker.recording.decoding import MessageDecoder, is_readable, pose_row, row_channel
from contact_tracker.recording.frames import REFERENCE, Chain, may_be_step
from contact_tracker.recording.items import Channel, Item, RawMessage
from contact_tracker.recording.reading import Reading
from contact_tracker.recording.sources import ChannelFilter, PoseSource, peek, poses_by_source, take_prefix
from contact_tracker.recording.stamping import Logged
from contact_tracker.recording.transform_tree import (
    Step,
    TransformTree,
    is_static,
    is_transform,
)

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
    counts : ``bad_parent`` as docs/conventions.md says, and ``undecodable`` messages.
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
    channel = row_channel(wrench.topic, wrench.type, wrench.frame_id, wrench.child_frame_id)
    own = {step.source.topic for step in steps}
    reading = Reading(path, lambda channel: channel.topic in own and is_readable(channel))
    composer = Composer(
        (*steps, Step(wrench, False)), len(steps), wrench, MessageDecoder(reading.budget), BATCH
    )
    composer.learn(found.known)
    unturned = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    logged = log_time_ns.argsort(kind="stable")  # stamps may be in another order
    rows = (
        RawMessage(channel, logged_ns, pose_row(at_ns, unturned))
        for at_ns, logged_ns in zip(stamp_ns[logged].tolist(), log_time_ns[logged].tolist(), strict=True)
    )
    transforms = (item for item in reading if isinstance(item, RawMessage))
    items: Iterator[RawMessage] = merge(rows, transforms, key=lambda message: message.log_time_ns)
    poses = Poses.join([NO_POSES, *_columns(composer.compose(items))])
    poses = poses[poses.stamp_ns.argsort(kind="stable")]
    return FramePoses(poses, found.in_object, tuple(sorted(own)), composer.counts)


def _columns(items: Iterator[Item]) -> Iterator[Poses]:
    """Composed poses, in columns."""
    decoder = MessageDecoder(None)
    messages = (item for item in items if isinstance(item, RawMessage))
    for first in messages:
        observed = decoder.observe_all(list(chain([first], islice(messages, BATCH - 1))))
        assert observed is not None
        yield observed.poses
