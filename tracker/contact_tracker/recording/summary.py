"""Summary of a recording for ``contact-tracker info``."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.quantities import RANGE_NS
from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.motion.pose_validation import PoseGate, remark_on_loss
from contact_tracker.motion.poses import BATCH, NO_POSES, Pose, Poses
from contact_tracker.recording.decoding import (
    MessageDecoder,
    Undecodable,
    assumption_text,
    is_row,
    may_have_poses,
)
from contact_tracker.recording.items import BUFFER_BYTES, Attachment, Channel, Metadata, RawMessage
from contact_tracker.recording.log import PoseLog
from contact_tracker.recording.reading import Reading
from contact_tracker.recording.sources import PoseSource
from contact_tracker.recording.stamping import PREFIX_MESSAGES, PREFIX_NS, Logged, Stamping

SOURCES_KEPT: Final = 256
BEGINNING_S: Final = 30.0
BEGINNING_NS: Final = round(BEGINNING_S * 1e9)
BEGINNING_POSES: Final = 20_000
KEPT_POSES: Final = 200_000
"""Limit for all sources together."""
_SAMPLE: Final = 50_000
_MAD_TO_SIGMA: Final = 1.4826


@dataclass(frozen=True)
class SourceSummary:
    """Summary of one pose source; figures are nan or None where too few poses are valid.

    Parameters
    ----------
    poses, observed : numbers of valid and of published poses.
    first_ns, last_ns : stamps of the first and last valid pose.
    median_rate_hz, jitter_s : of the time between poses; jitter is its robust standard deviation.
    counts : what the gate dropped, repaired or noted, by kind (including ``gap`` and ``held``).
    log_offset_s : median of log time minus header stamp.
    path_m, extent_m : length of the path of the body's origin, and its range along each world axis.
    loss : one line if most poses were dropped.
    beginning : the first valid poses, ``BEGINNING_S`` at most.
    sigma_position_m, sigma_rotation_rad : estimated sensor noise; filled in by the caller.
    """

    source: PoseSource
    poses: int
    observed: int
    first_ns: int | None
    last_ns: int | None
    median_rate_hz: float
    jitter_s: float
    counts: Mapping[str, int]
    log_offset_s: float
    path_m: float
    extent_m: tuple[float, float, float]
    loss: str | None = None
    beginning: Poses = field(default=NO_POSES, compare=False, repr=False)
    sigma_position_m: float | None = None
    sigma_rotation_rad: float | None = None

    @property
    def duration_s(self) -> float:
        if self.first_ns is None or self.last_ns is None:
            return float("nan")
        return (self.last_ns - self.first_ns) * 1e-9


@dataclass(frozen=True)
class RecordingSummary:
    """Summary of a recording.

    Parameters
    ----------
    sources : the pose sources, at most ``SOURCES_KEPT``, in the order of their names.
    more_sources : whether there are more.
    topics : messages by (topic, type, encoding), of all topics.
    metadata : records by name. attachments : their names.
    undecodable : number of messages of pose topics that do not match their schema.
    damage : one line if it is truncated or damaged.
    assumptions : one line for each source whose type the file does not define usably, and for a guessed time
        unit.
    """

    sources: tuple[SourceSummary, ...]
    topics: Mapping[tuple[str, str, str], int]
    metadata: Mapping[str, Mapping[str, str]]
    attachments: tuple[str, ...]
    undecodable: int
    damage: str | None
    more_sources: bool = False
    assumptions: tuple[str, ...] = ()


def summarise(path: str, table: TableReading = AS_NAMED) -> RecordingSummary:
    """Read a whole recording once, in bounded memory; ``table`` is that of ``open_log``.

    Raises
    ------
    UnreadableRecording
        No such file, or not MCAP.
    """
    topics: Counter[Channel] = Counter()
    metadata: dict[str, Mapping[str, str]] = {}
    attachments: list[str] = []
    reading = Reading(path, lambda channel: True, table=table)
    tallies = _Tallies(MessageDecoder(reading.budget))
    for item in reading:
        match item:
            case Metadata(name, values):
                metadata[name] = values
            case Attachment(name, _):
                attachments.append(name)
            case RawMessage(channel, _, _):
                topics[channel] += 1
                tallies.add(item)
    sources = tallies.finish()
    by_topic: Counter[tuple[str, str, str]] = Counter()
    for channel, count in topics.items():
        by_topic[channel.topic, channel.type, channel.encoding] += count
    return RecordingSummary(
        sources,
        by_topic,
        metadata,
        tuple(attachments),
        tallies.undecodable,
        reading.damage,
        tallies.more_sources,
        (*tallies.assumptions, *filter(None, [reading.assumption])),
    )


def summarise_log(log: PoseLog) -> SourceSummary:
    """Summary of the poses that a log selects, which may be composed; reads it to its end."""
    tallies = _Tallies(log.decoder)
    for message in log.messages():
        tallies.add(message)
    (found,) = (one for one in tallies.finish() if one.source == log.source)
    return replace(found, source=log.source, counts=Counter(found.counts) + Counter(log.counts))


class _Tallies:
    """Running figures of all sources; messages are buffered to many of a channel."""

    def __init__(self, decoder: MessageDecoder) -> None:
        self.undecodable = 0
        self.more_sources = False
        self._decoder = decoder
        self._current: Channel | None = None
        self._has_poses = False
        self._waiting: dict[Channel, list[RawMessage]] = {}
        self._waiting_bytes = 0
        self._tallies: dict[PoseSource, _Tally] = {}
        self._kept = 0
        self._assumed: dict[PoseSource, str] = {}

    def add(self, message: RawMessage) -> None:
        channel = message.channel
        if channel is not self._current:
            self._current, self._has_poses = channel, may_have_poses(channel)
        if not self._has_poses:
            return
        waiting = self._waiting.setdefault(channel, [])
        waiting.append(message)
        self._waiting_bytes += len(message.data)
        if self._waiting_bytes >= BUFFER_BYTES:
            self._tally_all()
        elif len(waiting) == BATCH:
            self._waiting_bytes -= sum(len(one.data) for one in waiting)
            self._tally(self._waiting.pop(channel))

    def _tally_all(self) -> None:
        while self._waiting:
            self._tally(self._waiting.pop(next(iter(self._waiting))))
        self._waiting_bytes = 0

    def finish(self) -> tuple[SourceSummary, ...]:
        self._tally_all()
        return tuple(self._tallies[source].summary(source) for source in sorted(self._tallies))

    @property
    def assumptions(self) -> tuple[str, ...]:
        """One line for each source read by a known definition."""
        return tuple(
            f"{source.topic}: {assumption_text(self._tallies[source].observed, source.type, why)}"
            for source, why in sorted(self._assumed.items())
        )

    def _tally(self, messages: list[RawMessage]) -> None:
        """Add messages of one channel."""
        channel = messages[0].channel
        columns = self._decoder.observe_all(messages)
        if columns is not None:
            source = PoseSource(channel.topic, channel.type, columns.frame_id, columns.child_frame_id)
            log_times_ns = [message.log_time_ns for message in messages]
            self._add(source, columns.poses, log_times_ns, channel)
            return
        observed = dict[PoseSource, list[Logged]]()
        for message in messages:
            try:
                observations = self._decoder.observe(message)
            except Undecodable:
                self.undecodable += 1
                continue
            for frame_id, child_frame_id, pose in observations:
                source = PoseSource(channel.topic, channel.type, frame_id, child_frame_id)
                observed.setdefault(source, []).append((pose, message.log_time_ns))
        for source, logged in observed.items():
            poses, log_times_ns = [pose for pose, _ in logged], [log_time_ns for _, log_time_ns in logged]
            self._add(source, poses, log_times_ns, channel)

    def _add(
        self, source: PoseSource, poses: Poses | list[Pose], log_times_ns: list[int], channel: Channel
    ) -> None:
        tally = self._tallies.get(source)
        if tally is None:
            if len(self._tallies) >= SOURCES_KEPT:
                self.more_sources = True
                return
            tally = self._tallies[source] = _Tally(is_row(channel))
        why = self._decoder.assumption(channel)
        if why is not None:
            self._assumed[source] = why
            tally.counts["known_definition"] += len(poses)
        kept = tally.kept
        tally.add(poses, log_times_ns, keep=self._kept < KEPT_POSES)
        self._kept += tally.kept - kept


class _Sample:
    """A regular sample of a stream of integers; when full, every second one is dropped and the stride
    doubles."""

    def __init__(self) -> None:
        self.values = np.zeros(0, np.int64)
        self._stride = 1
        self._seen = 0

    def add(self, values: NDArray[np.int64]) -> None:
        """Add at most ``_SAMPLE`` values."""
        self.values = np.append(self.values, values[-self._seen % self._stride :: self._stride])
        self._seen += len(values)
        while len(self.values) > _SAMPLE:
            self.values = self.values[::2]
            self._stride *= 2


class _Tally:
    """Running figures of one source, with ``kept`` poses of its beginning and the number ``observed``.

    ``of_rows``: its messages are rows, all of which have a stamp.
    """

    def __init__(self, of_rows: bool) -> None:
        self._of_rows = of_rows
        self.counts: Counter[str] = Counter()
        self.kept = 0
        self._gate = PoseGate(self.counts)
        self.observed = 0
        self._prefix: list[Logged] = []
        self._stamping: Stamping | None = None
        self._poses = 0
        self._beginning: list[Poses] = []
        self._first_ns = 0
        self._last = NO_POSES
        self._steps_ns = _Sample()
        self._offsets_ns = _Sample()
        self._path_m = 0.0
        self._low_m = np.full(3, np.inf)
        self._high_m = np.full(3, -np.inf)

    def add(self, observed: Poses | list[Pose], log_times_ns: list[int], keep: bool) -> None:
        """Add poses; the first are buffered until their stamping is determined."""
        self.observed += len(observed)
        if isinstance(observed, Poses):
            self._note_offsets(observed.stamp_ns, log_times_ns)
        else:
            self._note_offsets(np.array([_clipped(pose.stamp_ns) for pose in observed]), log_times_ns)
        noted, at = list[Pose](), 0
        while self._stamping is None and at < len(observed):
            (pose,) = observed[at : at + 1]
            self._prefix.append((pose, log_times_ns[at]))
            at += 1
            if len(self._prefix) == PREFIX_MESSAGES or log_times_ns[at - 1] - self._prefix[0][1] >= PREFIX_NS:
                noted = self._admit_prefix()
        self._note(Poses.collect(noted), keep)
        if self._stamping is not None and at < len(observed):
            self._note(self._admit_all(self._stamping, observed[at:], log_times_ns[at:]), keep)

    def _admit_all(
        self, stamping: Stamping, observed: Poses | list[Pose], log_times_ns: Sequence[int]
    ) -> Poses:
        """The valid ones of some poses: in columns if nothing has to be decided for single ones."""
        columns = _in_columns(observed)
        if columns is not None and not stamping.by_log_time and columns.stamp_ns.all():
            admitted = self._gate.admit_all(columns)
            if admitted is not None:
                return admitted
        logged = zip(observed, log_times_ns, strict=True)
        return Poses.collect(pose for one in logged for pose in self._admit(stamping, *one))

    def _note_offsets(self, stamp_ns: NDArray[np.int64], log_times_ns: list[int]) -> None:
        log_ns = np.array([_clipped(time) for time in log_times_ns], np.int64)
        self._offsets_ns.add(log_ns - np.clip(stamp_ns, -RANGE_NS, RANGE_NS))

    def _admit_prefix(self) -> list[Pose]:
        self._stamping = Stamping(() if self._of_rows else self._prefix)
        admitted = [pose for logged in self._prefix for pose in self._admit(self._stamping, *logged)]
        self._prefix = []
        return admitted

    def _admit(self, stamping: Stamping, observed: Pose, log_time_ns: int) -> Sequence[Pose]:
        if stamping.lacks_stamp(observed.stamp_ns, log_time_ns):
            self.counts["log_time_as_stamp"] += 1
            observed = observed._replace(stamp_ns=stamping.from_log_time(log_time_ns))
        return self._gate.admit(observed)

    def _note(self, poses: Poses, keep: bool) -> None:
        """Add valid poses."""
        if not len(poses):
            return
        if not self._poses:
            self._first_ns = int(poses.stamp_ns[0])
        self._poses += len(poses)
        joined = Poses.join([self._last, poses])
        self._steps_ns.add(np.diff(joined.stamp_ns))
        self._path_m += float(np.linalg.norm(np.diff(joined.position_m, axis=0), axis=1).sum())
        self._low_m = np.minimum(self._low_m, poses.position_m.min(axis=0))
        self._high_m = np.maximum(self._high_m, poses.position_m.max(axis=0))
        self._last = joined[-1:]
        early = poses[: np.searchsorted(poses.stamp_ns, self._first_ns + BEGINNING_NS)] if keep else NO_POSES
        if len(early) and self.kept < BEGINNING_POSES:
            self._beginning.append(early)
            self.kept += len(early)

    def summary(self, source: PoseSource) -> SourceSummary:
        if self._stamping is None:
            self._note(Poses.collect(self._admit_prefix()), keep=True)
        self._note(Poses.collect(self._gate.finish()), keep=True)
        nan = float("nan")
        steps = self._steps_ns.values
        period_ns = float(np.median(steps)) if len(steps) else nan
        jitter_ns = _MAD_TO_SIGMA * float(np.median(np.abs(steps - period_ns))) if len(steps) else nan
        x, y, z = (self._high_m - self._low_m).tolist() if self._poses else (nan, nan, nan)
        return SourceSummary(
            source=source,
            poses=self._poses,
            observed=self.observed,
            first_ns=self._first_ns if self._poses else None,
            last_ns=int(self._last.stamp_ns[0]) if self._poses else None,
            median_rate_hz=1e9 / period_ns,
            jitter_s=jitter_ns * 1e-9,
            counts=dict(self.counts),
            log_offset_s=float(np.median(self._offsets_ns.values)) * 1e-9,
            path_m=self._path_m,
            extent_m=(x, y, z),
            loss=remark_on_loss(self.counts, self.observed, self._gate.refused_xyzw),
            beginning=Poses.join(self._beginning),
        )


def _in_columns(poses: Poses | list[Pose]) -> Poses | None:
    """The poses in columns; None where a stamp is beyond those of poses."""
    if isinstance(poses, Poses):
        return poses
    return Poses.collect(poses) if all(abs(pose.stamp_ns) <= RANGE_NS for pose in poses) else None


def _clipped(time_ns: int) -> int:
    return max(min(time_ns, RANGE_NS), -RANGE_NS)
