"""Pose sources of a recording, and selection of one.

A source is a topic with its frames. If a file has an index, this gives the channels, and a prefix from the
first chunk of each gives their frames. Otherwise (pipes, growing, truncated and index-less files) the prefix
of the whole file decides. A prefix is one second of log time from its first pose, and
at most 2000 pose messages and 10,000 poses; with an index at most 8 MB per channel, and 32 MB together. If
another matching source appears later, the user has to choose; a live stream continues with the first source,
and reports the other.
`/tf_static` does not move, and `/contact/frames` belongs to results: these are sources only if their topic is
requested.
"""

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import median
from typing import Final, NamedTuple

from mcap.summary import Summary

from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import AmbiguousSource, ChoiceError, NoPoses
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording.bytestream import WorkBudget, is_regular, open_stream
from contact_tracker.recording.decoding import (
    POSE_TYPES,
    READ,
    SECOND_NS,
    USUAL,
    LoggedPose,
    MessageDecoder,
    fields_with_poses,
    is_readable,
    may_have_poses,
)
from contact_tracker.recording.definitions import canonical
from contact_tracker.recording.items import (
    BUFFER_BYTES,
    FRAMES_TOPIC,
    RESULT_TOPICS,
    ROWS_AT_ONCE,
    Channel,
    PoseSource,
    RawMessage,
)
from contact_tracker.recording.mcap_file import RecordLoop, channel_of, summary_of
from contact_tracker.recording.reading import parts_of
from contact_tracker.suggestions import suggestion

PREFIX_NS: Final = SECOND_NS
PREFIX_MESSAGES: Final = 2000
_LATEST_NS: Final = 2**63 - 1
COARSE: Final = 4
"""Number of different poses per stamp from which stamps cannot order poses in time."""
COARSE_SECONDS: Final = 2
"""The same number for stamps in whole seconds, only two of which occur among the first poses."""

Logged = tuple[Pose, int]
"""A pose with the stamp of its header, and its log time in nanoseconds."""


class Stamping(NamedTuple):
    """Assigns stamps to the poses of one source.

    Parameters
    ----------
    by_log_time : whether every pose gets its log time: all stamps of the prefix are zero, or most differing
        poses share one.
    offset_ns : median delay from stamps to log times; None if unknown.
    near_zero_ns : how far from zero stamps of the prefix may be, as a clock may run faster than log time.
    """

    by_log_time: bool = False
    offset_ns: int | None = None
    near_zero_ns: int = PREFIX_NS

    @classmethod
    def by(cls, prefix: Sequence[Logged]) -> "Stamping":
        """The stamping by the first poses of a source: one second of log time, at most 2000 poses."""
        good = [(pose.stamp_ns, log_time_ns) for pose, log_time_ns in prefix if pose.stamp_ns]
        are_zero = len(prefix) > 1 and not good
        stamps = {pose.stamp_ns for pose, _ in prefix}  # coarse if most share theirs with a different pose
        enough = COARSE_SECONDS if all(stamp_ns % SECOND_NS == 0 for stamp_ns in stamps) else COARSE
        by_log_time = are_zero or len({pose[1:] for pose, _ in prefix}) >= enough * len(stamps) > 0
        if not good:
            return cls(by_log_time)
        offset_ns = round(median(log_time_ns - stamp_ns for stamp_ns, log_time_ns in good))
        return cls(by_log_time, offset_ns, max(PREFIX_NS, max(good)[0] - min(good)[0]))

    @property
    def log_offset_ns(self) -> int:
        """Median delay from a pose's stamp to its log time (ns)."""
        return 0 if self.by_log_time or self.offset_ns is None else self.offset_ns

    def admitted(self, gate: PoseGate, logged: Iterable[Logged]) -> Poses:
        """The poses with their stamps that pass the gate."""
        return gate.admit_all(self.stamped(*entry, gate.counts) for entry in logged)

    def stamped(self, pose: Pose, log_time_ns: int, counts: Counter[str]) -> Pose:
        """The pose with its log time as stamp if it lacks one, which is counted.

        Zero is an unset stamp, unless the other stamps are near zero: clocks of simulations start there.
        """
        stamp_ns = log_time_ns
        if not self.by_log_time:
            if pose.stamp_ns or self.offset_ns is None:
                return pose
            stamp_ns -= self.offset_ns
            if abs(stamp_ns) <= self.near_zero_ns:
                return pose
        counts["log_time_as_stamp"] += 1
        return pose._replace(stamp_ns=min(stamp_ns, _LATEST_NS))


