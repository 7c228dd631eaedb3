"""Chains of transforms for the poses that ``--frame PARENT->CHILD`` or ``--relative-to`` selects."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Final

from contact_tracker.errors import AmbiguousSource
from contact_tracker.recording.items import Channel
from contact_tracker.recording.message_types import canonical
from contact_tracker.recording.sources import ChannelFilter, PoseSource, only_one
from contact_tracker.recording.stamping import Logged
from contact_tracker.recording.transform_tree import (
    TRANSFORM_TYPES,
    Step,
    TransformTree,
    frame_name,
    is_static,
    is_transform,
)

ARROW: Final = "->"
_BODY: Final = "the body "
REFERENCE: Final = "the reference "
"""Frame names that do not occur in logs."""


def may_be_step(channel: Channel, relative_to: str | None) -> bool:
    """Whether a channel may be part of a chain: it has transforms, or is the topic that poses are relative
    to."""
    return canonical(channel.type) in TRANSFORM_TYPES or channel.topic == relative_to


class FrameFilter(ChannelFilter):
    """Accepts what ``ChannelFilter`` accepts, transforms, and the topic that poses are relative to."""

    def __init__(self, topic: str | None, relative_to: str | None) -> None:
        super().__init__(topic)
        self._relative_to = relative_to

    def __call__(self, channel: Channel) -> bool:
        is_asked = super().__call__(channel)
        return is_asked or may_be_step(channel, self._relative_to)

    def takes(self, source: PoseSource) -> bool:
        """Whether this source may be that of the poses."""
        channel = next(c for c in self.seen.values() if (c.topic, c.type) == (source.topic, source.type))
        return super().__call__(channel)


class Chain(tuple[Step, ...]):
    """Transforms from a frame to a body."""

    __slots__ = ()

    @property
    def body(self) -> int:
        """Index of the last moving transform, which gives the stamps."""
        return max((i for i, step in enumerate(self) if not is_static(step.source)), default=-1)


def chain_between(known: Mapping[PoseSource, list[Logged]], frame: str) -> Chain | None:
    """The transforms from parent to child of ``PARENT->CHILD``; None unless one of them moves."""
    parent, _, child = frame.partition(ARROW)
    found = TransformTree(filter(is_transform, known)).chain(parent, child)
    chain = Chain(found or ())
    return chain if chain and chain.body >= 0 else None


def chain_relative(
    path: str, known: Iterable[PoseSource], source: PoseSource, relative_to: str
) -> Chain | None:
    """The transforms from a frame, or from another body (by its topic, or its name beside it in a table), to
    the body of ``source``."""
    sources = set(known)
    references = [s for s in sources if s.topic == relative_to and s != source]
    references = references or [s for s in sources if s != source and is_beside(s, source, relative_to)]
    tree = {s for s in sources if is_transform(s) and s != source}
    # Bodies in the same frame are found without a tree; a body has no children.
    body = replace(source, child_frame_id=_BODY)
    steps, start = {s: Step(s, False) for s in tree} | {body: Step(source, False)}, relative_to
    if references and not any(map(is_transform, references)):
        reference = only_one(path, references)
        named = replace(reference, child_frame_id=REFERENCE)
        steps[named], start = Step(reference, False), REFERENCE
    elif source.child_frame_id and relative_to in (source.child_frame_id,):
        raise AmbiguousSource(f"{path}: {relative_to} is the body itself: name another frame")
    found = TransformTree(steps).chain(start, _BODY)
    if found is None:
        return None
    return Chain(Step(steps[step.source].source, step.inverted) for step in found)


def is_beside(other: PoseSource, source: PoseSource, name: str) -> bool:
    """Whether ``other`` has the poses of the body ``name`` in the frame in which those of ``source`` are."""
    is_same_frame = frame_name(other.frame_id) == frame_name(source.frame_id)
    is_known_to_be = other.topic == source.topic and not source.frame_id  # of one file of motion capture
    is_named = bool(name) and frame_name(other.child_frame_id) == frame_name(name)
    return is_named and is_same_frame and is_known_to_be and not is_transform(other)


def composition_hint(sources: Iterable[PoseSource]) -> str:
    """A hint for a choice among transforms that connect one frame to one body."""
    steps = [source for source in sources if is_transform(source)]
    parents = {frame_name(source.frame_id) for source in steps}
    children = {frame_name(source.child_frame_id) for source in steps}
    roots, bodies = parents - children, children - parents
    if len(steps) < 2 or len(roots) != 1 or len(bodies) != 1:
        return ""
    return f", or compose them by --frame '{min(roots)}->{min(bodies)}'"


def relative_hint(path: str, sources: Iterable[PoseSource], frame: str) -> str:
    """A hint for ``PARENT->CHILD`` where ``--relative-to`` would give these poses, else empty."""
    known = sorted(sources)
    parent, arrow, child = frame.partition(ARROW)
    for source in known if arrow else ():
        with suppress(AmbiguousSource):
            if source.child_frame_id == child and chain_relative(path, known, source, parent):
                return f"; compose it by --frame {child} --relative-to {parent}"
    return ""


def composed_source(chain: Chain, parent: str, child: str) -> PoseSource:
    """The source name of the poses of a chain."""
    body = chain[chain.body].source
    frame_moves = any(step.inverted and not is_static(step.source) for step in chain)
    return PoseSource(body.topic, body.type, parent, child, frame_moves=frame_moves)


def moving_parent_note(known: Iterable[PoseSource], source: PoseSource) -> str | None:
    """One line if the parent frame of the poses may itself move, else None."""
    tree = TransformTree(s for s in known if s != source)
    root = tree.moving_root(source.frame_id) if source.frame_id else None
    if root is None:
        return None
    advice = f"--frame '{root}->{source.child_frame_id}'" if is_transform(source) else f"--relative-to {root}"
    return (
        f"poses are in {source.frame_id}, which may move in {root}: contacts are with {source.frame_id}; for "
        f"those with {root}: {advice}"
    )
