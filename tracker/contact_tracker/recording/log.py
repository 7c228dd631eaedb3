"""A recording as a stream of validated poses of one source, and its summary for ``contact-tracker info``."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, islice
from types import MappingProxyType
from typing import Final

import numpy as np
from mcap.records import Attachment, Metadata
from numpy.typing import NDArray

from contact_tracker.config.quantities import RANGE_NS
from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import ChoiceError, MissingExtra, NoPoses, UnreadableRecording
from contact_tracker.motion.losses import counts_text, remark_on_excursions, remark_on_loss, remarks_on
from contact_tracker.motion.pose_validation import Arrival, PoseGate
from contact_tracker.motion.poses import BATCH, NO_POSES, Pose, Poses
from contact_tracker.recording.bytestream import Follow
from contact_tracker.recording.decoding import LoggedPose, assumption_text
from contact_tracker.recording.items import ROWS, Item, PoseSource, RawMessage, Rows
from contact_tracker.recording.reading import STDIN, Reading
from contact_tracker.recording.sources import (
    PREFIX_MESSAGES,
    PREFIX_NS,
    ChannelFilter,
    Logged,
    Stamping,
    only_one,
    peek,
    poses_by_source,
    take_prefix,
    without_frame,
)
from contact_tracker.recording.transforms import (
    ARROW,
    Composer,
    composition_hint,
    find_chain,
    last_moving,
    moving_parent_note,
    relative_hint,
)

_MOST_HEAD: Final = 200_000
"""Most poses that are buffered until the requested frames are connected."""
_LATE: Final = 8
"""Largest number of late sources that are named."""
_SEVERAL: Final = "time runs backward in it; if its files are recordings of their own, name one"
_FOREVER_NS: Final = 2**63


class PoseLog:
    """Iterate once for the poses of one source while they are read, in bounded memory.

    Attributes
    ----------
    source : the source of the poses.
    first : the first pose of the source, valid or not, and its log time (ns).
    note : one line if the parent frame of the poses may itself move.
    gate : validates the poses.
    stamping : gives the poses their stamps.
    is_stamped : whether all stamps are valid even if zero, as in tables and of composed poses.
    late_sources : matching sources that appeared after this one was chosen.
    counts : numbers of dropped or repaired poses so far, by kind: the kinds of ``motion.pose_validation`` and
        ``undecodable`` (messages), ``known_definition`` (poses of messages with an unusable definition in the
        file), ``other_source`` (poses of late sources),
        ``log_time_as_stamp`` (poses whose header has no time, see ``contact_tracker.recording.sources``).
    origin_ns : stamp of the recording's first valid pose, even if it is not selected.
    valid, first_ns, last_ns : number of poses yielded so far, and the stamps of the first and the last.
    damage : one line if most poses were dropped, or the recording is truncated or damaged; final after
        iteration.

    Iteration raises AmbiguousSource if another matching source appears, unless its poses are counted.
    """

    def __init__(
        self,
        source: PoseSource,
        reading: Reading,
        logged: Iterator[LoggedPose],
        prefix: Sequence[Logged],
        frame: str | None = None,
        count_late: bool = False,
        composer: Composer | None = None,
        note: str | None = None,
    ) -> None:
        self.source, self.note, self.first = source, note, prefix[0]
        self.late_sources: tuple[PoseSource, ...] = ()
        self.stamping = Stamping.by(prefix)
        self.is_stamped = reading.is_table or composer is not None
        self._counts = reading.decoder.counts
        self.gate, self._is_resumed = PoseGate(self._counts), False
        self._taken = self._skipped = 0
        self.origin_ns = self.first_ns = self.last_ns = self.valid = 0
        self._start_ns, self._end_ns = 0, _FOREVER_NS
        self._read_ns: int | None = None  # time of the last pose, since the first one
        self._reading, self._composer, self._logged = reading, composer, logged
        self._frame, self._count_late = frame, count_late
        self._assumed: PoseSource | None = None  # of the poses that are read by a known definition
        self._arrivals = self._arrive()

    @property
    def counts(self) -> Mapping[str, int]:
        composed = self._composer.counts if self._composer is not None else Counter[str]()
        return MappingProxyType(self._counts + composed if composed else self._counts)

    @property
    def loss(self) -> str | None:
        """One line with the likely cause if most poses were dropped; None for a log that was carried on."""
        return None if self._is_resumed else remark_on_loss(self.counts, self.taken, self.gate.refused_xyzw)

    def no_poses(self, name: str) -> NoPoses | ChoiceError:
        """The error if no pose of the recording ``name`` is valid, or in the interval."""
        reason = "" if self.loss is None else f": {self.loss}"
        noted = counts_text(self.counts)
        noted = noted and f"; noted: {noted}"
        if self._read_ns is None:
            return NoPoses(f"{name}: no pose that can be used{reason}{noted}")
        return ChoiceError(
            f"{name}: no pose in the interval of --start and --duration; poses were read until "
            f"{self._read_ns * 1e-9:.2f} s{noted}"
        )

    @property
    def damage(self) -> str | None:
        return "; ".join(filter(None, (self.loss, self._reading.notes.damage))) or None

    @property
    def remarks(self) -> tuple[str, ...]:
        """One line each: the known definition of a type replaced that of the file, or the time unit is a
        guess; many poses are out of order (not for a log that was carried on); a folder's clock was reset."""
        counts, assumed = self.counts, self._reading.notes.assumption
        if self._assumed is not None:
            assumed = assumption_text(counts["known_definition"], self._assumed)
        doubts = (remark_on_excursions(counts),) if self._is_resumed else remarks_on(counts, self.taken)
        is_reset = counts.get("clock_reset") and self._reading.is_folder
        return tuple(filter(None, (assumed, *doubts, _SEVERAL if is_reset else None)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """All doubts about the poses, one line each, the damage first; final after iteration."""
        return tuple(filter(None, (self.damage, self.note, *self.remarks)))

    @property
    def taken(self) -> int:
        """Number of poses of the log that have been read, valid or not, here or before it was carried on."""
        return max(self._taken, self._skipped)

    @property
    def first_stamp_ns(self) -> int:
        """The stamp of the first pose."""
        return self._assigned.stamped(*self.first, Counter()).stamp_ns

    @property
    def _assigned(self) -> Stamping:
        """The rule for stamps, if these are not assigned yet."""
        return Stamping() if self.is_stamped else self.stamping

    def select(self, start_s: float, duration_s: float | None) -> None:
        """Select the poses of an interval, in seconds since the first pose; to the end without a duration."""
        self._start_ns = round(start_s * 1e9)
        self._end_ns = _FOREVER_NS if duration_s is None else self._start_ns + round(duration_s * 1e9)

    def carry_on(
        self, gate: PoseGate, stamping: Stamping, taken: int, is_same_log: bool, span: tuple[int, ...]
    ) -> None:
        """Continue, before the first pose, where another reading of the source has stopped.

        ``taken`` poses went through ``gate`` with ``stamping``; in the same log they are skipped. ``span`` is
        ``origin_ns``, ``first_ns``, ``last_ns`` and ``valid``.
        """
        gate.counts.update(self._counts)
        self.gate, self._counts = gate, gate.counts
        self._reading.decoder.counts = gate.counts
        self.origin_ns, self.first_ns, self.last_ns, self.valid = span
        self._is_resumed = True
        if is_same_log:
            self.stamping, self._skipped = stamping, taken

    def __iter__(self) -> Iterator[Pose]:
        return (pose for arrival in self._arrivals for pose in arrival.poses)

    def arrivals(self) -> Iterator[Arrival]:
        """The poses and the gate's decision for each measured pose, instead of the poses alone."""
        return self._arrivals

    def _arrive(self) -> Iterator[Arrival]:
        stamping = self._assigned
        arrivals = (self.gate.arrive(stamping.stamped(*logged, self._counts)) for logged in self._own())
        for arrival in chain(arrivals, map(PoseGate.end, [self.gate])):
            rows, has_ended = self._cut([pose.stamp_ns for pose in arrival.poses])
            poses = arrival.poses[rows]
            yield Arrival(poses, None, None) if has_ended else arrival._replace(poses=poses)
            if has_ended:
                return

    def batches(self) -> Iterator[Poses]:
        """The poses in columns, many at once; with more delay than iteration."""
        for poses in self._admitted():
            rows, has_ended = self._cut(poses.stamp_ns)
            if rows.start < rows.stop:
                yield poses[rows]
            if has_ended:
                return

    def _admitted(self) -> Iterator[Poses]:
        poses, stamping = self._own(), self._assigned
        while logged := list(islice(poses, BATCH)):
            yield stamping.admitted(self.gate, logged)
        yield Poses.collect(self.gate.finish())

    def _cut(self, stamp_ns: Sequence[int] | NDArray[np.int64]) -> tuple[slice, bool]:
        """The rows of the next poses within the interval, which are counted, and whether the interval is
        over."""
        count = len(stamp_ns)
        if not count:
            return slice(0, 0), False
        if self._read_ns is None and not self.valid:
            self.origin_ns = int(stamp_ns[0])
        self._read_ns = int(stamp_ns[-1]) - self.origin_ns
        begin = bisect_left(stamp_ns, self.origin_ns + self._start_ns)
        end = bisect_left(stamp_ns, self.origin_ns + self._end_ns)
        if begin < end:
            self.first_ns = self.first_ns if self.valid else int(stamp_ns[begin])
            self.valid += end - begin
            self.last_ns = int(stamp_ns[end - 1])
        return slice(begin, end), end < count

    def _own(self) -> Iterator[Logged]:
        """The poses of the source after the skipped ones; those of others are counted."""
        for source, pose, log_time_ns in self._logged:
            if source != self.source:
                self._note_other(source)
                continue
            self._taken += 1
            if self._taken > self._skipped:
                if source.assumed:
                    self._assumed = source
                    self._counts["known_definition"] += 1
                yield pose, log_time_ns

    def _note_other(self, source: PoseSource) -> None:
        """Note a pose of another matching source, or of the same body in another parent frame."""
        fits = self._frame is None or source.is_named(self._frame)
        if not fits and (not source.child_frame_id or source.child_frame_id != self.source.child_frame_id):
            return
        if fits and not self._count_late:
            only_one(self._reading.path, [self.source, source])
        self._counts["other_source"] += 1
        if source not in self.late_sources and len(self.late_sources) < _LATE:
            self.late_sources = (*self.late_sources, source)


def open_log(
    path: str,
    topic: str | None = None,
    frame: str | None = None,
    follow: Follow | None = None,
    count_late: bool = False,
    relative_to: str | None = None,
    table: TableReading = AS_NAMED,
) -> PoseLog:
    """Open the poses of a recording.

    Parameters
    ----------
    path : MCAP file, ROS bag, table, folder of rosbag2 parts, or ``-`` for standard input.
    topic : only poses from this topic; ``/topic:TYPE`` if it has several types.
    frame : only poses of this frame: ``parent->child``, the child, or, for types without child, the header's
        frame. If nothing is published from parent to child, transforms between them are composed.
    follow : continue reading while the file grows, until it is finished or ``follow.stop()`` is called.
    count_late : whether poses of a matching source that appears later are counted, as they are with
        ``follow``; else iteration ends with AmbiguousSource.
    relative_to : a frame, or another body (its topic, or its name in a file of several bodies), that replaces
        the header's frame.
    table : how the columns of a table are read, or the field of messages with the poses, if names and types
        do not decide it.

    Raises
    ------
    UnreadableRecording
        No such file, not MCAP, or damaged before the first pose.
    NoPoses
        It has no pose of a known type and encoding.
    ChoiceError
        None matches ``topic``, ``frame`` and ``relative_to``, or ``table`` or ``follow`` does not fit.
    AmbiguousSource
        Several sources match.
    """
    is_chain = relative_to is not None or (frame is not None and ARROW in frame)
    selection = ChannelFilter(topic, table, is_chain, relative_to)
    reading = Reading(path, selection, follow, table)
    groups = reading.decoder.groups(reading)
    count_late = count_late or follow is not None
    sources = {} if follow else peek(path, selection)
    all_sources = dict(sources)
    head = list[LoggedPose]()
    while True:
        fitting = [s for s in sources if selection.takes(s) and (frame is None or s.is_named(frame))]
        logged = chain(head, chain.from_iterable(groups))
        if fitting and relative_to is None:
            source = only_one(path, fitting, composition_hint(fitting))
            source = replace(source, messages=selection.counts.get(source.topic))
            note, prefix, around = None, sources[source], set(all_sources)
            if source.frame_id and not (frame == source.frames and is_chain):
                with suppress(NoPoses, MissingExtra):
                    if follow is None:
                        around |= peek(path, ChannelFilter(None, with_transforms=True)).keys()
                note = moving_parent_note(around, source)
            return PoseLog(source, reading, logged, prefix, frame, count_late, None, note)
        composition = find_chain(path, all_sources, fitting, frame, relative_to)
        if composition is not None:
            steps, source = composition
            at_once = 1 if follow is not None or path == STDIN else BATCH
            learned = {} if reading.is_table else all_sources
            composer = Composer(steps, source, at_once, learned)
            prefix, composed = all_sources[steps[last_moving(steps)].source], composer.compose(logged)
            return PoseLog(source, reading, composed, prefix, None, count_late, composer)
        following = take_prefix(groups)
        head = [*head, *following] if is_chain else following
        if not following or len(head) > _MOST_HEAD:
            raise _explain(path, frame, set(all_sources), selection, reading.notes.damage)
        sources = poses_by_source(following)
        all_sources = {**sources, **all_sources}


def list_sources(path: str, table: TableReading = AS_NAMED) -> list[PoseSource]:
    """The pose sources of a recording, found as by ``open_log``, which for ``-`` consumes its start; raises
    UnreadableRecording if there is no such file, or it is no recording."""
    selection = ChannelFilter(None, table)
    try:
        sources = peek(path, selection)
    except NoPoses:
        return []
    if not sources:
        reading = Reading(path, selection, table=table)
        sources = poses_by_source(take_prefix(reading.decoder.groups(reading)))
    return [replace(source, messages=selection.counts.get(source.topic)) for source in sorted(sources)]


def _explain(
    path: str, frame: str | None, sources: set[PoseSource], selection: ChannelFilter, damage: str | None
) -> Exception:
    """The error if no pose is selected."""
    relative_to = selection.relative_to
    is_named = frame is None or any(source.is_named(frame) for source in sources)
    if sources and relative_to is not None and is_named:
        return without_frame(path, f"that leads to {relative_to}", relative_to, sources)
    if sources and frame is not None:
        hint = relative_hint(path, sources, frame) if relative_to is None else ""
        if not any(source.frames for source in sources) and len(sources) == 1:
            hint = "; it has no frame: leave out --frame"
        return without_frame(path, frame, frame, sources, hint)
    if damage is not None:
        return UnreadableRecording(f"{path}: no pose can be read: {damage}")
    return selection.nothing_found(path)


SOURCES_KEPT: Final = 256
BEGINNING_S: Final = 30.0
BEGINNING_NS: Final = round(BEGINNING_S * 1e9)
BEGINNING_POSES: Final = 20_000
KEPT_POSES: Final = 200_000
"""Most poses in the beginnings of all sources together."""
_SAMPLE: Final = 50_000
_MAD_TO_SIGMA: Final = 1.4826


class _Sample:
    """A regular sample of a stream of integers; when full, every second one is dropped and the stride
    doubles."""

    def __init__(self) -> None:
        self.values, self._stride, self._seen = np.zeros(0, np.int64), 1, 0

    def add(self, values: NDArray[np.int64]) -> None:
        """Add at most ``_SAMPLE`` values."""
        self.values = np.append(self.values, values[-self._seen % self._stride :: self._stride])
        self._seen += len(values)
        while len(self.values) > _SAMPLE:
            self.values, self._stride = self.values[::2], 2 * self._stride


class SourceSummary:
    """Figures of one pose source, complete after ``finish``; nan or None if too few poses are valid.

    Attributes
    ----------
    poses, observed : numbers of valid and of published poses.
    first_ns, last_ns : stamps of the first and last valid pose.
    rate_hz, jitter_s : rate by the mean period without gaps, and robust standard deviation of the periods.
    counts : numbers of dropped, repaired or noted poses, by kind (including ``gap`` and ``held``).
    log_offset_s : median of log time minus header stamp.
    path_m, extent_m : length of the path of the body's origin, and its range along each world axis.
    loss : one line if most poses were dropped.
    beginning : the first valid poses, ``BEGINNING_S`` at most, as long as ``has_room``.
    """

    def __init__(self, source: PoseSource, is_stamped: bool, has_room: Callable[[], bool]) -> None:
        self.source, self.counts, self._has_room = source, Counter[str](), has_room
        self.poses = self.observed = 0
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self.path_m, self.beginning = 0.0, NO_POSES
        self._gate = PoseGate(self.counts)
        self._stamping = Stamping() if is_stamped else None
        self._waiting, self._last = list[Logged](), NO_POSES
        self._steps_ns, self._offsets_ns = _Sample(), _Sample()
        self._low_m, self._high_m = np.full(3, np.inf), np.full(3, -np.inf)

    @property
    def duration_s(self) -> float:
        if self.first_ns is None or self.last_ns is None:
            return float("nan")
        return (self.last_ns - self.first_ns) * 1e-9

    def add(self, pose: Pose, log_time_ns: int) -> None:
        """Add a pose; the first poses are buffered until their stamping is determined."""
        self.observed += 1
        self._waiting.append((pose, log_time_ns))
        span_ns, count = log_time_ns - self._waiting[0][1], len(self._waiting)
        is_prefix = span_ns >= PREFIX_NS or count >= PREFIX_MESSAGES
        if is_prefix if self._stamping is None else count == BATCH:
            self._admit()

    def finish(self) -> "SourceSummary":
        """Add the buffered poses, and compute the figures of all poses."""
        if self._waiting:
            self._admit()
        self._note(Poses.collect(self._gate.finish()))
        nan, steps = float("nan"), self._steps_ns.values
        median_ns = float(np.median(steps)) if len(steps) else nan
        jitter_ns = _MAD_TO_SIGMA * float(np.median(np.abs(steps - median_ns))) if len(steps) else nan
        # of rounded stamps the median period is off; a step nearer to none or two periods is no period
        periods_ns = steps[np.abs(steps - median_ns) < 0.5 * median_ns]
        self.rate_hz = 1e9 / float(np.mean(periods_ns)) if len(periods_ns) else nan
        self.jitter_s = jitter_ns * 1e-9
        self.log_offset_s = float(np.median(self._offsets_ns.values)) * 1e-9
        self.extent_m = tuple((self._high_m - self._low_m).tolist()) if self.poses else (nan, nan, nan)
        self.loss = remark_on_loss(self.counts, self.observed, self._gate.refused_xyzw)
        return self

    def _admit(self) -> None:
        waiting, self._waiting = self._waiting, []
        self._stamping = self._stamping or Stamping.by(waiting)
        times_ns = np.array(
            [[max(min(t, RANGE_NS), -RANGE_NS) for t in (log_ns, pose.stamp_ns)] for pose, log_ns in waiting]
        )
        self._offsets_ns.add(times_ns[:, 0] - times_ns[:, 1])
        self._note(self._stamping.admitted(self._gate, waiting))

    def _note(self, poses: Poses) -> None:
        """Add valid poses."""
        if not len(poses):
            return
        self.first_ns = int(poses.stamp_ns[0]) if self.first_ns is None else self.first_ns
        self.last_ns = int(poses.stamp_ns[-1])
        self.poses += len(poses)
        joined = Poses.join([self._last, poses])
        self._steps_ns.add(np.diff(joined.stamp_ns))
        self.path_m += float(np.linalg.norm(np.diff(joined.position_m, axis=0), axis=1).sum())
        self._low_m = np.minimum(self._low_m, poses.position_m.min(axis=0))
        self._high_m = np.maximum(self._high_m, poses.position_m.max(axis=0))
        self._last = joined[-1:]
        early = poses[: np.searchsorted(poses.stamp_ns, self.first_ns + BEGINNING_NS)]
        if len(early) and len(self.beginning) < BEGINNING_POSES and self._has_room():
            self.beginning = Poses.join([self.beginning, early])


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
    damage : one line if the recording is truncated or damaged.
    assumptions : one line for each source with an unusable definition in the file, and for a guessed time
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
    """Read a whole recording once, in bounded memory; ``table`` is as for ``open_log``. Raises
    UnreadableRecording if there is no such file, or it is no recording."""
    topics, attachments = Counter[tuple[str, str, str]](), list[str]()
    metadata: dict[str, Mapping[str, str]] = {}

    def noted(items: Iterable[Item]) -> Iterator[Item]:
        for item in items:
            match item:
                case Metadata(name, values):
                    metadata[name] = values
                case Attachment(name=name):
                    attachments.append(name)
                case RawMessage(channel, _, _):
                    topics[channel.topic, channel.type, channel.encoding] += 1
                case Rows([source, *_], poses):
                    topics[source.topic, source.type, ROWS] += len(poses)
            yield item

    reading = Reading(path, lambda channel: True, table=table)
    logged = reading.decoder.poses(noted(reading))
    sources, more_sources = _summaries(logged, reading.is_table)
    assumptions = [
        f"{summary.source.topic}: {assumption_text(summary.observed, summary.source)}"
        for summary in sources
        if summary.source.assumed
    ]
    assumptions += filter(None, [reading.notes.assumption])
    undecodable = reading.decoder.counts["undecodable"]
    about = topics, metadata, tuple(attachments), undecodable, reading.notes.damage
    return RecordingSummary(sources, *about, more_sources, tuple(assumptions))


def summarise_log(log: PoseLog) -> SourceSummary:
    """Summary of the poses that a log selects, which may be composed; reads it to its end."""
    sources, _ = _summaries(log._logged, log.is_stamped)
    (summary,) = (candidate for candidate in sources if candidate.source == log.source)
    summary.source = log.source
    summary.counts += Counter(log.counts)
    del summary.counts["undecodable"]  # of all messages
    return summary


def _summaries(logged: Iterable[LoggedPose], is_stamped: bool) -> tuple[tuple[SourceSummary, ...], bool]:
    """The summary of each source, and whether there are more sources."""
    tallies, more_sources = dict[PoseSource, SourceSummary](), False

    def has_room() -> bool:
        return sum(len(tally.beginning) for tally in tallies.values()) < KEPT_POSES

    for source, pose, log_time_ns in logged:
        tally = tallies.get(source)
        if tally is None:
            if len(tallies) >= SOURCES_KEPT:
                more_sources = True
                continue
            tally = tallies[source] = SourceSummary(source, is_stamped, has_room)
        tally.add(pose, log_time_ns)
    for source, tally in tallies.items():
        if source.assumed:
            tally.counts["known_definition"] += tally.observed
    return tuple(tallies[source].finish() for source in sorted(tallies)), more_sources