_STATIC: Final = "tf_static"
_UNDECODED: Final = (
    "no pose on {} can be read: messages are empty, or not what their definition in the file says, or it "
    "cannot be used"
)
_LISTED: Final = 8
_TEXT_SHOWN: Final = 120
"""Largest number of characters of a name from the file in messages."""
_POSE_LIKE: Final = re.compile(r"Pose|Transform|Odometry|TFMessage|Path|RigidBod|Mocap")


TRANSFORM_TYPES: Final = frozenset(
    kind for kind in POSE_TYPES if re.search("Transform|TFMessage|tfMessage", kind)
)


class ChannelFilter:
    """Whether a channel may carry the selected poses; records all tested channels, and the number of messages
    by topic, if an index has it.

    Parameters
    ----------
    topic : ``/name``, or ``/name:TYPE`` if the topic has several types; TYPE may be without its package.
    table : reading with the path to the poses in messages of unknown types, and the command that reads them.
    with_transforms : whether transforms are accepted as well, and the topic ``relative_to``.
    """

    def __init__(
        self,
        topic: str | None,
        table: TableReading = AS_NAMED,
        with_transforms: bool = False,
        relative_to: str | None = None,
    ) -> None:
        self._topic, self.table = topic, table
        self._with_transforms, self.relative_to = with_transforms, relative_to
        self.seen: dict[tuple[str, str, str], Channel] = {}
        self.counts = Counter[str]()

    def __call__(self, channel: Channel) -> bool:
        self.seen[channel.topic, channel.type, channel.encoding] = channel
        return self._has_poses(channel) or (self._with_transforms and may_be_step(channel, self.relative_to))

    def takes(self, source: PoseSource) -> bool:
        """Whether this source may be the selected one; the filter also passes transforms."""
        return any(
            (channel.topic, channel.type) == (source.topic, source.type) and self._has_poses(channel)
            for channel in self.seen.values()
        )

    def _has_poses(self, channel: Channel) -> bool:
        return may_have_poses(channel, self.table.field) and self._is_asked(channel)

    def _is_asked(self, channel: Channel) -> bool:
        if self._topic is None:
            return not channel.topic.endswith(_STATIC) and channel.topic not in RESULT_TOPICS
        if channel.topic == self._topic:
            return True
        topic, colon, kind = self._topic.rpartition(":")
        names = (channel.type, canonical(channel.type), re.split(r"[/.]", channel.type)[-1])
        return bool(colon) and channel.topic == topic and kind in names

    def nothing_found(self, path: str) -> NoPoses | ChoiceError:
        """The error that lists what the recording has instead of the selected poses."""
        seen = list(self.seen.values())
        requested = [c for c in seen if self._topic is not None and self._is_asked(c)]
        poses = [c for c in seen if may_have_poses(c, self.table.field)]
        alike = [c for c in seen if not may_have_poses(c) and _POSE_LIKE.search(c.type)]
        alike = alike or [c for c in seen if not is_readable(c)]
        fields = _fields_in(path, requested or seen, self.table)
        fault: type[NoPoses | ChoiceError] = NoPoses
        if any(map(self, requested)):
            text = _UNDECODED.format(requested[0].topic[:_TEXT_SHOWN])
        elif fields and (requested or not poses):
            text = fields
        elif requested:
            fault, text = (ChoiceError if poses else NoPoses), _reasons(requested)
        elif self._topic is not None:
            topics = [c.topic for c in (poses or seen)]
            fault, near = (ChoiceError if poses else NoPoses), suggestion(self._topic, topics)[:_TEXT_SHOWN]
            text = f"no topic {self._topic}; there is {_listing(dict.fromkeys(topics)) or 'none'}{near}"
        elif any(c.topic == FRAMES_TOPIC for c in poses):
            text = f"it holds a result only; --topic {FRAMES_TOPIC} takes the poses in it"
        elif poses and all(c.topic.endswith(_STATIC) for c in poses):
            static = poses[0].topic
            text = f"its only poses are on {static}, which does not move"
            text += f": to take them all the same, --topic {static}"
        elif poses or alike:
            text = _UNDECODED.format(_listing(c.topic for c in poses)) if poses else _reasons(alike)
        else:
            topics_seen = _listing(f"{c.topic} ({c.type})" for c in seen) or "no topics at all"
            text = f"no pose topic among {topics_seen}; poses are {USUAL}"
        return fault(f"{path}: {text}")


def may_be_step(channel: Channel, relative_to: str | None) -> bool:
    """Whether a channel may be part of a chain: it has transforms, or is the topic ``relative_to``."""
    return canonical(channel.type) in TRANSFORM_TYPES or channel.topic == relative_to


def peek(path: str, selection: ChannelFilter) -> dict[PoseSource, list[Logged]]:
    """The sources on the wanted channels of an index, with the poses in the prefix of each; reads only the
    chunks that have its first messages.

    Raises NoPoses or ChoiceError if the indexes list all channels, and none is wanted, or none of the topic.
    """
    messages, indexed = list[RawMessage](), True
    for part in parts_of(path):
        if (summary := summary_of(part)) is None:
            indexed = False
            continue
        read, missing = {message.channel for message in messages}, dict[int, Channel]()
        assert summary.statistics is not None
        for channel_id in sorted(summary.channels):
            count = summary.statistics.channel_message_counts.get(channel_id, 0)
            channel = channel_of(summary.channels[channel_id], summary.schemas)
            selection.counts[channel.topic] += count
            if selection(channel) and count and channel not in read:
                missing[channel_id] = channel
        messages += _peek_channels(part, summary, missing)
    if indexed and not any(selection(channel) for channel in list(selection.seen.values())):
        raise selection.nothing_found(path)
    budget = WorkBudget(sum(os.path.getsize(part) for part in parts_of(path) if is_regular(part)))
    return poses_by_source(MessageDecoder(budget, selection.table, path).poses(messages))


def _peek_channels(part: str, summary: Summary, missing: Mapping[int, Channel]) -> list[RawMessage]:
    """The prefixes of the ``missing`` channels, from the chunks with their messages; each chunk is read
    once."""
    prefixes = {channel: list[RawMessage]() for channel in missing.values()}
    sizes = Counter[Channel]()
    budget = WorkBudget(sum(chunk.chunk_length for chunk in summary.chunk_indexes))

    def is_full(channel: Channel) -> bool:
        """Whether the first messages of a channel are enough: one second of log time, or many."""
        prefix = prefixes[channel]
        is_long = bool(prefix) and prefix[-1].log_time_ns - prefix[0].log_time_ns >= PREFIX_NS
        return is_long or len(prefix) >= PREFIX_MESSAGES or sizes[channel] >= BUFFER_BYTES

    with open_stream(part, budget=budget) as stream:
        loop = RecordLoop(stream, lambda text: None, prefixes.__contains__, summary)
        for chunk in sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset):
            channels = [missing[i] for i in missing.keys() & chunk.message_index_offsets.keys()]
            if sizes.total() >= 4 * BUFFER_BYTES or all(map(is_full, channels)):
                continue
            for item in loop.items_of(chunk):
                if isinstance(item, RawMessage) and not is_full(item.channel):
                    prefixes[item.channel].append(item)
                    sizes[item.channel] += len(item.data)
    return [message for prefix in prefixes.values() for message in prefix]


def take_prefix(groups: Iterator[Sequence[LoggedPose]]) -> list[LoggedPose]:
    """The poses of the next messages or rows, up to one second of log time, or many; empty at the end."""
    prefix = list[LoggedPose]()
    for count, group in enumerate(groups, 1):
        prefix += group
        is_long = count >= PREFIX_MESSAGES or len(prefix) >= ROWS_AT_ONCE
        if prefix and (is_long or prefix[-1][2] - prefix[0][2] >= PREFIX_NS):
            break
    return prefix


def poses_by_source(logged: Iterable[LoggedPose]) -> dict[PoseSource, list[Logged]]:
    """The poses by source."""
    poses: dict[PoseSource, list[Logged]] = {}
    for source, pose, log_time_ns in logged:
        poses.setdefault(source, []).append((pose, log_time_ns))
    return poses


def only_one(path: str, sources: Iterable[PoseSource], hint: str = "") -> PoseSource:
    """The only source; raises AmbiguousSource, which lists them, if there are several; ``hint`` names
    alternatives."""
    source, *further = sources
    if further:
        listing = _listing(map(str, sorted({source, *further})), "; ")
        raise AmbiguousSource(
            f"{path} holds several pose sources, choose by --topic or --frame{hint}: {listing}"
        )
    return source


def without_frame(
    path: str, lacking: str, name: str, sources: Iterable[PoseSource], hint: str = ""
) -> ChoiceError:
    """The error if no source has a frame, which is ``lacking`` in words and ``name`` as stated; ``hint`` says
    how to get its poses nevertheless."""
    listed = sorted(sources)
    names = [text for s in listed for text in (s.topic, s.frame_id, s.child_frame_id, s.frames) if text]
    listing = _listing(map(str, listed), "; ")
    advice = hint or suggestion(name, names)
    return ChoiceError(
        f"{path}: no pose source has the frame {lacking}; there is {listing}{advice[:_TEXT_SHOWN]}"
    )


def _fields_in(path: str, channels: Iterable[Channel], table: TableReading) -> str:
    """The fields with poses in messages of unknown types, or without the stated field, with the command that
    reads them; empty if there are none."""
    stated = table.field
    unknown = [channel for channel in channels if stated or not may_have_poses(channel)]
    found = [(channel, *fields_with_poses(channel)) for channel in unknown]
    fields = [(channel, field) for channel, poses, _ in found for field in poses]
    arrays = [(channel, field) for channel, _, array in found for field in array]
    if not (fields or arrays) or stated in [field for _, field in fields + arrays]:
        return ""
    channel, field = (fields or arrays)[0]
    command = replace(table, field=field).command(path, "--topic", channel.topic)
    further = [f"{field} of {c.topic}" for c, field in (fields or arrays)[1:]]
    hint = f"; others are in {_listing(further)}" if further else ""
    lacks = "" if stated is None else f"no messages have poses in the field {stated}; "
    lacks += f"the messages of {channel.topic} ({channel.type})"[:_TEXT_SHOWN]
    if fields:
        return f"{lacks} have poses in the field {field}: read them by {command}{hint}"
    return f"{lacks} have numbers in {field}: if these are poses, read them by {command}{hint}"


def _reasons(channels: Sequence[Channel]) -> str:
    """The message on channels that are not pose sources."""
    reasons = list[str]()
    for channel in channels[:_LISTED]:
        why = f"{channel.type}, which is no pose"
        if not is_readable(channel) or not channel.type:
            how = f"{channel.encoding or 'no encoding'} with {channel.schema_encoding or 'no schema'}"
            why = f"{channel.type or 'of no type'} in {how}"
        reasons.append(f"{channel.topic} is {why}"[:_TEXT_SHOWN])
    if any(map(is_readable, channels)):
        reasons.append(f"poses are {USUAL}")
    if not all(map(is_readable, channels)):
        reasons.append(f"only {READ} with their schemas are read: record or convert it so")
    if any(channel.schema_encoding == "ros2idl" for channel in channels):
        reasons.append("definitions in IDL are not read: record the types with ros2msg definitions")
    return "; ".join(reasons)


def _listing(texts: Iterable[str], separator: str = ", ") -> str:
    all_texts = [text[:_TEXT_SHOWN] for text in texts]
    hidden = len(all_texts) - _LISTED
    return separator.join(all_texts[:_LISTED]) + (f"{separator}and {hidden} more" if hidden > 0 else "")
